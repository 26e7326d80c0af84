"""The ONNX graph of a trained network. torch's exporter would need `onnxscript` beside `onnx`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.policy.onnx_session import INPUT, OUTPUT, Rows

# Old enough for every runtime in use.
OPSET = 17
IR = 8
ACTIVATIONS = {"none": "", "tanh": "Tanh", "relu": "Relu", "elu": "Elu"}


@dataclass(frozen=True, slots=True)
class NetworkLayer:
    """One layer of a network: weight (out, in), bias (out,), as `torch.nn.Linear` has them."""

    weight: Rows
    bias: Rows
    activation: str = "none"  # of `ACTIVATIONS`


def build_graph(layers: Sequence[NetworkLayer], mean: Rows, std: Rows, clip: float) -> Any:
    """The graph: clip((observation - mean) / std, ±clip), the layers, clip(±1). Raises InvalidInput."""
    from onnx import TensorProto, helper

    _require_network(layers, mean, std, clip)
    arrays: dict[str, object] = {
        "mean": mean,
        "std": std,
        "lowest": np.float32(-clip),
        "highest": np.float32(clip),
        "minus_one": np.float32(-1.0),
        "one": np.float32(1.0),
    }
    nodes = [
        helper.make_node("Sub", [INPUT, "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "std"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "lowest", "highest"], ["h0"]),
    ]
    for at, layer in enumerate(layers):
        arrays[f"weight{at}"], arrays[f"bias{at}"] = layer.weight, layer.bias
        operation = ACTIVATIONS[layer.activation]
        into = f"g{at}" if operation else f"h{at + 1}"
        nodes.append(helper.make_node("Gemm", [f"h{at}", f"weight{at}", f"bias{at}"], [into], transB=1))
        if operation:
            nodes.append(helper.make_node(operation, [into], [f"h{at + 1}"]))
    nodes.append(helper.make_node("Clip", [f"h{len(layers)}", "minus_one", "one"], [OUTPUT]))
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", count])
        for name, count in ((INPUT, len(mean)), (OUTPUT, len(layers[-1].bias)))
    ]
    return helper.make_graph(nodes, "policy", ends[:1], ends[1:], [_tensor(*each) for each in arrays.items()])


def _tensor(name: str, array: Any) -> Any:
    from onnx import numpy_helper

    return numpy_helper.from_array(np.asarray(array, np.float32), name)


def _require_network(layers: Sequence[NetworkLayer], mean: Rows, std: Rows, clip: float) -> None:
    if not layers or mean.shape != std.shape or mean.ndim != 1:
        raise InvalidInput(f"{len(layers)} layers, mean {mean.shape}, std {std.shape}: mean and std are (N,)")
    if not ((std > 0.0).all() and np.isfinite(std).all() and np.isfinite(mean).all() and 0.0 < clip < np.inf):
        raise InvalidInput("mean, std and clip must be finite, std and clip above 0")
    width = len(mean)
    for at, layer in enumerate(layers):
        if layer.activation not in ACTIVATIONS:
            raise InvalidInput(
                f"layer {at}: activation {layer.activation!r}; known: {', '.join(ACTIVATIONS)}"
            )
        if layer.weight.shape != (len(layer.bias), width):
            raise InvalidInput(
                f"layer {at}: weight {layer.weight.shape}, expected ({len(layer.bias)}, {width})"
            )
        if not (np.isfinite(layer.weight).all() and np.isfinite(layer.bias).all()):
            raise InvalidInput(f"layer {at}: a weight is not finite")
        width = len(layer.bias)
