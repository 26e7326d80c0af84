"""Messages of the robot's state for ROS, at the loop's rate. Pure; standard library, Python 3.10.

A joint without reply in a reading is not in its message: no zero, no old number under a new stamp. An unknown
velocity or effort is NaN; a column without any value is empty, as ROS has it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import nan
from typing import Any

from twind.bridge.ros.ros_endpoints import (
    ACCEPTED,
    HW_JOINTS,
    INERTIAL,
    JOINTS,
    MIRRORED_JOINTS,
    SIM_JOINTS,
    RosTopic,
)
from twind.client.clock_pair import ClockPair
from twind.ros import ImuBuffer, JointStateBuffer
from twind.ros.joint_state_message import LAST
from twind.ros.trajectory_message import accepted_bytes

FELT = ("gyro", "acceleration", "quaternion")
NEWER = 1e-3  # s from one reading of an IMU to the next, at least
SHAPES = 32  # sets of joints whose bytes are kept prepared; a bus that loses answers has many

Message = tuple[RosTopic, bytes]
Row = Mapping[str, Any]  # `Joint` of the interface


class RosStateMessages:
    """Turns answers of `Monitor` into messages. `state` and the others may be called by two threads."""

    def __init__(self) -> None:
        self._mode = ""
        self._measured = False
        self.prepared: dict[tuple[tuple[str, ...], bool, bool], JointStateBuffer] = {}
        self._inertial = ImuBuffer()
        self._felt = float("-inf")

    def status(self, status: Mapping[str, Any]) -> None:
        """Take `Status` of the interface, which determines the robot of `/joint_states`."""
        self._mode = status["mode"]
        self._measured = bool(status["hw_connected"])

    def state(self, answer: Mapping[str, Any], clocks: ClockPair) -> list[Message]:
        """Topic `state`: what was measured, what is simulated, and which of both is the robot's."""
        rows = answer["joints"]
        time = answer["time"]
        mode = answer.get("mode") or self._mode
        messages: list[Message] = []
        measured = None if mode == "sim" else self._answered_joints(rows, time, clocks)
        simulated = self._simulated(rows, wall(clocks, time))
        if measured is not None:
            messages.append((HW_JOINTS, measured))
        if simulated is not None:
            messages.append((MIRRORED_JOINTS if mode == "mirror" else SIM_JOINTS, simulated))
        # In live the message is of the real robot: without its readings a simulation must not pass for it.
        real = mode == "live" or (mode == "mirror" and self._measured)
        chosen = measured if real else simulated
        if chosen is not None:
            messages.append((JOINTS, chosen))
        return messages + self._imu(answer, time, clocks)

    def accepted(self, answer: Mapping[str, Any], clocks: ClockPair) -> list[Message]:
        """Topic `trajectories`: what passed the gate."""
        return [(ACCEPTED, accepted_bytes(answer["accepted"], wall(clocks, answer["time"])))]

    def _answered_joints(self, rows: Sequence[Row], time: float, clocks: ClockPair) -> bytes | None:
        """Build the message of the joints that replied in this reading, stamped with the last reply; None:
        none.
        """
        fresh = [row for row in rows if row["heard"] and row["position"] is not None]
        if not fresh:
            return None
        age = min((row["age_ms"] or 0.0) for row in fresh) / 1e3
        velocity, effort = ([row[key] for row in fresh] for key in ("velocity", "effort"))
        columns = [row["position"] for row in fresh], velocity, effort
        return self._filled([row["name"] for row in fresh], columns, wall(clocks, time - age))

    def _simulated(self, rows: Sequence[Row], stamp_ns: int) -> bytes | None:
        known = [row for row in rows if row["simulated"] is not None]
        if not known:
            return None
        nothing = [None] * len(known)
        columns = [row["simulated"] for row in known], nothing, nothing
        return self._filled([row["name"] for row in known], columns, stamp_ns)

    def _filled(
        self, names: Sequence[str], columns: Sequence[Sequence[float | None]], stamp_ns: int
    ) -> bytes:
        """Fill position, velocity, effort of these joints; a column without values stays empty."""
        velocity, effort = (any(each is not None for each in column) for column in columns[1:])
        shape = tuple(names), velocity, effort
        buffer = self.prepared.get(shape)
        if buffer is None:
            while len(self.prepared) >= SHAPES:
                del self.prepared[next(iter(self.prepared))]
            buffer = self.prepared[shape] = JointStateBuffer(names, velocity=velocity, effort=effort)
        present = (True, velocity, effort)
        numbers = [
            [nan if each is None else each for each in column]
            for column, wanted in zip(columns, present, strict=True)
            if wanted
        ]
        return buffer.fill(stamp_ns, *numbers)

    def _imu(self, answer: Mapping[str, Any], time: float, clocks: ClockPair) -> list[Message]:
        """Build the message of a new IMU reading, stamped with its time."""
        imu = answer.get("imu")
        if imu is None:
            return []
        taken = time - imu["age_ms"] / 1e3
        if abs(taken - self._felt) < NEWER:
            return []
        self._felt = taken
        return [(INERTIAL, self._inertial.fill(wall(clocks, taken), *(imu[key] for key in FELT)))]


def wall(clocks: ClockPair, time: float) -> int:
    """Return ns since 1970 of a monotonic time, s, within the range of a ROS stamp."""
    return min(max(clocks.wall(time), 0), LAST)
