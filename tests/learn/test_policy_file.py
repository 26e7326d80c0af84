"""Policy files: what is written is what runs, and what anybody hands over is checked before it does."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")
pytest.importorskip("onnxruntime", reason="make extras EXTRAS=learn")

import onnx
import onnxruntime

from tests.support.policy_files import TWO, network, plain, written
from twind.exceptions import InvalidInput
from twind.learn.policy.policy_card import PolicyCard, PolicyRobot, differences, require_fit
from twind.learn.policy.policy_file import KEY, NetworkLayer, load, save

BODY = PolicyRobot("two", TWO.joints, TWO.layout, TWO.lower, TWO.upper, TWO.velocity, TWO.acceleration, 100.0)
Observations = np.random.default_rng(3).normal(0.0, 1.0, (200, TWO.observations)).astype(np.float32)


def reference(path: Path, observation: np.ndarray) -> np.ndarray:
    """What the vendor-neutral runtime makes of the same file."""
    return onnxruntime.InferenceSession(str(path)).run(None, {"observation": observation})[0]


def changed(path: Path, change: Callable[[Any], None]) -> Path:
    """The same file with its model changed."""
    model = onnx.load(str(path))
    change(model)
    path.write_bytes(model.SerializeToString())
    return path


def of_card(path: Path, **fields: Any) -> Path:
    """The same file with another card, as somebody with a text editor makes it."""

    def edit(model: Any) -> None:
        given = json.loads(model.metadata_props[0].value) | fields
        model.metadata_props[0].value = json.dumps({k: v for k, v in given.items() if v is not ...})

    return changed(path, edit)


# ------------------------------------------------------------------------------------------ written and read


@pytest.mark.parametrize("activation", ["tanh", "relu", "elu", "none"])
def test_numpy_gives_what_onnxruntime_gives_of_the_same_file(tmp_path: Path, activation: str) -> None:
    rng = np.random.default_rng(1)
    layers = [replace(each, activation=activation) for each in network(TWO)[:-1]] + network(TWO)[-1:]
    mean, std = (rng.uniform(0.5, 2.0, TWO.observations).astype(np.float32) for _ in range(2))
    save(tmp_path / "p.onnx", layers, mean, std, 3.0, TWO)
    policy = load(tmp_path / "p.onnx")
    expected = reference(tmp_path / "p.onnx", Observations)
    assert np.abs(expected).max() == 1.0  # some are clipped, most are not
    assert (np.abs(expected) < 0.99).mean() > 0.3
    np.testing.assert_allclose(policy.act(Observations), expected, atol=2e-6)
    one_by_one = [policy.act(each) for each in Observations]
    np.testing.assert_allclose(one_by_one, expected, atol=2e-6)


def test_the_file_is_a_model_that_the_checker_of_onnx_accepts(tmp_path: Path) -> None:
    onnx.checker.check_model(onnx.load(str(written(tmp_path))), full_check=True)


def test_the_card_comes_back_as_it_was(tmp_path: Path) -> None:
    card = replace(TWO, command={"forward": (0.0, 0.4)}, evaluation={"return": 12.5}, notes={"seed": "7"})
    assert load(written(tmp_path, card)).card == card


def test_what_is_returned_is_nobodys_buffer(tmp_path: Path) -> None:
    policy = load(written(tmp_path))
    first = policy.act(Observations[0])
    before = first.copy()
    policy.act(Observations[1])
    assert (first == before).all()


def _before_the_end(model: Any, type_: str, *others: str, first: bool = False, **attributes: Any) -> None:
    """One more operation before the last one."""
    last = model.graph.node[-1]
    name = f"more{len(model.graph.node)}"
    inputs = [*others, last.input[0]] if first else [last.input[0], *others]
    made = onnx.helper.make_node(type_, inputs, [name], **attributes)
    model.graph.node.insert(len(model.graph.node) - 1, made)
    last.input[0] = name


def _array(model: Any, name: str, value: Any) -> str:
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.array(value, np.float32), name))
    return name


def test_every_operation_on_the_list_gives_what_onnxruntime_gives(tmp_path: Path) -> None:
    def longer(model: Any) -> None:  # as other exporters write it
        tenth = onnx.numpy_helper.from_array(np.float32(0.1).reshape(()), "")
        model.graph.node.insert(0, onnx.helper.make_node("Constant", [], ["tenth"], value=tenth))
        weight = _array(model, "weight", [[0.5, -0.2, 1.0], [2.0, 0.3, -1.0]])
        _before_the_end(model, "MatMul", weight)
        _before_the_end(model, "Add", _array(model, "bias", [0.1, -0.1, 0.0]), first=True)
        _before_the_end(model, "Elu", alpha=1.0)
        _before_the_end(model, "Mul", "tenth", first=True)
        _before_the_end(model, "Max", _array(model, "low", [[-0.5, 0.0, 0.01]]))
        _before_the_end(model, "Min", _array(model, "high", [0.08, 0.2, 0.3]))
        _before_the_end(model, "Sub", "tenth")
        _before_the_end(model, "Div", _array(model, "scale", [0.1, 0.2, 0.3]))
        _before_the_end(model, "Sigmoid")
        turned = _array(model, "turned", [[1.0, 0.0], [0.5, 0.5], [0.0, -0.5]])
        _before_the_end(model, "Gemm", turned, _array(model, "last", [0.0, 0.5]), alpha=1.0, transB=0)
        _before_the_end(model, "Identity")
        _before_the_end(model, "Clip", "tenth", "")

    path = changed(written(tmp_path), longer)
    expected = reference(path, Observations)
    assert np.ptp(expected, axis=0).min() > 0.05
    policy = load(path)
    np.testing.assert_allclose(policy.act(Observations), expected, atol=2e-6)
    np.testing.assert_allclose(policy.act(Observations[0]), expected[0], atol=2e-6)


def test_a_policy_runs_where_no_library_of_onnx_is(tmp_path: Path) -> None:
    code = (
        "import sys\n"
        "from twind.learn.policy.policy_file import load\n"
        "load(sys.argv[1])\n"
        "print(sorted({'onnx', 'onnxruntime', 'torch', 'google.protobuf'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(written(tmp_path))], capture_output=True, text=True, timeout=60.0
    )
    assert done.stdout == "[]\n", done.stderr


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


# ------------------------------------------------------------------------------------------ anybody's file


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
        ({"layout": {}}, "card says 0"),
        ({"velocity": ...}, "velocity"),
    ],
)
def test_a_card_that_is_not_as_agreed_is_refused(tmp_path: Path, fields: dict[str, Any], said: str) -> None:
    path = of_card(written(tmp_path), **fields)
    with pytest.raises(InvalidInput, match=said) as caught:
        load(path)
    assert str(path) in str(caught.value)


def _outside(model: Any) -> None:
    tensor = model.graph.initializer[0]
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../../etc/passwd")
    tensor.ClearField("raw_data")


def _constant(**value: Any) -> Callable[[Any], None]:
    def change(model: Any) -> None:
        model.graph.node.insert(0, onnx.helper.make_node("Constant", [], ["far"], **value))

    return change


def _far() -> Any:
    """An array whose numbers lie in another file."""
    tensor = onnx.TensorProto(name="v", data_type=1, dims=[2], data_location=onnx.TensorProto.EXTERNAL)
    tensor.external_data.add(key="location", value="secret")
    return tensor


def _sparse() -> Any:
    at = onnx.numpy_helper.from_array(np.arange(2), "i")
    return onnx.SparseTensorProto(values=_far(), indices=at, dims=[1, 2])


def _infinite(model: Any) -> None:
    tensor = model.graph.initializer[-1]
    tensor.CopyFrom(
        onnx.numpy_helper.from_array(np.full(tuple(tensor.dims), np.inf, np.float32), tensor.name)
    )


def _doubling(model: Any) -> None:
    for _ in range(40):
        _before_the_end(model, "Concat", model.graph.node[-1].input[0], axis=1)


def _forking(model: Any) -> None:
    _before_the_end(model, "Add", model.graph.node[-1].input[0])


def _many(model: Any) -> None:
    for _ in range(65):
        _before_the_end(model, "Tanh")


def _heavy(model: Any) -> None:
    """Little to store, much to do: one weight, again and again."""
    wide = _array(model, "wide", np.zeros((2, 300)))
    square = _array(model, "square", np.zeros((300, 300)))
    narrow = _array(model, "narrow", np.zeros((300, 2)))
    for name in (wide, *[square] * 24, narrow):
        _before_the_end(model, "MatMul", name)


def _wide(model: Any) -> None:
    _before_the_end(model, "MatMul", _array(model, "wide", np.zeros((2, 4097))))


def _outer(model: Any) -> None:
    _before_the_end(model, "Add", _array(model, "column", np.zeros((4000, 1))))


def _operation(name: str, domain: str = "") -> Callable[[Any], None]:
    def change(model: Any) -> None:
        model.graph.node[-1].op_type = name
        model.graph.node[-1].domain = domain

    return change


def _attribute(**given: Any) -> Callable[[Any], None]:
    return lambda model: _before_the_end(model, "Tanh", **given)


def _renamed(model: Any) -> None:
    model.graph.input[0].name = "obs"


def _lying(model: Any) -> None:
    model.graph.initializer[0].dims[0] = 1 << 40


def _unpacked(model: Any) -> None:
    """The same numbers, not as raw data."""
    tensor = model.graph.initializer[0]
    tensor.float_data.extend(onnx.numpy_helper.to_array(tensor).tolist())
    tensor.ClearField("raw_data")


def _second_card(model: Any) -> None:
    model.metadata_props.add(key=KEY, value="{}")


def _old(model: Any) -> None:
    model.opset_import[0].version = 7


GRAPH = onnx.helper.make_graph([], "g", [], [])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_outside, "array has the field 13"),
        (_constant(value=_far()), "array has the field 13"),
        (_constant(sparse_value=_sparse()), "attribute has the field 22"),
        (_constant(value_floats=[1.0, 2.0]), "attribute has the field 7"),
        (_constant(value_float=1.0), "arrays that are not read"),
        (_unpacked, "array has the field 4"),
        (_infinite, "not finite"),
        (_doubling, "'Concat' is not run"),
        (_forking, "only one chain"),
        (_many, "operations, at most 64"),
        (_heavy, "multiplications, at most 2097152"),
        (_wide, "4097 entries, at most 4096"),
        (_outer, r"array \(4000, 1\)"),
        (_operation("Loop"), "not run"),
        (_operation("RandomNormalLike"), "not run"),
        (_operation("Clip", "evil"), "not run"),
        (_attribute(body=GRAPH), "attribute has the field 6"),
        (_attribute(what="a text"), "attribute has the field 4"),
        (_attribute(alpha=2.0), "alpha 2, which is not run"),
        (lambda model: _before_the_end(model, "Elu", alpha=2.0), "alpha 2, which is not run"),
        (_renamed, "expected observation alone"),
        (_lying, "bytes of raw data"),
        (_second_card, "no card"),
        (_old, "operator set is 7, 13 to 25"),
        (lambda model: model.ClearField("opset_import"), "operator set is None"),
        (lambda model: model.ClearField("metadata_props"), "no card"),
        (lambda model: model.functions.add(name="f"), "model has the field 25"),
        (lambda model: model.graph.sparse_initializer.append(_sparse()), "graph has the field 15"),
        (lambda model: model.graph.input.pop(), "none"),
        (lambda model: model.graph.node.pop(), "its chain ends with"),
    ],
)
def test_a_graph_that_could_do_more_than_a_policy_is_refused(
    tmp_path: Path, change: Callable[[Any], None], said: str
) -> None:
    with pytest.raises(InvalidInput, match=said):
        load(changed(written(tmp_path), change))


def _shapes(path: Path) -> None:
    """A shape, joined to itself 26 times: whoever works shapes out makes gigabytes of a kilobyte."""

    def change(model: Any) -> None:
        model.graph.node.append(onnx.helper.make_node("Shape", ["observation"], ["s0"]))
        for at in range(26):
            made = onnx.helper.make_node("Concat", [f"s{at}", f"s{at}"], [f"s{at + 1}"], axis=0)
            model.graph.node.append(made)

    changed(path, change)


def _empty(path: Path) -> None:
    """Millions of operations of two bytes each: a library makes 80 of each of them."""
    rest = onnx.load(str(path))
    rest.ClearField("graph")
    count = 7 << 20
    length = b""
    while count:
        count, part = count >> 7, count & 0x7F
        length += bytes([part | (0x80 if count else 0)])
    path.write_bytes(rest.SerializeToString() + b"\x3a" + length + b"\x0a\x00" * (7 << 19))


def _sizes(path: Path) -> None:
    """Arrays of a few bytes that say they are as large as memory."""

    def change(model: Any) -> None:
        tensor = model.graph.initializer[0]
        tensor.ClearField("dims")
        tensor.dims.extend([1 << 31, 1 << 31])

    changed(path, change)


@pytest.mark.parametrize(
    ("make", "said"), [(_shapes, "Shape"), (_empty, "more than 8192 fields"), (_sizes, "bytes of raw data")]
)
def test_no_file_takes_more_memory_than_it_weighs(
    tmp_path: Path, make: Callable[[Path], None], said: str
) -> None:
    path = written(tmp_path)
    make(path)
    code = (
        "import resource, sys\n"
        "from twind.learn.policy.policy_file import load\n"
        "had = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (had + (40 << 20),) * 2)\n"
        "load(sys.argv[1])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=60.0
    )
    assert re.search(f"InvalidInput: .*({said})", done.stderr), done.stderr[-400:]


def test_a_file_that_is_none_of_ours_is_refused(tmp_path: Path) -> None:
    garbage, large, fifo = (tmp_path / name for name in ("garbage", "large", "fifo"))
    garbage.write_bytes(np.random.default_rng(0).bytes(5000))
    with open(large, "wb") as file:
        file.truncate((8 << 20) + 1)
    os.mkfifo(fifo)
    for path, said in (
        (garbage, "no ONNX"),
        (large, "8388609 bytes, at most 8388608"),
        (fifo, "no file"),
        (tmp_path / "x", "No such"),
    ):
        with pytest.raises(InvalidInput, match=said):
            load(path)


def test_no_byte_of_a_file_can_be_lost_or_turned_so_that_loading_breaks_otherwise(tmp_path: Path) -> None:
    whole = written(tmp_path).read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(150):
        data = bytearray(whole)
        if rng.random() < 0.3:
            del data[rng.integers(len(data)) :]
        for place in rng.integers(0, max(len(data), 1), 3) if data else ():
            data[place] ^= 1 << rng.integers(8)
        (tmp_path / "torn.onnx").write_bytes(data)
        try:
            action = load(tmp_path / "torn.onnx").act(np.zeros(TWO.observations, np.float32))
        except InvalidInput:
            continue
        assert action.shape == (2,)


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
def test_a_policy_that_does_not_fit_says_all_that_differs(body: dict[str, Any], said: list[str]) -> None:
    other = replace(BODY, **body)
    text = "; ".join(differences(TWO, other))
    assert all(each in text for each in said), text
    with pytest.raises(InvalidInput, match="made for two, it does not fit two"):
        require_fit(TWO, other)


def test_a_policy_fits_what_it_was_made_for_and_what_may_more() -> None:
    require_fit(TWO, BODY)
    require_fit(TWO, replace(BODY, upper=(2.0, 2.0), velocity=(9.0, 9.0), rate_hz=500.0))


def test_a_card_that_nobody_could_read_again_is_not_written() -> None:
    bad = replace(TWO, evaluation={"return": float("nan")})
    with pytest.raises((InvalidInput, ValueError)):
        bad.text()
    assert PolicyCard is type(bad)
