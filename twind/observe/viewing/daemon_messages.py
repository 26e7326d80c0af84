"""Messages of a daemon and its successors, which may have another robot. On a connection of its own."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import closing
from typing import Any

from twind.client import CallError, ClientError
from twind.observe.viewing.robot_connections import RobotConnections, observer
from twind.observe.viewing.viewer_state import DaemonLost, News, RobotAnnounced
from twind.robot.event_codes import EventCode

RATE = 30.0  # Hz of states: pictures a second
SILENT = 5.0  # s without a word after which a daemon counts as gone
AGAIN = 0.5  # s between two tries
TOPICS = ("state", "status", "latency", "events", "verdicts")


def messages(
    ways: RobotConnections, ended: threading.Event, *, topics: Sequence[str] = TOPICS, rate: float = RATE
) -> Iterator[News]:
    """Messages until `ended`. The first of a daemon describes its robot; `topics` contain `events`."""
    while not ended.is_set():
        try:
            with closing(observer(ways, SILENT)) as client:
                yield RobotAnnounced(client.call("GetRobot"))
                yield from _of_one_daemon(
                    ways, client.stream("Monitor", topics=list(topics), rate=rate), ended
                )
        except CallError as error:  # it answers, and will answer no better at once
            yield DaemonLost(f"the daemon is not there, tried again: {error}")
            ended.wait(4.0 * AGAIN)
        except ClientError as error:
            yield DaemonLost(f"the daemon is not there, tried again: {error}")
            ended.wait(AGAIN)
        except Exception as error:  # noqa: BLE001  a thread that ends here leaves a picture that looks live
            yield DaemonLost(f"a message of the daemon is unreadable: {type(error).__name__}: {error}")
            ended.wait(4.0 * AGAIN)


def _of_one_daemon(ways: RobotConnections, stream: Iterator[Any], ended: threading.Event) -> Iterator[News]:
    for message in stream:
        if ended.is_set():
            return
        yield message
        if message["topic"] == "events" and message["event"]["code"] == EventCode.RELOADED:
            with closing(observer(ways, SILENT)) as other:
                yield RobotAnnounced(other.call("GetRobot"))
