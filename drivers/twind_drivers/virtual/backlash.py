"""Backlash between the encoder of a servo and the joint that it turns."""

import numpy as np
from numpy.typing import NDArray

from twind_drivers.virtual.servo_physics import DriveState, ServoPhysics
from twind_drivers.virtual.shaft_physics import Bools, Floats


class Backlash:
    """Muscles whose encoders follow the joints with play: they move once it is used up, and stay behind it.

    Keeps `ServoPhysics`. What the motors seek is the joint's place, so a servo that has arrived shows up to
    half of its play away from its goal, on the side that it came from.
    """

    def __init__(self, muscles: ServoPhysics, play: NDArray[np.float64]) -> None:
        """Make the backlash; `play` (m,): ticks, from one side to the other."""
        self._muscles = muscles
        self._half = play / 2.0
        self.position = muscles.position.copy()
        self._seen = muscles.position.copy()
        self.velocity = muscles.velocity.copy()  # of the encoder too: none while the play is used up
        self.current = muscles.current
        self.pwm = muscles.pwm

    def drive(self, drive: DriveState) -> None:
        """See `ServoPhysics.drive`."""
        self._muscles.drive(drive)

    def set_goals(self, goal: Floats) -> None:
        """See `ServoPhysics.set_goals`."""
        self._muscles.set_goals(goal)

    def block(self, held: Bools) -> None:
        """See `ServoPhysics.block`."""
        self._muscles.block(held)

    def set_hand_positions(self, place: Floats, speed: Floats) -> None:
        """See `ServoPhysics.set_hand_positions`: a hand holds the joint, not the encoder."""
        self._muscles.set_hand_positions(place, speed)

    def set_base_pose(self, base: str) -> None:
        """See `ServoPhysics.set_base_pose`."""
        self._muscles.set_base_pose(base)

    def advance(self, now: float) -> None:
        """See `ServoPhysics.advance`."""
        self._muscles.advance(now)
        place = self._muscles.position
        before = self.position.copy()
        if np.array_equal(place, self._seen):  # no time has passed, or nothing turns
            self.velocity[self._muscles.velocity == 0.0] = 0.0
            return
        self._seen[:] = place
        np.clip(self.position, place - self._half, place + self._half, out=self.position)
        moved = (self.position != before) | (self._half == 0.0)
        np.multiply(self._muscles.velocity, moved, out=self.velocity)
