"""The thread that takes the monitor's news: it goes on whatever a daemon says."""

import queue
import time
from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.picture_messages import NAMES, event, joints, robot, status
from tests.support.processes import until
from twind.client import ClientError, Disconnected
from twind.ctl.dashboard.dashboard_state import DisplayThresholds
from twind.ctl.dashboard.live_dashboard import MonitorFeed, show


def message(topic: str, key: str, what: Any) -> dict[str, Any]:
    return {"topic": topic, "dropped": 0, key: what}


STATUS = message("status", "status", status())
STATE = message("state", "joints", joints())
RELOADED = message("events", "event", event("RELOADED", "limits"))


class Daemon:
    """Each connection but those for a question has the next of `streams`; a stream ends by hanging up."""

    def __init__(self, *streams: list[Any]) -> None:
        self.robot = robot()
        self.streams = list(streams)
        self.told: queue.Queue[Any] = queue.Queue()  # more, after the last stream's own

    def __enter__(self) -> "Daemon":
        return self

    def __exit__(self, *_: object) -> None: ...

    def close(self) -> None: ...

    def call(self, method: str) -> Any:
        assert method == "GetRobot"
        return {"robot": self.robot}

    def stream(self, method: str, **_asked: Any) -> Iterator[Any]:
        yield from self.streams.pop(0)
        while not self.streams:
            yield self.told.get()
        raise Disconnected("hung up")


def bounds(feed: MonitorFeed) -> DisplayThresholds:
    return feed.watched.view(time.monotonic()).bounds[NAMES[0]]


def test_after_a_message_that_is_none_the_next_connection_is_taken() -> None:
    daemon = Daemon([STATUS, STATE, {"topic": "status", "status": {}}], [STATUS, STATE])
    feed = MonitorFeed(lambda: daemon, 5.0)  # type: ignore[arg-type,return-value]
    until(lambda: feed.watched.count >= 3, 5.0, "the second connection")
    assert feed.watched.view(time.monotonic()).gone == ""
    daemon.told.put({"no": "topic"})
    until(lambda: "KeyError: 'topic'" in feed.watched.view(time.monotonic()).gone, 5.0, "what is wrong")
    feed.close()


def test_a_daemon_that_never_makes_sense_ends_it_with_the_reason() -> None:
    with pytest.raises(ClientError, match="unreadable: KeyError"):
        show(lambda: Daemon([{"topic": "status", "dropped": 0}]), 5.0, 1)  # type: ignore[arg-type,return-value]


def test_after_a_reload_the_bounds_are_the_new_ones() -> None:
    daemon = Daemon([STATUS, STATE])
    feed = MonitorFeed(lambda: daemon, 5.0)  # type: ignore[arg-type,return-value]
    until(lambda: feed.watched.is_complete, 5.0, "a picture")
    assert bounds(feed).upper == 3.0
    daemon.robot = {"joints": [{"name": NAMES[0], "lower": -1.0, "upper": 1.0}]}
    daemon.told.put(RELOADED)
    until(lambda: bounds(feed).upper == 1.0, 5.0, "the new bounds")
