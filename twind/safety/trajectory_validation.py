"""Form of a trajectory, UNKNOWN_JOINT to TIME_ORDER: by names (`form`) and on arrays (`wellformed`).

Pure. The front turns a message into a `Trajectory` here and reports all errors in it at once.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from twind.robot.arrays import Bools, Floats
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_map import similar_joints
from twind.robot.trajectory import Trajectory

LONGEST = 64  # characters of a joint's name
MOST = 32  # findings of names, and of shapes: the search for similar names takes time
ROUNDING = 1e-12  # s: stamps of 60 s are exact to 7e-15, so a step of 1 ms may read a little less


class PointRow(NamedTuple):
    """One point of a message: time from start (s), and per named joint rad, rad/s, rad/s²."""

    time: float
    positions: Sequence[float]
    velocities: Sequence[float] | None = None
    accelerations: Sequence[float] | None = None


def form(
    joint_names: Sequence[str],
    rows: Sequence[PointRow | tuple[Any, ...]],
    names: tuple[str, ...],
    *,
    max_points: int = 2000,
    max_duration: float = 60.0,
    min_dt: float = 0.001,
) -> tuple[Trajectory | None, tuple[Finding, ...]]:
    """Return the trajectory of a message in the robot's joint order, or all errors in its form.

    `names` are the robot's joints. Columns of joints that are not named are NaN. Points are (time, positions,
    velocities or None, accelerations or None); velocities, and then accelerations, at every point or at none.
    """
    findings = [*islice(_names(joint_names, names), MOST)]
    if not len(rows):
        findings.append(Finding(ReasonCode.EMPTY, message="no points"))
    if len(rows) > max_points:
        findings.append(_too_many(len(rows), max_points))
        return None, tuple(findings)  # before any work that grows with it
    misshapen = [*islice(_shapes(rows, len(joint_names)), MOST)]
    if findings or misshapen:
        return None, tuple(findings + misshapen)
    path = _arrays(rows, [names.index(name) for name in joint_names], len(names))
    findings += wellformed(path, len(names), max_points, max_duration, min_dt)
    return (None if findings else path), tuple(findings)


def unknown_joint(name: str, names: Sequence[str], what: str = "") -> Finding:
    """Return UNKNOWN_JOINT with similar names and a command that lists all. `what`: prefix of the message."""
    name = name[: LONGEST + 1]
    hint = f"{similar_joints(name, names)}; `twindctl status --joints` lists all"
    return Finding(ReasonCode.UNKNOWN_JOINT, message=f"{what}no joint {name!r}; {hint}")


def _names(joint_names: Sequence[str], names: tuple[str, ...]) -> Iterator[Finding]:
    """Check UNKNOWN_JOINT."""
    if not len(joint_names):
        yield Finding(ReasonCode.NO_JOINTS, message="no joint is named")
    for name, times in Counter(joint_names).items():
        if name not in names:
            yield unknown_joint(name, names)
        elif times > 1:
            yield Finding(
                ReasonCode.DUP_JOINT, joint=names.index(name), value=times, bound=1, message="named twice"
            )


def _shapes(rows: Sequence[PointRow | tuple[Any, ...]], width: int) -> Iterator[Finding]:
    """Yield BAD_SHAPE: every row as wide as the names, made of numbers, and with the columns of the first."""
    rich: tuple[bool, bool] | None = None
    for point, row in enumerate(rows):
        if len(row) != 4:
            reason = "a point is time, positions, velocities, accelerations"
            yield Finding(ReasonCode.BAD_SHAPE, point=point, value=len(row), bound=4, message=reason)
            continue
        time, *columns = row
        if not _numbers([time]):
            yield Finding(ReasonCode.BAD_SHAPE, point=point, message=f"time {time!r} is not a number")
        for column, what in zip(columns, ("positions", "velocities", "accelerations"), strict=True):
            if column is None and what != "positions":
                continue
            if column is None or len(column) != width:
                have = 0 if column is None else len(column)
                reason = f"{what}: one number per named joint"
                yield Finding(ReasonCode.BAD_SHAPE, point=point, value=have, bound=width, message=reason)
            elif not _numbers(column):
                yield Finding(ReasonCode.BAD_SHAPE, point=point, message=f"{what}: not all are numbers")
        given = (columns[1] is not None, columns[2] is not None)
        rich = given if rich is None else rich
        if given != rich:
            reason = "velocities and accelerations at every point or at none"
            yield Finding(ReasonCode.BAD_SHAPE, point=point, message=reason)
        elif given == (False, True):
            yield Finding(ReasonCode.BAD_SHAPE, point=point, message="accelerations need velocities")


def _numbers(column: Sequence[Any]) -> bool:
    """Check that all are ints or floats; True is not a number."""
    return set(map(type, column)) <= {int, float}


def _arrays(rows: Sequence[PointRow | tuple[Any, ...]], places: list[int], count: int) -> Trajectory:
    """Return rows of the right shape as arrays in the robot's order."""
    commanded: Bools = np.zeros(count, np.bool_)
    commanded[places] = True

    def block(index: int) -> Floats | None:
        if rows[0][index] is None:
            return None
        spread = np.full((len(rows), count), np.nan)
        spread[:, places] = _floats([row[index] for row in rows])
        return spread

    position = block(1)
    assert position is not None  # `_shapes` has checked it
    return Trajectory(_floats([row[0] for row in rows]), position, commanded, block(2), block(3))


def _floats(numbers: list[Any]) -> Floats:
    """Return the numbers as float64; an integer beyond its range becomes infinite, which is refused."""
    try:
        return np.array(numbers, np.float64)
    except OverflowError:
        return np.array(_bounded(numbers), np.float64)


def _bounded(number: Any) -> Any:
    """Return lists of numbers with overflows replaced by infinity."""
    if isinstance(number, list | tuple):
        return [_bounded(one) for one in number]
    try:
        return float(number)
    except OverflowError:
        return float("inf")


# ------------------------------------------------------------------------------------------ on arrays


def wellformed(
    path: Trajectory, count: int, max_points: int, max_duration: float, min_dt: float
) -> list[Finding]:
    """Check UNKNOWN_JOINT to TIME_ORDER on `path`, `count` joints; only commanded columns count."""
    points = path.time.size
    findings = []
    if path.position.size == 0 or points == 0:
        findings.append(Finding(ReasonCode.EMPTY, message="no points"))
    if not path.commanded.any():
        findings.append(Finding(ReasonCode.NO_JOINTS, message="no joint is commanded"))
    findings += _misfits(path, count)
    if points > max_points:
        findings.append(_too_many(points, max_points))
    if findings:
        return findings
    if path.time[-1] > max_duration:
        last = float(path.time[-1])
        reason = "too long (s)"
        findings.append(
            Finding(ReasonCode.TOO_MANY_POINTS, None, points - 1, last, last, max_duration, reason)
        )
    return [*findings, *_nonfinite(path), *_disorder(path.time, min_dt)]


def _too_many(points: int, most: int) -> Finding:
    """Check BAD_SHAPE."""
    return Finding(ReasonCode.TOO_MANY_POINTS, value=points, bound=most, message="too many points")


def _misfits(path: Trajectory, count: int) -> Iterator[Finding]:
    """Yield BAD_SHAPE: arrays that do not fit together."""
    shape = (path.time.size, count)
    if path.time.ndim != 1:
        yield Finding(
            ReasonCode.BAD_SHAPE, message=f"time has shape {path.time.shape}, not one number per point"
        )
    if path.commanded.shape != (count,):
        yield Finding(
            ReasonCode.BAD_SHAPE, message=f"commanded has shape {path.commanded.shape}, not ({count},)"
        )
    for given, what in (
        (path.position, "position"),
        (path.velocity, "velocity"),
        (path.acceleration, "acceleration"),
    ):
        if given is not None and given.shape != shape:
            yield Finding(ReasonCode.BAD_SHAPE, message=f"{what} has shape {given.shape}, not {shape}")
    if path.acceleration is not None and path.velocity is None:
        yield Finding(ReasonCode.BAD_SHAPE, message="accelerations need velocities")


def _nonfinite(path: Trajectory) -> Iterator[Finding]:
    """Yield NONFINITE: per joint the first number that is not finite."""
    for point in np.flatnonzero(~np.isfinite(path.time))[:1]:
        yield Finding(ReasonCode.NONFINITE, point=int(point), value=float(path.time[point]), message="time")
    for given, what in (
        (path.position, "position"),
        (path.velocity, "velocity"),
        (path.acceleration, "acceleration"),
    ):
        if given is None or np.isfinite(given).all():
            continue
        wrong = ~np.isfinite(given) & path.commanded
        for joint in np.flatnonzero(wrong.any(axis=0)):
            point = int(wrong[:, joint].argmax())
            value = float(given[point, joint])
            yield Finding(
                ReasonCode.NONFINITE, int(joint), point, float(path.time[point]), value, message=what
            )


def _disorder(time: Floats, min_dt: float) -> Iterator[Finding]:
    """Find the first step shorter than `min_dt` (TIME_ORDER). A first point at 0 is a start."""
    if not time[0] >= 0.0:
        yield Finding(ReasonCode.TIME_ORDER, point=0, time=float(time[0]), value=float(time[0]), bound=0.0)
        return
    with np.errstate(all="ignore"):
        steps = np.diff(time, prepend=0.0)
    short = ~(steps >= min_dt - ROUNDING)
    short[0] &= time[0] > 0.0
    for point in np.flatnonzero(short)[:1]:
        reason = "times must increase by at least this (s)"
        step = float(steps[point])
        at = float(time[point])
        yield Finding(
            ReasonCode.TIME_ORDER, point=int(point), time=at, value=step, bound=min_dt, message=reason
        )
