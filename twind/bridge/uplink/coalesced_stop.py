"""A stop that anybody asks for, as often as he likes: all who wait are answered by one call of the daemon."""

from __future__ import annotations

import threading
from collections import deque

from twind.bridge.uplink.query_server import RemoteQuery, Serve
from twind.bridge.uplink.worker_queue import PACE

WAITING = 1024  # who may wait: of more the oldest is let go, and asks again; the stop is made all the same


class CoalescedStop:
    """Nobody is ever told that too much is asked: one call does what all of them want.

    Who comes while a call is under way waits for the next, since the robot may have been freed in between.
    """

    def __init__(self, name: str, serve: Serve) -> None:
        """`serve`: one call, with the parameters of whoever waits longest."""
        self._serve = serve
        self._waiting = deque[RemoteQuery]()
        self._lock = threading.Lock()
        self._some = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.name = name
        self.done = 0
        self.full = 0

    def start(self) -> None:
        """Begin with who waits."""
        self._thread.start()

    def put(self, question: RemoteQuery) -> bool:
        """To be answered by the next call: True. Returns at once, from any thread."""
        with self._lock:
            self._waiting.append(question)
            oldest = self._waiting.popleft() if len(self._waiting) > WAITING else None
            self.full += oldest is not None
        self._some.set()
        if oldest is not None:
            oldest.forget()
        return True

    def stop(self, patience: float = 1.0) -> None:
        """Call no more. Returns when that is so, or after `patience` s."""
        self._stop.set()
        self._some.set()
        if self._thread.ident is not None:
            self._thread.join(patience)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._some.wait()
            self._some.clear()
            with self._lock:
                waiting = list(self._waiting)
                self._waiting.clear()
            if waiting and not self._stop.is_set():
                outcome = waiting[0].outcome(self._serve)
                for each in waiting:
                    each.reply(outcome)
                self.done += len(waiting)
                self._stop.wait(PACE)
