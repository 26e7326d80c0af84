"""Reader of ONNX files: accepts one graph of plain operations and its arrays, else refuses. No ONNX library.

A file may come from an untrusted source. A library that reads all of ONNX does more than a policy needs:
arrays in other files, graphs in graphs, computed shapes. This reader refuses all that is not on its list.
Numbers of fields: onnx.proto, IR versions 8 to 13.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.policy.onnx_writer import INPUT, OUTPUT, Rows
from twind.learn.policy.protobuf_reader import (
    BYTES,
    FIXED32,
    VARINT,
    ProtobufFieldBudget,
    ProtobufSchema,
    Value,
    message,
    signed,
    text,
)

MOST_NODES = 64  # operations; a network of 10 layers has 23
OPSETS = (13, 25)  # oldest, newest: what the operations on the list mean is the same in all of them
FLOAT = 1
TENSOR_VALUE = "value"
DIMENSIONS = 2  # of an array, at most
SHOWN = 40  # letters of somebody else's name

_MODEL = ProtobufSchema(
    "model",
    {1: ("ir", VARINT), 7: ("graph", BYTES), 8: ("opset", BYTES), 14: ("metadata", BYTES)},
    frozenset((2, 3, 4, 5, 6)),  # who wrote it
)
_OPSET = ProtobufSchema("operator set", {1: ("domain", BYTES), 2: ("version", VARINT)})
_ENTRY = ProtobufSchema("metadata", {1: ("key", BYTES), 2: ("value", BYTES)})
_GRAPH = ProtobufSchema(
    "graph",
    {1: ("node", BYTES), 5: ("initializer", BYTES), 11: ("input", BYTES), 12: ("output", BYTES)},
    frozenset((2, 10, 13, 16)),  # name, words, shapes that somebody worked out, metadata
)
_NODE = ProtobufSchema(
    "operation",
    {1: ("input", BYTES), 2: ("output", BYTES), 4: ("type", BYTES), 5: ("attribute", BYTES)}
    | {7: ("domain", BYTES)},
    frozenset((3, 6, 9)),
)
_ATTRIBUTE = ProtobufSchema(
    "attribute",
    {1: ("name", BYTES), 2: ("float", FIXED32), 3: ("int", VARINT), 5: ("tensor", BYTES)},
    frozenset((13, 20)),  # words, and which of the fields it is
)
_TENSOR = ProtobufSchema(
    "array",
    {1: ("dims", VARINT), 2: ("type", VARINT), 8: ("name", BYTES), 9: ("raw", BYTES)},
    frozenset((12,)),
)
_END = ProtobufSchema("end", {1: ("name", BYTES), 2: ("type", BYTES)}, frozenset((3, 4)))
_TYPE = ProtobufSchema("type", {1: ("tensor", BYTES)}, frozenset((6,)))
_TENSOR_TYPE = ProtobufSchema("tensor type", {1: ("element", VARINT), 2: ("shape", BYTES)})
_SHAPE = ProtobufSchema("shape", {1: ("dim", BYTES)})
_DIM = ProtobufSchema("dimension", {1: ("value", VARINT), 2: ("name", BYTES)}, frozenset((3,)))


@dataclass(frozen=True, slots=True)
class OnnxNode:
    """One operation."""

    type: str
    inputs: tuple[str, ...]  # "": not given
    output: str
    attributes: Mapping[str, float]  # numbers alone


@dataclass(frozen=True, slots=True)
class OnnxModel:
    """Content of a file. Its arrays are float32, finite, read-only, of at most two dimensions."""

    metadata: tuple[tuple[str, str], ...]
    nodes: tuple[OnnxNode, ...]  # without constants, which are arrays
    arrays: Mapping[str, Rows]
    observations: int
    actions: int


def parsed(data: bytes) -> OnnxModel:
    """Parse the bytes of an ONNX file. Raises InvalidInput that names the part that cannot be read."""
    budget = ProtobufFieldBudget()
    fields = message(memoryview(data), _MODEL, budget)
    if len(fields["graph"]) != 1:
        raise InvalidInput(f"is no ONNX file: it has {len(fields['graph'])} graphs, one is needed")
    _require_opset([_all(each, _OPSET, budget) for each in fields["opset"]])
    metadata = tuple(_entry(_all(each, _ENTRY, budget)) for each in fields["metadata"])
    graph = _all(fields["graph"][0], _GRAPH, budget)
    if len(graph["node"]) > MOST_NODES:
        raise InvalidInput(f"its graph has {len(graph['node'])} operations, at most {MOST_NODES} are run")
    arrays = dict(_array(each, budget) for each in graph["initializer"])
    nodes = []
    for each in graph["node"]:
        node, constant = _node(each, budget)
        if constant is not None:
            arrays[node.output] = constant
        else:
            nodes.append(node)
    counts = [
        _end(what, name, graph[what], set(arrays), budget)
        for what, name in (("input", INPUT), ("output", OUTPUT))
    ]
    return OnnxModel(metadata, tuple(nodes), arrays, *counts)


def _all(value: Value, kind: ProtobufSchema, budget: ProtobufFieldBudget) -> dict[str, list[Value]]:
    assert isinstance(value, memoryview)
    return message(value, kind, budget)


def _last(values: list[Value]) -> str:
    """Return the last value of a text field that may be left out."""
    return text(values[-1]) if values else ""


def _require_opset(sets: list[dict[str, list[Value]]]) -> None:
    oldest, newest = OPSETS
    plain = [each["version"] for each in sets if _last(each["domain"]) in ("", "ai.onnx")]
    version = signed(plain[0][-1]) if len(plain) == 1 and plain[0] else None
    if version is None or not oldest <= version <= newest:
        raise InvalidInput(f"its operator set is {version}, {oldest} to {newest} are run")


def _entry(fields: dict[str, list[Value]]) -> tuple[str, str]:
    return _last(fields["key"]), _last(fields["value"])


def _array(value: Value, budget: ProtobufFieldBudget) -> tuple[str, Rows]:
    fields = _all(value, _TENSOR, budget)
    name = _last(fields["name"])
    kind = [signed(each) for each in fields["type"]]
    shape = tuple(signed(each) for each in fields["dims"])
    said = f"its array {name[:SHOWN]!r}"
    if kind != [FLOAT]:
        raise InvalidInput(f"{said} has the element type {kind[:4]}, float32 ([{FLOAT}]) is needed")
    if len(shape) > DIMENSIONS or any(each <= 0 for each in shape):
        raise InvalidInput(
            f"{said} has the shape {shape[:4]}, at most {DIMENSIONS} dimensions above 0 are read"
        )
    raw = b"".join(each for each in fields["raw"] if isinstance(each, memoryview))
    if len(raw) != 4 * prod(shape):
        raise InvalidInput(f"{said} of the shape {shape} has {len(raw)} bytes of raw data in the file")
    array = np.frombuffer(raw, "<f4").reshape(shape)
    if not np.isfinite(array).all():
        raise InvalidInput(f"{said} has numbers that are not finite")
    return name, array


def _node(value: Value, budget: ProtobufFieldBudget) -> tuple[OnnxNode, Rows | None]:
    fields = _all(value, _NODE, budget)
    kind = _last(fields["type"])
    domain = _last(fields["domain"])
    if domain not in ("", "ai.onnx"):
        raise InvalidInput(
            f"its graph has the operation {domain[:SHOWN]!r} {kind[:SHOWN]!r}, which is not run"
        )
    if len(fields["output"]) != 1:
        raise InvalidInput(
            f"its operation {kind[:SHOWN]!r} has {len(fields['output'])} outputs, one is needed"
        )
    numbers = dict[str, float]()
    tensors = dict[str, Rows]()
    for each in fields["attribute"]:
        attribute = _all(each, _ATTRIBUTE, budget)
        name = _last(attribute["name"])
        given = [*attribute["float"], *attribute["int"], *attribute["tensor"]]
        if len(given) != 1 or name in numbers or name in tensors:
            raise InvalidInput(
                f"its operation {kind[:SHOWN]!r}: {name[:SHOWN]!r} has {len(given)} values, not one"
            )
        if attribute["tensor"]:
            tensors[name] = _array(given[0], budget)[1]
        else:
            numbers[name] = signed(given[0]) if attribute["int"] else _float(given[0])
    inputs = tuple(map(text, fields["input"]))
    node = OnnxNode(kind, inputs, text(fields["output"][0]), numbers)
    if kind != "Constant" and not tensors:
        return node, None
    if kind != "Constant" or list(tensors) != [TENSOR_VALUE] or numbers or inputs:
        raise InvalidInput(f"its operation {kind[:SHOWN]!r} has arrays that are not read")
    return node, tensors[TENSOR_VALUE]


def _float(value: Value) -> float:
    assert isinstance(value, memoryview)
    number: float = struct.unpack("<f", value)[0]
    return number


def _end(what: str, name: str, ends: list[Value], given: set[str], budget: ProtobufFieldBudget) -> int:
    """Return the number of entries of the observation (input) or of the action (output)."""
    found = [(_last(each["name"]), each["type"]) for each in (_all(end, _END, budget) for end in ends)]
    found = [each for each in found if each[0] not in given]
    if [each[0] for each in found] != [name]:
        said = ", ".join(each[0][:SHOWN] for each in found) or "none"
        raise InvalidInput(f"its {what} is {said}, expected {name} alone")
    dims = list[int]()
    element = list[Value]()
    for kind in found[0][1]:
        for tensor in _all(kind, _TYPE, budget)["tensor"]:
            fields = _all(tensor, _TENSOR_TYPE, budget)
            element += fields["element"]
            for shape in fields["shape"]:
                each = (_all(dim, _DIM, budget)["value"] for dim in _all(shape, _SHAPE, budget)["dim"])
                dims += [signed(values[-1]) if values else 0 for values in each]
    if element != [FLOAT] or len(dims) != 2 or not 0 <= dims[0] <= 1 or dims[1] <= 0:
        raise InvalidInput(f"its {what} {name} is not float32 of (batch, count)")
    return dims[1]
