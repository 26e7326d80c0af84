"""Messages of a daemon, for as long as anybody wants them: it may restart, and the next one be another robot.

A client of `observe.sock`, on a connection of its own.
"""

import contextlib
import threading
from collections.abc import Iterator

from twind.client import CallError, Client, ClientError, NoDaemon
from twind.observe.viewing.news import Described, Lost, News

RATE = 30.0  # Hz of states: pictures a second
SILENT = 5.0  # s without a word after which a daemon counts as gone
AGAIN = 0.5  # s between two tries
TOPICS = ["state", "status", "latency", "events", "verdicts"]
CHANGED = "RELOADED"  # the event after which the robot may be described otherwise


def observer(place: str | None, timeout: float) -> Client:
    """A connection that reads: `observe.sock`, else `control.sock`. Raises NoDaemon."""
    client = Client(place, name="observe", timeout=timeout)
    try:
        client.connect()
    except NoDaemon:
        client = Client(place, timeout=timeout)
        client.connect()
    return client


def messages(place: str | None, ended: threading.Event) -> Iterator[News]:
    """Without end, until `ended`. The first of a daemon says which robot it has."""
    while not ended.is_set():
        try:
            with contextlib.closing(observer(place, SILENT)) as client:
                yield from _of_one_daemon(place, client, ended)
        except CallError as error:  # it answers, and will answer no better at once
            yield Lost(f"the daemon is not there, tried again: {error}")
            ended.wait(4.0 * AGAIN)
        except ClientError as error:
            yield Lost(f"the daemon is not there, tried again: {error}")
            ended.wait(AGAIN)
        except Exception as error:  # noqa: BLE001  a thread that ends here leaves a picture that looks live
            yield Lost(f"what the daemon says cannot be understood: {type(error).__name__}: {error}")
            ended.wait(4.0 * AGAIN)


def _of_one_daemon(place: str | None, client: Client, ended: threading.Event) -> Iterator[News]:
    yield Described(client.call("GetRobot"))
    for message in client.stream("Monitor", topics=TOPICS, rate=RATE):
        if ended.is_set():
            return
        yield message
        if message["topic"] == "events" and message["event"]["code"] == CHANGED:
            with contextlib.closing(observer(place, SILENT)) as other:
                yield Described(other.call("GetRobot"))
