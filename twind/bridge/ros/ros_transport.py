"""Interface of a ROS back end: it carries bytes, without their meaning. Standard library, 3.10."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import Any, Protocol

from twind.bridge.ros.ros_endpoints import RosService, RosTopic

MessageHandler = Callable[[RosTopic, bytes], None]  # CDR, header included; returns at once, from any thread
Reply = Callable[[bool, str], None]  # success, message; from any thread
# with a request's `data` (None: the type has none); returns at once, the reply comes within PATIENCE
RequestHandler = Callable[[RosService, "bool | None", Reply], None]

PATIENCE = 75.0  # s: a stop waits for one before it, at most


def answer_to(handle: RequestHandler, service: RosService, data: bool | None) -> tuple[bool, str]:
    """Wait for the reply to a request: success, and a message."""
    replied: Future[tuple[bool, str]] = Future()
    handle(service, data, lambda done, message: replied.set_result((done, message)))
    return replied.result(PATIENCE)


class RosTransport(Protocol):
    """One way into the ROS 2 graph. `publish` may be called by several threads."""

    refuses: str  # why no command arrives here, for the user; "": topics are read and services are served
    node: str  # full name of the node in the graph, `/twind`

    def open(
        self,
        topics: Sequence[RosTopic],
        services: Sequence[RosService],
        on_message: MessageHandler,
        asked: RequestHandler,
    ) -> None:
        """Join the graph with these endpoints; with `refuses`, only with those that are written.

        Raises OperationFailed.
        """

    def publish(self, topic: RosTopic, data: bytes) -> None:
        """Send CDR bytes with their header. Returns within milliseconds. Raises OperationFailed."""

    def show(self, topic: RosTopic, content: Mapping[str, Any]) -> None:
        """Take the content of a topic of JSON, for what only this back end makes of it."""

    def close(self) -> None:
        """Leave the graph. May be called twice."""
