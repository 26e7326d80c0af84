"""Windows of a recorded motion in which one joint is simulated from its measured state on."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from twind.identification.joint_loads import JointLoads
from twind.identification.servo_response import ResponseWindows
from twind.robot.arrays import Bools, Floats, Ints

STEP = 0.0025  # s, of the simulation of a joint
LENGTH = 2.0  # s, of a window
LONGEST_DELAY = 0.08  # s, of a goal
SETTLED = 0.3  # s at the begin that are not judged: the measured speed is uncertain
MOVED = 0.01  # rad that a joint or its goal moves in a window that counts
MOST = 36  # windows of one joint
BLOCK = 2  # windows in a row that take part in the fit, or judge it
HELD_OUT = 4  # each of so many blocks judges the fit and takes no part in it
_TABLES = tuple(each.name for each in fields(ResponseWindows) if each.name not in ("step", "lead", "passive"))


@dataclass(frozen=True, slots=True)
class JointWindows:
    """Windows of one joint: what is simulated, the readings, and which windows judge the fit."""

    windows: ResponseWindows
    rows: Ints  # (s,) steps at which a reading stands
    measured: Floats  # (s, w) rad
    held_out: Bools  # (w,)

    def chosen(self, which: Bools) -> "JointWindows":
        """Return only those windows for which `which` (w,) is true."""
        tables: dict[str, Any] = {name: getattr(self.windows, name)[..., which] for name in _TABLES}
        measured = self.measured[:, which]
        return JointWindows(replace(self.windows, **tables), self.rows, measured, self.held_out[which])


def windows_of(
    time: Floats, goal: Floats, shown: Floats, loads: JointLoads, joint: int, passive: float
) -> JointWindows | None:
    """Return the windows of a joint in an evenly sampled motion; None: it moves too little in all of them.

    `goal`, `shown`: (t, n) rad; `passive`: damping without torque, N·m·s/rad.
    """
    spacing = float(np.median(np.diff(time)))
    length = round(LENGTH / spacing)
    lead = round(LONGEST_DELAY / spacing)
    fine = max(1, round(spacing / STEP))
    begins = _moving(goal[:, joint], shown[:, joint], lead, length)
    if not len(begins):
        return None
    rows = begins + np.arange(length)[:, None]
    share = np.arange(length * fine) / fine
    below = np.minimum(share.astype(np.int64), length - 2)

    def spread(table: Floats) -> Floats:
        """Interpolate (t, n) to the steps of the windows, (steps, w)."""
        column = table[rows, joint]
        weight = (share - below)[:, None]
        return np.asarray(column[below] * (1.0 - weight) + column[below + 1] * weight)

    early = goal[begins + np.arange(-lead, 0)[:, None], joint]
    goals = np.concatenate([early, goal[rows, joint]])
    windows = ResponseWindows(
        step=spacing / fine,
        goal=np.repeat(goals, fine, axis=0),
        lead=lead * fine,
        gain=np.ones(len(begins)),
        torque_on=np.ones((length * fine, len(begins))),
        inertia=spread(loads.inertia),
        bias=spread(loads.bias),
        slope=spread(loads.slope),
        measured=spread(loads.position),
        swing=np.zeros(len(begins)),
        start=shown[begins, joint],
        speed=loads.velocity[begins, joint],
        side=_sides(loads.velocity[:, joint])[begins],
        passive=passive,
    )
    first = round(SETTLED / spacing)
    return JointWindows(
        windows=windows,
        rows=np.arange(first, length) * fine,
        measured=shown[rows[first:], joint],
        held_out=is_held_out(begins, length),
    )


def is_held_out(rows: Ints, length: int) -> Bools:
    """Return which rows of a motion judge the fit, for windows of `length` rows; alike for all joints."""
    return np.asarray(rows // length // BLOCK % HELD_OUT == HELD_OUT - 1)


def join_windows(parts: Sequence[JointWindows]) -> JointWindows:
    """Return the windows of several motions of one joint, which have one control period."""
    windows = [each.windows for each in parts]

    def joined(name: str) -> Floats:
        return np.concatenate([getattr(each, name) for each in windows], axis=-1)

    tables: dict[str, Any] = {name: joined(name) for name in _TABLES}
    return JointWindows(
        windows=replace(windows[0], **tables),
        rows=parts[0].rows,
        measured=np.concatenate([each.measured for each in parts], axis=-1),
        held_out=np.concatenate([each.held_out for each in parts]),
    )


def with_cable(windows: JointWindows, stiffness: float) -> JointWindows:
    """Return the windows of a joint that a cable pulls to the middle of its motion. `stiffness`: N·m/rad."""
    plain = windows.windows
    away = plain.measured - plain.measured.mean()
    pulled = replace(plain, bias=plain.bias + stiffness * away, slope=plain.slope + stiffness)
    return replace(windows, windows=pulled)


def _moving(goal: Floats, shown: Floats, lead: int, length: int) -> Ints:
    """Return the first rows of at most `MOST` windows in which the joint moves, spread over the motion."""
    begins = np.arange(length, len(shown) - length, length)
    spans = [max(np.ptp(goal[at : at + length]), np.ptp(shown[at : at + length])) for at in begins]
    both = np.isfinite(goal) & np.isfinite(shown)
    known = [bool(both[at - lead : at + length].all()) for at in begins]
    begins = begins[(np.array(spans, np.float64) > MOVED) & np.array(known, np.bool_)]
    if len(begins) > MOST:
        begins = begins[np.linspace(0, len(begins) - 1, MOST).round().astype(np.int64)]
    return begins


def _sides(velocity: Floats) -> Floats:
    """Return on which side of its play a joint stands (t,): of the last motion that was one."""
    moving = np.abs(velocity) > 0.03
    last = np.maximum.accumulate(np.where(moving, np.arange(len(velocity)), 0))
    return np.where(moving[last], np.sign(velocity[last]), 0.0)
