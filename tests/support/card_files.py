"""Networks and cards of other frameworks for tests, made with the `onnx` helper."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Shapes = Mapping[str, Sequence[Any]]
HEAD = """\
format: twind-card/1
rate_hz: 50.0
joints: [knee, hip]
default_rad: {hip: 0.1, knee: 0.2}
"""
PLAIN = """\
inputs: {obs: {terms: {joint_position: {}, projected_gravity: {}}}}
action: {output: actions, scale_rad: 0.5, path: hold}
"""
COUNTER = """\
inputs: {obs: {terms: {joint_position: {}}}}
state: {s_in: {output: s_out, shape: [1, 2]}}
action: {output: actions, scale_rad: 0.001, path: hold}
"""


def model(
    nodes: list[Any], arrays: Mapping[str, Any], inputs: Shapes, outputs: Shapes, opset: int = 17
) -> Any:
    """An ONNX model of float32 inputs and outputs."""
    from onnx import helper, numpy_helper

    ends = [
        [helper.make_tensor_value_info(name, 1, list(shape)) for name, shape in each.items()]
        for each in (inputs, outputs)
    ]
    given = [numpy_helper.from_array(np.asarray(array, np.float32), name) for name, array in arrays.items()]
    graph = helper.make_graph(nodes, "g", *ends, given)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)


def linear(entries: int, actions: int, weight: Any = 0.0, bias: Any = 0.0, opset: int = 17) -> Any:
    """actions = obs @ weight + bias."""
    from onnx import helper

    arrays = {
        "w": np.broadcast_to(np.float32(weight), (entries, actions)),
        "b": np.broadcast_to(np.float32(bias), (actions,)),
    }
    nodes = [helper.make_node("Gemm", ["obs", "w", "b"], ["actions"])]
    return model(nodes, arrays, {"obs": ["batch", entries]}, {"actions": ["batch", actions]}, opset)


def counter() -> Any:
    """A recurrent network of two joints whose actions are the number of steps since its state was zero."""
    from onnx import helper

    nodes = [
        helper.make_node("MatMul", ["obs", "nothing"], ["zero"]),
        helper.make_node("Add", ["s_in", "one"], ["next"]),
        helper.make_node("Add", ["next", "zero"], ["s_out"]),
        helper.make_node("Identity", ["s_out"], ["actions"]),
    ]
    arrays = {"one": np.ones((1, 2)), "nothing": np.zeros((2, 2))}
    return model(nodes, arrays, {"obs": [1, 2], "s_in": [1, 2]}, {"actions": [1, 2], "s_out": [1, 2]})


def lstm(entries: int, actions: int, hidden: int = 16, size: float = 0.1) -> Any:
    """An LSTM with its two states as inputs and outputs, and a layer behind it."""
    from onnx import helper

    rng = np.random.default_rng(4)
    arrays = {
        "w": rng.normal(0.0, 0.2, (1, 4 * hidden, entries)),
        "r": rng.normal(0.0, 0.2, (1, 4 * hidden, hidden)),
        "out": rng.normal(0.0, size, (hidden, actions)),
    }
    nodes = [
        helper.make_node("Constant", [], ["first"], value_ints=[0]),
        helper.make_node("Unsqueeze", ["obs", "first"], ["sequence"]),
        helper.make_node(
            "LSTM", ["sequence", "w", "r", "", "", "h_in", "c_in"], ["", "h_out", "c_out"], hidden_size=hidden
        ),
        helper.make_node("Squeeze", ["h_out", "first"], ["last"]),
        helper.make_node("MatMul", ["last", "out"], ["actions"]),
    ]
    state = [1, 1, hidden]
    inputs = {"obs": [1, entries], "h_in": state, "c_in": state}
    return model(nodes, arrays, inputs, {"actions": [1, actions], "h_out": state, "c_out": state})


def convolution(size: int, steps: int, actions: int) -> Any:
    """A convolution over the history (1, size, steps), and a layer behind it."""
    from onnx import helper

    rng = np.random.default_rng(5)
    arrays = {
        "kernel": rng.normal(0.0, 0.1, (4, size, steps)),
        "out": rng.normal(0.0, 0.1, (4, actions)),
    }
    nodes = [
        helper.make_node("Conv", ["obs", "kernel"], ["seen"]),
        helper.make_node("Flatten", ["seen"], ["flat"]),
        helper.make_node("MatMul", ["flat", "out"], ["actions"]),
    ]
    return model(nodes, arrays, {"obs": [1, size, steps]}, {"actions": [1, actions]})


def carded(folder: Path, network: Any, card: str, name: str = "policy") -> Path:
    """Write a network with its card beside it; return the network's path."""
    path = folder / f"{name}.onnx"
    path.write_bytes(network.SerializeToString())
    (folder / f"{name}.card.yaml").write_text(card)
    return path


STANDING = """\
format: twind-card/1
robot: h24-standing
rate_hz: 50.0
joints: [l_knee, r_knee, l_hip_pitch, r_hip_pitch]
default_rad: {l_knee: 0.6, r_knee: 0.6, l_hip_pitch: -0.3, r_hip_pitch: -0.3}
"""
STANDING_PLAIN = """\
inputs: {obs: {terms: {joint_position: {}, base_angular_velocity: {}}}}
action: {output: actions, scale_rad: 0.5, clip: [-1.0, 1.0]}
"""
STANDING_LSTM = """\
inputs: {obs: {terms: {joint_position: {}, base_angular_velocity: {}}}}
state: {h_in: {output: h_out, shape: [1, 1, 16]}, c_in: {output: c_out, shape: [1, 1, 16]}}
action: {output: actions, scale_rad: 0.5}
"""
FOREARM = """\
format: twind-card/1
robot: h24-standing
rate_hz: 50.0
joints: [l_shoulder_yaw, l_elbow]
default_rad: {l_shoulder_yaw: 0.0, l_elbow: 0.0}
inputs: {obs: {terms: {joint_position: {}}}}
action: {output: actions, scale_rad: 1.0, path: hold}
"""
INTO_PELVIS = [-1.4, -2.1]  # its actions that push the forearm into the pelvis
