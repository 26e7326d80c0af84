"""Parser of a varlink interface definition, and the check of values against its types. Library only.

Grammar: varlink.org/Interface-Definition. Enums and `object` included; comments are skipped.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from twind.exceptions import InvalidInput

_TOKEN = re.compile(r"\s+|#[^\n]*|(?P<token>->|\[string\]|\[\]|[?:,()]|[A-Za-z][A-Za-z0-9_.-]*)")
_INT = range(-(1 << 63), 1 << 63)


class IdlType:
    """Type of a value."""

    def check(self, value: object, where: str) -> None:
        """Check `value`. Raises InvalidInput: the type does not allow it."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class ScalarType(IdlType):
    """Type bool, int, float, string or object. A bool is no number; an int is valid as a float."""

    name: str

    def check(self, value: object, where: str) -> None:
        """Raises InvalidInput."""
        kind = type(value)
        if self.name == "float":
            good = kind is float or (kind is int and value in _INT)
        elif self.name == "int":
            good = kind is int and value in _INT
        elif self.name == "object":
            good = kind is dict
        else:
            good = kind is (bool if self.name == "bool" else str)
        if not good:
            raise InvalidInput(f"expected {self.name}, got {_described(value)}", where=where)


@dataclass(frozen=True, slots=True)
class OptionalType(IdlType):
    """The value, or null."""

    of: IdlType

    def check(self, value: object, where: str) -> None:
        """Raises InvalidInput."""
        if value is not None:
            self.of.check(value, where)


@dataclass(frozen=True, slots=True)
class ListType(IdlType):
    """Any number of values of one type."""

    of: IdlType

    def check(self, value: object, where: str) -> None:
        """Raises InvalidInput."""
        if type(value) is not list:
            raise InvalidInput(f"expected an array, got {_described(value)}", where=where)
        if (
            isinstance(self.of, ScalarType)
            and self.of.name == "float"
            and all(type(x) is float for x in value)
        ):
            return  # the bulk of a trajectory
        for place, item in enumerate(value):
            self.of.check(item, f"{where}[{place}]")


@dataclass(frozen=True, slots=True)
class MapType(IdlType):
    """Values of one type by name."""

    of: IdlType

    def check(self, value: object, where: str) -> None:
        """Raises InvalidInput."""
        if type(value) is not dict:
            raise InvalidInput(f"expected an object, got {_described(value)}", where=where)
        for key, item in value.items():
            self.of.check(item, f"{where}.{key}" if where else key)


@dataclass(frozen=True, slots=True)
class EnumType(IdlType):
    """One of several words."""

    words: tuple[str, ...]

    def check(self, value: object, where: str) -> None:
        """Raises InvalidInput."""
        if value not in self.words:
            raise InvalidInput(
                f"expected one of {', '.join(self.words)}, got {_described(value)}", where=where
            )


@dataclass(frozen=True, slots=True)
class StructType(IdlType):
    """Named fields; those of type `Maybe` may be absent, others and unknown ones may not."""

    fields: Mapping[str, IdlType]

    def check(self, value: object, where: str) -> None:
        """Raises InvalidInput."""
        if type(value) is not dict:
            raise InvalidInput(f"expected an object, got {_described(value)}", where=where)
        prefix = f"{where}." if where else ""
        for name, kind in self.fields.items():
            if name in value:
                kind.check(value[name], prefix + name)
            elif not isinstance(kind, OptionalType):
                raise InvalidInput("is missing", where=prefix + name)
        if len(value) > len(self.fields) or value.keys() - self.fields.keys():
            unknown = sorted(value.keys() - self.fields.keys())[0]
            known = ", ".join(self.fields) or "none"
            raise InvalidInput(f"unknown field; known: {known}", where=prefix + unknown)


@dataclass(slots=True)
class NamedType(IdlType):
    """A type of the interface by its name; resolved when first used, so that order does not matter."""

    name: str
    types: Mapping[str, IdlType]

    def check(self, value: object, where: str) -> None:
        """Raises InvalidInput."""
        self.types[self.name].check(value, where)


@dataclass(frozen=True, slots=True)
class IdlMethod:
    """One method: types of its parameters and of its answer."""

    name: str
    parameters: StructType
    results: StructType


@dataclass(frozen=True, slots=True)
class IdlInterface:
    """One interface: its name, its text as written, its members."""

    name: str
    description: str
    types: dict[str, IdlType] = field(default_factory=dict)
    methods: dict[str, IdlMethod] = field(default_factory=dict)
    errors: dict[str, StructType] = field(default_factory=dict)


def parse(text: str) -> IdlInterface:
    """The interface that `text` defines. Raises SyntaxError: it names the wrong token."""
    reader = _IdlTokens(text)
    reader.expect("interface")
    interface = IdlInterface(reader.word(), text)
    reader.types = interface.types
    while reader.token is not None:
        kind = reader.word()
        name = reader.word()
        if kind == "type":
            interface.types[name] = reader.composite()
        elif kind == "method":
            parameters = reader.struct()
            reader.expect("->")
            interface.methods[name] = IdlMethod(name, parameters, reader.struct())
        elif kind == "error":
            interface.errors[name] = reader.struct()
        else:
            raise SyntaxError(f"expected type, method or error, got {kind!r}")
    missing = reader.named - interface.types.keys()
    if missing:
        raise SyntaxError(f"no such type: {', '.join(sorted(missing))}")
    return interface


class _IdlTokens:
    """Tokens of an interface definition, one ahead."""

    def __init__(self, text: str) -> None:
        self._tokens = _tokens(text)
        self.types: Mapping[str, IdlType] = {}
        self.named: set[str] = set()
        self.token: str | None = next(self._tokens, None)

    def take(self) -> str:
        """Return the next token. Raises SyntaxError at the end of the text."""
        token = self.token
        self.token = next(self._tokens, None)
        if token is None:
            raise SyntaxError("the definition ends too early")
        return token

    def expect(self, wanted: str) -> None:
        """Skip the token `wanted`. Raises SyntaxError for another one."""
        got = self.take()
        if got != wanted:
            raise SyntaxError(f"expected {wanted!r}, got {got!r}")

    def word(self) -> str:
        """Return the next token, a name. Raises SyntaxError for anything else."""
        got = self.take()
        if not got[0].isalpha():
            raise SyntaxError(f"expected a name, got {got!r}")
        return got

    def struct(self) -> StructType:
        """Parse a struct `(name: type, ...)`. Raises SyntaxError for an enum."""
        composite = self.composite()
        if not isinstance(composite, StructType):
            raise SyntaxError(f"expected (name: type, ...), got words {composite}")
        return composite

    def composite(self) -> IdlType:
        """Parse a struct, or an enum: words without types."""
        self.expect("(")
        fields: dict[str, IdlType] = {}
        words: list[str] = []
        while self.token != ")":
            name = self.word()
            if self.token == ":":
                self.take()
                fields[name] = self.type()
            else:
                words.append(name)
            if self.token != ")":
                self.expect(",")
        self.take()
        if words and fields:
            raise SyntaxError(f"words {words} among typed fields")
        return EnumType(tuple(words)) if words else StructType(fields)

    def type(self) -> IdlType:
        """Parse a type."""
        if self.token == "(":
            return self.composite()
        token = self.take()
        if token == "?":
            return OptionalType(self.type())
        if token == "[]":
            return ListType(self.type())
        if token == "[string]":
            return MapType(self.type())
        if token in ("bool", "int", "float", "string", "object"):
            return ScalarType(token)
        self.named.add(token)
        return NamedType(token, self.types)


def _tokens(text: str) -> Iterator[str]:
    place = 0
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None:
            line = text.count("\n", 0, place) + 1
            raise SyntaxError(f"line {line}: {text[place : place + 20]!r} is no part of a definition")
        place = match.end()
        if match["token"]:
            yield match["token"]


def _described(value: Any) -> str:
    names = {bool: "bool", int: "int", float: "float", str: "string", list: "array", dict: "object"}
    if value is None:
        return "null"
    shown = "" if type(value) in (list, dict) else f" {str(value)[:40]!r}"
    return names.get(type(value), type(value).__name__) + shown
