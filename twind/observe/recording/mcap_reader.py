"""An .mcap file as columns: our own recordings, and as far as it goes any with JointState messages."""

import json
from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Attachment, Message
from numpy.typing import NDArray

from twind.command_line.verb import Rejected
from twind.observe.recording.foreign_content import refuse_foreign_content
from twind.observe.recording.joint_rows import JointRows
from twind.observe.recording.mcap_record_scanner import McapContent, McapRecordScanner
from twind.observe.recording.recording_columns import (
    ExternalColumns,
    Floats,
    ImuColumns,
    LatencyColumns,
    RecordedMessage,
    RobotRecording,
    SlowColumns,
    marked,
)
from twind.observe.recording.recording_topics import (
    ABOUT,
    CALIBRATION,
    COMMANDS,
    EVENTS,
    INERTIAL,
    JOINTS,
    LATENCY,
    MEASURED,
    MJCF,
    NOTES,
    ROBOT,
    SIMULATED,
    STATUS,
    VERDICTS,
)
from twind.ros import JOINT_STATE, STRING, decode
from twind.ros.cdr import HEAD
from twind.ros.imu_message import imu_numbers

SECOND = 1e9  # ns
SAID = frozenset({STATUS, EVENTS, VERDICTS, LATENCY, JOINTS, NOTES})
FIGURES = ("now_ms", "mean_ms", "std_ms", "min_ms", "max_ms", "p50_ms", "p99_ms", "violations")


class TopicMessage(NamedTuple):
    """A message of one topic."""

    time: int  # ns
    data: bytes


def read(path: Path) -> RobotRecording:
    """The recording in an .mcap file. Raises Rejected."""
    file = McapRecordScanner(path)
    taken = _McapContents(file)
    with refuse_foreign_content(path):
        try:
            for each in file.contents():
                taken.take(each)
        except OSError as error:
            raise Rejected(f"{path}: {error}") from None
    if taken.start is None:
        raise Rejected(f"{path}: no message is in it" + (f": {file.cut}" if file.cut else ""))
    with refuse_foreign_content(path):
        return _recording(path, taken, taken.start)


class _ImuRows:
    """Readings of an IMU as numbers: an hour of them fits."""

    def __init__(self) -> None:
        self.times: list[int] = []  # ns
        self.numbers = array("d")  # 10 of each

    def add(self, time: int, data: bytes) -> None:
        """The next message. Raises struct.error."""
        self.numbers.extend(imu_numbers(data))
        self.times.append(time)


class _McapContents:
    """Used contents of a file: JointStates and IMU as numbers, other used messages as bytes, attachments.

    Messages of other topics are skipped.
    """

    def __init__(self, file: McapRecordScanner) -> None:
        self.file = file
        self.states: dict[str, JointRows] = {}
        self.said: dict[str, list[TopicMessage]] = {}
        self.felt = _ImuRows()
        self.files: dict[str, bytes] = {}
        self.meta: dict[str, str] = {}
        self.start: int | None = None  # ns, of the first message

    def take(self, each: McapContent) -> None:
        """Store one message, attachment or metadata record. Raises as foreign content does."""
        if isinstance(each, Message):
            topic = self.file.channels[each.channel_id].topic
            self.start = each.log_time if self.start is None else min(self.start, each.log_time)
            if topic == INERTIAL:
                self.felt.add(each.log_time, each.data)
            elif topic in SAID:
                self.said.setdefault(topic, []).append(TopicMessage(each.log_time, each.data))
            elif topic in self.states or self._is_state(each.channel_id):
                self.states.setdefault(topic, JointRows()).add(each.log_time, each.data)
        elif isinstance(each, Attachment):
            self.files[each.name] = each.data
        elif each.name == ABOUT:
            self.meta |= each.metadata

    def _is_state(self, number: int) -> bool:
        channel = self.file.channels[number]
        schema = self.file.schemas.get(channel.schema_id)
        names = (JOINT_STATE, JOINT_STATE.replace("/msg/", "/"))
        return schema is not None and schema.name in names and channel.message_encoding == "cdr"


def _recording(path: Path, taken: _McapContents, start: int) -> RobotRecording:
    chosen = _chosen(list(taken.states))
    rows = {role: taken.states[topic].settled() for role, topic in chosen.items()}
    joints = tuple(dict.fromkeys(name for each in rows.values() for name in each.names))
    times = np.unique(np.concatenate([np.zeros(0, np.int64), *(each.times for each in rows.values())]))

    def column(role: str, place: int) -> Floats:
        table = np.full((times.size, len(joints)), np.nan)
        if role in rows:
            rows[role].lay(table, times, joints, place)
        return table

    def messages_of_topic(topic: str) -> tuple[RecordedMessage, ...]:
        return tuple(
            RecordedMessage((kept.time - start) / SECOND, _json(kept.data))
            for kept in taken.said.get(topic, ())
        )

    events = messages_of_topic(EVENTS)
    notes = messages_of_topic(NOTES)
    mjcf = taken.files.get(MJCF)
    return RobotRecording(
        path=path,
        start_ns=start,
        joints=joints,
        time=(times - start) / SECOND,
        measured=column("measured", 0),
        velocity=column("measured", 1),
        effort=column("measured", 2),
        goal=column("goal", 0),
        simulated=column("simulated", 0),
        imu=_inertial(taken.felt, times),
        external=external(messages_of_topic(JOINTS), joints),
        events=events,
        verdicts=messages_of_topic(VERDICTS),
        statuses=messages_of_topic(STATUS),
        notes=notes,
        slow=slow(messages_of_topic(JOINTS), joints),
        latency=hops([(each.time, each.what.get("hops") or ()) for each in messages_of_topic(LATENCY)]),
        episodes=marked(sorted((*events, *notes), key=lambda each: each.time)),
        meta=taken.meta,
        robot=_attached(taken.files, ROBOT),
        calibration=_attached(taken.files, CALIBRATION),
        mjcf=None if mjcf is None else mjcf.decode(),
        damage=_damage(taken.file),
    )


def _inertial(message: _ImuRows, times: NDArray[np.int64]) -> ImuColumns | None:
    """Return the IMU columns of the rows at `times` (ns); None: no IMU message was recorded."""
    if not message.times or not times.size:
        return None
    at = np.array(message.times, np.int64)
    rows = np.searchsorted(times, at).clip(0, times.size - 1)
    known = times[rows] == at
    numbers = np.full((times.size, 10), np.nan)
    numbers[rows[known]] = np.array(message.numbers).reshape(-1, 10)[known]
    return ImuColumns(numbers[:, :3], numbers[:, 3:6], numbers[:, 6:])


def _chosen(states: Sequence[str]) -> dict[str, str]:
    """Topics by role; in a foreign file the first JointState topic is the measured one."""
    roles = {"measured": MEASURED, "goal": COMMANDS, "simulated": SIMULATED}
    found = {role: topic for role, topic in roles.items() if topic in states}
    if not found and states:
        usual = "/joint_states"
        found["measured"] = usual if usual in states else states[0]
    return found


def _damage(file: McapRecordScanner) -> str:
    parts = [file.cut] if file.cut else []
    if not (file.cut or file.indexed):
        parts.append("it has no index: a full disk may have ended it, and what came then is not in it")
    if file.damaged:
        first = f"the first at byte {file.damage}"
        parts.append(
            f"{file.damaged} chunks do not match their checksums, or are too large: left out, {first}"
        )
    return "; ".join(parts)


# ------------------------------------------------------------------------------------------ messages


def _json(data: bytes) -> Mapping[str, object]:
    """Parse a JSON object, either bare or in a message of std_msgs/String; empty if it is none."""
    try:
        found = json.loads(decode(STRING, data)["data"] if data.startswith(HEAD) else data)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _attached(files: Mapping[str, bytes], name: str) -> Mapping[str, object] | None:
    return _json(files[name]) if name in files else None


def slow(message: Sequence[RecordedMessage], joints: Sequence[str]) -> SlowColumns | None:
    """The slow columns of messages {"joints": [Joint]}; None: there are none."""
    if not message:
        return None
    temperature, voltage, torque, age = _fields(
        message, joints, ("temperature", "voltage", "torque", "age_ms")
    )
    return SlowColumns(_times(message), temperature, voltage, torque, age / 1e3)


def external(message: Sequence[RecordedMessage], joints: Sequence[str]) -> ExternalColumns | None:
    """The torque from outside in messages {"joints": [Joint]}; None: there is none."""
    torque, deviation, contact = _fields(message, joints, ("external_nm", "external_sd_nm", "contact"))
    if not np.isfinite(torque).any():
        return None
    return ExternalColumns(_times(message), torque, deviation, contact == 1.0)


def _times(message: Sequence[RecordedMessage]) -> Floats:
    return np.array([each.time for each in message])


def _fields(
    message: Sequence[RecordedMessage], joints: Sequence[str], keys: Sequence[str]
) -> tuple[Floats, ...]:
    """Fields of each joint, (m, n) each; NaN where one is unknown."""
    rows = []
    for each in message:
        table = {joint.get("name"): joint for joint in each.what.get("joints") or ()}
        rows.append([[table.get(name, {}).get(key) for name in joints] for key in keys])
    columns = np.array(rows, np.float64).reshape(len(rows), len(keys), len(joints))  # None becomes NaN
    return tuple(columns[:, place] for place in range(len(keys)))


def hops(message: Sequence[tuple[float, Sequence[Mapping[str, object]]]]) -> dict[str, LatencyColumns]:
    """Build the latency columns of each hop from pairs of a time (s) and the latencies reported at it."""
    found: dict[str, list[tuple[float, Mapping[str, object]]]] = {}
    for time, latencies in message:
        for each in latencies:
            found.setdefault(str(each.get("hop")), []).append((time, each))
    return {name: _hop(rows) for name, rows in found.items()}


def _hop(rows: Sequence[tuple[float, Mapping[str, Any]]]) -> LatencyColumns:
    columns = {key: np.array([row.get(key) for _, row in rows], np.float64) for key in FIGURES}
    histograms = [row["histogram"] for _, row in rows if row.get("histogram")]
    return LatencyColumns(np.array([time for time, _ in rows]), columns, histograms[-1] if histograms else ())
