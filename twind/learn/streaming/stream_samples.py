"""Messages of `Monitor` as samples, and samples as the body of one POST. Pure: clocks are handed in."""

import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np

from twind.client.clock_pair import ClockPair
from twind.client.errors import ClientError, as_error

FORMAT = "twind-stream/1"
ROWS = ("position", "velocity", "effort", "commanded", "age_ms")  # of each sample, in the order of its joints
DIGITS = 6  # behind the point, of rad, rad/s, N·m: a thousandth of an encoder's step, in half the bytes
JSON = "application/json"
NDJSON = "application/x-ndjson"
_encode = msgspec.json.Encoder().encode  # writes NaN as null


class _StreamedJoint(msgspec.Struct, gc=False):
    """Fields that are read of `Joint`.

    The others are skipped unread, which costs a seventh of the time to read them.
    """

    name: str
    position: float | None
    velocity: float | None
    effort: float | None
    goal: float | None
    age_ms: float | None


class _StreamedState(msgspec.Struct):
    time: float
    sequence: int
    joints: list[_StreamedJoint]
    dropped: int = 0
    imu: dict[str, object] | None = None
    mode: str | None = None


class _StreamedMessage(msgspec.Struct):
    parameters: _StreamedState


_message = msgspec.json.Decoder(_StreamedMessage)


class StreamSample(NamedTuple):
    """One reading. `dropped`: messages that the daemon had to leave out before it."""

    time: float  # s, monotonic clock of the robot's machine
    tick: int  # of the loop
    names: list[str]
    rows: list[list[float | None]]  # by ROWS: rad, rad/s, N·m, rad, ms
    imu: dict[str, object] | None  # `Imu` of the interface
    dropped: int = 0
    mode: str | None = None  # of this reading; None: an older daemon does not say


@dataclass(frozen=True, slots=True)
class StreamedRobot:
    """Robot that the samples belong to, as the daemon reports it."""

    name: str
    individual: str
    version: str
    mode: str


@dataclass(frozen=True, slots=True)
class SampleBatch:
    """Samples of one robot with the same joints, in order. `lost`: samples before it, by who lost them."""

    robot: StreamedRobot
    clocks: ClockPair
    samples: Sequence[StreamSample]
    lost: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class PostMessage:
    """Content of one POST: a body, the headers that describe it, and the number of its samples."""

    body: bytes
    headers: Mapping[str, str]
    samples: int = 0


def sample(data: bytes) -> StreamSample:
    """One message of topic `state`. Raises ClientError for an error, or what is no such message."""
    try:
        state = _message.decode(data).parameters
    except (msgspec.DecodeError, UnicodeDecodeError):
        raise _decode_error(data) from None
    joints = state.joints
    rows = [
        [joint.position for joint in joints],
        [joint.velocity for joint in joints],
        [joint.effort for joint in joints],
        [joint.goal for joint in joints],
        [joint.age_ms for joint in joints],
    ]
    return StreamSample(
        state.time,
        state.sequence,
        [joint.name for joint in joints],
        rows,
        state.imu,
        state.dropped,
        state.mode,
    )


def _decode_error(data: bytes) -> ClientError:
    try:
        found = json.loads(data)
        return as_error(str(found["error"]), found.get("parameters") or {})
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError):
        return ClientError(f"a message of the daemon cannot be decoded: {data[:80]!r}")


def message(batch: SampleBatch, *, ndjson: bool = False, zipped: bool = False) -> PostMessage:
    """The batch as it is sent: one object, or lines of which the first is its head. Numbers have 6 digits."""
    head = {
        "format": FORMAT,
        "robot": batch.robot.name,
        "individual": batch.robot.individual,
        "version": batch.robot.version,
        "mode": batch.robot.mode,
        "joints": batch.samples[0].names,
        "clock": {"monotonic": batch.clocks.monotonic, "wall_ns": batch.clocks.wall_ns},
        "lost": batch.lost,
    }
    rows = _rounded(batch.samples)
    if ndjson:
        body = b"\n".join(map(_encode, [head, *rows])) + b"\n"
    else:
        body = _encode({**head, "samples": rows})
    headers = {"Content-Type": NDJSON if ndjson else JSON}
    if zipped:
        body = gzip.compress(body, 1, mtime=0)
        headers["Content-Encoding"] = "gzip"
    return PostMessage(body, headers, len(batch.samples))


def _rounded(samples: Sequence[StreamSample]) -> list[dict[str, object]]:
    """All numbers of a batch at once: one sample after the other would cost twice as much."""
    rounded = np.array([each.rows for each in samples], dtype=float).round(DIGITS)
    table = (rounded + 0.0).tolist()  # no -0.0
    return [
        {"time": each.time, "tick": each.tick, **dict(zip(ROWS, rows, strict=True)), "imu": each.imu}
        for each, rows in zip(samples, table, strict=True)
    ]


def picture(jpeg: bytes, camera: str, clocks: ClockPair) -> PostMessage:
    """One image. Its headers say when it was taken, and by what."""
    headers = {
        "Content-Type": "image/jpeg",
        "Twind-Camera": camera,
        "Twind-Monotonic": f"{clocks.monotonic:.6f}",
        "Twind-Wall-Ns": str(clocks.wall_ns),
    }
    return PostMessage(jpeg, headers)
