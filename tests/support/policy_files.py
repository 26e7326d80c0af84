"""Policy files for tests: small networks that do what a test wants, and a card that fits."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.processes import Daemon, favour
from twind.learn.policy.onnx_session import Rows
from twind.learn.policy.policy_card import PolicyCard
from twind.learn.policy.policy_file import NetworkLayer, save
from twind.learn.task.action_shaping import ActionShaping

TWO = PolicyCard(
    task="Stand",
    robot="two",
    joints=("hip", "knee"),
    layout={"position": (0, 1), "velocity": (2, 3), "gravity": (4, 6)},
    default=(0.1, -0.2),
    lower=(-1.0, -1.0),
    upper=(1.0, 1.0),
    velocity=(4.0, 4.0),
    acceleration=(20.0, 20.0),
    shaping=ActionShaping(),
)


def network(
    card: PolicyCard, hidden: tuple[int, ...] = (16, 16), seed: int = 0, scale: float = 1.0
) -> list[NetworkLayer]:
    """Random weights, tanh between, as a PPO policy has them."""
    rng = np.random.default_rng(seed)
    width = card.observations
    layers = []
    for count in hidden:
        layers.append(_layer(rng, width, count, "tanh", scale))
        width = count
    return [*layers, _layer(rng, width, len(card.joints), "none", scale)]


def constant(card: PolicyCard, action: Any) -> list[NetworkLayer]:
    """Gives `action` (n,) whatever it sees."""
    weight = np.zeros((len(card.joints), card.observations), np.float32)
    return [NetworkLayer(weight, np.broadcast_to(np.float32(action), len(card.joints)).copy())]


def _layer(rng: np.random.Generator, width: int, count: int, activation: str, scale: float) -> NetworkLayer:
    weight = rng.normal(0.0, scale / np.sqrt(width), (count, width))
    return NetworkLayer(weight.astype(np.float32), rng.normal(0.0, 0.1, count).astype(np.float32), activation)


def onnx_model(
    nodes: list[Any], arrays: dict[str, Any], batch: Any = "batch", count: Any = 7, element: int = 1
) -> Any:
    """An ONNX model of these nodes; `count` of its observations, `element`: type of its ends (1: float)."""
    from onnx import helper, numpy_helper

    ends = [
        helper.make_tensor_value_info(name, element, [batch, each])
        for name, each in (("observation", count), ("action", 2))
    ]
    given = [numpy_helper.from_array(np.asarray(array), name) for name, array in arrays.items()]
    graph = helper.make_graph(nodes, "g", ends[:1], ends[1:], given)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def looping(card: PolicyCard, *, always: bool = False) -> Any:
    """A model that loops for days at an observation above 0, or `always`, in short rounds."""
    import onnx
    from onnx import helper, numpy_helper

    real = onnx.TensorProto.FLOAT
    integer = onnx.TensorProto.INT64
    truth = onnx.TensorProto.BOOL
    value = helper.make_tensor_value_info
    make = helper.make_node
    count = len(card.joints)
    inner = helper.make_graph(
        [make("Identity", ["go"], ["goes"]), make("Tanh", ["before"], ["after"])],
        "round",
        [value("at", integer, []), value("go", truth, []), value("before", real, ["batch", count])],
        [value("goes", truth, []), value("after", real, ["batch", count])],
    )
    nodes = [
        make("MatMul", ["observation", "weight"], ["first"]),
        make("ReduceMax", ["first"], ["most"], keepdims=0),
        make("Mul", ["most", "many"], ["product"]),
        make("Cast", ["product"], ["seen"], to=integer),
        make("Loop", ["forever" if always else "seen", "true", "first"], ["action"], body=inner),
    ]
    arrays = {
        "weight": np.ones((card.observations, count), np.float32),
        "many": np.float32(1e15),
        "true": np.array(True),
        "forever": np.array(1 << 62),
    }
    ends = [
        value("observation", real, ["batch", card.observations]),
        value("action", real, ["batch", count]),
    ]
    given = [numpy_helper.from_array(np.asarray(array), name) for name, array in arrays.items()]
    graph = helper.make_graph(nodes, "looping", ends[:1], ends[1:], given)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def plain(card: PolicyCard) -> tuple[Rows, Rows, float]:
    """mean, std and clip of a normalisation that changes nothing."""
    return np.zeros(card.observations, np.float32), np.ones(card.observations, np.float32), 100.0


def written(
    folder: Path, card: PolicyCard = TWO, layers: list[NetworkLayer] | None = None, **changed: Any
) -> Path:
    """A file of `card`, changed."""
    card = replace(card, **changed)
    path = folder / "policy.onnx"
    save(path, network(card) if layers is None else layers, *plain(card), card)
    return path


class Run:
    """A `twindctl policy run` that goes on."""

    def __init__(self, daemon: Daemon, file: Path, *options: str) -> None:
        command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(daemon.sockets), "--json"]
        self.process = subprocess.Popen(
            [*command, "policy", "run", str(file), *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        favour(self.process)

    def drives(self, seconds: float = 0.5) -> dict[str, Any]:
        """Once it has sent for so long: what it says then."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            told: dict[str, Any] = json.loads(line)
            if told["phase"] == "running" and told["steps"] > 20 and told["seconds"] >= seconds:
                return told
            if told["phase"] == "ended":
                raise AssertionError(told)
        raise AssertionError(self.end())

    def kill(self) -> None:
        """End it at once, if it has not ended; one that was stopped, too."""
        if self.process.poll() is None:
            self.process.kill()
        for pipe in (self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()
        self.process.wait(30.0)

    def end(self, seconds: float = 30.0) -> tuple[int, dict[str, Any], str]:
        """Exit code, what it said last, and its complaints."""
        out, complaints = self.process.communicate(timeout=seconds)
        lines = [line for line in out.splitlines() if line]
        return self.process.returncode, json.loads(lines[-1]) if lines else {}, complaints
