"""ONNX models of untrusted files: no other file is read, memory and time are bounded, wrong ends refused."""

import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")
pytest.importorskip("onnxruntime", reason="make extras EXTRAS=learn")

import onnx

from tests.support.policy_files import TWO, looping, onnx_model
from twind.exceptions import InvalidInput
from twind.learn.policy.onnx_session import MEMORY
from twind.learn.policy.policy_file import load, read, save_model


def _external_tensor(location: str) -> Any:
    """An array (7, 2) whose numbers lie at `location`."""
    tensor = onnx.TensorProto(name="w", data_type=1, dims=[7, 2], data_location=onnx.TensorProto.EXTERNAL)
    tensor.external_data.add(key="location", value=location)
    tensor.external_data.add(key="length", value="56")
    return tensor


def _external_model(location: str, *, constant: bool = False, sparse: bool = False) -> Any:
    """A model whose weight lies at `location`: as an initializer, in a node or in a sparse array."""
    model = onnx_model([onnx.helper.make_node("MatMul", ["observation", "w"], ["action"])], {})
    tensor = _external_tensor(location)
    if constant:
        model.graph.node.insert(0, onnx.helper.make_node("Constant", [], ["w"], value=tensor))
    elif sparse:
        tensor.ClearField("dims")
        tensor.dims.append(14)
        at = onnx.numpy_helper.from_array(np.arange(14), "i")
        model.graph.sparse_initializer.append(onnx.SparseTensorProto(values=tensor, indices=at, dims=[7, 2]))
    else:
        model.graph.initializer.append(tensor)
    return model


@pytest.mark.parametrize("kind", ["initializer", "constant", "sparse"])
@pytest.mark.parametrize("place", ["beside", "absolute", "parent", "memory"])
def test_no_array_is_read_from_another_file(
    tmp_path: Path, kind: str, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file exists and has the right size, so that only the refusal keeps it out."""
    (tmp_path / "in").mkdir()
    for folder in (tmp_path, tmp_path / "in"):
        (folder / "secret").write_bytes(np.ones(14, np.float32).tobytes())
    monkeypatch.chdir(tmp_path / "in")
    locations = {"beside": "secret", "absolute": str(tmp_path / "secret"), "parent": "../secret"}
    location = locations.get(place, "*/_ORT_MEM_ADDR_/*")
    model = _external_model(location, **({} if kind == "initializer" else {kind: True}))
    save_model("p.onnx", model, TWO)
    with pytest.raises(InvalidInput, match="no ONNX model that can be run"):
        load("p.onnx")


MATMUL = onnx.helper.make_node("MatMul", ["observation", "w"], ["action"])
WEIGHT = {"w": np.ones((7, 2), np.float32)}


def _changed_model(change: Callable[[Any], None]) -> Any:
    model = onnx_model([MATMUL], WEIGHT)
    change(model)
    return model


def _another_input(model: Any) -> None:
    model.graph.input.append(onnx.helper.make_tensor_value_info("state", 1, [1, 2]))


def _another_output(model: Any) -> None:
    model.graph.node.append(onnx.helper.make_node("Tanh", ["action"], ["state"]))
    model.graph.output.append(onnx.helper.make_tensor_value_info("state", 1, ["batch", 2]))


def _renamed(model: Any) -> None:
    model.graph.input[0].name = "obs"
    model.graph.node[0].input[0] = "obs"


def _undeclared(model: Any) -> None:
    model.graph.input[0].type.tensor_type.ClearField("shape")


def _doubles() -> Any:
    weight = {"w": np.ones((7, 2))}
    return onnx_model([MATMUL], weight, element=onnx.TensorProto.DOUBLE)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (_changed_model(_renamed), "its input is obs, observation alone is needed"),
        (_changed_model(_another_input), "its input is observation, state, observation alone"),
        (_changed_model(_another_output), "its output is action, state, action alone"),
        (_doubles(), r"its input observation is a tensor\(double\), float32 is needed"),
        (
            onnx_model([MATMUL], WEIGHT, count="any"),
            r"the shape \['batch', 'any'\], its card says \(batch, 7\)",
        ),
        (onnx_model([MATMUL], {"w": np.ones((6, 2), np.float32)}, count=6), r"\['batch', 6\], its card says"),
        (onnx_model([MATMUL], WEIGHT, batch=3), r"\[3, 7\], its card says \(batch, 7\)"),
        (_changed_model(_undeclared), r"the shape \[\], its card says"),
        (
            onnx_model([MATMUL], {"w": np.full((7, 2), np.inf, np.float32)}),
            "hip is nan for an observation of zeros",
        ),
        (onnx_model([onnx.helper.make_node("Loop", [], [])], WEIGHT), "no ONNX model that can be run"),
        (
            onnx_model([onnx.helper.make_node("Evil", ["observation"], ["action"], domain="evil")], WEIGHT),
            "evil",
        ),
    ],
)
def test_a_model_that_is_no_policy_is_refused(tmp_path: Path, model: Any, message: str) -> None:
    save_model(tmp_path / "p.onnx", model, TWO)
    with pytest.raises(InvalidInput, match=message):
        read((tmp_path / "p.onnx").read_bytes())


def test_a_model_without_a_card_is_refused_with_the_way_to_write_one() -> None:
    with pytest.raises(InvalidInput, match=r"no card .*`save_model`"):
        read(onnx_model([MATMUL], WEIGHT).SerializeToString())


def _shapes() -> Any:
    """A shape, joined to itself 30 times: gigabytes from a kilobyte while shapes are worked out."""
    make = onnx.helper.make_node
    nodes = [MATMUL, make("Shape", ["observation"], ["s0"])]
    nodes += [make("Concat", [f"s{at}", f"s{at}"], [f"s{at + 1}"], axis=0) for at in range(30)]
    return onnx_model(nodes, WEIGHT)


def _large() -> Any:
    """An array of 64 GB, made while the network runs."""
    make = onnx.helper.make_node
    nodes = [
        make("ConstantOfShape", ["size"], ["large"]),
        make("ReduceSum", ["large"], ["sum"], keepdims=0),
        make("MatMul", ["observation", "w"], ["a"]),
        make("Add", ["a", "sum"], ["action"]),
    ]
    return onnx_model(nodes, WEIGHT | {"size": np.array([1 << 17, 1 << 17])})


def _empty() -> bytes:
    """Millions of operations of two bytes each, 80 each in memory."""
    count = 7 << 20
    length = b""
    while count:
        count, part = count >> 7, count & 0x7F
        length += bytes([part | (0x80 if count else 0)])
    return b"\x3a" + length + b"\x0a\x00" * (7 << 19)


@pytest.mark.parametrize("make", [_shapes, _large, _empty])
def test_a_model_takes_no_more_memory_than_its_bound(tmp_path: Path, make: Callable[[], Any]) -> None:
    made = make()
    if isinstance(made, bytes):
        (tmp_path / "p.onnx").write_bytes(made)
    else:
        save_model(tmp_path / "p.onnx", made, TWO)
    code = (
        "import re, resource, sys\n"
        "from twind.learn.policy.policy_file import load\n"
        "try: load(sys.argv[1])\n"
        # ru_maxrss of itself would be that of the process it was forked from, if that was larger
        "finally: print(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1], "
        "resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "p.onnx")], capture_output=True, text=True, timeout=60.0
    )
    assert re.search("InvalidInput: .*needs more than 512 MiB of memory", done.stderr), done.stderr[-400:]
    assert max(map(int, done.stdout.split())) << 10 < MEMORY + (150 << 20)


def test_an_inference_that_takes_all_memory_fails_and_leaves_the_process(tmp_path: Path) -> None:
    """The array is as large as the observation asks for; the trial with zeros passes."""
    make = onnx.helper.make_node
    nodes = [
        make("MatMul", ["observation", "w"], ["a"]),
        make("ReduceMax", ["observation"], ["most"], axes=[1], keepdims=0),
        make("Cast", ["most"], ["size"], to=7),
        make("ConstantOfShape", ["size"], ["large"]),
        make("ReduceSum", ["large"], ["sum"], keepdims=0),
        make("Add", ["a", "sum"], ["action"]),
    ]
    save_model(tmp_path / "p.onnx", onnx_model(nodes, WEIGHT), TWO)
    code = (
        "import sys, numpy\n"
        "from twind.learn.policy.onnx_session import limit_memory\n"
        "from twind.learn.policy.policy_file import InvalidInput, load\n"
        "policy = load(sys.argv[1])\n"
        "limit_memory()\n"
        "try: policy.act(numpy.full(7, 1e9, 'f'))\n"
        "except InvalidInput as error: print(error)\n"
        "print(policy.act(numpy.zeros(7, 'f')).tolist())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "p.onnx")], capture_output=True, text=True, timeout=60.0
    )
    expected = (
        "its inference failed: it needs more than 512 MiB of memory, the bound of a policy\n[0.0, 0.0]\n"
    )
    assert done.stdout == expected, done.stderr


def test_a_model_that_never_ends_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twind.learn.policy.policy_file.CHECKED", 3.0)
    save_model(tmp_path / "p.onnx", looping(TWO, always=True), TWO)
    with pytest.raises(InvalidInput, match="not done within 3 s"):
        load(tmp_path / "p.onnx")


def test_an_inference_that_does_not_end_is_ended_and_the_next_one_runs(tmp_path: Path) -> None:
    save_model(tmp_path / "p.onnx", looping(TWO), TWO)
    policy = load(tmp_path / "p.onnx")
    rest = np.zeros(TWO.observations, np.float32)
    with policy.ending_long_inferences():
        began = time.monotonic()
        with pytest.raises(InvalidInput, match="more than 1 s"):
            policy.act(rest + 1.0)
        assert time.monotonic() - began < 10.0
        assert (policy.act(rest) == 0.0).all()
