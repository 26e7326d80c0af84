"""A flight recorder's file as columns: the last seconds before a fault."""

from pathlib import Path
from typing import Any

import numpy as np

from twind.command_line.verb import Rejected
from twind.exceptions import InvalidInput
from twind.flight import LoadedFlight, load
from twind.link import Tick
from twind.observe.recording.flight_monitor_messages import answers, news
from twind.observe.recording.foreign_content import refuse_foreign_content
from twind.observe.recording.mcap_reader import external, hops, slow
from twind.observe.recording.recording_columns import (
    Floats,
    ImuColumns,
    RecordedMessage,
    RobotRecording,
    marked,
)

SECOND = 1_000_000_000  # ns
NEWER = 1.0  # ms from one reading of an IMU to the next, at least
SLOW_PERIOD = 0.5  # s between rows of `RobotRecording.slow`


def read(path: Path) -> RobotRecording:
    """The recording in a flight file. Raises Rejected."""
    try:
        flight = load(path)
    except (InvalidInput, OSError) as error:
        raise Rejected(str(error)) from None
    entries = flight.contents.entries
    if not entries:
        raise Rejected(f"{path}: nothing was recorded yet")
    with refuse_foreign_content(path):
        ticks = [each for each in news(flight) if isinstance(each, Tick)]
        begin = ticks[0].time if ticks else entries[0].time
        topics: dict[str, list[RecordedMessage]] = {}
        for answer in answers(flight):
            topics.setdefault(answer["topic"], []).append(RecordedMessage(answer["time"] - begin, answer))
        return _recording(path, flight, ticks, begin, topics)


def wall_offset(flight: LoadedFlight) -> int:
    """Nanoseconds to add to monotonic times for the wall clock of the writer; 0: unknown."""
    wall = flight.meta.get("wall_ns")
    monotonic = flight.meta.get("monotonic")
    if not isinstance(wall, int) or not isinstance(monotonic, int | float):
        return 0
    return wall - round(monotonic * SECOND)


def _recording(
    path: Path,
    flight: LoadedFlight,
    ticks: list[Tick],
    begin: float,
    topics: dict[str, list[RecordedMessage]],
) -> RobotRecording:
    count = len(flight.briefing.joints)
    joints = tuple(joint.name for joint in flight.briefing.joints)

    def column(name: str) -> Floats:
        data = b"".join(getattr(tick, name) for tick in ticks)
        return np.frombuffer(data, "<f8").reshape(len(ticks), count)

    def messages_of_topic(topic: str, field: str) -> tuple[RecordedMessage, ...]:
        return tuple(RecordedMessage(each.time, each.what[field]) for each in topics.get(topic, ()))

    simulated = np.array([tick.mode == "sim" for tick in ticks], np.bool_)
    measured, velocity, effort = (column(name).copy() for name in ("position", "velocity", "effort"))
    for each in (measured, velocity, effort):
        each[simulated] = np.nan  # there is no robot: a tick shows the simulation in its place
    events = messages_of_topic("events", "event")
    return RobotRecording(
        path=path,
        start_ns=wall_offset(flight) + round(begin * SECOND),
        joints=joints,
        time=np.array([tick.time - begin for tick in ticks], np.float64),
        measured=measured,
        velocity=velocity,
        effort=effort,
        goal=column("goal"),
        simulated=column("simulated"),
        imu=_inertial(ticks),
        external=external(topics.get("state", ()), joints),
        events=events,
        verdicts=tuple(
            RecordedMessage(each.time, _verdict(each.what)) for each in topics.get("verdicts", ())
        ),
        statuses=messages_of_topic("status", "status"),
        slow=slow(_now_and_then(topics.get("state", [])), joints),
        latency=hops([(each.time, each.what["latency"] or ()) for each in topics.get("latency", ())]),
        episodes=marked(events),
        meta=_words(flight),
        robot=flight.briefing.description,
        calibration=flight.briefing.calibration,
        mjcf=flight.briefing.mjcf,
    )


def _inertial(ticks: list[Tick]) -> ImuColumns | None:
    """None: no tick has one."""
    if not any(tick.imu for tick in ticks):
        return None
    numbers = np.full((len(ticks), 10), np.nan)
    heard = -np.inf
    for row, tick in enumerate(ticks):
        if tick.imu and (at := tick.time - tick.imu_age) >= heard + NEWER / 1e3:
            numbers[row] = np.frombuffer(tick.imu)
            heard = at
    return ImuColumns(numbers[:, :3], numbers[:, 3:6], numbers[:, 6:])


def _verdict(answer: Any) -> dict[str, Any]:
    return {"id": answer["id"], **answer["verdict"]}


def _now_and_then(states: list[RecordedMessage]) -> list[RecordedMessage]:
    """Twice a second is enough for what is slow."""
    found: list[RecordedMessage] = []
    for each in states:
        if not found or each.time >= found[-1].time + SLOW_PERIOD:
            found.append(each)
    return found


def _words(flight: LoadedFlight) -> dict[str, str]:
    about = {"version": flight.briefing.version, "robot": flight.briefing.robot}
    return about | {key: str(value) for key, value in flight.meta.items() if value is not None}
