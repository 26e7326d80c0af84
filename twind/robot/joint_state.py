"""One reading of the robot."""

from dataclasses import dataclass

from twind.robot.arrays import Bools, Floats


@dataclass(frozen=True, slots=True)
class Imu:
    """One reading of an inertial sensor, in the axes of the base: x forward, y left, z up. Read-only."""

    time: float  # s, monotonic, when its last byte arrived
    gyro: Floats  # rad/s, (3,)
    acceleration: Floats  # m/s², (3,)
    quaternion: Floats  # w x y z, (4,), from the base's axes to the world's


@dataclass(frozen=True, slots=True)
class JointState:
    """One reading of every joint, in `JointMap` order. Arrays are (n,) and read-only.

    A joint that did not reply keeps its last values with a growing `age`; one that never replied is NaN with
    infinite age. Never a zero, never an old value with a new stamp.
    """

    time: float  # s, monotonic, when the last byte of the reading arrived
    position: Floats  # rad
    velocity: Floats  # rad/s
    effort: Floats  # N·m, NaN where the actuator reports none
    age: Floats  # s, since this joint's last reply, at `time`
    heard: Bools  # False: this joint did not reply; its values are old
    round_trip: float = 0.0  # s, request to last byte, the slowest bus; NaN unknown
    imu: Imu | None = None  # None: there is none, or it has not replied yet
