"""A mapping of a file, read as a `ConfigStruct` that declares its keys, types, bounds and defaults.

Every error is a ConfigError with file, line, column, path, value and bound. A key that the Struct does not
declare is an error. A key with `_rad` in its name has a `_deg` twin; both given is an error.
"""

import copy
import difflib
import math
import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import is_dataclass
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta

from twind.config.yaml_tree import ConfigError, FilePosition, Node, YamlMapping, YamlScalar, YamlSequence

T = TypeVar("T")
Plain = str | int | float | bool | None | list["Plain"] | dict[str, "Plain"]
Text = Annotated[str, Meta(min_length=1)]
Name = Annotated[
    Text,
    Meta(
        pattern=r"^[a-z0-9_-]{1,64}\Z",
        title="1–64 of a-z, 0-9, `_`, `-`",
        description="use 1 to 64 of a-z, 0-9, _ and -",
    ),
]

_LOOKS_NUMERIC = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|0[ox]?[0-9a-fA-F]+")
_KINDS = {str: "text", bool: "a truth value", int: "a whole number", float: "a number", type(None): "nothing"}
_WANTED = _KINDS | {bool: "true or false", tuple: "a list", dict: "a mapping"}


class ConfigStruct(msgspec.Struct):
    """Keys of one mapping of a file. None stands for a key that is absent; null in a file is an error."""


class ConfigReader:
    """One mapping under conversion. `path` is how its place reads in a message: `joints.l_knee`."""

    def __init__(self, file: str, table: YamlMapping, path: str = "", unit: float = 1.0) -> None:
        self.file = file
        self.path = path
        self._table = table
        self._unit = unit  # of its numbers, where its own key says degrees
        self._common: tuple[ConfigReader, Collection[str]] | None = None

    def inherit(self, common: "ConfigReader", keys: Collection[str]) -> "ConfigReader":
        """This mapping, with the values of `common` for those of `keys` that it does not have."""
        made = copy.copy(self)
        made._common = (common, keys)
        return made

    def drop_nulls(self, *keys: str) -> "ConfigReader":
        """This mapping without those of `keys` that are null."""
        null = {key for key in keys if key in self._table.items and self.plain(key) is None}
        items = {key: node for key, node in self._table.items.items() if key not in null}
        return ConfigReader(self.file, YamlMapping(self._table.mark, items, self._table.keys), self.path)

    # ---------------------------------------------------------------------------------- what is there

    def has(self, key: str) -> bool:
        """Return whether `key` (or its `_deg` twin) is given, be it as `null`."""
        return self._owner(key)._given(key) is not None

    def __iter__(self) -> Iterator[str]:
        """Every key of this mapping, in the order of the file."""
        return iter(tuple(self._table.items))

    def refuse(self, key: str, message: str) -> ConfigError:
        """The error to raise about `key`: at its value, else at the mapping."""
        owner = self._owner(key)
        given = owner._given(key) or key
        node = owner._table.items.get(given, owner._table)
        return ConfigError(owner.file, node.mark, owner._join(given), message)

    def require_known(self, keys: Iterable[str]) -> None:
        """Every key is one of `keys`, or the `_deg` twin of one. Raises ConfigError for the first other."""
        known = dict.fromkeys(name for key in keys for name in (key, _twin(key)))
        for key in self._table.items:
            self._given(key.replace("_deg", "_rad"))
            if key not in known:
                near = difflib.get_close_matches(key, known, 1)
                hint = f"nearest: {near[0]}" if near else f"known: {', '.join(known) or 'none'}"
                mark = self._table.keys[key]
                raise ConfigError(self.file, mark, self._join(key), f"unknown key; {hint}")

    # ---------------------------------------------------------------------------------- values

    def read(self, shape: type[T], *beside: type, **fixed: Any) -> T:
        """The mapping as `shape`. Raises ConfigError.

        `beside`: other shapes of the same mapping, whose keys are known too. `fixed`: fields that it has not.
        """
        declared: type = shape
        keys = {key: field for key, field in keys_of(declared).items() if key not in fixed}
        self.require_known([*keys, *(key for each in beside for key in keys_of(each))])
        found = {
            name: self._field(name, field.kind)
            for name, field in keys.items()
            if field.required or self.has(name)
        }
        return shape(**found, **fixed)

    def value(self, key: str, kind: Any) -> Any:
        """The value of `key` as `kind`, a type with its bounds; rad where the key says `_rad`."""
        owner = self._owner(key)
        given = owner._given(key)
        if given is None:
            raise self.refuse(key, "is required and missing")
        node = owner._table.items[given]
        plain = _plain(node, owner._unit_of(key))
        if plain is None and kind is not Any:  # an optional key is left out, not null
            raise self.refuse(key, _explain(node, plain, kind))
        try:
            return msgspec.convert(plain, kind, strict=True)
        except msgspec.ValidationError:
            path, node, reason = _find_fault(owner._join(given), node, plain, kind)
            raise ConfigError(owner.file, node.mark, path, reason) from None

    def choice(self, key: str, known: Iterable[str]) -> str:
        """One of the names `known`."""
        value: str = self.value(key, Text)
        if value not in known:
            raise self.refuse(key, none_of(value, known))
        return value

    def check(self, key: str, kind: Any) -> None:
        """Raises ConfigError for a value that is given and is not of `kind`, a narrower type."""
        if self.has(key):
            self.value(key, kind)

    def require_format(self, name: str) -> None:
        """The file is of the format `name`, whatever else stands in it."""
        if (found := self.value("format", Text)) != name:
            raise self.refuse("format", f"{found!r} is not {name}")

    def section(self, key: str) -> "ConfigReader":
        """A mapping; one that is absent is empty."""
        given = self._given(key)
        if given is None:
            return ConfigReader(self.file, YamlMapping(self._table.mark, {}, {}), self._join(key))
        node = self._table.items[given]
        if not isinstance(node, YamlMapping):
            raise self.refuse(key, f"a mapping is expected, found {_shown(node)}")
        return ConfigReader(self.file, node, self._join(key), self._unit_of(key))

    def sections(self, form: re.Pattern[str] | None = None) -> dict[str, "ConfigReader"]:
        """The mappings that stand here, by name. Raises ConfigError for a name that has not the form."""
        for name in self:
            if form is not None and not form.fullmatch(name):
                raise self.refuse(name, f"{name!r}: use 1 to 64 letters, digits, _ . and -")
        return {name: self.section(name) for name in self}

    def plain(self, key: str) -> Plain:
        """The value as it stands, unchecked but for YAML's traps; None when absent."""
        owner = self._owner(key)
        given = owner._given(key)
        found: Plain = None if given is None else _plain(owner._table.items[given])
        return found

    # ---------------------------------------------------------------------------------- inside

    def _field(self, key: str, kind: Any) -> Any:
        base, _ = type_parts(kind)
        shape = shape_of(kind)
        if base is ConfigReader:
            return self.section(key)
        if shape is not None:
            return self.section(key).read(shape)
        if get_origin(base) is dict:
            section = self.section(key)
            return {name: section._field(name, get_args(base)[1]) for name in section}
        return self.value(key, kind)

    def _owner(self, key: str) -> "ConfigReader":
        """Return the mapping that has `key`: this one, else the inherited one."""
        if self._common is None or key not in self._common[1] or self._given(key) is not None:
            return self
        return self._common[0] if self._common[0].has(key) else self

    def _unit_of(self, key: str) -> float:
        return self._unit if self._given(key) in (key, None) else math.radians(1.0)

    def _join(self, key: str) -> str:
        return ".".join(filter(None, (self.path, key)))

    def _given(self, key: str) -> str | None:
        """The key as it is written in the file. Raises when it is given in rad and in deg."""
        items = self._table.items
        twin = _twin(key)
        if key not in items:
            return twin if twin in items else None
        if twin != key and twin in items:
            mark = self._table.keys[twin]
            raise ConfigError(self.file, mark, self._join(twin), f"{key} is given too: keep one of them")
        return key


class FileKey(NamedTuple):
    """A key that a shape declares: its type with the bounds, and whether a file must have it."""

    kind: Any
    required: bool
    default: Any


@cache
def keys_of(shape: type) -> dict[str, FileKey]:
    """The keys of a Struct or dataclass, in order."""
    kinds = get_type_hints(shape, include_extras=True)
    declared = msgspec.inspect.type_info(shape).fields  # type: ignore[attr-defined]  # of a Struct or dataclass
    return {each.name: FileKey(kinds[each.name], each.required, each.default) for each in declared}


@cache
def shape_of(kind: Any) -> type | None:
    """The Struct or dataclass that a type is; None: it is another one."""
    base, _ = type_parts(kind)
    is_shape = isinstance(base, type) and (issubclass(base, msgspec.Struct) or is_dataclass(base))
    return base if is_shape else None


def bounds_text(limits: Iterable[Meta]) -> str:
    """Bounds of a number as a message writes them: `>= 10 and <= 1000`."""
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    found = ((sign, getattr(each, name)) for name, sign in signs.items() for each in limits)
    return " and ".join(f"{sign} {bound:g}" for sign, bound in found if bound is not None)


@cache
def type_parts(kind: Any) -> tuple[Any, tuple[Meta, ...]]:
    """The type without bounds and `| None`, and its bounds."""
    if get_origin(kind) is Annotated:
        base, *limits = get_args(kind)
        inner, more = type_parts(base)
        return inner, (*limits, *more)
    if isinstance(kind, UnionType) or get_origin(kind) is Union:
        return type_parts(next(each for each in get_args(kind) if each is not type(None)))
    return kind, ()


def _find_fault(path: str, node: Node, value: Any, kind: Any) -> tuple[str, Node, str]:
    """Return path, node and reason of a wrong value: an item of a list, where that alone is wrong."""
    base, _ = type_parts(kind)
    if isinstance(node, YamlSequence) and get_origin(base) is tuple:
        kinds = get_args(base)
        count = len(node.items)
        wanted = kinds[:1] * count if kinds[-1] is ... else kinds
        for index in range(count if len(wanted) == count else 0):
            try:
                msgspec.convert(value[index], wanted[index], strict=True)
            except msgspec.ValidationError:
                return _find_fault(f"{path}[{index}]", node.items[index], value[index], wanted[index])
    return path, node, _explain(node, value, kind)


def _explain(node: Node, value: Any, kind: Any) -> str:
    """Return why a value is not of `kind`: the value, the bound and the remedy."""
    base, limits = type_parts(kind)
    remedy = next((f"; {each.description}" for each in limits if each.description), "")
    if get_origin(base) is Literal and type(value) is type(get_args(base)[0]):
        return none_of(value, get_args(base)) + remedy
    wanted = type(get_args(base)[0]) if get_origin(base) is Literal else get_origin(base) or base
    if wanted is float and type(value) is int:
        value = float(value)
    if wanted is tuple and isinstance(value, list):
        return f"needs {len(get_args(base))} values, found {len(value)}{remedy}"
    if type(value) is not wanted:
        return _unfit(node, wanted) + remedy
    if wanted is not str:
        return f"{value:g} is outside {bounds_text(limits)}"
    return f"{value!r} has a wrong form{remedy}" if value else "must not be empty"


def _unfit(node: Node, wanted: type) -> str:
    """A value of another type than `wanted`."""
    value = node.value if isinstance(node, YamlScalar) else None
    if wanted is float and isinstance(value, str) and _LOOKS_NUMERIC.fullmatch(value):
        quoted = isinstance(node, YamlScalar) and not node.plain
        how = "without quotes" if quoted else "as a decimal, 1.0e+3 or -0.5"
        return f"{value} is text in YAML, not a number: write it {how}"
    hint = "; quote it" if wanted is str and value is not None else ""
    return f"{_WANTED[wanted]} is expected, found {_shown(node)}{hint}"


def none_of(value: object, known: Iterable[object]) -> str:
    """A choice that is not there: the choices, and the nearest."""
    names = [str(each) for each in known if each != ""]  # "": the key is left out
    if not names:
        return f"{value!r} is not described: the file describes none"
    near = difflib.get_close_matches(str(value), names, 1)
    hint = f"; nearest: {near[0]}" if near else ""
    return f"{value!r} is none of {', '.join(names)}{hint}"


def _shown(node: Node) -> str:
    """Return the description of an unexpected value in a message."""
    if isinstance(node, YamlSequence):
        return "a list"
    if isinstance(node, YamlMapping):
        return "a mapping"
    if node.value is None:
        return "nothing"
    text = repr(node.value)
    return f"{_KINDS[type(node.value)]} ({text if len(text) <= 40 else text[:37] + '...'})"


def _plain(node: Node, unit: float = 1.0) -> Any:
    """The value without its places; numbers times `unit`."""
    if isinstance(node, YamlSequence):
        return [_plain(item, unit) for item in node.items]
    if isinstance(node, YamlMapping):
        return {key: _plain(item, unit) for key, item in node.items.items()}
    scaled = unit != 1.0 and type(node.value) in (int, float)
    return float(node.value) * unit if scaled else node.value  # type: ignore[arg-type]  # a number


def _twin(key: str) -> str:
    """The key of the same value in degrees; itself where there is none."""
    return key.replace("_rad", "_deg")


def file_error(file: str, message: str) -> ConfigError:
    """An error about a file as a whole."""
    return ConfigError(file, FilePosition(0, 0), "", message)
