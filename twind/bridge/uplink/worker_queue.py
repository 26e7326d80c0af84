"""Lanes: each does one thing after the other in its own thread, so that what is slow holds up nobody else.

A lane is bounded: who comes when it is full is told so at once, and counted.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable

PACE = 0.01  # s: who asks flat out costs the robot no more
LONG = 64

Job = Callable[[], None]


class WorkerQueue:
    """Jobs must not raise. `tend` is called after each, and each `period` s at least; `last` at its end."""

    def __init__(
        self,
        name: str,
        *,
        length: int = LONG,
        pace: float = PACE,
        tend: Job | None = None,
        period: float | None = None,
        last: Job | None = None,
    ) -> None:
        """`length`: jobs that may wait. `pace`: s between two at least."""
        self._jobs: queue.Queue[Job | None] = queue.Queue(length)
        self._pace = pace
        self._tend = tend
        self._period = period
        self._last = last
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.name = name
        self.done = 0
        self.full = 0

    def start(self) -> None:
        """Begin with what was put."""
        self._thread.start()

    def put(self, job: Job) -> bool:
        """To be done in its turn; False: too much waits. Returns at once, from any thread."""
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            self.full += 1
            return False
        return True

    def stop(self, patience: float = 1.0) -> None:
        """Begin no more. Returns when that is so, or after `patience` s."""
        self._stop.set()
        with contextlib.suppress(queue.Full):  # then it looks anyway
            self._jobs.put_nowait(None)
        if self._thread.ident is not None:
            self._thread.join(patience)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                job = self._jobs.get(timeout=self._period)
            except queue.Empty:
                job = None
            if job is not None and not self._stop.is_set():
                job()
                self.done += 1
            if self._tend is not None:
                self._tend()
            if job is not None:
                self._stop.wait(self._pace)
        if self._last is not None:
            self._last()
