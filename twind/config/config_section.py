"""A mapping of a file, asked key by key for the type and the bounds it must have.

Every getter raises ConfigError with file, line, column, path, value, bound. What nobody asked for when
`close` is called is an unknown key. A key with `_rad` in its name has a `_deg` twin; both given is an error.
"""

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

from twind.config.yaml_tree import ConfigError, FilePosition, Node, YamlMapping, YamlScalar, YamlSequence

T = TypeVar("T")
Plain = str | int | float | bool | None | list["Plain"] | dict[str, "Plain"]

_LOOKS_NUMERIC = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|0[ox]?[0-9a-fA-F]+")
_KINDS = {str: "text", bool: "a truth value", int: "a whole number", float: "a number", type(None): "nothing"}


class ConfigSection:
    """One mapping under conversion. `path` is how its place reads in a message: `joints.l_knee`."""

    def __init__(self, file: str, table: YamlMapping, path: str = "") -> None:
        self.file = file
        self.path = path
        self._table = table
        self._known: dict[str, None] = {}  # keys asked for, in order

    # ---------------------------------------------------------------------------------- what is there

    def has(self, key: str) -> bool:
        """Whether `key` (or its `_deg` twin) is given, be it as `null`."""
        return self._given(key) is not None

    def __iter__(self) -> Iterator[str]:
        """Every key of this mapping, in the order of the file."""
        return iter(tuple(self._table.items))

    def refuse(self, key: str, message: str) -> ConfigError:
        """The error to raise about `key`: at its value, at the key where it has none, else at the mapping."""
        given = self._given(key) or key
        node = self._table.items.get(given)
        mark = node.mark if node is not None else self._table.mark
        return ConfigError(self.file, mark, self._join(given), message)

    def close(self, also: Iterable[str] = ()) -> None:
        """Every key has been asked for, or is in `also`. Raises ConfigError for the first that is not."""
        self._known.update(dict.fromkeys(also))
        for key in self._table.items:
            if key not in self._known:
                raise self._unknown(key)

    # ---------------------------------------------------------------------------------- typed getters

    def text(self, key: str, default: str | None = None, choices: Sequence[str] = ()) -> str:
        """Text; one of `choices` where there are any. Required when `default` is None."""
        if not self.has(key) and default is not None:
            return default
        value = self._leaf(key, "text", str)
        if not value:
            raise self.refuse(key, "must not be empty")
        if choices and value not in choices:
            near = difflib.get_close_matches(value, choices, 1)
            hint = f"; nearest: {near[0]}" if near else ""
            raise self.refuse(key, f"{value!r} is none of {', '.join(choices)}{hint}")
        return value

    def number(
        self,
        key: str,
        default: float | None = None,
        *,
        least: float = -math.inf,
        most: float = math.inf,
        above: float = -math.inf,
    ) -> float:
        """A finite number with least <= x <= most and x > above; rad where the key says `_rad`."""
        if not self.has(key) and default is not None:
            return default
        value = self._number(self._node(key), self._join(self._given(key) or key)) * self._unit(key)
        return self._bounded(key, value, least, most, above)

    def integer(
        self, key: str, default: int | None = None, *, least: float = -math.inf, most: float = math.inf
    ) -> int:
        """A whole number with least <= x <= most."""
        if not self.has(key) and default is not None:
            return default
        value = self._leaf(key, "a whole number", int)
        self._bounded(key, value, least, most, -math.inf)
        return value

    def flag(self, key: str, default: bool | None = None) -> bool:
        """true or false."""
        if not self.has(key) and default is not None:
            return default
        return self._leaf(key, "true or false", bool)

    def numbers(self, key: str, count: int | None = None) -> tuple[float, ...]:
        """A list of (`count`) finite numbers; rad where the key says `_rad`."""
        items = self._row(key)
        if count is not None and len(items) != count:
            raise self.refuse(key, f"needs {count} numbers, found {len(items)}")
        path = self._join(self._given(key) or key)
        return tuple(self._number(item, f"{path}[{i}]") * self._unit(key) for i, item in enumerate(items))

    def integers(self, key: str, count: int) -> tuple[int, ...]:
        """A list of `count` whole numbers."""
        values = []
        for item in self._row(key):
            if not isinstance(item, YamlScalar) or type(item.value) is not int:
                raise self.refuse(key, f"a list of whole numbers is expected, found {_shown(item)}")
            values.append(item.value)
        if len(values) != count:
            raise self.refuse(key, f"needs {count} whole numbers, found {len(values)}")
        return tuple(values)

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts, empty when absent."""
        if not self.has(key):
            return ()
        values = []
        for item in self._row(key):
            if not isinstance(item, YamlScalar) or not isinstance(item.value, str):
                raise self.refuse(key, f"a list of names is expected, found {_shown(item)}")
            values.append(item.value)
        return tuple(values)

    def section(self, key: str) -> "ConfigSection":
        """A mapping; one that is absent is empty."""
        if not self.has(key):
            return ConfigSection(self.file, YamlMapping(self._table.mark, {}, {}), self._join(key))
        node = self._node(key)
        if not isinstance(node, YamlMapping):
            raise self.refuse(key, f"a mapping is expected, found {_shown(node)}")
        return ConfigSection(self.file, node, self._join(key))

    def plain(self, key: str) -> Plain:
        """The value as it stands, unchecked but for YAML's traps; None when absent."""
        return _plain(self._node(key)) if self.has(key) else None

    # ---------------------------------------------------------------------------------- inside

    def _join(self, key: str) -> str:
        return ".".join(filter(None, (self.path, key)))

    def _given(self, key: str) -> str | None:
        """The key as it is written in the file. Raises when it is given in rad and in deg."""
        self._known[key] = None
        twin = key.replace("_rad", "_deg")
        if twin != key:
            self._known[twin] = None
            if key in self._table.items and twin in self._table.items:
                mark = self._table.keys[twin]
                raise ConfigError(self.file, mark, self._join(twin), f"{key} is given too: keep one of them")
        return next((name for name in (key, twin) if name in self._table.items), None)

    def _unit(self, key: str) -> float:
        return math.radians(1.0) if self._given(key) != key else 1.0

    def _node(self, key: str) -> Node:
        given = self._given(key)
        if given is not None:
            return self._table.items[given]
        unknown = [name for name in self._table.items if name not in self._known]
        for meant in (key, key.replace("_rad", "_deg")):  # a misspelt key explains what is missing
            for name in difflib.get_close_matches(meant, unknown, 1, 0.75):
                mark = self._table.keys[name]
                raise ConfigError(self.file, mark, self._join(name), f"unknown key; nearest: {meant}")
        raise ConfigError(self.file, self._table.mark, self._join(key), "is required and missing")

    def _leaf(self, key: str, wanted: str, kind: type[T]) -> T:
        node = self._node(key)
        if isinstance(node, YamlScalar) and type(node.value) is kind:
            return node.value
        hint = "; quote it" if kind is str and isinstance(node, YamlScalar) and node.value is not None else ""
        raise self.refuse(key, f"{wanted} is expected, found {_shown(node)}{hint}")

    def _row(self, key: str) -> list[Node]:
        node = self._node(key)
        if not isinstance(node, YamlSequence):
            raise self.refuse(key, f"a list is expected, found {_shown(node)}")
        return node.items

    def _number(self, node: Node, path: str) -> float:
        value = node.value if isinstance(node, YamlScalar) else None
        if type(value) is int or type(value) is float:
            return float(value)
        message = f"a number is expected, found {_shown(node)}"
        if isinstance(value, str) and _LOOKS_NUMERIC.fullmatch(value):
            how = (
                "without quotes"
                if isinstance(node, YamlScalar) and not node.plain
                else "as a decimal, 1.0e+3 or -0.5"
            )
            message = f"{value} is text in YAML, not a number: write it {how}"
        raise ConfigError(self.file, node.mark, path, message)

    def _bounded(self, key: str, value: float, least: float, most: float, above: float) -> float:
        if not (least <= value <= most and value > above):
            low = f"> {above:g}" if above > -math.inf else f">= {least:g}" if least > -math.inf else ""
            high = f"<= {most:g}" if most < math.inf else ""
            raise self.refuse(key, f"{value:g} is outside {' and '.join(filter(None, (low, high)))}")
        return value

    def _unknown(self, key: str) -> ConfigError:
        known = list(self._known)
        near = difflib.get_close_matches(key, known, 1)
        hint = f"nearest: {near[0]}" if near else f"known: {', '.join(known) or 'none'}"
        return ConfigError(self.file, self._table.keys[key], self._join(key), f"unknown key; {hint}")


def _shown(node: Node) -> str:
    """What a message calls a value that is not what was asked for."""
    if isinstance(node, YamlSequence):
        return "a list"
    if isinstance(node, YamlMapping):
        return "a mapping"
    if node.value is None:
        return "nothing"
    text = repr(node.value)
    return f"{_KINDS[type(node.value)]} ({text if len(text) <= 40 else text[:37] + '...'})"


def _plain(node: Node) -> Plain:
    if isinstance(node, YamlScalar):
        return node.value
    if isinstance(node, YamlSequence):
        return [_plain(item) for item in node.items]
    return {key: _plain(item) for key, item in node.items.items()}


def file_error(file: str, message: str) -> ConfigError:
    """An error about a file as a whole."""
    return ConfigError(file, FilePosition(0, 0), "", message)
