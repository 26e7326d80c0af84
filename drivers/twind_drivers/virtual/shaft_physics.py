"""Interface to the physics of virtual shafts, the same for servos and CAN actuators."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class ShaftPhysics(Protocol):
    """The shafts of one bus. Arrays are (m,), in the order of its devices and in their unit.

    The readings stay valid until the next `advance`; only the physics writes them.
    """

    position: Floats  # continuous over turns
    velocity: Floats

    def block(self, held: Bools) -> None:
        """Set the blocked shafts (m,); they turn neither with torque nor without."""

    def set_hand_positions(self, place: Floats, speed: Floats) -> None:
        """Set the positions (m,) where hands hold limp shafts, NaN: no hand; their speed, per s.

        Where torque is on a hand slips.
        """

    def set_base_pose(self, base: str) -> None:
        """Set how the base of the robot is held. Raises KeyError: no such way, ValueError: no body."""

    def advance(self, now: float) -> None:
        """Let the time pass until `now` (s). A time already passed does nothing."""
