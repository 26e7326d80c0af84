"""Worker queues: each runs its jobs in order in a separate thread, so that a slow job delays no other queue.

A queue is bounded: a job for a full one is refused at once, and counted.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable

PACE = 0.01  # s, shortest time between jobs: bounds the load of a client without pauses
LONG = 64  # jobs that may wait: a client gives up on a later answer, and the memory stays bounded

Job = Callable[[], None]


class WorkerQueue:
    """Queue of jobs, which must not raise. `last` is called at the end.

    `tend` is called after each job and at least each `period` s.
    """

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
        """Make the queue; `length`: jobs that may wait. `pace`: shortest time between two, s."""
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
        """Start to run the queued jobs."""
        self._thread.start()

    def put(self, job: Job) -> bool:
        """Queue a job; return False if it is full. Returns at once, from any thread."""
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            self.full += 1
            return False
        return True

    def stop(self, patience: float = 1.0) -> None:
        """Start no more jobs. Returns when the last one has ended, or after `patience` s."""
        self._stop.set()
        with contextlib.suppress(queue.Full):  # a full queue wakes the worker anyway
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
