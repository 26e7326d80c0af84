"""Torque on the joints from outside the robot: hands, loads, obstacles."""

from dataclasses import dataclass

from twind.robot.arrays import Floats


@dataclass(frozen=True, slots=True)
class ExternalTorque:
    """Estimate of one tick. Arrays are (n,), in joint order, and new in each tick."""

    torque: Floats  # N·m
    deviation: Floats  # N·m, one standard deviation
