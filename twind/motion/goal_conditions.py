"""Options of a goal beside its path: tolerances, its end, and how a late start is corrected."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from twind.motion.time_scaling import Stretch
from twind.robot.arrays import Bools, Floats
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Trajectory

STOPPED = 0.05  # rad/s: at the end slower than this counts as stopped (as END_NOT_AT_REST)


@dataclass(frozen=True, slots=True)
class GoalTolerances:
    """Largest allowed difference of measured and reference, (n,) each; inf: not checked."""

    path: Floats  # rad, while the goal runs
    goal: Floats  # rad, at its end
    speed: Floats  # rad/s, at its end

    @classmethod
    def from_entries(
        cls,
        count: int,
        entries: Sequence[tuple[int, float | None, float | None]],
        arrival: float = inf,
    ) -> "GoalTolerances":
        """Tolerances from (joint, path, goal) entries: None and 0 keep the default, -1 erases it.

        The default is no check of the path, and `arrival` (rad) at the end. A joint whose goal tolerance an
        entry sets must also stop. Raises ValueError for an unknown joint, NaN and other negative numbers.
        """
        bounds = np.full((2, count), inf)
        bounds[1] = arrival
        speed = np.full(count, inf)
        for joint, *given in entries:
            if not 0 <= joint < count:
                raise ValueError(f"tolerance of joint {joint}: there are joints 0..{count - 1}")
            for row, value in zip(bounds, given, strict=True):
                if value is None or value == 0.0:
                    continue
                if not (value > 0.0 or value == -1.0):
                    raise ValueError(
                        f"tolerance {value} of joint {joint}: above 0, 0 (default) or -1 (no check)"
                    )
                row[joint] = value if value > 0.0 else inf
            goal = given[1]
            if goal is not None and goal > 0.0:
                speed[joint] = STOPPED
        return cls(path=bounds[0], goal=bounds[1], speed=speed)


@dataclass(frozen=True, slots=True)
class GoalOutcome:
    """Result of a goal. The setpoint stream reports itself with an empty id."""

    id: str
    phase: str  # succeeded, cancelled, replaced, aborted
    findings: tuple[Finding, ...] = ()
    fraction: float = field(default=0.0, compare=False)  # share of its path that was done, 0..1
    stretch: Stretch | None = field(default=None, compare=False)  # None: it did not begin


def off(code: ReasonCode, out: Bools, error: Floats, bound: Floats, time: float) -> tuple[Finding, ...]:
    """Build one finding with `code` for each joint (n,) that is `out` of bound, `time` s after the start."""
    return tuple(
        Finding(code, joint, time=time, value=float(error[joint]), bound=float(bound[joint]))
        for joint in np.flatnonzero(out).tolist()
    )


def without_past(path: Trajectory, start_in: float) -> Trajectory | Finding:
    """Return the waypoints still ahead when the start lies `-start_in` s in the past.

    CMD_EXPIRED without any.
    """
    if start_in >= 0.0:
        return path
    ahead = path.time + start_in > 0.0
    if not ahead.any():
        end = float(path.time[-1]) if len(path.time) else 0.0
        message = "every waypoint lies in the past: send it earlier, or without a start"
        return Finding(ReasonCode.CMD_EXPIRED, value=-start_in, bound=end, message=message)
    return replace(
        path,
        time=path.time[ahead] + start_in,
        position=path.position[ahead],
        velocity=None if path.velocity is None else path.velocity[ahead],
        acceleration=None if path.acceleration is None else path.acceleration[ahead],
    )
