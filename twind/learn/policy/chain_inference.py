"""A graph that is one chain of operations, run by numpy: as fast as any runtime, without another package.

Its cost is known before it runs: its widths and its multiplications are bounded.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.policy.onnx_reader import SHOWN, OnnxModel, OnnxNode
from twind.learn.policy.onnx_writer import INPUT, OUTPUT, Rows

Step = Callable[[Rows], Rows]  # takes what the last one gave, may write over it
Part = tuple[str, list[Any]]  # an operation and its constants
MOST_WIDTH = 4096  # entries that an operation takes or gives
MOST_PRODUCTS = 1 << 21  # multiplications of an action: twenty times those of 128-256-256-24, about 1 ms
_EITHER = frozenset(("Add", "Mul", "Min", "Max"))  # operations that take a constant on either side
# Attributes that may be there, and what they may be: all else would be another operation.
_ATTRIBUTES: dict[str, dict[str, tuple[float, ...]]] = {
    "Gemm": {"alpha": (1.0,), "beta": (1.0,), "transA": (0.0,), "transB": (0.0, 1.0)},
    "Elu": {"alpha": (1.0,)},
}


def chain(model: OnnxModel) -> list[Part]:
    """Return the operations from input to output, with their constants.

    Raises InvalidInput where the graph is no such chain.
    """
    parts = list[Part]()
    at = INPUT
    width = model.observations
    products = 0
    if width > MOST_WIDTH:
        raise InvalidInput(f"its {INPUT} has {width} entries, at most {MOST_WIDTH} are possible")
    for node in model.nodes:
        name = f"its operation {node.type[:SHOWN]!r}"
        if node.type not in _STEPS:
            raise InvalidInput(f"{name} is not run; known: {', '.join(sorted(_STEPS))}")
        held = _constants(model, node, at, name)
        if node.type in ("Gemm", "MatMul"):
            width = _next_width(width, held, name)
            products += held[0].size
        elif node.type == "Clip":
            _require_scalars(held, name)
        else:
            held = [_row(each, width, name) for each in held]
        parts.append((node.type, held))
        at = node.output
    if at != OUTPUT or width != model.actions:
        raise InvalidInput(
            f"its chain ends with {at[:SHOWN]!r} ({width}), not with {OUTPUT} ({model.actions})"
        )
    if products > MOST_PRODUCTS:
        raise InvalidInput(f"its graph has {products} multiplications, at most {MOST_PRODUCTS} are run")
    return parts


def _constants(model: OnnxModel, node: OnnxNode, at: str, name: str) -> list[Any]:
    """Return the constants of an operation beside the value; a weight as (in, out). None: not given."""
    inputs = list(node.inputs)
    if node.type in _EITHER and inputs[1:] == [at]:
        inputs.reverse()
    if inputs[:1] != [at] or not all(each in model.arrays for each in inputs[1:] if each):
        raise InvalidInput(
            f"{name} takes {', '.join(inputs)[:SHOWN]!r}: only one chain from {INPUT} on is run"
        )
    may = _ATTRIBUTES.get(node.type, {})
    for key, value in node.attributes.items():
        if value not in may.get(key, ()):
            raise InvalidInput(f"{name} has {key[:SHOWN]} {value:g}, which is not run")
    held: list[Any] = [model.arrays[each] if each else None for each in inputs[1:]]
    least, most, _ = _STEPS[node.type]
    if not least <= len(held) <= most or (least and any(each is None for each in held)):
        raise InvalidInput(f"{name} has {len(held)} constants, expected {least} to {most}")
    if node.attributes.get("transB"):
        held[0] = np.ascontiguousarray(held[0].T)
    return held


def _next_width(width: int, held: list[Any], name: str) -> int:
    """Return the output width of a product operation.

    Raises InvalidInput where its arrays do not fit `width` entries, or the output exceeds `MOST_WIDTH`.
    """
    shapes = [each.shape for each in held]
    columns = shapes[0][-1] if len(shapes[0]) == 2 else 0
    if shapes not in ([(width, columns)], [(width, columns), (columns,)]):
        raise InvalidInput(f"{name} has arrays {shapes} for {width} entries")
    if columns > MOST_WIDTH:
        raise InvalidInput(f"{name} gives {columns} entries, at most {MOST_WIDTH} are possible")
    return int(columns)


def _require_scalars(held: list[Any], name: str) -> None:
    for each in held:
        if each is not None and each.shape != ():
            raise InvalidInput(f"{name} has a bound of the shape {each.shape}, one number is needed")


def _row(array: Any, width: int, name: str) -> Any:
    if array.shape not in ((), (1,), (width,), (1, width)):
        raise InvalidInput(f"{name} has an array {array.shape}, expected () or ({width},)")
    return array.reshape(-1)


def compiled(steps: Sequence[Part], rows: int | None, width: int) -> Step:
    """One function of a chain, for an observation (width,) or `rows` of them; it writes into own arrays."""
    shape = (width,) if rows is None else (rows, width)
    work = np.zeros(shape, np.float32)
    parts = []
    for name, held in steps:
        part, work = _STEPS[name][2](work, held)
        parts.append(part)

    def run(observation: Rows) -> Rows:
        value = observation
        for part in parts:
            value = part(value)
        return value

    return run


def _of_two(function: Any) -> Any:
    def made(before: Rows, held: list[Any]) -> tuple[Step, Rows]:
        other = np.asarray(held[0], np.float32)
        out = np.empty(np.broadcast_shapes(before.shape, other.shape), np.float32)
        return lambda value: function(value, other, out=out), out

    return made


def _of_one(function: Any) -> Any:
    def made(before: Rows, _held: list[Any]) -> tuple[Step, Rows]:
        out = np.empty(before.shape, np.float32)
        return lambda value: function(value, out=out), out

    return made


def _matmul(before: Rows, held: list[Any]) -> tuple[Step, Rows]:
    out = np.empty((*before.shape[:-1], held[0].shape[1]), np.float32)

    def run(value: Rows) -> Rows:
        np.matmul(value, held[0], out=out)
        return out

    return run, out


def _clip(before: Rows, held: list[Any]) -> tuple[Step, Rows]:
    bounds = [*held, None, None]
    low = np.float32(-np.inf) if bounds[0] is None else np.float32(bounds[0])
    high = np.float32(np.inf) if bounds[1] is None else np.float32(bounds[1])
    out = np.empty(before.shape, np.float32)

    def run(value: Rows) -> Rows:
        np.maximum(value, low, out=out)  # keeps a NaN, so that nobody takes it for a bound
        np.minimum(out, high, out=out)
        return out

    return run, out


def _gemm(before: Rows, held: list[Any]) -> tuple[Step, Rows]:
    weight, bias = held
    out = np.empty((*before.shape[:-1], weight.shape[1]), np.float32)

    def run(value: Rows) -> Rows:
        np.matmul(value, weight, out=out)
        np.add(out, bias, out=out)
        return out

    return run, out


def _sigmoid(value: Rows, out: Rows) -> Rows:
    np.exp(np.negative(value, out=out), out=out)
    np.add(out, np.float32(1.0), out=out)
    return np.reciprocal(out, out=out)


def _elu(value: Rows, out: Rows) -> Rows:
    np.expm1(np.minimum(value, np.float32(0.0)), out=out)
    np.copyto(out, value, where=value > 0.0)
    return out


_Make = Callable[[Rows, list[Any]], tuple[Step, Rows]]
_STEPS: dict[str, tuple[int, int, _Make]] = {  # constants it has, at least and at most
    "Sub": (1, 1, _of_two(np.subtract)),
    "Add": (1, 1, _of_two(np.add)),
    "Mul": (1, 1, _of_two(np.multiply)),
    "Div": (1, 1, _of_two(np.divide)),
    "Min": (1, 1, _of_two(np.minimum)),
    "Max": (1, 1, _of_two(np.maximum)),
    "MatMul": (1, 1, _matmul),
    "Gemm": (2, 2, _gemm),
    "Clip": (0, 2, _clip),
    "Tanh": (0, 0, _of_one(np.tanh)),
    "Sigmoid": (0, 0, _of_one(_sigmoid)),
    "Relu": (0, 0, _of_one(lambda value, out: np.maximum(value, np.float32(0.0), out=out))),
    "Elu": (0, 0, _of_one(_elu)),
    "Identity": (0, 0, _of_one(np.positive)),
}
