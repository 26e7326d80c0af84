"""Messages of the robot's state for ROS, at the loop's rate. Pure; standard library, Python 3.10.

A joint without reply in a reading is not in its message: no zero, no old number under a new stamp. An unknown
velocity or effort is NaN; a column without any value is empty, as ROS has it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any

from twind.bridge.ros.robot_model_messages import RobotModelMessages, make_room
from twind.bridge.ros.ros_endpoints import (
    ACCEPTED,
    DYNAMIC_JOINTS,
    HW_JOINTS,
    INERTIAL,
    JOINTS,
    MIRRORED_JOINTS,
    MOVING_FRAMES,
    SIM_JOINTS,
    SIM_TIME,
    RosTopic,
)
from twind.client.clock_pair import ClockPair
from twind.ros import CLOCK, DYNAMIC_JOINT_STATE, ImuBuffer, JointStateBuffer, MessageBuffer, encode, stamp
from twind.ros.joint_state_message import LAST
from twind.ros.trajectory_message import accepted_bytes

FELT = ("gyro", "acceleration", "quaternion")
NEWER = 1e-3  # s from one reading of an IMU to the next, at least
INTERFACES = ("position", "velocity", "effort", "temperature", "voltage")  # of /dynamic_joint_states

Message = tuple[RosTopic, bytes]
Row = Mapping[str, Any]  # `Joint` of the interface


@dataclass(frozen=True, slots=True)
class JointColumns:
    """Joints of one reading: known columns by interface, NaN: unknown, and the JointState of them."""

    names: tuple[str, ...]
    columns: Mapping[str, Sequence[float]]
    stamp_ns: int
    data: bytes


class RosStateMessages:
    """Turns answers of `Monitor` into messages. `state` and the others may be called by two threads."""

    def __init__(self) -> None:
        self._mode = ""
        self._measured = False
        self.prepared: dict[tuple[tuple[str, ...], bool, bool], JointStateBuffer] = {}
        self.description: RobotModelMessages | None = None  # for /tf; None: not known, or not wanted
        self._dynamic: dict[tuple[tuple[str, ...], tuple[str, ...]], MessageBuffer] = {}
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
            messages.append((HW_JOINTS, measured.data))
        if simulated is not None:
            messages.append((MIRRORED_JOINTS if mode == "mirror" else SIM_JOINTS, simulated.data))
        # In live the message is of the real robot: without its readings a simulation must not pass for it.
        real = mode == "live" or (mode == "mirror" and self._measured)
        chosen = measured if real else simulated
        if chosen is not None:
            messages += self._robot(chosen)
        if chosen is not None and mode == "sim":
            messages.append((SIM_TIME, encode(CLOCK, {"clock": stamp(chosen.stamp_ns)})))
        return messages + self._imu(answer, time, clocks)

    def _robot(self, chosen: JointColumns) -> list[Message]:
        """Return the messages of the robot's own joints and frames, all with the same stamp."""
        messages = [(JOINTS, chosen.data), (DYNAMIC_JOINTS, self._interfaces(chosen))]
        description = self.description
        if description is not None:
            frames = description.moving(chosen.names, chosen.columns["position"], chosen.stamp_ns)
            messages.append((MOVING_FRAMES, frames))
        return messages

    def accepted(self, answer: Mapping[str, Any], clocks: ClockPair) -> list[Message]:
        """Topic `trajectories`: what passed the gate."""
        return [(ACCEPTED, accepted_bytes(answer["accepted"], wall(clocks, answer["time"])))]

    def _answered_joints(self, rows: Sequence[Row], time: float, clocks: ClockPair) -> JointColumns | None:
        """Take the joints that replied in this reading, stamped with the last reply; None: no joint."""
        fresh = [row for row in rows if row["heard"] and row["position"] is not None]
        if not fresh:
            return None
        age = min((row["age_ms"] or 0.0) for row in fresh) / 1e3
        columns = {key: [row[key] for row in fresh] for key in INTERFACES}
        return self._filled(fresh, columns, wall(clocks, time - age))

    def _simulated(self, rows: Sequence[Row], stamp_ns: int) -> JointColumns | None:
        known = [row for row in rows if row["simulated"] is not None]
        if not known:
            return None
        return self._filled(known, {"position": [row["simulated"] for row in known]}, stamp_ns)

    def _filled(
        self, rows: Sequence[Row], columns: Mapping[str, Sequence[float | None]], stamp_ns: int
    ) -> JointColumns:
        """Fill position, velocity, effort of these joints; a column without values stays empty."""
        names = tuple(row["name"] for row in rows)
        known = {
            key: [nan if each is None else each for each in column]
            for key, column in columns.items()
            if any(each is not None for each in column)
        }
        shape = names, "velocity" in known, "effort" in known
        buffer = self.prepared.get(shape)
        if buffer is None:
            make_room(self.prepared)
            buffer = self.prepared[shape] = JointStateBuffer(names, velocity=shape[1], effort=shape[2])
        data = buffer.fill(stamp_ns, *(known[key] for key in INTERFACES[:3] if key in known))
        return JointColumns(names, known, stamp_ns, data)

    def _interfaces(self, chosen: JointColumns) -> bytes:
        """Return the message of /dynamic_joint_states, with each column that has a value."""
        shape = chosen.names, tuple(chosen.columns)
        buffer = self._dynamic.get(shape)
        if buffer is None:
            make_room(self._dynamic)
            values = {"interface_names": list(shape[1]), "values": [0.0] * len(shape[1])}
            message = {"joint_names": list(shape[0]), "interface_values": [values] * len(shape[0])}
            buffer = self._dynamic[shape] = MessageBuffer(DYNAMIC_JOINT_STATE, message)
        rows = zip(*chosen.columns.values(), strict=True)
        return buffer.fill(chosen.stamp_ns, [each for row in rows for each in row])

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
