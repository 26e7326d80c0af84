"""The table of a linkage: a CSV file of joint angles at actuator angles, rad. Read once, checked.

The first line names the columns by actuators and joints of its transmission, each with `_rad`; every further
line is a place. Together the places are a rectangular grid, in any order. Checked is that the table can be
inverted: its Jacobian keeps one sign everywhere, and every place leads back to itself alone.
"""

import csv
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twind.config.yaml_tree import ConfigError, FilePosition
from twind.exceptions import InvalidInput
from twind.plain_file import read_plain
from twind.robot.arrays import Floats
from twind.robot.linkage_table import LinkageTable

MAX_BYTES = 1024 * 1024
MOST_ROWS = 4096  # every start proves the inverse at all of them and between
RESIDUAL = 1e-6  # rad between an actuator angle and where forward and inverse lead; a count is some 1e-3
UNIT = "_rad"


@dataclass(frozen=True, slots=True)
class ParsedLinkage:
    """A table as it was read."""

    law: LinkageTable
    residual: float  # rad, the largest of inverse(forward(x)) - x
    sha256: str  # of the file


def linkage(path: Path, actuators: Sequence[str], joints: Sequence[str]) -> ParsedLinkage:
    """The table at `path`, its actuators and joints in these orders. Raises ConfigError."""
    data = _bytes(path)
    try:
        rows = list(csv.reader(data.decode("utf-8").splitlines(), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise _wrong(path, 0, f"is no CSV file: {error}") from None
    head = [name.strip() for name in rows[0]] if rows else []
    wanted = [f"{name}{UNIT}" for name in (*actuators, *joints)]
    if sorted(head) != sorted(wanted):
        raise _wrong(path, 1, f"the columns are {', '.join(head) or 'none'}; needed: {', '.join(wanted)}")
    places = np.array([_numbers(path, line, row, head) for line, row in _lines(rows)])
    if not 2 <= len(places) <= MOST_ROWS:
        raise _wrong(path, 0, f"has {len(places)} places: 2 to {MOST_ROWS} are taken")
    law = _gridded(path, places[:, [head.index(name) for name in wanted]], actuators)
    return ParsedLinkage(law, _proved(path, law, actuators), hashlib.sha256(data).hexdigest())


def _bytes(path: Path) -> bytes:
    try:
        return read_plain(path, MAX_BYTES)
    except InvalidInput as error:
        raise _wrong(path, 0, error.reason) from None
    except (OSError, ValueError) as error:
        raise _wrong(path, 0, f"cannot be read: {error}") from None


def _lines(rows: list[list[str]]) -> list[tuple[int, list[str]]]:
    return [(number, row) for number, row in enumerate(rows[1:], 2) if row]


def _numbers(path: Path, line: int, row: list[str], head: list[str]) -> list[float]:
    if len(row) != len(head):
        raise _wrong(path, line, f"has {len(row)} numbers, the first line names {len(head)}")
    found = []
    for text, name in zip(row, head, strict=True):
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise _wrong(path, line, f"{name}: {text.strip()!r} is no finite number")
        found.append(number)
    return found


def _gridded(path: Path, places: Floats, actuators: Sequence[str]) -> LinkageTable:
    """Every combination of the actuator angles that occur must stand there, once."""
    count = len(actuators)
    axes = [sorted(set(places[:, column].tolist())) for column in range(count)]
    whole = int(np.prod([len(axis) for axis in axes]))
    rows = {tuple(place[:count]): tuple(place[count:]) for place in places.tolist()}
    if len(rows) != len(places):
        raise _wrong(path, 0, "one place of the actuators stands there twice")
    if whole != len(places):
        sizes = " x ".join(str(len(axis)) for axis in axes)
        raise _wrong(path, 0, f"{len(places)} places are no rectangular grid of {sizes} actuator angles")
    try:
        return LinkageTable(axes, [rows[place] for place in sorted(rows)])
    except ValueError as error:
        raise _wrong(path, 0, str(error)) from None


def _proved(path: Path, law: LinkageTable, actuators: Sequence[str]) -> float:
    """The residual, rad. Raises ConfigError where joint angles have no or several places behind them."""
    signs = np.sign(np.linalg.det(law.slopes))
    if not np.all(signs == signs[0]) or not signs[0]:
        odd = law.places[int(np.flatnonzero((signs != signs[0]) | (signs == 0.0))[0])]
        where = _at(odd, actuators)
        raise _wrong(path, 0, f"cannot be inverted: the linkage turns back near {where}; leave that part out")
    worst = 0.0
    for place in law.checked:
        found = law.preimages(law.forward(place))
        off = max((float(np.abs(one - place).max()) for one in found), default=math.inf)
        if not off <= RESIDUAL:
            where = _at(place, actuators)
            many = (
                f"{len(found)} places of the actuators give" if found else "no place of the actuators gives"
            )
            raise _wrong(path, 0, f"cannot be inverted: {many} what {where} gives (off by {off:.3g} rad)")
        worst = max(worst, off)
    return worst


def _at(place: Floats, actuators: Sequence[str]) -> str:
    return ", ".join(f"{name} {angle:.4g}" for name, angle in zip(actuators, place, strict=True))


def _wrong(path: Path, line: int, message: str) -> ConfigError:
    return ConfigError(str(path), FilePosition(line, 1 if line else 0), "", message)
