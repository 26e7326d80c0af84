"""Policy files: what is written is what runs, and a file from elsewhere is checked before it runs."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")
pytest.importorskip("onnxruntime", reason="make extras EXTRAS=learn")

import onnx

from tests.support.doc_pages_text import ROOT
from tests.support.policy_files import TWO, looping, network, plain, written
from twind.exceptions import InvalidInput
from twind.learn.policy.onnx_session import MEMORY
from twind.learn.policy.policy_card import PolicyCard, PolicyRobot, differences, require_fit
from twind.learn.policy.policy_file import NetworkLayer, load, read, save, save_model

BODY = PolicyRobot("two", TWO.joints, TWO.layout, TWO.lower, TWO.upper, TWO.velocity, TWO.acceleration, 100.0)
STORED = ROOT / "tests" / "data" / "policies"
Observations = np.random.default_rng(3).normal(0.0, 1.0, (200, TWO.observations)).astype(np.float32)


def reference(layers: list[NetworkLayer], mean: Any, std: Any, clip: float, observation: Any) -> Any:
    """The action of a network, computed with numpy in double precision."""
    functions = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0), "none": lambda x: x}
    functions["elu"] = lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0)))
    value = np.clip((observation.astype(np.float64) - mean) / std, -clip, clip)
    for layer in layers:
        value = functions[layer.activation](value @ layer.weight.T.astype(np.float64) + layer.bias)
    return np.clip(value, -1.0, 1.0)


def changed(path: Path, change: Callable[[Any], None]) -> Path:
    """The same file with its model changed."""
    model = onnx.load(str(path))
    change(model)
    path.write_bytes(model.SerializeToString())
    return path


def of_card(path: Path, **fields: Any) -> Path:
    """The same file with another card, as a text editor makes it."""

    def edit(model: Any) -> None:
        given = json.loads(model.metadata_props[0].value) | fields
        model.metadata_props[0].value = json.dumps({k: v for k, v in given.items() if v is not ...})

    return changed(path, edit)


# ------------------------------------------------------------------------------------------ written and read


@pytest.mark.parametrize("activation", ["tanh", "relu", "elu", "none"])
def test_a_saved_network_gives_its_actions_for_one_observation_and_for_many(
    tmp_path: Path, activation: str
) -> None:
    rng = np.random.default_rng(1)
    layers = [replace(each, activation=activation) for each in network(TWO)[:-1]] + network(TWO)[-1:]
    mean, std = (rng.uniform(0.5, 2.0, TWO.observations).astype(np.float32) for _ in range(2))
    save(tmp_path / "p.onnx", layers, mean, std, 3.0, TWO)
    policy = load(tmp_path / "p.onnx")
    expected = reference(layers, mean, std, 3.0, Observations)
    assert np.abs(expected).max() == 1.0  # some are clipped, most are not
    assert (np.abs(expected) < 0.99).mean() > 0.3
    np.testing.assert_allclose(policy.act(Observations), expected, atol=2e-6)
    one_by_one = [policy.act(each) for each in Observations]
    np.testing.assert_allclose(one_by_one, expected, atol=2e-6)


@pytest.mark.parametrize("name", ["h24", "two"])
def test_a_stored_file_gives_the_actions_that_were_stored_with_it(name: str) -> None:
    """`two.onnx` has every operation that the first release of the format allowed."""
    policy = load(STORED / f"{name}.onnx")
    stored = np.load(STORED / f"{name}.npz")
    np.testing.assert_allclose(policy.act(stored["observation"]), stored["action"], atol=2e-6)
    np.testing.assert_allclose(policy.act(stored["observation"][0]), stored["action"][0], atol=2e-6)


def _recurrent() -> Any:
    """A GRU beside a skip connection: a branched graph with integer arrays and control flow inside."""
    rng = np.random.default_rng(2)
    hidden = 4
    arrays = {
        "w": rng.normal(0.0, 0.3, (1, 3 * hidden, TWO.observations)).astype(np.float32),
        "r": rng.normal(0.0, 0.3, (1, 3 * hidden, hidden)).astype(np.float32),
        "out": rng.normal(0.0, 0.3, (hidden, 2)).astype(np.float32),
        "skip": rng.normal(0.0, 0.3, (TWO.observations, 2)).astype(np.float32),
        "first": np.array([0]),
    }
    make = onnx.helper.make_node
    nodes = [
        make("Unsqueeze", ["observation", "first"], ["sequence"]),
        make("GRU", ["sequence", "w", "r"], ["", "state"], hidden_size=hidden),
        make("Squeeze", ["state", "first"], ["last"]),
        make("MatMul", ["last", "out"], ["a"]),
        make("MatMul", ["observation", "skip"], ["b"]),
        make("Add", ["a", "b"], ["sum"]),
        make("Tanh", ["sum"], ["action"]),
    ]
    return _model(nodes, arrays)


def _model(
    nodes: list[Any], arrays: dict[str, Any], batch: Any = "batch", count: Any = 7, **more: Any
) -> Any:
    ends = [
        onnx.helper.make_tensor_value_info(name, more.get("element", onnx.TensorProto.FLOAT), [batch, each])
        for name, each in (("observation", count), ("action", 2))
    ]
    given = [onnx.numpy_helper.from_array(array, name) for name, array in arrays.items()]
    graph = onnx.helper.make_graph(nodes, "g", ends[:1], ends[1:], given)
    return onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)


def test_any_network_with_the_ends_of_a_policy_runs(tmp_path: Path) -> None:
    save_model(tmp_path / "p.onnx", _recurrent(), TWO)
    policy = load(tmp_path / "p.onnx")
    action = policy.act(Observations)
    assert np.ptp(action, axis=0).min() > 0.5
    np.testing.assert_allclose([policy.act(each) for each in Observations], action, atol=2e-6)


def test_a_model_of_one_row_acts_on_many_row_by_row(tmp_path: Path) -> None:
    weight = np.arange(14, dtype=np.float32).reshape(7, 2) / 14
    node = onnx.helper.make_node("MatMul", ["observation", "w"], ["action"])
    save_model(tmp_path / "p.onnx", _model([node], {"w": weight}, batch=1), TWO)
    np.testing.assert_allclose(load(tmp_path / "p.onnx").act(Observations), Observations @ weight, atol=2e-6)


def test_the_file_is_a_model_that_the_checker_of_onnx_accepts(tmp_path: Path) -> None:
    onnx.checker.check_model(onnx.load(str(written(tmp_path))), full_check=True)


def test_the_card_comes_back_as_it_was(tmp_path: Path) -> None:
    card = replace(TWO, command={"forward": (0.0, 0.4)}, evaluation={"return": 12.5}, notes={"seed": "7"})
    assert load(written(tmp_path, card)).card == card


def test_a_later_action_leaves_an_earlier_one_as_it_was(tmp_path: Path) -> None:
    policy = load(written(tmp_path))
    first = policy.act(Observations[0])
    before = first.copy()
    policy.act(Observations[1])
    assert (first == before).all()


def test_a_policy_runs_in_one_thread_and_without_the_libraries_that_train(tmp_path: Path) -> None:
    code = (
        "import os, sys, numpy, onnxruntime\n"
        "from twind.learn.policy.policy_file import load\n"
        "had = len(os.listdir('/proc/self/task'))\n"
        "load(sys.argv[1]).act(numpy.zeros((512, 7), 'f'))\n"
        "print(len(os.listdir('/proc/self/task')) - had, sorted({'onnx', 'torch'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(written(tmp_path))], capture_output=True, text=True, timeout=60.0
    )
    assert done.stdout == "0 []\n", done.stderr


def test_a_network_that_makes_nan_gives_nan_and_not_its_bound(tmp_path: Path) -> None:
    # Infinite twice, then their difference: one sum is infinite or NaN as the processor adds it up.
    infinite = NetworkLayer(np.full((2, TWO.observations), 3e38, np.float32), np.zeros(2, np.float32))
    layers = [infinite, NetworkLayer(np.array([[1, -1], [-1, 1]], np.float32), np.zeros(2, np.float32))]
    observation = np.full(TWO.observations, 3.0, np.float32)
    assert np.isnan(load(written(tmp_path, layers=layers)).act(observation)).all()


def test_an_observation_of_another_size_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"\(6,\)"):
        load(written(tmp_path)).act(np.zeros(6, np.float32))


def test_a_failed_save_leaves_what_was_there(tmp_path: Path) -> None:
    path = written(tmp_path)
    before = path.read_bytes()
    wide = [NetworkLayer(np.full((2, TWO.observations), np.nan, np.float32), np.zeros(2, np.float32))]
    with pytest.raises(InvalidInput, match="not finite"):
        save(path, wide, *plain(TWO), TWO)
    assert path.read_bytes() == before and os.listdir(tmp_path) == [path.name]


# ------------------------------------------------------------------------------------ files from elsewhere


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"format": "twind-policy/2"}, "'twind-policy/2'"),
        ({"format": ...}, "format"),
        ({"colour": "red"}, "'colour'"),
        ({"shaping": {"reach": "far"}}, "reach"),
        ({"shaping": {"period": 5.0}}, "steps a second"),
        ({"shaping": {"period": 0.1}}, "10 steps a second, 12.5 to 1000 are possible"),
        ({"shaping": {"smoothing": 2.0}}, "smoothing"),
        ({"shaping": {"period": float("nan")}}, "no JSON"),
        ({"joints": ["hip"]}, "one per joint"),
        ({"joints": ["hip", "hip"]}, "each once"),
        ({"default": [0.1, 1.5]}, "knee is outside"),
        ({"velocity": [0.5, 0.0]}, "velocity of knee"),
        ({"layout": {"position": [0, 1], "velocity": [3, 6]}}, "follow each other"),
        ({"layout": {}}, r"card says \(batch, 0\)"),
        ({"velocity": ...}, "velocity"),
    ],
)
def test_a_card_that_is_not_as_agreed_is_refused(tmp_path: Path, fields: dict[str, Any], said: str) -> None:
    path = of_card(written(tmp_path), **fields)
    with pytest.raises(InvalidInput, match=said):
        read(path.read_bytes())


def test_a_refusal_names_the_file(tmp_path: Path) -> None:
    path = of_card(written(tmp_path), colour="red")
    with pytest.raises(InvalidInput, match=f"{re.escape(str(path))}: its card has an unknown key 'colour'"):
        load(path)


def _tensor_elsewhere(location: str) -> Any:
    """An array (7, 2) whose numbers lie at `location`."""
    tensor = onnx.TensorProto(name="w", data_type=1, dims=[7, 2], data_location=onnx.TensorProto.EXTERNAL)
    tensor.external_data.add(key="location", value=location)
    tensor.external_data.add(key="length", value="56")
    return tensor


def _elsewhere(location: str, *, constant: bool = False, sparse: bool = False) -> Any:
    """A model whose weight lies at `location`: as an initializer, in a node or in a sparse array."""
    model = _model([onnx.helper.make_node("MatMul", ["observation", "w"], ["action"])], {})
    tensor = _tensor_elsewhere(location)
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
    model = _elsewhere(location, **({} if kind == "initializer" else {kind: True}))
    save_model("p.onnx", model, TWO)
    with pytest.raises(InvalidInput, match="no ONNX model that can be run"):
        load("p.onnx")


MATMUL = onnx.helper.make_node("MatMul", ["observation", "w"], ["action"])
WEIGHT = {"w": np.ones((7, 2), np.float32)}


def _changed_model(change: Callable[[Any], None]) -> Any:
    model = _model([MATMUL], WEIGHT)
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
    return _model([MATMUL], weight, element=onnx.TensorProto.DOUBLE)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (_changed_model(_renamed), "its input is obs, observation alone is needed"),
        (_changed_model(_another_input), "its input is observation, state, observation alone"),
        (_changed_model(_another_output), "its output is action, state, action alone"),
        (_doubles(), r"its input observation is a tensor\(double\), float32 is needed"),
        (_model([MATMUL], WEIGHT, count="any"), r"the shape \['batch', 'any'\], its card says \(batch, 7\)"),
        (_model([MATMUL], {"w": np.ones((6, 2), np.float32)}, count=6), r"\['batch', 6\], its card says"),
        (_model([MATMUL], WEIGHT, batch=3), r"\[3, 7\], its card says \(batch, 7\)"),
        (_changed_model(_undeclared), r"the shape \[\], its card says"),
        (
            _model([MATMUL], {"w": np.full((7, 2), np.inf, np.float32)}),
            "hip is nan for an observation of zeros",
        ),
        (_model([onnx.helper.make_node("Loop", [], [])], WEIGHT), "no ONNX model that can be run"),
        (_model([onnx.helper.make_node("Evil", ["observation"], ["action"], domain="evil")], WEIGHT), "evil"),
    ],
)
def test_a_model_that_is_no_policy_is_refused(tmp_path: Path, model: Any, said: str) -> None:
    save_model(tmp_path / "p.onnx", model, TWO)
    with pytest.raises(InvalidInput, match=said):
        read((tmp_path / "p.onnx").read_bytes())


def test_a_model_without_a_card_is_refused_with_the_way_to_write_one() -> None:
    with pytest.raises(InvalidInput, match=r"no card .*`save_model`"):
        read(_model([MATMUL], WEIGHT).SerializeToString())


def _shapes() -> Any:
    """A shape, joined to itself 30 times: gigabytes from a kilobyte while shapes are worked out."""
    make = onnx.helper.make_node
    nodes = [MATMUL, make("Shape", ["observation"], ["s0"])]
    nodes += [make("Concat", [f"s{at}", f"s{at}"], [f"s{at + 1}"], axis=0) for at in range(30)]
    return _model(nodes, WEIGHT)


def _large() -> Any:
    """An array of 64 GB, made while the network runs."""
    make = onnx.helper.make_node
    nodes = [
        make("ConstantOfShape", ["size"], ["large"]),
        make("ReduceSum", ["large"], ["sum"], keepdims=0),
        make("MatMul", ["observation", "w"], ["a"]),
        make("Add", ["a", "sum"], ["action"]),
    ]
    return _model(nodes, WEIGHT | {"size": np.array([1 << 17, 1 << 17])})


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
        "import resource, sys\n"
        "from twind.learn.policy.policy_file import load\n"
        "try: load(sys.argv[1])\n"
        "finally: print(*(resource.getrusage(who).ru_maxrss for who in (0, -1)))"
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
    save_model(tmp_path / "p.onnx", _model(nodes, WEIGHT), TWO)
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


def test_an_action_of_another_shape_is_refused(tmp_path: Path) -> None:
    """The count of its rows depends on what it sees; the trial with zeros gives one."""
    make = onnx.helper.make_node
    nodes = [
        make("ReduceMax", ["observation"], ["most"], keepdims=0),
        make("Cast", ["most"], ["extra"], to=7),
        make("Add", ["extra", "one"], ["rows"]),
        make("Unsqueeze", ["rows", "zero"], ["row"]),
        make("Concat", ["row", "one1"], ["times"], axis=0),
        make("MatMul", ["observation", "w"], ["a"]),
        make("Tile", ["a", "times"], ["action"]),
    ]
    whole = {"one": np.array(1), "zero": np.array([0]), "one1": np.array([1])}
    save_model(tmp_path / "p.onnx", _model(nodes, WEIGHT | whole), TWO)
    policy = load(tmp_path / "p.onnx")
    with pytest.raises(InvalidInput, match=r"float32 \(3, 2\), float32 \(1, 2\) is needed"):
        policy.act(np.full(TWO.observations, 2.0, np.float32))


def test_a_path_that_is_no_policy_file_is_refused(tmp_path: Path) -> None:
    garbage, large, fifo = (tmp_path / name for name in ("garbage", "large", "fifo"))
    garbage.write_bytes(np.random.default_rng(0).bytes(5000))
    with open(large, "wb") as file:
        file.truncate((8 << 20) + 1)
    os.mkfifo(fifo)
    for path, said in (
        (garbage, "no ONNX"),
        (large, "8388609 bytes, at most 8388608"),
        (fifo, "no regular file"),
        (tmp_path / "x", "No such"),
    ):
        with pytest.raises(InvalidInput, match=said):
            load(path)


_TORN = """
import sys
import numpy as np
from twind.learn.policy.onnx_session import limit_memory
from twind.learn.policy.policy_card import InvalidInput
from twind.learn.policy.policy_file import read
whole = open(sys.argv[1], "rb").read()
rng = np.random.default_rng(5)
refused = 0
for _ in range(150):
    data = bytearray(whole)
    if rng.random() < 0.3:
        del data[rng.integers(len(data)) :]
    for place in rng.integers(0, max(len(data), 1), 3) if data else ():
        data[place] ^= 1 << rng.integers(8)
    try:
        policy = read(bytes(data))
        assert policy.act(np.zeros(policy.card.observations, np.float32)).shape == (2,)
    except InvalidInput:
        refused += 1
print(refused)
"""


def test_no_byte_of_a_file_can_be_lost_or_turned_so_that_loading_breaks_otherwise(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _TORN, str(written(tmp_path))], capture_output=True, text=True, timeout=120.0
    )
    assert done.returncode == 0, done.stderr[-400:]
    assert 20 < int(done.stdout) < 150


# ------------------------------------------------------------------------------------------ does it fit


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ({"joints": ("hip", "ankle")}, ["no joint knee", "no joint ankle"]),
        ({"joints": ("knee", "hip")}, ["order differs"]),
        ({"layout": {"position": (0, 1), "gravity": (2, 4), "velocity": (5, 6)}}, ["velocity at 2..3"]),
        ({"layout": {"position": (0, 1), "velocity": (2, 3)}}, ["gravity at 4..6", "nothing"]),
        ({"lower": (-1.0, -0.9)}, ["knee: its lower limit -1 is beyond -0.9"]),
        ({"upper": (0.5, float("nan"))}, ["hip: its upper limit 1", "knee: its upper limit"]),
        ({"velocity": (3.0, 4.0)}, ["hip: its velocity 4 is beyond 3"]),
        ({"acceleration": (20.0, 19.0)}, ["knee: its acceleration"]),
        ({"rate_hz": 40.0}, ["50 times a second, the loop only 40"]),
    ],
)
def test_an_unfit_policy_lists_all_differences(body: dict[str, Any], said: list[str]) -> None:
    other = replace(BODY, **body)
    text = "; ".join(differences(TWO, other))
    assert all(each in text for each in said), text
    with pytest.raises(InvalidInput, match="made for two, it does not fit two"):
        require_fit(TWO, other)


def test_a_policy_fits_what_it_was_made_for_and_what_may_more() -> None:
    require_fit(TWO, BODY)
    require_fit(TWO, replace(BODY, upper=(2.0, 2.0), velocity=(9.0, 9.0), rate_hz=500.0))


def test_a_card_that_cannot_be_read_back_is_not_written() -> None:
    bad = replace(TWO, evaluation={"return": float("nan")})
    with pytest.raises((InvalidInput, ValueError)):
        bad.text()
    assert PolicyCard is type(bad)
