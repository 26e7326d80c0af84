"""Readings of a daemon on their way into batches."""

import argparse
import threading
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from twind.client.clock_pair import clocks
from twind.learn.streaming import reading_subscriber
from twind.learn.streaming.reading_subscriber import ReadingSubscriber
from twind.learn.streaming.sample_batcher import SampleBatcher
from twind.learn.streaming.stream_samples import SampleBatch

JOINT = {"name": "l_knee", "position": 0.5, "velocity": 0.0, "effort": None, "goal": None, "age_ms": 1.0}


class ModeChangingDaemon:
    """A connection to a daemon in mode live that changes to sim between two readings of one burst."""

    timeout = 0.0

    def __init__(self) -> None:
        self.all_sent = threading.Event()

    def __enter__(self) -> "ModeChangingDaemon":
        return self

    def __exit__(self, *_: object) -> None:
        self.all_sent.set()

    def call(self, method: str) -> dict[str, Any]:
        status = {"robot": "h24", "version": "0.2.0", "mode": "live"}
        return {"GetStatus": {"status": status}, "GetParameters": {"parameters": {}}}[method]

    def bursts(self, _method: str, **_parameters: object) -> Iterator[list[bytes]]:
        if self.all_sent.is_set():
            return
        modes = ("live", "live", "sim", "sim", "live")
        states = (
            {"time": 0.01 * tick, "sequence": tick, "joints": [JOINT], "mode": mode}
            for tick, mode in enumerate(modes)
        )
        yield [msgspec.json.encode({"parameters": state}) for state in states]


def test_each_reading_has_the_mode_that_it_was_made_in(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = ModeChangingDaemon()
    monkeypatch.setattr(reading_subscriber, "observer", lambda _options: daemon)
    batcher = SampleBatcher(100, 100.0, time.monotonic, clocks)
    listening = ReadingSubscriber(argparse.Namespace(rate=100.0), batcher, time.monotonic, lambda _text: None)
    listening.start()
    assert daemon.all_sent.wait(10.0)
    listening.stop()
    batcher.end()
    batches = []
    while isinstance(one := batcher.take(0.0), SampleBatch):
        batches.append((one.robot.mode, [each.tick for each in one.samples]))
    assert batches == [("live", [0, 1]), ("sim", [2, 3]), ("live", [4])]
