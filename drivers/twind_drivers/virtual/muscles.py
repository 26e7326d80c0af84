"""What turns a virtual servo's shaft: the protocol, in servo units, and the cheapest muscles that keep it.

A servo knows encoder ticks, raw velocity, raw current and raw PWM; it does not know whether a formula or a
physics engine moves it. Ticks here are the bare encoder's, continuous over turns, without homing offset.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Muscles(Protocol):
    """The motors of the servos of one bus. Arrays are (m,), in the order of the servos.

    The four readings stay true until the next `advance`; nobody but the muscles writes them.
    """

    position: Floats  # encoder ticks
    velocity: Floats  # raw, 0.229 rpm
    current: Floats  # raw, the model's current unit
    pwm: Floats  # raw, 0.113 %

    def drive(
        self, *, on: Bools, p: Floats, i: Floats, d: Floats, pwm_cap: Floats, current_cap: Floats
    ) -> None:
        """From now on: torque on or off, the position gains of the registers, caps of output and current."""

    def aim(self, goal: Floats) -> None:
        """From now on: where the position loop pulls to, encoder ticks. Ignored where torque is off."""

    def advance(self, now: float) -> None:
        """Let the time pass until `now` (s). A time already passed does nothing."""


class FirstOrder:
    """Joints without load: the error decays with a time constant, the speed is capped, off means it stays.

    The step is exact for any length, so an hour of robot needs no small steps.
    """

    def __init__(
        self, start: Floats, *, lag: float = 0.04, gain: float = 800.0, speed: float = 201.0, now: float = 0.0
    ) -> None:
        """`start` (m,) ticks; `lag` s at P gain `gain`; `speed` raw (201 = 46 rpm, XM430-W350 at 12 V)."""
        self.position = np.array(start, np.float64)
        self.velocity = np.zeros_like(self.position)
        self.current = np.zeros_like(self.position)
        self.pwm = np.zeros_like(self.position)
        self._lag, self._gain = lag, gain
        self._speed = speed * 0.229 / 60.0 * 4096.0  # ticks/s
        self._goal = self.position.copy()
        self._time = now
        self._on = np.zeros(self.position.size, np.bool_)
        self._rate = np.zeros_like(self.position)  # 1/s; 0 where nothing pulls
        self._slowest = np.full_like(self.position, 1e-9)  # the rate, but never 0: to divide by
        self._p = np.zeros_like(self.position)
        self._cap = np.zeros_like(self.position)

    def drive(
        self, *, on: Bools, p: Floats, i: Floats, d: Floats, pwm_cap: Floats, current_cap: Floats
    ) -> None:
        """The P gain sets the lag; no output or no current allowed means no motion. I and D do nothing."""
        pulls = on & (pwm_cap > 0.0) & (current_cap > 0.0)
        self._on = on.copy()
        self._rate = np.where(pulls, p / (self._gain * self._lag), 0.0)
        self._slowest = np.maximum(self._rate, 1e-9)
        self._p, self._cap = np.where(pulls, p / 128.0, 0.0), pwm_cap.copy()

    def aim(self, goal: Floats) -> None:
        """See `Muscles.aim`."""
        self._goal[:] = goal

    def advance(self, now: float) -> None:
        """Constant speed while the error is beyond speed/rate, exponential decay after it."""
        dt = now - self._time
        if not dt > 0.0:
            return
        self._time = now
        rate = self._rate
        error = self._goal - self.position
        size = np.abs(error)
        beyond = size * rate - self._speed
        if np.count_nonzero(beyond > 0.0):
            cruise = np.maximum(beyond, 0.0) / self._slowest  # ticks at full speed
            moved = np.minimum(cruise, self._speed * dt)
            left = (size - moved) * np.exp(rate * (moved / self._speed - dt))
        else:
            left = size * np.exp(rate * -dt)
        way = np.copysign(1.0, error)
        np.copyto(self.position, self._goal - way * left, where=rate > 0.0)
        raw = np.minimum(left * rate, self._speed) * way
        raw *= 60.0 / (0.229 * 4096.0)
        self.velocity[:] = raw
        np.multiply(raw, 0.1, out=self.current)  # viscous friction of the gear: nothing else loads it
        np.minimum(self._p * left, self._cap, out=left)
        np.multiply(left, way, out=self.pwm)
