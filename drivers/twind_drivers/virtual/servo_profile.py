"""Reference of a servo's loop towards its goal, by profile velocity (112) and acceleration (108).

A goal makes a plan at once: gather speed, cruise, brake. The plan is exact at any time, so its shape does not
depend on how often it is read. Sources: e-manual, "Profile Acceleration", "Profile Velocity", "Velocity
Override": a new goal on the way begins at the speed that is there.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind_drivers.virtual.servo_physics import RPM

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
RATE = 214.577  # rev/min² per unit of register 108, X series
RATE_P = 1.0  # the P series' (assumed from older pages; today's give none)
STEP = 0.002  # s
# bits of the moving status (123)
NONE = 0x00
RECTANGLE = 0x10
TRIANGLE = 0x20
TRAPEZOID = 0x30
TINY = 1e-9


class ServoProfile:
    """Plans of m servos. A place is in ticks (`spins` False) or raw velocity, speed is that per second."""

    def __init__(self, position: Floats, turn: Floats | float = 4096.0, rpm: Floats | float = RPM) -> None:
        """Begin at rest at `position` (m,). `turn`: ticks a turn; `rpm`: of one raw velocity."""
        count = position.size
        self.raw = np.broadcast_to(
            np.asarray(turn * rpm / 60.0, np.float64), (count,)
        )  # ticks/s per velocity
        rate = np.where(np.asarray(rpm) > 0.1, RATE, RATE_P) * turn / 3600.0
        self._rate = np.broadcast_to(np.asarray(rate, np.float64), (count,))  # ticks/s² per acceleration
        self.reference = position.copy()
        self.speed = np.zeros(count)
        self.kind = np.zeros(count, np.uint8)  # of the latest plan: NONE, RECTANGLE, TRIANGLE, TRAPEZOID
        self.running = np.zeros(count, np.bool_)
        self.shaped = False  # does anyone have a profile, or still follow one?
        self.target = position.copy()
        # as in the registers
        self._velocity = np.zeros(count)
        self._acceleration = np.zeros(count)
        self._timed = np.zeros(count, np.bool_)
        self.spins = np.zeros(count, np.bool_)
        self._begun = np.zeros(count)
        self._place = position.copy()
        self._start = np.zeros(count)
        # s of gathering, cruising, braking
        self._peak = np.zeros(count)
        self._ends = np.zeros((3, count))

    def limit(self, velocity: NDArray[Any], acceleration: NDArray[Any], timed: Bools, spins: Bools) -> None:
        """Registers 112 and 108 (m,), 0 is none; they count from the next goal on.

        `timed`: 112 is the whole time and 108 the ramp in ms, at most half of it (drive mode bit 2). `spins`:
        velocity mode, which has no use for 112. Where neither register shapes anything all goals are steps.
        """
        self._velocity = velocity.astype(np.float64)
        self._acceleration = acceleration.astype(np.float64)
        self._timed = timed.copy()
        self.spins = spins.copy()
        self.shaped = bool(self._shaping().any() or self.running.any())
        self.reference = self.reference.copy()  # without a profile it may be the target itself
        if not self.shaped:
            self.kind[:] = NONE

    def _shaping(self) -> Bools:
        return np.where(self.spins, self._acceleration > 0.0, self._velocity > 0.0)

    def set_targets(self, target: Floats, now: float) -> None:
        """New goals (m,) at `now` (s), kept: a plan for those that differ, from the place and speed there."""
        if not self.shaped:
            self.reference = self.target = target
            return
        new = target != self.target
        step = new & ~self._shaping()
        self.target = target.copy()
        self.reference[step] = target[step]
        self.speed[step] = 0.0
        self.running[step] = False
        self.kind[step] = NONE
        for row in np.flatnonzero(new & ~step):
            self._plan(int(row), now)
        self.shaped = bool(self._shaping().any() or self.running.any())

    def hold(self, rows: Any, place: Floats | float) -> None:
        """Rest at `place` without a plan: torque came on, or the watchdog stopped it (profile as 0)."""
        self.reference[rows] = self.target[rows] = place
        self.speed[rows] = 0.0
        self.running[rows] = False
        self.kind[rows] = NONE

    def follow(self, now: float) -> None:
        """Bring `reference` and `speed` up to `now` (s)."""
        run = self.running
        if not run.any():
            return
        one, two, three = self._ends
        t = np.minimum(np.maximum(now - self._begun, 0.0), one + two + three)
        gather = np.minimum(t, one)
        cruise = np.minimum(np.maximum(t - one, 0.0), two)
        brake = np.minimum(np.maximum(t - one - two, 0.0), three)
        grown = self._start + (self._peak - self._start) * _share(gather, one)
        left = self._peak * (1.0 - _share(brake, three))
        place = self._place + (self._start + grown) / 2.0 * gather
        place += self._peak * cruise + (self._peak + left) / 2.0 * brake
        speed = np.where(t < one, grown, np.where(t < one + two, self._peak, left))
        done = run & (now - self._begun >= one + two + three)
        self.reference[run] = place[run]
        self.speed[run] = speed[run]
        self.reference[done] = self.target[done]
        self.speed[done] = 0.0
        self.running = run & ~done
        self.shaped = bool(self._shaping().any() or self.running.any())

    def _plan(self, row: int, now: float) -> None:
        way = float(self.target[row] - self.reference[row])
        start = float(self.speed[row])
        if self.spins[row]:
            shape = self._ramp(row, way)
        elif self._timed[row]:
            shape = self._timed_shape(row, way, start)
        else:
            shape = self._capped_shape(row, way, start)
        begin, peak, ends, kind = shape
        self._begun[row] = now
        self._place[row] = self.reference[row]
        self._start[row] = begin
        self._peak[row] = peak
        self._ends[:, row] = ends
        self.kind[row] = kind
        self.running[row] = True
        self.speed[row] = begin

    def _ramp(self, row: int, way: float) -> tuple[float, float, tuple[float, float, float], int]:
        """Velocity mode: the reference is a velocity, and it changes at one rate."""
        rate = self._acceleration[row] * self._rate[row] / self.raw[row]  # raw/s; so t1 = 64 V / A ms
        time = self._acceleration[row] * 1e-3 if self._timed[row] else abs(way) / rate
        return way / time, way / time, (0.0, float(time), 0.0), TRAPEZOID

    def _timed_shape(
        self, row: int, way: float, start: float
    ) -> tuple[float, float, tuple[float, float, float], int]:
        """Whole time and ramp are given, the speed follows."""
        whole = self._velocity[row] * 1e-3
        ramp = min(self._acceleration[row] * 1e-3, whole / 2.0)
        if ramp <= 0.0:
            return way / whole, way / whole, (0.0, whole, 0.0), RECTANGLE
        peak = (way - start * ramp / 2.0) / (whole - ramp)
        cruise = max(whole - 2.0 * ramp, 0.0)
        return start, peak, (ramp, cruise, ramp), TRAPEZOID if cruise > TINY else TRIANGLE

    def _capped_shape(
        self, row: int, way: float, start: float
    ) -> tuple[float, float, tuple[float, float, float], int]:
        """Speed and acceleration are capped, the time follows."""
        top = self._velocity[row] * self.raw[row]
        rate = self._acceleration[row] * self._rate[row]
        if rate <= 0.0:
            peak = float(np.copysign(top, way))
            return peak, peak, (0.0, abs(way) / top, 0.0), RECTANGLE
        sign = 1.0 if way >= start * abs(start) / (2.0 * rate) else -1.0  # short of where braking would end
        way = sign * way
        start = sign * start
        peak = min(top, float(np.sqrt(max(rate * way + start * start / 2.0, 0.0))))
        gather = abs(peak - start) / rate
        brake = peak / rate
        cruise = 0.0
        if peak > TINY:
            cruise = max((way - (start + peak) / 2.0 * gather - peak / 2.0 * brake) / peak, 0.0)
        kind = TRAPEZOID if cruise > TINY else TRIANGLE
        return sign * start, sign * peak, (gather, cruise, brake), kind


def _share(passed: Floats, whole: Floats) -> Floats:
    """Return `passed` / `whole`, 1 for a phase without time."""
    return np.where(whole > 0.0, passed / np.maximum(whole, TINY), 1.0)
