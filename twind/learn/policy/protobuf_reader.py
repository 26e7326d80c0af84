"""Messages of protocol buffers, as far as a policy file needs them, from bytes that may come from anybody.

Each kind of message says which fields are read, and which are passed over; any other is refused. Nothing is
built but numbers and views of the bytes, so a file costs what it weighs. Source: protobuf.dev, "Encoding".
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from twind.exceptions import InvalidInput

# wire types
VARINT = 0
FIXED64 = 1
BYTES = 2
FIXED32 = 5
MOST_FIELDS = 8192  # of a whole file
_WIDTHS = {FIXED64: 8, FIXED32: 4}
_SIGN = 1 << 63
_WHOLE = 1 << 64

Value = int | memoryview  # of a field: a number, or its bytes


@dataclass(frozen=True, slots=True)
class ProtobufSchema:
    """One kind of message: `read` name by number, with its wire type; `passed`: fields that mean nothing."""

    name: str
    read: Mapping[int, tuple[str, int]]
    passed: frozenset[int] = frozenset()


@dataclass(slots=True)
class ProtobufFieldBudget:
    """Number of fields that a file may still have."""

    fields: int = field(default=MOST_FIELDS)

    def spend(self) -> None:
        """Count one field. Raises InvalidInput if there are too many."""
        self.fields -= 1
        if self.fields < 0:
            raise InvalidInput(f"has more than {MOST_FIELDS} fields: no policy of ours")


def message(data: memoryview, kind: ProtobufSchema, budget: ProtobufFieldBudget) -> dict[str, list[Value]]:
    """Its fields by name, in their order; those that are not there are empty. Raises InvalidInput."""
    found: dict[str, list[Value]] = {name: [] for name, _ in kind.read.values()}
    at = 0
    while at < len(data):
        budget.spend()
        key, at = _varint(data, at)
        number = key >> 3
        wire = key & 7
        value, at = _value(data, at, wire)
        if number in kind.passed:
            continue
        name, expected = kind.read.get(number, ("", -1))
        if not name:
            raise InvalidInput(f"its {kind.name} has the field {number}, which is not read")
        if wire == BYTES and expected == VARINT:
            assert isinstance(value, memoryview)
            found[name] += _packed(value, budget)
        elif wire == expected:
            found[name].append(value)
        else:
            raise InvalidInput(f"its {kind.name}: {name} has the wire type {wire}, expected {expected}")
    return found


def text(value: Value) -> str:
    """Decode a field's bytes as UTF-8. Raises InvalidInput if they are no UTF-8."""
    assert isinstance(value, memoryview)
    try:
        return str(value, "utf-8")
    except UnicodeDecodeError:
        raise InvalidInput("has a text that is no UTF-8") from None


def signed(value: Value) -> int:
    """Convert a varint of protocol buffers to a signed int64."""
    assert isinstance(value, int)
    return value - _WHOLE if value >= _SIGN else value


def _value(data: memoryview, at: int, wire: int) -> tuple[Value, int]:
    if wire == VARINT:
        return _varint(data, at)
    if wire == BYTES:
        count, at = _varint(data, at)
    else:
        count = _WIDTHS.get(wire, _WHOLE)
    if count > len(data) - at:
        raise InvalidInput(f"is no ONNX file, or torn: {count} bytes of wire type {wire} are not there")
    return data[at : at + count], at + count


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            break
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80 and value < _WHOLE:
            return value, at
    raise InvalidInput("is no ONNX file, or torn: a number in it has no end")


def _packed(data: memoryview, budget: ProtobufFieldBudget) -> list[Value]:
    values = list[Value]()
    at = 0
    while at < len(data):
        budget.spend()
        value, at = _varint(data, at)
        values.append(value)
    return values
