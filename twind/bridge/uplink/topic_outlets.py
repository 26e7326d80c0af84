"""Outlets of the daemon's topics on the network: only with subscribers, at requested rates, byte for byte.

A relay is one connection to the daemon. Nothing waits for the network: a message that a link cannot accept is
dropped after a millisecond, which receivers see by `sequence`. Messages that the relay cannot accept are
dropped and counted by the daemon: `dropped`.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

from twind.bridge.uplink.query_server import JSON
from twind.bridge.zenoh.zenoh_keys import robot_key
from twind.client import Client, ClientError

SILENCE = 5.0  # s without a message after which the daemon counts as gone
AGAIN = 0.5  # s between two attempts: a daemon that restarts refuses connections meanwhile
_TOPIC = re.compile(rb'"topic":"([a-z]+)"')

TakeTopic = Callable[[str, bytes], None]


class TopicOutlet:
    """Outlet of one key. `changed` is called when the first subscriber comes or the last one goes."""

    def __init__(self, session: zenoh.Session, robot: str, *key: str, changed: Callable[[], None]) -> None:
        drop = zenoh.CongestionControl.DROP
        self._publisher = session.declare_publisher(
            robot_key(robot, *key),
            encoding=JSON,
            congestion_control=drop,
            priority=zenoh.Priority.DATA_LOW if key[0] == "state" else zenoh.Priority.DATA,
        )
        self._matching = self._publisher.declare_matching_listener(lambda status: changed())

    @property
    def has_subscribers(self) -> bool:
        """Return True if a subscriber exists."""
        status: Any = self._publisher.matching_status  # declared a bool; in 1.10 an object, always true
        return bool(getattr(status, "matching", status))

    def put(self, data: bytes) -> None:
        """Publish the message within milliseconds. Raises zenoh.ZError: the session is closed."""
        self._publisher.put(data)


class MonitorRelay:
    """One Monitor call of the daemon, while one of its outlets is wanted; `always`: without that too."""

    def __init__(
        self,
        connect: Callable[[], Client],
        topics: Sequence[str],
        rate: float | None,
        *,
        always: bool = False,
        began: Callable[[Client], None] = lambda client: None,
        take: TakeTopic = lambda topic, data: None,
        ended: Callable[[str], None] = lambda why: None,
    ) -> None:
        """Make the relay; `began` gets a connection to each daemon before its first message.

        It may raise ClientError. `take` receives each message. `ended` gets the reason of an end.
        """
        self._connect = connect
        self._topics = list(topics)
        self._rate = rate
        self._always = always
        self._began = began
        self._on_message = take
        self._ended = ended
        self._wake = threading.Event()
        self._stop = threading.Event()
        self.outlets: dict[str, TopicOutlet] = {}
        self._thread = threading.Thread(target=self._run, name=f"relay {topics[0]} {rate}", daemon=True)

    def lead(self, session: zenoh.Session, robot: str, topic: str, *key: str) -> None:
        """Publish `topic` at `twind/ROBOT/KEY`."""
        self.outlets[topic] = TopicOutlet(session, robot, *key, changed=self._wake.set)

    def start(self) -> None:
        """Start the thread."""
        self._wake.set()
        self._thread.start()

    def stop(self) -> None:
        """End the publication. Returns at once; `join` waits."""
        self._stop.set()
        self._wake.set()

    def join(self, patience: float) -> None:
        """Wait at most `patience` s for the thread, which ends with the next message."""
        if self._thread.ident is not None:
            self._thread.join(patience)

    @property
    def has_subscribers(self) -> bool:
        """Return True if a subscriber exists."""
        return self._always or any(outlet.has_subscribers for outlet in self.outlets.values())

    def _run(self) -> None:
        while not self._stop.is_set():
            self._wake.wait()
            self._wake.clear()  # before the check: a later subscriber must wake the thread again
            while self.has_subscribers and not self._stop.is_set():
                self._ended(self._followed())
                if self.has_subscribers:
                    self._stop.wait(AGAIN)

    def _followed(self) -> str:
        """Follow one daemon to its end, or until the last subscriber goes; return the reason."""
        try:
            with self._connect() as client:
                client.timeout = SILENCE
                self._began(client)
                for burst in client.bursts("Monitor", topics=self._topics, rate=self._rate):
                    for data in burst:
                        self._take(data)
                    if self._stop.is_set() or not self.has_subscribers:
                        return ""
        except ClientError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001  a thread that dies in silence would look like a daemon without news
            return "" if self._stop.is_set() else f"{type(error).__name__}: {error}"
        return "the daemon ended the stream"

    def _take(self, data: bytes) -> None:
        found = _TOPIC.search(data, 0, 200)
        topic = "" if found is None else found[1].decode()
        self._on_message(topic, data)
        outlet: Any = self.outlets.get(topic)
        if outlet is not None and outlet.has_subscribers:
            outlet.put(data)
