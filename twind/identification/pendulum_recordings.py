"""Recordings of one servo that swings a mass on an arm: CSV, plain or .gz, hanging down at angle zero.

The first line may be `# mass_kg=... length_m=... kp=... vin_V=...`; options of the command line replace it.
Columns that count: `timestamp`, `position`, `goal_position`, and `torque_enable` where it is there.
"""

import gzip
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats

SETTINGS = ("mass_kg", "length_m", "kp")
NEEDED = ("timestamp", "position", "goal_position")


@dataclass(frozen=True, slots=True)
class PendulumRecording:
    """One recording. Arrays (k,), in the order of time."""

    name: str
    mass: float  # kg
    length: float  # m
    kp: float  # P gain of the servo, as in its register
    time: Floats  # s
    position: Floats  # rad
    goal: Floats  # rad
    torque_on: Floats  # 1.0, 0.0


def is_pendulum_file(path: Path) -> bool:
    """Return whether a file is a CSV, by its name."""
    return path.name.endswith((".csv", ".csv.gz"))


def load_pendulum(path: Path, given: Mapping[str, float]) -> PendulumRecording:
    """Return the recording at `path`; `given` replaces `SETTINGS` of its first line. Raises InvalidInput."""
    try:
        opener = gzip.open if path.suffix == ".gz" else open
        with opener(path, "rt", encoding="utf-8") as file:
            lines = file.read().splitlines()
    except (OSError, UnicodeDecodeError, EOFError) as error:
        raise InvalidInput(f"{path}: {error}") from None
    first = lines.pop(0) if lines and lines[0].startswith("#") else ""
    settings = {key: float(value) for key, value in re.findall(r"(\w+)=([-+.\deE]+)(?=\s|$)", first)}
    settings |= given
    missing = [key for key in SETTINGS if not settings.get(key, 0.0) > 0.0]
    if missing:
        raise InvalidInput(f"{path}: {missing[0]} is not known: give --{missing[0].split('_')[0]}")
    columns = _columns(path, lines)
    order = np.argsort(columns["timestamp"], kind="stable")
    on = columns.get("torque_enable", np.ones(len(order)))
    return PendulumRecording(
        name=path.name,
        mass=settings["mass_kg"],
        length=settings["length_m"],
        kp=settings["kp"],
        time=columns["timestamp"][order] - columns["timestamp"][order[0]],
        position=columns["position"][order],
        goal=columns["goal_position"][order],
        torque_on=(on[order] > 0.5).astype(np.float64),
    )


def _columns(path: Path, lines: list[str]) -> dict[str, Floats]:
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    absent = [name for name in NEEDED if name not in names]
    if absent:
        raise InvalidInput(f"{path}: no column {absent[0]!r}; needed are {', '.join(NEEDED)}")
    try:
        table = np.array([line.split(",") for line in lines[1:] if line], np.float64)
    except ValueError as error:
        raise InvalidInput(
            f"{path}: a row is not all numbers, or not as long as the others: {error}"
        ) from None
    if len(table) < 100 or not np.isfinite(table).all():
        raise InvalidInput(f"{path}: {len(table)} rows; at least 100, all finite, are needed")
    return {name: table[:, place] for place, name in enumerate(names)}
