"""Joint actuators of a virtual robot, of any family: their zeros and hinges."""

import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from twind.config.counts import rad_per_tick
from twind.config.robot_spec import JointSpec
from twind.config.travel import travel_refusal, zero_range
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.virtual.robot_ground_truth import JointGroundTruth
from twind_drivers.virtual.hinge import Hinge

SCATTER = 400  # ticks either side of the middle of what the travel allows


class EndstopPhysics(Protocol):
    """Motion of joints without load, between mechanical stops."""

    def set_endstops(self, lower: Floats, upper: Floats) -> None:
        """Set the ends (m,) of the shafts, in the unit of their positions."""


def zero_of(robot: str, joint: JointSpec, truth: JointGroundTruth, by_hand: tuple[float, float]) -> int:
    """Return the encoder position at joint angle 0: from the truth, else fixed by the names.

    That keeps the travel `by_hand` (rad) on one turn, clear of the seam. `joint` as it is wired. Raises
    InvalidInput.
    """
    if truth.zero_ticks is not None:
        return truth.zero_ticks
    refusal = travel_refusal(joint)
    if refusal is not None:
        raise InvalidInput(f"{joint.name}: {refusal}")
    first, last = zero_range(joint)
    middle = (first + last) // 2
    first = max(first, middle - SCATTER)
    last = min(last, middle + SCATTER)
    zero = first + zlib.crc32(f"{robot}/{joint.name}".encode()) % (last - first + 1)
    least, most = zero_range(joint, by_hand)
    return min(max(zero, least), most)


def hinge_of(joint: JointSpec, zero: int, ends: Mapping[str, tuple[float, float]], unit: float) -> Hinge:
    """Make the hinge of `joint` as it is wired. `unit`: of the physics' positions, in counts."""
    scale = unit / rad_per_tick(joint)
    return Hinge(joint.name, zero * unit, scale, ends.get(joint.name, (-math.inf, math.inf)))


def fence(muscles: EndstopPhysics, hinges: Sequence[Hinge | None]) -> None:
    """Joints without load end where their hinges do."""
    ends = [(-math.inf, math.inf) if hinge is None else hinge.ends() for hinge in hinges]
    lower, upper = np.array(ends, np.float64).reshape(-1, 2).T
    muscles.set_endstops(lower, upper)
