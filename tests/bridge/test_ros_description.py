"""The description of a robot on the graph is that of the daemon that is there, or none."""

import threading
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from twind.bridge.ros import ros_bridge
from twind.bridge.ros.robot_model_messages import RobotModelMessages
from twind.bridge.ros.ros_bridge import RosBridge
from twind.exceptions import OperationFailed


class StandInTransport:
    """Keeps what is published."""

    refuses = "reads only"
    node = "/twind"

    def __init__(self) -> None:
        self.published: list[tuple[str, bytes]] = []

    def publish(self, topic: Any, data: bytes) -> None:
        self.published.append((topic.name, data))


def made(transport: StandInTransport, told: list[str]) -> RosBridge:
    bridge = RosBridge(
        transport,  # type: ignore[arg-type]
        commands=False,
        describer="python",
        tell=told.append,
        stop=threading.Event(),
    )
    bridge._joined = True
    client = SimpleNamespace(call=lambda method: {"robot": {}, "mjcf": ""})
    bridge._observer = lambda: nullcontext(client)  # type: ignore[method-assign, assignment, return-value]
    return bridge


def test_after_a_failure_the_description_of_another_robot_is_gone_and_the_next_try_succeeds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ros_bridge, "DESCRIBE_AGAIN", 0.0)
    transport = StandInTransport()
    told: list[str] = []
    bridge = made(transport, told)
    answers: list[Any] = [
        RobotModelMessages("<robot name='A'/>", []),
        OperationFailed("timed out"),
        ValueError("no JSON"),
        RobotModelMessages("<robot name='B'/>", []),
    ]
    seen: list[object] = []

    def describe(interpreter: str, answer: object) -> RobotModelMessages:
        seen.append(bridge._messages.description)
        found = answers.pop(0)
        if isinstance(found, Exception):
            raise found
        return found

    monkeypatch.setattr(ros_bridge, "describe", describe)
    bridge._describe(bridge._news.lives)
    bridge._describe(bridge._news.lives)
    assert seen == [None, None, None, None]
    assert [text.split(";")[0].rpartition(": ")[2] for text in told] == ["timed out", "no JSON"]
    assert bridge._messages.description is not None
    assert b"name='B'" in bridge._messages.description.urdf
