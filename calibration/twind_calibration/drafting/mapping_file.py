"""Mapping files: where another software's file keeps ids, models, limits and signs of motors.

    format: twind-mapping/1
    software: Poppy and pypot
    reads: json                     # json, yaml or table
    motors: motors.*                # path of the motors; the key that its last `*` stands for is the name
    facts:
      id: {path: id}
      lower: {path: angle_limit.0, unit: deg}
      sign: {path: orientation, values: {direct: 1, indirect: -1}}

A path is a row of keys, separated by dots; a number takes an element of a list, `*` each element. `name` is
the path of the name within a motor, where its key is none. `unit` turns degrees to rad; `values` translates,
`scale` multiplies. A file is recognised by its mapping where every path of `requires` exists.
`skip` leaves out motors: `{is_passive: ["True"]}` those whose `is_passive` is true. `members` is the path,
within a bus, of the names of its motors or of groups of them, which `groups` holds. Keys of a motor that no
path reads are reported; `unread` gives the reason.
A `table` is text of `[section]` and of rows with `|`, as the framework of ROBOTIS writes; it reads as lists.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import yaml
from msgspec import Struct, ValidationError, convert

from twind.command_line.verb import Rejected
from twind.exceptions import InvalidInput
from twind.plain_file import read_plain
from twind.protocol.strict_json import loads
from twind_calibration.drafting.robot_draft import BUS_FACTS, JOINT_FACTS, FactSet, RobotDraft

FORMAT = "twind-mapping/1"
KEYS = f"`format: {FORMAT}`, `software`, `reads: json|yaml|table`, `motors` and `facts`"
LARGEST = 1 << 20  # bytes of a file of another software
UNITS = {"": 1.0, "rad": 1.0, "deg": math.pi / 180.0}
TYPES: Mapping[str, type] = {
    **{"id": int, "baud": int, "bus": str, "device": str, "port": str, "model_joint": str, "mode": str},
    **dict.fromkeys(("protocol", "ratio", "lower", "upper", "velocity"), float),
    **dict.fromkeys(("sign", "lower_count", "upper_count"), int),
}


class FactRule(Struct, forbid_unknown_fields=True):
    """Rule by which one fact is read from the entry of a motor or a bus."""

    path: str
    unit: str = ""
    scale: float = 1.0
    values: dict[str, Any] | None = None
    default: Any = None

    def read(self, entry: Any, key: str) -> Any:
        """Return the value. Raises LookupError: not there; ValueError: unusable."""
        value = next((each for _, each in _walk(entry, self.path)), self.default)
        if value is None or value == "":
            raise LookupError(self.path)
        if self.values is not None:
            if str(value) not in self.values:
                raise ValueError(f"{value!r} is none of {', '.join(self.values)}")
            value = self.values[str(value)]
        kind = TYPES[key]
        if kind is str:
            return str(value)
        number = float(value) * UNITS[self.unit] * self.scale
        if not math.isfinite(number) or (kind is int and number != round(number)):
            raise ValueError(f"{value!r} is no {'whole ' if kind is int else ''}number")
        return kind(number)


class MappingContent(Struct, forbid_unknown_fields=True):
    """Content of a mapping file."""

    format: str
    software: str
    reads: Literal["json", "yaml", "table"]
    motors: str
    facts: dict[str, FactRule]
    name: str = ""
    requires: list[str] = []
    skip: dict[str, list[str]] = {}
    buses: str = ""
    bus_name: str = ""
    bus_facts: dict[str, FactRule] = {}
    members: str = ""
    groups: str = ""
    unread: dict[str, str] = {}


@dataclass(frozen=True)
class FileMapping:
    """A checked mapping with the name of its file."""

    file: str
    content: MappingContent

    def matches(self, tree: Any) -> bool:
        """Return whether a file's content is what this mapping describes."""
        return all(any(_walk(tree, path)) for path in (self.content.motors, *self.content.requires))

    def fill(self, draft: RobotDraft, tree: Any, source: str, prefix: str = "") -> int:
        """State every fact of every motor; return how many motors there are. Raises Rejected.

        `prefix`: of the names of joints and buses.
        """
        bus_of: dict[str, str] = {}
        for key, entry in _walk(tree, self.content.buses) if self.content.buses else ():
            bus = draft.bus(prefix + bus_name(_text(entry, self.content.bus_name) or key))
            self._state(bus, self.content.bus_facts, entry, source)
            bus_of |= dict.fromkeys(self._members(tree, entry), bus.name)
        count = 0
        unread: dict[str, str] = {}
        for key, entry in _walk(tree, self.content.motors):
            name = (_text(entry, self.content.name) or key).strip()
            count += 1
            skipped = self._skipped(entry)
            if skipped:
                draft.remarks.append(f"{source}: {name} is left out: {skipped}")
                continue
            joint = draft.joint(prefix + name)
            self._state(joint, self.content.facts, entry, source, prefix)
            if name in bus_of:
                joint.state("bus", bus_of[name], source)
            unread |= self._unread(entry)
        if unread:
            draft.remarks.append(f"{source}: not read: {', '.join(unread.values())}")
        if not count:
            raise Rejected(f"{source}: no motor at {self.content.motors} ({self.file})")
        return count

    def _members(self, tree: Any, bus: Any) -> list[str]:
        """Return the names of the motors that a bus lists, by itself or by groups, which may hold groups."""
        groups: Any = (
            next((each for _, each in _walk(tree, self.content.groups)), {}) if self.content.groups else {}
        )
        names = (
            [str(each) for _, each in _walk(bus, f"{self.content.members}.*")] if self.content.members else []
        )
        for name in names:  # grows: a group's members follow
            inside = groups.get(name) if isinstance(groups, dict) else None
            names.extend(str(each) for each in inside or () if str(each) not in names)
        return names

    def _unread(self, entry: Any) -> dict[str, str]:
        """Return the keys of a motor that no path reads, each with its reason where there is one."""
        if not isinstance(entry, dict):
            return {}
        paths = (self.content.name, *self.content.skip, *(rule.path for rule in self.content.facts.values()))
        read = {path.partition(".")[0] for path in paths}
        reasons = self.content.unread
        keys = [str(key) for key in entry if str(key) not in read]
        return {key: f"{key} ({reasons[key]})" if key in reasons else key for key in keys}

    def _skipped(self, entry: Any) -> str:
        """Return why an entry is no motor; empty: it is one."""
        found = ((path, _text(entry, path)) for path in self.content.skip)
        return next(
            (
                value if path.isdecimal() else f"{path} is {value}"
                for path, value in found
                if value in self.content.skip[path]
            ),
            "",
        )

    def _state(
        self, facts: FactSet, rules: Mapping[str, FactRule], entry: Any, source: str, prefix: str = ""
    ) -> None:
        for key, rule in rules.items():
            try:
                value = rule.read(entry, key)
            except LookupError:
                continue
            except (ValueError, TypeError) as error:
                raise Rejected(f"{source}: {facts.name}: {rule.path}: {error}") from None
            facts.state(key, prefix + bus_name(value) if key == "bus" else value, source)


def built_in_mappings() -> tuple[FileMapping, ...]:
    """Return the mappings that come with the package."""
    folder = resources.files("twind_calibration.drafting") / "formats"
    paths = sorted((each for each in folder.iterdir() if each.name.endswith(".yaml")), key=lambda p: p.name)
    return tuple(_mapping(path.read_text("utf-8"), path.name) for path in paths)


def read_mapping(path: Path) -> FileMapping:
    """Return an owner's mapping file. Raises Rejected."""
    return _mapping(_read(path).decode("utf-8", "replace"), str(path))


def fill_from_file(
    draft: RobotDraft, path: Path, mapping: FileMapping | None = None, prefix: str = ""
) -> str:
    """State what a file of another software says; return which software that is. Raises Rejected.

    Without `mapping` the one that matches is taken; no match, or several, are refused.
    """
    data = _read(path)
    tried = built_in_mappings() if mapping is None else (mapping,)
    fit: list[tuple[FileMapping, Any]] = []
    errors: list[str] = []
    for each in tried:
        try:
            tree = _parse(data, each.content.reads)
        except (InvalidInput, ValueError, yaml.YAMLError) as error:
            errors.append(f"as {each.content.reads}: {' '.join(str(error).split())}")
            continue
        if each.matches(tree):
            fit.append((each, tree))
    if len(fit) != 1:
        why = f"fits {' and '.join(each.file for each, _ in fit)}" if fit else "is of no known format"
        known = ", ".join(each.content.software for each in tried)
        reasons = "".join(f"; {each}" for each in dict.fromkeys(errors)) if not fit else ""
        raise Rejected(f"{path}: {why} (known: {known}); describe it in a file of --mapping{reasons}")
    chosen, tree = fit[0]
    chosen.fill(draft, tree, path.name, prefix)
    return chosen.content.software


def _mapping(text: str, file: str) -> FileMapping:
    try:
        content = convert(_yaml(text), MappingContent, strict=False)
    except (ValidationError, ValueError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise Rejected(f"{file}: {reason}; a mapping file has {KEYS}, see docs/tutorial.md") from None
    if content.format != FORMAT:
        raise Rejected(f"{file}: format is {content.format!r}; this version reads {FORMAT}")
    for rules, known in ((content.facts, JOINT_FACTS), (content.bus_facts, BUS_FACTS)):
        for key, rule in rules.items():
            if key not in known:
                raise Rejected(f"{file}: facts.{key}: unknown; known: {', '.join(known)}")
            if rule.unit not in UNITS:
                raise Rejected(f"{file}: facts.{key}.unit: {rule.unit!r} is none of rad, deg")
    return FileMapping(file, content)


def _read(path: Path) -> bytes:
    try:
        return read_plain(path, LARGEST)
    except InvalidInput as error:
        raise Rejected(f"{path}: {error.reason}") from None
    except OSError as error:
        raise Rejected(f"{path}: {error.strerror}") from None


def _parse(data: bytes, form: str) -> Any:
    if form == "json":
        lines = [line for line in data.splitlines() if line.strip()]
        if len(lines) > 1 and all(
            line.lstrip().startswith(b"{") and line.rstrip().endswith(b"}") for line in lines
        ):
            return [loads(line) for line in lines]  # a JSON text a line, as `twindctl --json` prints
        return loads(data)
    text = data.decode("utf-8")
    return _yaml(text) if form == "yaml" else _table(text)


def _yaml(text: str) -> Any:
    """Return YAML as plain values. Aliases are refused: nested ones unfold to any size."""
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, yaml.SafeLoader)):
        raise ValueError("has an alias (`*name`): write its value instead")
    return yaml.safe_load(text)


def _table(text: str) -> dict[str, list[list[str]]]:
    sections: dict[str, list[list[str]]] = {}
    rows: list[list[str]] | None = None
    for line in text.splitlines():
        plain = line.partition("#")[0].strip()
        if plain.startswith("[") and plain.endswith("]"):
            rows = sections.setdefault(plain[1:-1].strip(), [])
        elif plain and "|" in plain and rows is not None:
            rows.append([cell.strip() for cell in plain.split("|")])
    if not sections:
        raise ValueError("no [section]")
    return sections


def _walk(tree: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield (key that the last `*` stands for, value) of every place that a path names."""
    found: list[tuple[str, Any]] = [("", tree)]
    for part in path.split(".") if path else ():
        found = [pair for name, value in found for pair in _step(name, value, part)]
    yield from found


def _step(name: str, value: Any, part: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        if part == "*":
            yield from ((str(key), each) for key, each in value.items())
        else:
            yield from ((name, each) for key, each in value.items() if str(key) == part)
    elif isinstance(value, list):
        if part == "*":
            yield from ((str(place), each) for place, each in enumerate(value))
        elif part.isdecimal() and int(part) < len(value):
            yield name, value[int(part)]


def _text(entry: Any, path: str) -> str:
    value = next((each for _, each in _walk(entry, path)), None) if path else None
    return "" if value is None else str(value)


def bus_name(port: str) -> str:
    """Return the name of a bus: of a port its last part, such as ttyUSB0."""
    return str(port).strip().rstrip("/").rpartition("/")[2] or "main"
