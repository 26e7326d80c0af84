"""A YAML file as a tree of values that know their line and column, with YAML's traps refused.

Strict on purpose: no anchors, aliases, tags, merges or duplicate keys; no word or number that YAML 1.1 reads
as something else than a person does. Knows no schema: `config_reader.py` asks for types and bounds.
"""

import hashlib
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from twind.exceptions import InvalidInput, TwindError
from twind.plain_file import read_plain

MAX_BYTES = 256 * 1024
MAX_DEPTH = 16

_EVENTS: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the same events; C is 10 times faster
_RESOLVER: Any = yaml.resolver.Resolver()
_WHOLE = re.compile(r"[-+]?(0|[1-9][0-9]{0,17})")
_DECIMAL = re.compile(r"[-+]?[0-9]+\.[0-9]*([eE][-+][0-9]+)?|[-+]?\.[0-9]+([eE][-+][0-9]+)?")
_TRUTH = {"true": True, "false": False, "True": True, "False": False}


@dataclass(frozen=True, slots=True)
class FilePosition:
    """A place in a file; both count from 1, 0 where the file as a whole is meant."""

    line: int
    column: int


class ConfigError(TwindError):
    """A file that cannot be used, and why: `file:line:column: path: message`."""

    def __init__(self, file: str, mark: FilePosition, path: str, message: str) -> None:
        place = f"{file}:{mark.line}:{mark.column}" if mark.line else file
        super().__init__(f"{place}: {path}: {message}" if path else f"{place}: {message}")
        self.file = file
        self.line = mark.line
        self.column = mark.column
        self.path = path
        self.message = message

    @property
    def absent(self) -> bool:
        """Nothing stands there."""
        return isinstance(self.__cause__, FileNotFoundError | NotADirectoryError)

    @property
    def forbidden(self) -> bool:
        """It is not for this user to read."""
        return isinstance(self.__cause__, PermissionError)


@dataclass(frozen=True, slots=True)
class YamlScalar:
    """One value. `plain`: written without quotes."""

    mark: FilePosition
    value: str | int | float | bool | None
    plain: bool


@dataclass(frozen=True, slots=True)
class YamlSequence:
    """A sequence."""

    mark: FilePosition
    items: list["Node"]


@dataclass(frozen=True, slots=True)
class YamlMapping:
    """A mapping; keys are text. Each key knows its own place."""

    mark: FilePosition
    items: dict[str, "Node"]
    keys: dict[str, FilePosition]


Node = YamlScalar | YamlSequence | YamlMapping


def place(path: Path, sha256: str, keys: Sequence[str]) -> str:
    """`file:line:column: a.b.c` of a value that was read before, for who refuses it later. Without its line
    where the file is no longer the one of that `sha256`, or has no such value."""
    plain = f"{path}: {'.'.join(keys)}"
    try:
        text = read_text(path)
        node: Node = parse(text, str(path))
    except ConfigError:
        return plain
    if hashlib.sha256(text.encode()).hexdigest() != sha256:
        return plain
    for key in keys:
        if not isinstance(node, YamlMapping) or key not in node.items:
            return plain
        node = node.items[key]
    return f"{path}:{node.mark.line}:{node.mark.column}: {'.'.join(keys)}"


def read_text(path: Path) -> str:
    """The file's text. Raises ConfigError: missing, unreadable, no file, over 256 KiB, not UTF-8."""
    start = FilePosition(0, 0)
    try:
        data = read_plain(path, MAX_BYTES)
    except InvalidInput as error:
        raise ConfigError(str(path), start, "", error.reason) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise ConfigError(str(path), start, "", f"cannot be read: {reason}") from error
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        message = f"byte 0x{data[error.start]:02x} is not UTF-8: save the file as UTF-8"
        raise ConfigError(str(path), FilePosition(line, column), "", message) from None


def parse(text: str, file: str) -> YamlMapping:
    """The mapping that `text` holds. Raises ConfigError naming `file`."""
    if len(text.encode("utf-8", "surrogatepass")) > MAX_BYTES:
        raise ConfigError(
            file, FilePosition(0, 0), "", f"larger than {MAX_BYTES // 1024} KiB: not a file of ours"
        )
    if text.startswith("\ufeff"):  # two readers could take the first key for two things
        raise ConfigError(
            file, FilePosition(1, 1), "", "begins with a byte order mark: save as UTF-8 without one"
        )
    try:
        return _YamlTreeBuilder(file, yaml.parse(text, Loader=_EVENTS)).document()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        # The scanner of PyYAML 6.0.4 reads ahead and has a bound of its own, which lies above ours.
        deep = "nesting depth" in str(error.problem)
        problem = f"nested more than {MAX_DEPTH} deep" if deep else f"not YAML: {error.problem}"
        raise ConfigError(file, _mark(mark) if mark else FilePosition(0, 0), "", problem) from None
    except (yaml.YAMLError, UnicodeError) as error:  # characters that YAML does not allow
        raise ConfigError(file, FilePosition(0, 0), "", f"not YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise ConfigError(file, FilePosition(0, 0), "", "nested too deeply") from None


def _mark(mark: Any) -> FilePosition:
    return FilePosition(mark.line + 1, mark.column + 1)


class _YamlTreeBuilder:
    """Builds nodes from the parser's events, refusing what we do not allow as soon as it is seen."""

    def __init__(self, file: str, events: Iterator[Any]) -> None:
        self.file = file
        self.events = events

    def refuse(self, event: Any, message: str) -> ConfigError:
        return ConfigError(self.file, _mark(event.start_mark), "", message)

    def document(self) -> YamlMapping:
        """The one document of the stream."""
        next(self.events)
        first = next(self.events)
        if isinstance(first, yaml.StreamEndEvent):
            raise ConfigError(self.file, FilePosition(0, 0), "", "the file is empty")
        if first.tags or first.version:
            raise self.refuse(first, "directives (%TAG, %YAML) are not allowed: remove them")
        event = next(self.events)
        root = self.node(event, 1)
        if not isinstance(root, YamlMapping):
            raise self.refuse(event, "a mapping (key: value) is expected at the top level")
        next(self.events)
        after = next(self.events)
        if not isinstance(after, yaml.StreamEndEvent):
            raise self.refuse(after, "a second document: one file holds one document")
        return root

    def node(self, event: Any, depth: int) -> Node:
        """The node that begins with `event`."""
        if isinstance(event, yaml.AliasEvent):
            raise self.refuse(event, f"alias *{event.anchor}: write the value out")
        if event.anchor is not None:
            raise self.refuse(event, f"anchor &{event.anchor}: anchors and aliases are not allowed")
        if event.tag is not None:
            raise self.refuse(event, f"tag {event.tag!r}: tags are not allowed")
        if depth > MAX_DEPTH:
            raise self.refuse(event, f"nested more than {MAX_DEPTH} deep")
        if isinstance(event, yaml.ScalarEvent):
            return self.leaf(event)
        if isinstance(event, yaml.SequenceStartEvent):
            return self.row(event, depth)
        return self.table(event, depth)

    def row(self, start: Any, depth: int) -> YamlSequence:
        items: list[Node] = []
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            items.append(self.node(event, depth + 1))
        return YamlSequence(_mark(start.start_mark), items)

    def table(self, start: Any, depth: int) -> YamlMapping:
        items: dict[str, Node] = {}
        keys: dict[str, FilePosition] = {}
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            key = self.node(event, depth + 1)
            if not isinstance(key, YamlScalar) or not isinstance(key.value, str):
                shown = repr(key.value) if isinstance(key, YamlScalar) else "a list or mapping"
                raise self.refuse(event, f"a key must be text, found {shown}: quote it")
            if key.value in keys:
                first = keys[key.value]
                raise self.refuse(
                    event, f"duplicate key {key.value!r}, first at line {first.line}: remove one"
                )
            keys[key.value] = key.mark
            items[key.value] = self.node(next(self.events), depth + 1)
        return YamlMapping(_mark(start.start_mark), items, keys)

    def leaf(self, event: Any) -> YamlScalar:
        """The scalar as a person reads it, or a refusal where YAML 1.1 reads it otherwise."""
        text = event.value
        mark = _mark(event.start_mark)
        if not event.implicit[0]:  # quoted, or a block of text
            return YamlScalar(mark, text, plain=False)
        tag = _RESOLVER.resolve(yaml.ScalarNode, text, (True, False)).rpartition(":")[2]
        match tag:
            case "str":
                return YamlScalar(mark, text, plain=True)
            case "null":
                return YamlScalar(mark, None, plain=True)
            case "bool" if text in _TRUTH:
                return YamlScalar(mark, _TRUTH[text], plain=True)
            case "int" if _WHOLE.fullmatch(text):
                return YamlScalar(mark, int(text), plain=True)
            case "float" if _DECIMAL.fullmatch(text) and math.isfinite(float(text)):
                return YamlScalar(mark, float(text), plain=True)
        raise self.refuse(event, _trap(tag, text))


def _trap(tag: str, text: str) -> str:
    """Why a scalar without quotes is refused, and what to write instead."""
    shown = text if len(text) <= 40 else text[:37] + "..."
    match tag:
        case "bool":
            return f"YAML reads {shown} as a truth value: write true or false, or quote it to mean the word"
        case "int" | "float" if ":" in text:
            return f"YAML reads {shown} as a number to base 60: quote it to mean text"
        case "int" if "_" in text or len(text) > 18:
            return f"{shown}: write a whole number of at most 18 digits, without underscores"
        case "int":
            return (
                f"YAML reads {shown} as {yaml.safe_load(text)}: write a decimal number without leading zeros"
            )
        case "float" if "nan" in text.lower() or "inf" in text.lower():
            return f"{shown} is not a finite number"
        case "float":
            return f"{shown}: write a finite decimal number, such as 0.5 or 1.0e-3"
        case "timestamp":
            return f"YAML reads {shown} as a date: quote it"
        case "merge":
            return "<< (merge) is not allowed: write the keys out"
    return f"{shown} has a special meaning in YAML: quote it"
