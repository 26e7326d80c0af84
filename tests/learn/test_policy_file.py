"""Policy files: what is written is what runs, and a file from elsewhere is checked before it runs."""

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

from tests.support.doc_pages_text import ROOT
from tests.support.policy_files import TWO, network, onnx_model, plain, written
from twind.exceptions import InvalidInput
from twind.learn.policy.policy_file import NetworkLayer, load, read, save, save_model

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
    return onnx_model(nodes, arrays)


def test_any_network_with_the_ends_of_a_policy_runs(tmp_path: Path) -> None:
    save_model(tmp_path / "p.onnx", _recurrent(), TWO)
    policy = load(tmp_path / "p.onnx")
    action = policy.act(Observations)
    assert np.ptp(action, axis=0).min() > 0.5
    np.testing.assert_allclose([policy.act(each) for each in Observations], action, atol=2e-6)


def test_a_model_of_one_row_acts_on_many_row_by_row(tmp_path: Path) -> None:
    weight = np.arange(14, dtype=np.float32).reshape(7, 2) / 14
    node = onnx.helper.make_node("MatMul", ["observation", "w"], ["action"])
    save_model(tmp_path / "p.onnx", onnx_model([node], {"w": weight}, batch=1), TWO)
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


def test_a_card_of_another_layout_than_the_model_is_refused(tmp_path: Path) -> None:
    path = of_card(written(tmp_path), layout={})
    with pytest.raises(InvalidInput, match=r"card says \(batch, 0\)"):
        read(path.read_bytes())


def test_a_refusal_names_the_file(tmp_path: Path) -> None:
    path = of_card(written(tmp_path), colour="red")
    with pytest.raises(InvalidInput, match=f"{re.escape(str(path))}: its card has an unknown key 'colour'"):
        load(path)


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
    save_model(tmp_path / "p.onnx", onnx_model(nodes, {"w": np.ones((7, 2), np.float32)} | whole), TWO)
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
