"""Recordings for the tests: a robot of two joints, its answers, and a disk that is full or slow."""

import errno
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from twind.client.clock_pair import ClockPair
from twind.observe.recording import open_recording
from twind.observe.recording.recording_columns import RobotRecording
from twind.observe.recording.recording_topics import TRAJECTORY
from twind.observe.writing.record_encoder import RecordEncoder
from twind.observe.writing.record_file import BufferedFile, RecordFile
from twind.observe.writing.record_folder import DiskQuota
from twind.observe.writing.record_schemas import clock_words
from twind.observe.writing.record_writer import RecordSession, RecordWriter
from twind.ros import JOINT_TRAJECTORY, decode

JOINTS = ("hip", "knee")
UNLIMITED = {"keep": 1 << 40, "free": 0, "file": 1 << 40}  # bytes
CLOCKS = ClockPair(100.0, 1_795_000_000_000_000_000)
SESSION = RecordSession(
    "two",
    CLOCKS,
    {"version": "0", "robot": "two", **clock_words(CLOCKS)},
    {"robot.json": ("application/json", b'{"name": "two"}'), "model.mjcf": ("application/xml", b"<mujoco/>")},
)


def joint(name: str, position: float | None, **more: Any) -> dict[str, Any]:
    """A `Joint` of the interface."""
    known = {"name": name, "position": position, "velocity": 0.5, "effort": None, "goal": None}
    slow = {"simulated": None, "temperature": 40.0, "voltage": 12.0, "age_ms": 1.0, "torque": True}
    return known | slow | {"faults": []} | more


def state(time: float, **more: Any) -> dict[str, Any]:
    """An answer to topic `state`; positions are of the time."""
    joints = [joint(name, math.sin(time + place), **more) for place, name in enumerate(JOINTS)]
    return {"topic": "state", "time": time, "sequence": 0, "dropped": 0, "joints": joints}


def event(time: float, code: str, annotation: dict[str, Any] | None = None) -> dict[str, Any]:
    """An answer to topic `events`."""
    said = {"time": time, "sequence": 1, "level": "info", "code": code, "message": code, "findings": []}
    return {"topic": "events", "time": time, "dropped": 0, "event": said | {"annotation": annotation}}


def mark(time: float, kind: str, task: str = "pick", success: bool | None = None) -> dict[str, Any]:
    """An event that begins or ends an episode."""
    annotation = {"kind": kind, "task": task, "success": success, "text": None}
    return event(time, f"EPISODE_{kind.upper()}", annotation)


def status(time: float, mode: str = "live") -> dict[str, Any]:
    """An answer to topic `status`."""
    return {"topic": "status", "time": time, "dropped": 0, "status": {"mode": mode, "state": "armed"}}


class SteppedWriter:
    """A recording writer that the test steps by hand, with a clock that the test moves.

    `quota`: fields of `DiskQuota`, unlimited where missing; `options`: of `RecordWriter`.
    """

    def __init__(self, place: Path, quota: Mapping[str, Any] = UNLIMITED, **options: Any) -> None:
        self.time = 100.0
        self.writer = RecordWriter(place, DiskQuota(**{**UNLIMITED, **quota}), lambda: self.time, **options)
        self.encoder = RecordEncoder(JOINTS, CLOCKS)
        self.writer.begin(SESSION)

    def take(self, *answers: dict[str, Any]) -> None:
        """Pass answers of the daemon to the writer, and step it."""
        for answer in answers:
            for line in self.encoder.take(answer):
                self.writer.put(line)
        self.writer.step()

    def run(self, seconds: float, rate: float = 100.0) -> None:
        """Record states for `seconds` at `rate` Hz."""
        for _ in range(round(seconds * rate)):
            self.time = round(self.time + 1.0 / rate, 9)
            self.take(state(self.time))

    def finish(self) -> list[RobotRecording]:
        """Close the writer; return what its files contain."""
        self.writer.close()
        return [open_recording(path) for path in self.writer.tally.files]


def write(path: Path, seconds: float = 1.0, rate: float = 100.0) -> Path:
    """A small whole recording with a chunk every half a second."""
    file = RecordFile(path, SESSION.about, SESSION.attachments, CLOCKS.wall_ns)
    scribe = RecordEncoder(JOINTS, CLOCKS)
    for place in range(round(seconds * rate)):
        for line in scribe.take(state(100.0 + place / rate, goal=0.1)):
            file.write(line.topic, line.time_ns, line.data)
        if place % 50 == 49:
            file.flush()
    file.finish()
    return path


def trajectories(path: Path) -> list[dict[str, Any]]:
    """Accepted trajectories in a recording: `id`, `start_in` (s after the message), names, points."""
    with path.open("rb") as stream:
        kept = [each for _, _, each in make_reader(stream).iter_messages(topics=[TRAJECTORY])]
    found = []
    for each in kept:
        message = decode(JOINT_TRAJECTORY, each.data)
        stamp = message["header"]["stamp"]
        start_in = (stamp["sec"] * 10**9 + stamp["nanosec"] - each.log_time) / 1e9
        found.append({**message, "id": message["header"]["frame_id"], "start_in": start_in})
    return found


class FullDisk(BufferedFile):
    """Takes so many bytes, the last of them in part, as a real one does."""

    def __init__(self, path: Path, room: int) -> None:
        super().__init__(path)
        self._room = room
        self._poured = 0

    def pour(self, data: memoryview) -> None:
        part = data[: max(0, self._room - self._poured)]
        self._poured += len(part)
        super().pour(part)
        if len(part) < len(data):
            raise OSError(errno.ENOSPC, "No space left on device")

    def cut(self, size: int) -> None:
        super().cut(size)
        self._poured = size
