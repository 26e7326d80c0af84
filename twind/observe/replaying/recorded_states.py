"""The states of a recording as `Monitor` would tell them, at the pace at which they were: for the viewer."""

from collections.abc import Iterator
from heapq import merge
from itertools import count

import numpy as np

from twind.observe.recording.recording_columns import RobotRecording
from twind_drivers.clock import Clock

FRAME = 0.02  # s between two states that are shown, at the pace of the viewer


def messages(recording: RobotRecording, clock: Clock, speed: float) -> Iterator[dict[str, object]]:
    """All messages in time order; one is given when its time has come. `speed`: 1 is as it was."""
    begun = clock.now()
    first: float | None = None
    for time, _, topic, what in merge(*_columns(recording, FRAME * speed), key=lambda each: each[:2]):
        first = time if first is None else first
        clock.sleep_until(begun + (time - first) / speed)
        yield {"topic": topic, "time": time, "sequence": 0, "dropped": 0} | what


def _columns(
    recording: RobotRecording, frame: float
) -> Iterator[Iterator[tuple[float, int, str, dict[str, object]]]]:
    number = count()
    yield ((each.time, next(number), "status", {"status": each.what}) for each in recording.statuses)
    yield ((each.time, next(number), "events", {"event": each.what}) for each in recording.events)
    yield ((each.time, next(number), "verdicts", {"verdict": each.what}) for each in recording.verdicts)
    yield ((time, next(number), "state", {"joints": rows}) for time, rows in _states(recording, frame))


def _states(recording: RobotRecording, frame: float) -> Iterator[tuple[float, list[dict[str, object]]]]:
    due = float("-inf")
    columns = {
        "position": recording.measured,
        "velocity": recording.velocity,
        "effort": recording.effort,
        "goal": recording.goal,
        "simulated": recording.simulated,
    }
    for place, time in enumerate(recording.time.tolist()):
        if time < due:
            continue
        due = time + frame
        told = {key: column[place].tolist() for key, column in columns.items()} | _external(recording, time)
        yield (
            time,
            [
                {"name": name, "age_ms": 0.0, "heard": told["position"][joint] == told["position"][joint]}
                | {key: _null_if_nan(values[joint]) for key, values in told.items()}
                for joint, name in enumerate(recording.joints)
            ],
        )


def _external(recording: RobotRecording, time: float) -> dict[str, list[float]]:
    """Return the last torque from outside that was known at `time`, s; empty: none."""
    known = recording.external
    if known is None or time < known.time[0]:
        return {}
    place = int(np.searchsorted(known.time, time, "right")) - 1
    columns = {
        "external_nm": known.torque,
        "external_sd_nm": known.deviation,
        "contact": known.contact,
    }
    return {key: column[place].tolist() for key, column in columns.items()}


def _null_if_nan(value: float) -> float | None:
    return value if value == value else None
