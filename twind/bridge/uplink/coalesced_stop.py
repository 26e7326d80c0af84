"""Coalesced stops: one call of the daemon answers all waiting requests for a stop."""

from __future__ import annotations

import threading
from collections import deque

from twind.bridge.uplink.query_server import RemoteQuery, Serve
from twind.bridge.uplink.worker_queue import PACE

WAITING = 1024  # waiting requests; of more, the oldest get no answer, but the stop is made


class CoalescedStop:
    """Coalesced stop. No request is refused for load: one call of the daemon serves all that wait.

    A request during a call waits for the next one, since the robot may have been freed in between.
    """

    def __init__(self, name: str, serve: Serve) -> None:
        """Make the stop; `serve`: one call, with the parameters of the longest waiting request."""
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
        """Start the thread that serves waiting requests."""
        self._thread.start()

    def put(self, question: RemoteQuery) -> bool:
        """Queue a request for the next call; return True. Returns at once, from any thread."""
        with self._lock:
            self._waiting.append(question)
            oldest = self._waiting.popleft() if len(self._waiting) > WAITING else None
            self.full += oldest is not None
        self._some.set()
        if oldest is not None:
            oldest.forget()
        return True

    def stop(self, patience: float = 1.0) -> None:
        """Make no more calls. Returns when the last one has ended, or after `patience` s."""
        self._stop.set()
        self._some.set()
        if self._thread.ident is not None:
            self._thread.join(patience)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._some.wait()
            self._some.clear()  # before reading: a request that comes after it must start another call
            with self._lock:
                waiting = list(self._waiting)
                self._waiting.clear()
            if waiting and not self._stop.is_set():
                outcome = waiting[0].outcome(self._serve)
                for each in waiting:
                    each.reply(outcome)
                self.done += len(waiting)
                self._stop.wait(PACE)
