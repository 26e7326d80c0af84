"""Subscriber of the daemon: one stream of `Monitor`, over as many daemons as there are. Library, 3.10."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from twind.client import Client, ClientError
from twind.client.monitor_stream import RepeatedFaultFilter

SILENCE = 5.0  # s without a message after which the daemon counts as gone
FRESH = 0.5  # s after which a message counts as stale
AGAIN = 0.5  # s between two attempts to reach one
FASTEST = 1000.0  # Hz: the daemon gives at most its loop's rate


class RosSubscriber:
    """A thread, from `start` to the end of the process or `stop`."""

    def __init__(
        self,
        connect: Callable[[], Client],
        topics: Sequence[str],
        take: Callable[[Mapping[str, Any]], None],
        tell: Callable[[str], None],
        stop: threading.Event,
        *,
        rate: float | None = None,
    ) -> None:
        """Make the subscriber; `take` gets every answer; `tell` a line when the daemon goes and comes.

        `rate` None: the loop's.
        """
        self._connect = connect
        self._topics = list(topics)
        self._take = take
        self._tell = tell
        self._stop = stop
        self._rate = rate or FASTEST
        self._once = RepeatedFaultFilter()
        self._slow = 3.0 / self._rate  # s: a low rate needs a longer wait
        self._received = float("-inf")  # s, monotonic: of the last message
        self.error = ""  # why there is no daemon
        self.there = False  # a message was received
        self.lives = 0  # daemons that were found so far
        self.dropped = 0  # messages that the daemon had to drop because this reader was slow
        self._thread = threading.Thread(target=self._run, name=f"reads {topics[0]}", daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    @property
    def error_text(self) -> str:
        """Return why the last message is no longer valid: no daemon, or its loop stands still.

        "": it is valid.
        """
        silent = time.monotonic() - self._received
        if not self.there or silent <= max(FRESH, self._slow):
            return self.error
        return f"no message of the loop for {silent:.1f} s"

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._follow()
                self.error = "the daemon ended the stream"
            except ClientError as error:
                self.error = str(error)
            except Exception as error:  # noqa: BLE001  a thread that dies in silence would go on "bridging"
                self.error = f"a message of the daemon cannot be decoded: {type(error).__name__}: {error}"
            self.there = False
            if not self._stop.is_set() and self._once.is_transition(self.error, time.monotonic()):
                self._tell(f"{self.error}; waiting for the daemon")
            self._stop.wait(AGAIN)

    def _follow(self) -> None:
        """One daemon, to its end. Raises ClientError."""
        with self._connect() as client:
            client.timeout = max(SILENCE, self._slow)
            for answer in client.stream("Monitor", topics=self._topics, rate=self._rate):
                self.dropped += answer["dropped"]
                self._received = answer["time"]
                self._take(answer)
                if not self.there:
                    self.there = True
                    self.error = ""
                    self.lives += 1
                    if self._once.is_transition("", time.monotonic()):
                        self._tell("the daemon is there again")
                if self._stop.is_set():
                    return
