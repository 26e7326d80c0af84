"""The bytes of a message: XCDR1, little endian, as DDS, Zenoh and recordings of ROS 2 carry them.

A message is a dict by field name; numbers in rows are lists. A field that is left out is zero or empty.
Alignment counts from the byte after the four of the header. Standard library only.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from twind.exceptions import InvalidInput
from twind.ros.message_definitions import PRIMITIVES, TEXT, MessageDefinitions, MessageField, definitions_of

HEAD = b"\x00\x01\x00\x00"  # XCDR1, little endian
_COUNT = struct.Struct("<I")
# Bytes that may follow, as readers of ROS let them: some senders fill up to a multiple of four, and what
# rclpy serializes over Fast DDS has up to twelve behind it (measured with rclpy 9.1.2).
_LOOSE = 15

Message = dict[str, Any]


def encode(kind: str | MessageDefinitions, message: Mapping[str, object]) -> bytes:
    """The bytes of `message`, header included. Raises InvalidInput."""
    definitions = definitions_of(kind)
    out = bytearray(HEAD)
    _put(out, definitions, definitions.name, message)
    return bytes(out)


def decode(kind: str | MessageDefinitions, data: bytes) -> Message:
    """The message whose bytes, header included, are `data`. Raises InvalidInput."""
    if data[:2] != HEAD[:2]:
        raise InvalidInput(
            f"bytes begin with {data[:4].hex(' ')!r}: only XCDR1, little endian (00 01) is read"
        )
    definitions = definitions_of(kind)
    source = CdrReader(data)
    try:
        message = source.message(definitions, definitions.name)
    except (struct.error, UnicodeDecodeError) as error:
        raise InvalidInput(f"{definitions.name}: {error}, at byte {source.place} of {len(data)}") from None
    if len(data) - source.place > _LOOSE:
        raise InvalidInput(f"{definitions.name}: ends at byte {source.place}, but there are {len(data)}")
    return message


# ------------------------------------------------------------------------------------------ out


def _align(out: bytearray, size: int) -> None:
    out += bytes(-(len(out) - len(HEAD)) % size)


def _put(out: bytearray, definitions: MessageDefinitions, name: str, message: Mapping[str, object]) -> None:
    fields = definitions.fields(name)
    unknown = set(message) - {field.name for field in fields}
    if unknown:
        known = ", ".join(field.name for field in fields)
        raise InvalidInput(f"{name}: no field {sorted(unknown)[0]!r}; known: {known}")
    for field in fields:
        try:
            _put_field(out, definitions, field, message.get(field.name))
        except (struct.error, TypeError, AttributeError) as error:
            raise InvalidInput(f"{name}: {field.name}: {error}") from None


def _put_field(out: bytearray, definitions: MessageDefinitions, field: MessageField, value: Any) -> None:
    if not field.many:
        _put_one(out, definitions, field.kind, value)
        return
    row: Sequence[Any] = () if value is None else value
    if field.count is None:
        _align(out, 4)
        out += _COUNT.pack(len(row))
    elif value is None:
        row = [None] * field.count
    elif len(row) != field.count:
        raise TypeError(f"{len(row)} values, must be {field.count}")
    if field.kind in PRIMITIVES and len(row):
        letter, size = PRIMITIVES[field.kind]
        _align(out, size)
        out += struct.pack(f"<{len(row)}{letter}", *(0 if each is None else each for each in row))
    else:
        for each in row:
            _put_one(out, definitions, field.kind, each)


def _put_one(out: bytearray, definitions: MessageDefinitions, kind: str, value: Any) -> None:
    if kind in PRIMITIVES:
        letter, size = PRIMITIVES[kind]
        _align(out, size)
        out += struct.pack(f"<{letter}", 0 if value is None else value)
    elif kind == TEXT:
        text = ("" if value is None else value).encode() + b"\0"
        _align(out, 4)
        out += _COUNT.pack(len(text)) + text
    else:
        _put(out, definitions, kind, {} if value is None else value)


# ------------------------------------------------------------------------------------------ in


class CdrReader:
    """The bytes of a message, read from front to back: `place` is the next byte."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.place = len(HEAD)

    def message(self, definitions: MessageDefinitions, name: str) -> Message:
        """Every field of a type."""
        return {field.name: self.field(definitions, field) for field in definitions.fields(name)}

    def field(self, definitions: MessageDefinitions, field: MessageField) -> Any:
        """One field, or all of its row."""
        if not field.many:
            return self.read_value(definitions, field.kind)
        count = self.numbers("I", 4, 1)[0] if field.count is None else field.count
        if field.kind in PRIMITIVES:
            return list(self.numbers(*PRIMITIVES[field.kind], count)) if count else []
        if count > len(self.data) - self.place:  # each takes a byte at least: a lie must cost no memory
            raise struct.error(f"{field.name}: {count} values are more than the bytes that are left")
        return [self.read_value(definitions, field.kind) for _ in range(count)]

    def read_value(self, definitions: MessageDefinitions, kind: str) -> Any:
        """One value."""
        if kind in PRIMITIVES:
            return self.numbers(*PRIMITIVES[kind], 1)[0]
        return self.text() if kind == TEXT else self.message(definitions, kind)

    def numbers(self, letter: str, size: int, count: int) -> tuple[Any, ...]:
        """`count` numbers of `size` bytes, aligned. Raises struct.error where there are not so many."""
        place = self.place + -(self.place - len(HEAD)) % size
        if place + count * size > len(self.data):
            raise struct.error(f"{count} x {size} bytes are more than are left")
        self.place = place + count * size
        return struct.unpack_from(f"<{count}{letter}", self.data, place)

    def text(self) -> str:
        """A string, without the NUL that ends it."""
        length = self.numbers("I", 4, 1)[0]
        end = self.place + length
        if end > len(self.data):
            raise struct.error(f"a text of {length} bytes is longer than what is left")
        text = self.data[self.place : end]
        self.place = end
        return text[:-1].decode() if text.endswith(b"\0") else text.decode()
