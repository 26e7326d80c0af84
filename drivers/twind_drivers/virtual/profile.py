"""The reference that a position loop follows towards its goal, by profile velocity and acceleration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
VELOCITY = 0.229 / 60.0 * 4096.0  # ticks/s per unit of register 112
ACCELERATION = 214.577 / 3600.0 * 4096.0  # ticks/s² per unit of register 108
STEP = 0.002  # s


@dataclass(slots=True)
class Profile:
    """Reference and its speed of all servos, (m,), encoder ticks. `velocity` 0: the reference is the goal."""

    reference: Floats
    speed: Floats  # ticks/s
    velocity: Floats  # ticks/s, cap; inf: step
    acceleration: Floats  # ticks/s², cap; inf: rectangle
    shaped: bool = False  # does any servo have a profile?

    @classmethod
    def at(cls, position: Floats) -> "Profile":
        """At rest at `position`, every goal a step."""
        endless = np.full_like(position, np.inf)
        return cls(position.copy(), np.zeros_like(position), endless, endless.copy())

    def limit(self, velocity: Floats, acceleration: Floats) -> None:
        """Caps from registers 112 and 108, raw (m,); 0 is none (e-manual, "Profile Velocity")."""
        self.velocity = np.where(velocity > 0, velocity * VELOCITY, np.inf)
        self.acceleration = np.where(acceleration > 0, acceleration * ACCELERATION, np.inf)
        self.shaped = bool((velocity > 0).any())

    def follow(self, target: Floats, dt: float) -> None:
        """Let `dt` s pass. Speed and position stay continuous where both caps are set."""
        gap = target - self.reference
        braking = np.sqrt(2.0 * np.minimum(self.acceleration, 1e12) * np.abs(gap))  # inf * 0 is no number
        wish = np.copysign(np.minimum(np.minimum(self.velocity, braking), np.abs(gap) / dt), gap)
        reach = np.minimum(self.acceleration * dt, 1e12)
        self.speed = self.speed + np.clip(wish - self.speed, -reach, reach)
        step = np.isinf(self.velocity)
        self.speed[step] = 0.0
        self.reference = np.where(step, target, self.reference + self.speed * dt)
