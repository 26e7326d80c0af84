"""Messages of the daemon as samples, and as what is sent."""

import gzip
import json
from typing import Any

import msgspec
import pytest

from tests.support.spool_rig import ROBOT, some
from twind.client import CallError, ClientError
from twind.client.clock_pair import ClockPair
from twind.learn.streaming.stream_samples import (
    JSON,
    NDJSON,
    ROWS,
    SampleBatch,
    StreamSample,
    message,
    picture,
    sample,
)

CLOCKS = ClockPair(100.0, 1_800_000_000_000_000_000)
IMU = {
    "gyro": [0.0, 0.1, 0.2],
    "acceleration": [0.0, 0.0, 9.81],
    "quaternion": [1.0, 0.0, 0.0, 0.0],
    "age_ms": 3.0,
}


def joint(name: str, **fields: Any) -> dict[str, Any]:
    known = {"position": 0.5, "velocity": -0.25, "effort": 1.5, "goal": 0.75, "age_ms": 4.0}
    return {"name": name, "bus": "main", "id": 1, "simulated": 0.0, "faults": ["a"], **known, **fields}


def state_bytes(joints: list[dict[str, Any]], **fields: Any) -> bytes:
    state = {"dropped": 0, "topic": "state", "time": 12.5, "sequence": 7, "joints": joints, "skew_ms": 0.1}
    return msgspec.json.encode({"continues": True, "parameters": state | fields})


def test_a_message_is_a_sample_of_what_was_measured_and_commanded() -> None:
    found = sample(
        state_bytes([joint("l_knee"), joint("r_knee", position=None, goal=None)], dropped=2, imu=IMU)
    )
    assert (found.time, found.tick, found.names, found.dropped) == (12.5, 7, ["l_knee", "r_knee"], 2)
    rows = dict(zip(ROWS, found.rows, strict=True))
    assert rows["position"] == [0.5, None]
    assert rows["commanded"] == [0.75, None]
    assert (rows["velocity"], rows["effort"], rows["age_ms"]) == ([-0.25, -0.25], [1.5, 1.5], [4.0, 4.0])
    assert found.imu == IMU
    assert sample(state_bytes([joint("l_knee")])).imu is None


def test_an_error_of_the_daemon_is_the_error_that_it_is() -> None:
    data = b'{"error":"io.twind.Control.Busy","parameters":{"what":"all places are taken"}}'
    with pytest.raises(CallError, match="all places are taken"):
        sample(data)


@pytest.mark.parametrize(
    "data",
    [b"", b"{", b"[]", b'{"parameters":{}}', b'{"error":1}', b"\xff\xfe", b'{"error":"x","parameters":3}'],
)
def test_an_invalid_message_raises_a_client_error(data: bytes) -> None:
    with pytest.raises(ClientError):
        sample(data)


def batch(*samples: StreamSample) -> SampleBatch:
    return SampleBatch(ROBOT, CLOCKS, samples, {"daemon": 1, "here": 0})


def test_a_batch_is_one_object_whose_times_can_be_made_dates() -> None:
    made = message(batch(some(10), some(11, None, IMU)))
    body = json.loads(made.body)
    assert (made.headers, made.samples) == ({"Content-Type": JSON}, 2)
    assert (body["format"], body["robot"], body["individual"], body["mode"]) == (
        "twind-stream/1",
        "h24",
        "one",
        "live",
    )
    assert body["joints"] == ["l_knee", "r_knee"]
    assert body["clock"] == {"monotonic": 100.0, "wall_ns": 1_800_000_000_000_000_000}
    assert body["lost"] == {"daemon": 1, "here": 0}
    first, second = body["samples"]
    assert first == {"time": 0.1, "tick": 10, **{row: [0.123457, 0.0] for row in ROWS}, "imu": None}
    assert (second["position"], second["imu"]) == ([None, 0.0], IMU)
    assert b"-0.0" not in made.body


def test_the_ndjson_form_has_the_same_content_as_the_json_object() -> None:
    samples = some(10), some(11, None, IMU)
    body = json.loads(message(batch(*samples)).body)
    made = message(batch(*samples), ndjson=True)
    head, *lines = [json.loads(line) for line in made.body.splitlines()]
    assert made.headers == {"Content-Type": NDJSON}
    assert {**head, "samples": lines} == body


@pytest.mark.parametrize("ndjson", [False, True])
def test_a_compressed_message_is_labelled_and_has_the_same_content(ndjson: bool) -> None:
    plain = message(batch(some(10)), ndjson=ndjson)
    made = message(batch(some(10)), ndjson=ndjson, zipped=True)
    assert made.headers == {**plain.headers, "Content-Encoding": "gzip"}
    assert gzip.decompress(made.body) == plain.body
    assert made == message(batch(some(10)), ndjson=ndjson, zipped=True), "the same data are other bytes"


def test_an_image_message_carries_its_camera_and_times() -> None:
    made = picture(b"\xff\xd8", "render", CLOCKS)
    assert (made.body, made.samples) == (b"\xff\xd8", 0)
    assert made.headers["Content-Type"] == "image/jpeg"
    assert (made.headers["Twind-Camera"], made.headers["Twind-Wall-Ns"]) == ("render", str(CLOCKS.wall_ns))
    assert float(made.headers["Twind-Monotonic"]) == 100.0
