"""Tables of configuration keys for the documents, made from the Structs that read the files.

`python -m twind.config.write_keys_page docs/configuration.md` renews the tables of the page, each between two
markers. Values and defaults come from the types. The text under a field says what the key is; as three
parts, `value | default | what`, it also gives the cells that the type does not tell.
"""

import ast
import inspect
import math
import sys
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from typing import Any, Literal, NamedTuple, get_args, get_origin

from twind.config.collision_config import CollisionKeys
from twind.config.config_reader import ConfigReader, FileKey, keys_of, shape_of, type_parts
from twind.config.daemon_settings import SettingsKeys
from twind.config.doc_pages import renew_tables, rewrite_page
from twind.config.driver_family import families
from twind.config.imu_config import SensorKeys
from twind.config.joint_config import OF_DEFAULTS, JointKeys
from twind.config.robot_file import RobotKeys
from twind.config.transmission_config import DifferentialKeys, LinkageKeys

TABLES: Mapping[str, type] = {"keys of settings": SettingsKeys, "keys of the robot file": RobotKeys}
HEAD = "| key | value | default | what |\n|---|---|---|---|"

OWN = tuple(reversed(families()))  # of a key that several have, the last one's text stands

# Sections whose entries are read one by one: what stands for an entry's name, and its shapes.
_ENTRIES: Mapping[str, tuple[str, tuple[type, ...]]] = {
    "buses": ("BUS.", tuple(each.bus_keys for each in OWN)),
    "types": ("TYPE.", tuple(each.type_keys for each in OWN)),
    "joints": ("JOINT.", (*(each.slot_keys for each in OWN), JointKeys)),
    "transmissions": ("TRANSMISSION.", (DifferentialKeys, LinkageKeys)),
    "collision": ("", (CollisionKeys,)),
    "sensors": ("", (SensorKeys,)),
}
# Sections that repeat keys of joints.
_REPEATED = {"defaults": OF_DEFAULTS, "actuators": ("id", "feedback_id", *OF_DEFAULTS[:5], "registers")}
_NAMES = {"poses": ".POSE.JOINT", "registers": ".REGISTER", "joints": ".JOINT"}


class KeyRow(NamedTuple):
    """A row of a table: keys of one section with the same cells."""

    keys: list[str]
    cells: tuple[str, str, str]  # value, default, what


def key_table(shape: type) -> str:
    """The table of all keys of a file that is read as `shape`."""
    rows: list[KeyRow] = []
    for key, cells in dict(_cells("", shape)).items():
        same = (row for row in rows if row.cells == cells and _section(row.keys[0]) == _section(key))
        if (row := next(same, None)) is not None:
            row.keys.append(key)
        else:
            rows.append(KeyRow([key], cells))
    lines = (f"| {_listed(row.keys)} | {' | '.join(row.cells).rstrip()} |" for row in rows)
    return "\n".join((HEAD, *lines))


def renew_page(page: str) -> str:
    """The page with its tables made anew. Raises ValueError: a marker is missing."""
    return renew_tables(page, {name: key_table(shape) for name, shape in TABLES.items()})


def value_text(kind: Any) -> str:
    """The values of a type, as the column `value` has them; empty where the type does not tell."""
    base, limits = type_parts(kind)
    if title := next((each.title for each in limits if each.title), None):
        return title
    if base is bool:
        return "`true`, `false`"
    if get_origin(base) is Literal:
        return ", ".join(f"`{each}`" if isinstance(each, str) else f"{each}" for each in get_args(base))
    bounds = {name: getattr(each, name) for each in limits for name in ("gt", "ge", "le")}
    known = {name: _number(bound) for name, bound in bounds.items() if bound is not None}
    if known.keys() == {"ge", "le"}:
        return f"{known['ge']}–{known['le']}"
    signs = {"gt": ">", "ge": "≥", "le": "≤"}
    return ", ".join(f"{signs[name]}{bound}" for name, bound in known.items())


def field_notes(shape: type) -> dict[str, str]:
    """The text under each field of a class and of those that it is made from; empty: none."""
    found = dict.fromkeys(keys_of(shape), "")
    for each in reversed(shape.__mro__[:-1]):
        if each.__module__.startswith("msgspec"):
            continue
        (tree,) = ast.parse(dedent(inspect.getsource(each))).body
        body = tree.body if isinstance(tree, ast.ClassDef) else []
        for field, note in pairwise(body):
            match field, note:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    found[name] = " ".join(text.split())
    return found


def _cells(prefix: str, *shapes: type) -> Iterator[tuple[str, tuple[str, str, str]]]:
    """Every key below `prefix` with its cells."""
    for shape in shapes:
        notes = field_notes(shape)
        for key, field in keys_of(shape).items():
            path = prefix + key
            inner = shape_of(field.kind)
            if path in _ENTRIES:
                name, entries = _ENTRIES[path]
                yield from _cells(f"{path}.{name}", *entries)
            elif inner is not None:
                yield from _cells(f"{path}.", inner)
            elif path in _REPEATED:
                entry = f"{path}." if path == "defaults" else f"{path}.ACTUATOR."
                cells = _note_cells(notes[key], field)
                yield from (
                    (f"{entry}{each}{'.REGISTER' * (each == 'registers')}", cells) for each in _REPEATED[path]
                )
            else:
                name = _NAMES[key] if field.kind is ConfigReader else ""
                yield path + name, _note_cells(notes[key], field)


def _note_cells(note: str, field: FileKey) -> tuple[str, str, str]:
    value, default, what = note.split("|") if "|" in note else ("", "", note)
    return value.strip() or value_text(field.kind), default.strip() or _default_text(field), what.strip()


def _default_text(field: FileKey) -> str:
    if field.required:
        return "required"
    match field.default:
        case bool() as flag:
            return f"`{str(flag).lower()}`"
        case str() as text:
            return f"`{text}`"
        case int() | float() as number if math.isfinite(number):
            return _number(number)
    return "none"


def _number(value: float) -> str:
    return f"{int(value)}" if value == int(value) else f"{value:g}"


def _section(key: str) -> str:
    return key.partition(".")[0] if "." in key else key


def _listed(keys: list[str]) -> str:
    """Keys side by side; those of the first one's section without its name."""
    first = keys[0].rpartition(".")[0]
    rest = (
        f"`{key.removeprefix(first)}`" if first and key.startswith(f"{first}.") else f"`{key}`"
        for key in keys[1:]
    )
    return ", ".join((f"`{keys[0]}`", *rest))


if __name__ == "__main__":
    rewrite_page(Path(sys.argv[1]), renew_page)
