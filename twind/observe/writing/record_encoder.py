"""Answers of `Monitor` as messages of a recording. Pure: time is in the answers, clocks are handed in."""

from collections.abc import Iterator, Mapping, Sequence
from math import nan
from struct import Struct
from typing import Any, NamedTuple

import msgspec

from twind.client.clock_pair import SECOND, ClockPair
from twind.observe.recording.recording_topics import (
    COMMANDS,
    EVENTS,
    INERTIAL,
    JOINTS,
    LATENCY,
    MEASURED,
    NOTES,
    SIMULATED,
    STATUS,
    TRAJECTORY,
    VERDICTS,
)
from twind.ros import ImuBuffer, JointStateBuffer, stamp
from twind.ros.cdr import HEAD
from twind.ros.joint_state_message import LAST
from twind.ros.trajectory_message import accepted_bytes

# a header with a stamp is their first field
STAMPED = frozenset({MEASURED, SIMULATED, COMMANDS, TRAJECTORY, INERTIAL})
NEWER = 1.0  # ms from one reading of an IMU to the next, at least
SLOW = 0.5  # s between two messages of JOINTS
FELT = ("gyro", "acceleration", "quaternion")

Answer = Mapping[str, Any]
_STAMP = Struct("<iI")
_json = msgspec.json.Encoder()


class RecordLine(NamedTuple):
    """One message of a recording. `mark`: the annotation of an event that is one."""

    topic: str
    time_ns: int
    data: bytes
    mark: Mapping[str, Any] | None = None


def shifted(line: RecordLine, by: int) -> RecordLine:
    """The same message of a wall clock that was set by so many ns: log time and stamp."""
    data = line.data
    if line.topic in STAMPED:
        at = len(HEAD)
        seconds, rest = _STAMP.unpack_from(data, at)
        found = stamp(min(max(seconds * SECOND + rest + by, 0), LAST))
        data = data[:at] + _STAMP.pack(found["sec"], found["nanosec"]) + data[at + _STAMP.size :]
    return line._replace(time_ns=line.time_ns + by, data=data)


def note(clocks: ClockPair, time: float, kind: str, /, **message: Any) -> RecordLine:
    """A message of the recorder itself, at `time` (s, monotonic)."""
    return RecordLine(NOTES, clocks.wall(time), _json.encode({"kind": kind, **message}))


class RecordEncoder:
    """Encoder of one robot's answers. `mode`: the last reported target of commands.

    `state` answers may come from another thread than all others.
    """

    def __init__(self, joints: Sequence[str], clocks: ClockPair, mode: str = "live") -> None:
        self.joints = tuple(joints)
        self.clocks = clocks
        self.mode = mode
        self._measured = JointStateBuffer(joints, velocity=True, effort=True)
        self._only = JointStateBuffer(joints, velocity=False, effort=False)
        self._slow_due = float("-inf")
        self._inertial = ImuBuffer()
        self._felt = float("-inf")  # ms, time of the last written reading

    def take(self, answer: Answer) -> Iterator[RecordLine]:
        """Messages of one answer; none for a topic that is not recorded."""
        topic = answer["topic"]
        time = self.clocks.wall(answer["time"])
        if topic == "state":
            yield from self._state(answer, time)
        elif topic == "status":
            self.mode = answer["status"]["mode"]
            yield RecordLine(STATUS, time, _json.encode(answer["status"]))
        elif topic == "latency":
            yield RecordLine(LATENCY, time, _json.encode({"hops": answer["latency"]}))
        elif topic == "events":
            event = answer["event"]
            yield RecordLine(EVENTS, time, _json.encode(event), event.get("annotation"))
        elif topic == "verdicts":
            yield RecordLine(VERDICTS, time, _json.encode({"id": answer.get("id"), **answer["verdict"]}))
        elif topic == "trajectories":
            yield RecordLine(TRAJECTORY, time, accepted_bytes(answer["accepted"], time))

    def _state(self, answer: Answer, time: int) -> Iterator[RecordLine]:
        """Rows of which nothing is known are left out, of an IMU all that is not new.

        In sim there is no robot that was measured.
        """
        joints = answer["joints"]
        position = [joint["position"] for joint in joints]
        mode = answer.get("mode") or self.mode  # a status comes up to half a second after the change
        if mode != "sim" and _has_values(position):
            velocity = _numbers([joint["velocity"] for joint in joints])
            effort = _numbers([joint["effort"] for joint in joints])
            yield RecordLine(MEASURED, time, self._measured.fill(time, _numbers(position), velocity, effort))
        for topic, field in ((COMMANDS, "goal"), (SIMULATED, "simulated")):
            row = [joint[field] for joint in joints]
            if _has_values(row):
                yield RecordLine(topic, time, self._only.fill(time, _numbers(row)))
        imu = answer.get("imu")
        if imu is not None and (heard := answer["time"] * 1e3 - imu["age_ms"]) >= self._felt + NEWER:
            self._felt = heard
            yield RecordLine(INERTIAL, time, self._inertial.fill(time, *(imu[key] for key in FELT)))
        if answer["time"] >= self._slow_due:
            self._slow_due = answer["time"] + SLOW
            yield RecordLine(JOINTS, time, _json.encode({"joints": joints}))


def _has_values(row: Sequence[float | None]) -> bool:
    return any(each is not None for each in row)


def _numbers(row: Sequence[float | None]) -> list[float]:
    return [nan if each is None else each for each in row]
