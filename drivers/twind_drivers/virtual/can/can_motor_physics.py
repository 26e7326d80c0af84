"""Physics of a virtual CAN actuator's shaft: the interface, in SI, and its simplest implementation.

These actuators close an impedance loop at the output: torque = kp (place - q) + kd (speed - v) + torque. The
serial servos' physics (`twind_drivers.virtual.servo_physics`) use registers; one body may move both.
"""

from typing import Protocol

import numpy as np

from twind_drivers.virtual.shaft_physics import Bools, Floats, ShaftPhysics

INERTIA = 0.02  # kg·m² at the output: rotor and a light link
FRICTION = 0.2  # N·m·s/rad, viscous
STEP = 0.002  # s, the longest step of the solution that is exact as long as nothing saturates


class CanMotorPhysics(ShaftPhysics, Protocol):
    """The motors of the nodes of one bus: position in rad of the shaft, neither wrapped nor zeroed; rad/s."""

    torque: Floats  # N·m, what the motor gives

    def drive(
        self,
        on: Bools,
        position: Floats,
        velocity: Floats,
        kp: Floats,
        kd: Floats,
        torque: Floats,
        limit: Floats,
    ) -> None:
        """Set the command of each motor (rad, rad/s, N·m/rad, N·m·s/rad, N·m), within `limit` N·m.

        Off: nothing but friction.
        """


FASTEST = 30.0  # rad/s of a shaft


class FirstOrderCanPhysics:
    """Free shafts with inertia and viscous friction, without load.

    Implicit Euler in steps of at most 2 ms: stable for any gains, at rest at the commanded position.
    """

    def __init__(self, start: Floats, *, now: float = 0.0) -> None:
        """Begin at `start` (m,) rad."""
        self.position = np.array(start, np.float64)
        self.velocity = np.zeros_like(self.position)
        self.torque = np.zeros_like(self.position)
        self._time = now
        self._blocked = np.zeros(self.position.size, np.bool_)
        self._hand = np.full_like(self.position, np.nan)
        self._reach = np.zeros_like(self.position)
        self._lower = np.full_like(self.position, -np.inf)
        self._upper = np.full_like(self.position, np.inf)
        none = np.zeros_like(self.position)
        self.drive(none > 0, none, none, none, none, none, none)

    def drive(
        self,
        on: Bools,
        position: Floats,
        velocity: Floats,
        kp: Floats,
        kd: Floats,
        torque: Floats,
        limit: Floats,
    ) -> None:
        """See `CanMotorPhysics.drive`."""
        self._kp = np.where(on, kp, 0.0)
        self._kd = np.where(on, kd, 0.0)
        self._ahead = np.where(on, kp * position + kd * velocity + torque, 0.0)
        self._limit = np.where(on, limit, 0.0)
        self._limp = ~on

    def block(self, held: Bools) -> None:
        """See `CanMotorPhysics.block`."""
        self._blocked = held.copy()

    def set_hand_positions(self, place: Floats, speed: Floats) -> None:
        """See `CanMotorPhysics.set_hand_positions`."""
        self._hand = place.copy()
        self._reach = speed.copy()

    def set_base_pose(self, base: str) -> None:
        """See `CanMotorPhysics.set_base_pose`."""
        raise ValueError("lay: these are shafts without load, which no body holds together")

    def set_endstops(self, lower: Floats, upper: Floats) -> None:
        """Mechanical stops (rad), hard."""
        self._lower = np.array(lower, np.float64)
        self._upper = np.array(upper, np.float64)

    def advance(self, now: float) -> None:
        """See `CanMotorPhysics.advance`."""
        while now - self._time > 1e-9:
            step = min(now - self._time, STEP)
            self._time += step
            self._step(step)

    def _step(self, dt: float) -> None:
        """A shaft whose torque saturates is stepped again with that torque as given."""
        spring = self._kp * dt
        drag = self._kd + self._kp * dt
        push = self._ahead - self._kp * self.position
        speed = (INERTIA * self.velocity + dt * push) / (INERTIA + dt * (FRICTION + drag))
        torque = push - self._kd * speed - spring * speed
        if np.count_nonzero(np.abs(torque) > self._limit):
            torque = np.clip(torque, -self._limit, self._limit)
            speed = (INERTIA * self.velocity + dt * torque) / (INERTIA + dt * FRICTION)
        speed = np.clip(speed, -FASTEST, FASTEST)
        held = self._limp & np.isfinite(self._hand)
        if held.any():
            pace = np.clip((self._hand - self.position) / dt, -self._reach, self._reach)
            speed = np.where(held, pace, speed)
        self.velocity[:] = np.where(self._blocked, 0.0, speed)
        self.position += self.velocity * dt
        stuck = self._blocked | (self.position < self._lower) | (self.position > self._upper)
        if stuck.any():
            np.clip(self.position, self._lower, self._upper, out=self.position)
            self.velocity[stuck] = 0.0
            still = np.clip(push, -self._limit, self._limit)
            torque = np.where(stuck, still, torque)
        self.torque[:] = torque
