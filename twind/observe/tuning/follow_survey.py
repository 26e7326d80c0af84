"""Distance of each joint behind its goal in a recording, and the bounds of FOLLOW_ERR that it gives. Pure.

A distance is measured as the guard measures it, beyond its allowance for the goal's speed. Readings without
torque or in a fault do not count. Nor does what led to FOLLOW_ERR of a joint: it may have been blocked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twind.config.family_keys import MOST_FOLLOW
from twind.observe.recording.recording_columns import Floats, RobotRecording
from twind.robot.arrays import Bools
from twind.robot.modes import RobotState
from twind.safety.follow_bounds import MOST
from twind.safety.guard_types import GuardThresholds

USUAL = GuardThresholds()
# Of what was recorded. A supply at which a robot is settled gives an eighth less than a nominal one; the
# rest is for friction, payload and motions that the recording does not have.
MARGIN = 1.25
HELD = 0.5  # of the time of the bound: what passes sooner cannot latch FOLLOW_ERR
PATIENCE = 0.5  # s, the longest time that is proposed
LEAST_MOVED = 0.1  # rad: a goal that moves less shows no lag
STILL = 0.02  # rad/s of a goal that stands
NEAR = 0.05  # rad: a joint this near to its goal is not blocked
GAP = 2.5  # of the usual distance between two readings: from here on some are missing
STEP = 0.02  # s: a reading at most so long after its goal is compared with the goal before


@dataclass(frozen=True, slots=True)
class JointLag:
    """Lag of one joint in a recording, and its bounds. None: nothing is proposed."""

    joint: str
    moved: float  # rad that its goal moved
    p99: float  # rad; NaN: no reading
    worst: float  # rad
    above: float  # s, longest time above the default bound
    rad: float | None
    seconds: float | None
    note: str

    @property
    def proposed(self) -> bool:
        """True where the default bound does not fit."""
        return self.rad is not None and self.rad > USUAL.follow


def survey_follow(recording: RobotRecording) -> list[JointLag]:
    """Return the lag of each joint, in the order of the recording."""
    usable = armed_rows(recording)
    spacing = float(np.median(np.diff(recording.time))) if recording.time.size > 1 else STEP
    gaps = np.diff(recording.time, prepend=recording.time[:1]) > GAP * spacing
    off, speed = lag_behind_goal(recording, min(spacing, STEP))
    faults = follow_faults(recording)
    return [
        _joint_lag(
            recording, place, off[:, place], speed[:, place], usable & ~gaps, spacing, faults.get(name, [])
        )
        for place, name in enumerate(recording.joints)
    ]


def lag_behind_goal(recording: RobotRecording, step: float) -> tuple[Floats, Floats]:
    """Return distances beyond what the goal's speed allows (rad), and that speed (rad/s), (k, n) each.

    A recorded goal is the one after its reading: the servo had that of `step` s before.
    """
    if recording.time.size < 2:
        return np.full_like(recording.goal, np.nan), np.full_like(recording.goal, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):  # two readings of one time: unknown
        speed = np.gradient(recording.goal, recording.time, axis=0)
    speed[~np.isfinite(speed)] = np.nan
    behind = np.abs(recording.measured - (recording.goal - speed * step))
    return np.maximum(behind - USUAL.lag * np.abs(speed), 0.0), speed


def armed_rows(recording: RobotRecording) -> Bools:
    """Return the readings (k,) of an armed robot. Without a word on its state, all that are live."""
    known = [(said.time, said.what.get("state")) for said in recording.statuses]
    states = frozenset(state.value for state in RobotState)
    known += [(said.time, said.what["code"]) for said in recording.events if said.what.get("code") in states]
    known.sort(key=lambda each: each[0])
    if not known:
        return recording.live
    times = np.array([time for time, _ in known])
    armed = np.array([state == RobotState.ARMED for _, state in known])
    rows: Bools = armed[np.clip(np.searchsorted(times, recording.time, "right") - 1, 0, None)]
    return rows & recording.live


def follow_faults(recording: RobotRecording) -> dict[str, list[tuple[float, float]]]:
    """Return time (s) and distance (rad) of each FOLLOW_ERR, by joint."""
    found: dict[str, list[tuple[float, float]]] = {}
    for said in recording.events:
        for finding in said.what.get("findings") or ():
            if finding.get("code") == "FOLLOW_ERR" and finding.get("joint") in recording.joints:
                value = finding.get("value")
                distance = float("nan") if value is None else float(value)
                found.setdefault(finding["joint"], []).append((said.time, distance))
    return found


def yaml_text(lags: Sequence[JointLag]) -> str:
    """Return the proposed keys, to be merged into `joints` of a robot file; empty: none."""
    rows = [
        f"  {lag.joint}: {{follow_rad: {lag.rad:g}, follow_s: {lag.seconds:g}}}"
        for lag in lags
        if lag.proposed
    ]
    return "\n".join(["joints:", *rows]) if rows else ""


def _joint_lag(
    recording: RobotRecording,
    place: int,
    off: Floats,
    speed: Floats,
    usable: Bools,
    spacing: float,
    faults: Sequence[tuple[float, float]],
) -> JointLag:
    name = recording.joints[place]
    counted = usable.copy()
    for time, _ in faults:
        counted[_excursion(recording.time, off, time)] = False
    counted &= np.isfinite(off)
    notes = [f"FOLLOW_ERR at {time:.2f} s ({value:.2f} rad) is left out" for time, value in faults]
    if not counted.any():
        nothing = ["no reading of the armed robot"]
        return JointLag(name, 0.0, np.nan, np.nan, 0.0, None, None, "; ".join([*notes, *nothing]))
    known = np.where(counted, off, np.nan)
    goal = recording.goal[counted, place]
    moved = float(np.ptp(goal[np.isfinite(goal)]))
    worst = int(np.nanargmax(known))
    share = float(np.nanpercentile(known, 99.0))
    above = longest(known > USUAL.follow, spacing)
    rad, seconds = _bounds(known, spacing)
    if moved < LEAST_MOVED:
        notes.append("moved too little")
        rad = None
    elif rad is not None and rad > MOST_FOLLOW:
        notes.append(f"needs {rad:g} rad, more than {MOST_FOLLOW:g}: raise its gain")
        rad = None
    elif rad is not None and rad > USUAL.follow and not abs(float(speed[worst])) > STILL:
        notes.append("worst while its goal stands: load, or an obstacle?")
    kept = None if rad is None else seconds
    return JointLag(name, moved, share, float(known[worst]), above, rad, kept, "; ".join(notes))


def _bounds(known: Floats, spacing: float) -> tuple[float | None, float]:
    """Return follow_rad (rad) and follow_s (s): a wide bound is not needed where peaks are short."""
    rad = _up(max(MARGIN * _held(known, HELD * USUAL.follow_for, spacing), _damped(known)))
    if rad > MOST and _damped(known) <= MOST:
        patience = max(longest(known * MARGIN > MOST, spacing) / HELD, USUAL.follow_for)
        if patience <= PATIENCE:
            return MOST, _up(patience)
    return max(rad, USUAL.follow), USUAL.follow_for


def _damped(known: Floats) -> float:
    """Return the least bound (rad) at which the worst reading is not damped at once."""
    return MARGIN * float(np.nanmax(known)) - (USUAL.follow_damp - USUAL.follow)


def _held(known: Floats, seconds: float, spacing: float) -> float:
    """Return the largest distance (rad) that was kept up for `seconds`."""
    size = min(max(1, round(seconds / spacing)), len(known))
    windows = np.lib.stride_tricks.sliding_window_view(np.nan_to_num(known, nan=0.0), size)
    return float(windows.min(axis=1).max())


def longest(flags: Bools, spacing: float) -> float:
    """Return the longest time (s) for which flags (k,) of readings `spacing` s apart are set."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return spacing * float(np.max(edges[1::2] - edges[::2], initial=0))


def _excursion(time: Floats, off: Floats, fault: float) -> NDArray[np.intp]:
    """Return the readings before a fault since the joint was last near its goal."""
    before = np.flatnonzero(time <= fault)
    near = np.flatnonzero(off[before] <= NEAR)
    return before if near.size == 0 else before[near[-1] + 1 :]


def _up(value: float) -> float:
    """Return the value rounded up to a hundredth."""
    return float(np.ceil(round(100.0 * value, 6)) / 100.0)
