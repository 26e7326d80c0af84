"""Motion of a virtual servo's shaft: the interface, in servo units, and its simplest implementation.

A servo uses encoder ticks, raw velocity, raw current and raw PWM. A formula or a physics engine may move it.
Ticks here are the bare encoder's, continuous over turns, without homing offset.
"""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twind_drivers.virtual.mode_units import CURRENT, FULL_PWM, PWM, VELOCITY, seeks_position
from twind_drivers.virtual.servo_strength import RAD_S, MotorStrength
from twind_drivers.virtual.shaft_physics import Bools, Floats, ShaftPhysics

RPM = 0.229  # per raw velocity of the X series
AMPERE = 0.00269  # A per raw current of the X series
IDLE = 0.0235  # of the stall current: what a motor without load draws at full speed
COAST = 0.1  # s, after which a free shaft under constant current runs at 63 % of its speed
QUICK = 0.02  # s, time constant of the speed loop at the factory gains
# velocity gains of an XM430
FACTORY_P = 100.0
FACTORY_I = 1920.0


@dataclass(frozen=True, slots=True)
class DriveState:
    """Drive of m motors by the firmware, until the next order. Arrays (m,), numbers as in the registers."""

    on: Bools  # is torque enabled?
    mode: NDArray[Any]  # operating mode: 0, 1, 3, 4, 5 or 16
    p: Floats  # position gains
    i: Floats
    d: Floats
    velocity_p: Floats
    velocity_i: Floats
    pwm_cap: Floats  # 0..885, most output in any mode
    current_cap: Floats  # most current; inf where the model measures none
    supply: Floats  # of the nominal voltage
    full: Floats | float = FULL_PWM  # PWM counts that are all of the supply
    turn: Floats | float = 4096.0  # ticks per turn of the shaft
    rpm: Floats | float = RPM  # per raw velocity
    ampere: Floats | float = AMPERE  # per raw current
    motor: MotorStrength = field(default_factory=MotorStrength)  # at this supply


class ServoPhysics(ShaftPhysics, Protocol):
    """The motors of the servos of one bus.

    Position: encoder ticks; velocity: raw, 0.229 rpm but for the P series.
    """

    current: Floats  # raw, the model's current unit
    pwm: Floats  # raw, 0.113 % but for the P series

    def drive(self, drive: DriveState) -> None:
        """Set torque, mode, gains and caps from now on. `set_goals` must follow where a mode changed."""

    def set_goals(self, goal: Floats) -> None:
        """Set the goals: encoder ticks (modes 3, 4, 5), raw velocity (1), current (0) or PWM (16).

        Ignored where torque is off.
        """


def within(values: Floats, most: Floats) -> Floats:
    """Return values limited to -`most`..`most`; in less time than `numpy.clip` for arrays of a bus."""
    return np.asarray(np.minimum(np.maximum(values, -most), most))


class FirstOrderPhysics:
    """Joints without load: the error decays with a time constant, the speed is capped, off means it stays.

    Every step is exact for any length, so an hour of robot needs no small steps. In modes 3 to 5 the error of
    the position decays, in the others that of the speed. A motor without load runs at the share of its
    no-load speed that its output is of the supply, so the gain gives the rate. I and D of the position do
    nothing: nothing loads these joints. A blocked joint draws what its output drives into it.
    """

    def __init__(
        self,
        start: Floats,
        *,
        now: float = 0.0,
    ) -> None:
        """Begin at `start` (m,) ticks."""
        self.position = np.array(start, np.float64)
        self.velocity = np.zeros_like(self.position)
        self.current = np.zeros_like(self.position)
        self.pwm = np.zeros_like(self.position)
        self.goal = self.position.copy()
        self._time = now
        self._blocked = np.zeros(self.position.size, np.bool_)
        self._hand = np.full_like(self.position, np.nan)
        self._reach = np.zeros_like(self.position)
        self.lower = np.full_like(self.position, -np.inf)
        self.upper = np.full_like(self.position, np.inf)
        off = np.zeros_like(self.position)
        self.drive(DriveState(off > 0, off + 3, off, off, off, off, off, off, off, off))

    def drive(self, drive: DriveState) -> None:
        """The gains set the rate; no output or no current allowed means no motion."""
        self._on = drive.on.copy()
        self._mode = np.asarray(drive.mode).copy()
        pulls = drive.on & (drive.pwm_cap > 0.0) & (drive.current_cap > 0.0) & (drive.supply > 0.0)
        seeks = seeks_position(self._mode)
        self._cap = drive.pwm_cap.copy()
        self._current_cap = drive.current_cap.copy()
        self._floor = -self._cap
        self._volts = np.maximum(drive.supply, 1e-9)
        whole = np.ones_like(self.position)
        self._full = drive.full * whole
        self._ticks = drive.rpm / 60.0 * drive.turn * whole
        motor = drive.motor
        self._free = motor.speed / RAD_S / drive.rpm * whole
        self._stall = motor.stall / motor.torque_constant / drive.ampere * whole  # raw current
        self._friction = IDLE * self._stall / self._free
        duty = np.minimum(self._cap / self._full, 1.0)
        self._top = np.minimum(self._free * duty * self._volts, self._current_cap / self._friction)  # raw
        self._speed = np.maximum(np.where(pulls, self._top * self._ticks, 0.0), 1e-9)  # ticks/s: to divide by
        gain = drive.p / motor.divisor  # counts per tick
        self._rate = np.where(pulls & seeks, gain / self._full * self._free * self._ticks * self._volts, 0.0)
        self._pulled = self._rate > 0.0
        self._slowest = np.maximum(self._rate, 1e-9)
        self._per_tick = self._rate / self._ticks  # raw velocity per tick of error
        self._p = np.where(pulls & seeks, gain, 0.0)
        gains = (drive.velocity_p / FACTORY_P + drive.velocity_i / FACTORY_I) / 2.0
        rate = np.select(
            [self._mode == VELOCITY, self._mode == CURRENT], [gains / QUICK, 1.0 / COAST], 1.0 / QUICK
        )
        self._turning = np.flatnonzero(pulls & ~seeks & (rate > 0.0))
        self._quickness = rate[self._turning]
        self._look()

    def set_goals(self, goal: Floats) -> None:
        """See `ServoPhysics.set_goals`."""
        self.goal[:] = goal

    def block(self, held: Bools) -> None:
        """See `ServoPhysics.block`."""
        self._blocked = held.copy()
        self._look()

    def set_hand_positions(self, place: Floats, speed: Floats) -> None:
        """See `ServoPhysics.set_hand_positions`. A hand stops at a stop and at a blocked shaft."""
        self._hand = place.copy()
        self._reach = speed.copy()
        self._look()

    def set_base_pose(self, base: str) -> None:
        """See `ServoPhysics.set_base_pose`. Always raises ValueError: these joints have no body."""
        raise ValueError("lay: these are joints without load, which no body holds together")

    def set_endstops(self, lower: Floats, upper: Floats) -> None:
        """Set mechanical stops (ticks), hard: a shaft that pushes against one is jammed there."""
        self.lower = np.array(lower, np.float64)
        self.upper = np.array(upper, np.float64)
        self._look()

    def _look(self) -> None:
        """Update which motors do something else than seek a position, and whether any does."""
        self._strong = self._on & (self._speed > 1e-9)
        self._gripped = np.flatnonzero(np.isfinite(self._hand) & ~self._on & ~self._blocked)
        fenced = bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())
        self._odd = bool(self._turning.size or self._blocked.any() or self._gripped.size or fenced)

    def advance(self, now: float) -> None:
        """Constant speed while the error is beyond speed/rate, exponential decay after it."""
        dt = now - self._time
        if not dt > 0.0:
            return
        self._time = now
        if self._odd:
            self._advance_all(dt)
        else:
            self._seek(dt)

    def _seek(self, dt: float) -> None:
        """Move the motors in modes 3, 4 and 5."""
        error = self.goal - self.position
        cruises = np.count_nonzero(np.abs(error * self._rate) > self._speed)
        left = self._cruise(error, dt) if cruises else error * np.exp(self._rate * -dt)
        np.subtract(self.goal, left, out=self.position, where=self._pulled)
        np.multiply(left, self._per_tick, out=self.velocity)
        if cruises:
            top = self._speed / self._ticks
            np.clip(self.velocity, -top, top, out=self.velocity)
        np.multiply(self.velocity, self._friction, out=self.current)
        np.multiply(left, self._p, out=self.pwm)
        np.minimum(self.pwm, self._cap, out=self.pwm)
        np.maximum(self.pwm, self._floor, out=self.pwm)

    def _cruise(self, error: Floats, dt: float) -> Floats:
        """Return the error left after `dt` s: full speed until the decay is no faster, then the decay."""
        size = np.abs(error)
        cruise = np.maximum(size * self._rate - self._speed, 0.0) / self._slowest  # ticks at full speed
        moved = np.minimum(cruise, self._speed * dt)
        left: Floats = (size - moved) * np.exp(self._rate * (moved / self._speed - dt))
        return np.copysign(left, error, out=left)

    def _advance_all(self, dt: float) -> None:
        before = self.position.copy()
        speed = self.velocity[self._turning]
        self._seek(dt)
        self._turn(speed, dt)
        self._carry(before, dt)
        stuck = (self.position < self.lower) | (self.position > self.upper)
        np.minimum(np.maximum(self.position, self.lower), self.upper, out=self.position)
        self.position[self._blocked] = before[self._blocked]
        stuck |= self._blocked
        if stuck.any():
            self.velocity[stuck] = 0.0
            self._jam(np.flatnonzero(stuck & self._strong))

    def _carry(self, before: Floats, dt: float) -> None:
        """Move limp shafts straight to where a hand takes them."""
        at = self._gripped
        if at.size:
            most = self._reach[at] * dt
            moved = np.clip(self._hand[at] - before[at], -most, most)
            self.position[at] = before[at] + moved
            self.velocity[at] = moved / (dt * self._ticks[at])

    def _turn(self, speed: Floats, dt: float) -> None:
        """Modes 0, 1 and 16, `speed` (raw) before: the speed tends to what the goal means without load."""
        at = self._turning
        rate = self._quickness
        mode = self._mode[at]
        goal = self.goal[at]
        top = self._top[at]
        full = self._full[at]
        free = self._free[at]
        friction = self._friction[at]
        by_pwm = mode == PWM
        wish = np.where(by_pwm, goal / full * free * self._volts[at], goal)
        wish = within(np.where(mode == CURRENT, goal / friction, wish), top)
        decay = np.exp(-rate * dt)
        now = wish + (speed - wish) * decay
        self.position[at] += (wish * dt + (speed - wish) * (1.0 - decay) / rate) * self._ticks[at]
        self.velocity[at] = now
        torque = friction * (now + (wish - now) * rate * COAST)  # friction, and what the inertia takes
        cap = self._cap[at]
        most = self._current_cap[at]
        self.current[at] = within(torque, most)
        output = (now / free + self.current[at] / self._stall[at]) / self._volts[at] * full
        self.pwm[at] = within(np.where(by_pwm, goal, output), cap)

    def _jam(self, at: NDArray[np.intp]) -> None:
        """All output becomes current; a speed loop has long integrated up to its cap."""
        mode = self._mode[at]
        goal = self.goal[at]
        cap = self._cap[at]
        full = self._stall[at] * self._volts[at] / self._full[at]  # raw current per count
        pull = self._p[at] * (goal - self.position[at])
        spin = np.where(goal == 0.0, 0.0, np.copysign(cap, goal))
        output = np.select([mode == CURRENT, mode == VELOCITY, mode == PWM], [goal / full, spin, goal], pull)
        most = self._current_cap[at]
        self.current[at] = np.clip(np.clip(output, -cap, cap) * full, -most, most)
        self.pwm[at] = self.current[at] / full
