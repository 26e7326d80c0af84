"""Queue of requests: a thread and a bounded queue, so that a slow request delays no other kind."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Generic, TypeVar

PACE = 0.01  # s, shortest time between two calls: bounds the load of a client without pauses
LONG = 64  # requests that may wait: a client gives up on a later answer, and the memory stays bounded

T = TypeVar("T")


class RequestQueue(Generic[T]):
    """Queue from `start` to `stop`. `answered`, `refused`: requests served, and those without room."""

    def __init__(
        self,
        name: str,
        serve: Callable[[Sequence[T]], None],
        tell: Callable[[str], None],
        *,
        length: int = LONG,
        pace: float = PACE,
        newest: bool = False,
        choose: Callable[[Sequence[T]], Sequence[T]] = lambda waiting: waiting[:1],
        tend: Callable[[], None] | None = None,
        period: float | None = None,
        last: Callable[[], None] | None = None,
    ) -> None:
        """Make the queue. `serve` gets what `choose` returns of the requests that wait: usually the first.

        `newest`: a full queue drops its oldest request, instead of refusing the new one. `tell` gets a line
        if `serve` or `tend` raises; the next request is served all the same. `tend` is called after each
        request and at least each `period` s, `last` at the end; all in the queue's thread.
        """
        self._serve = serve
        self._tell = tell
        self._length = length
        self._pace = pace
        self._newest = newest
        self._choose = choose
        self._tend = tend
        self._period = period
        self._last = last
        self._waiting: list[T] = []
        self._changed = threading.Condition()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.name = name
        self.answered = 0
        self.refused = 0

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def put(self, request: T) -> Sequence[T] | None:
        """Queue a request, and return those that were dropped for it; None: there is no room.

        Returns at once, from any thread.
        """
        with self._changed:
            gone: list[T] = []
            if len(self._waiting) >= self._length:
                self.refused += 1
                if not self._newest:
                    return None
                gone.append(self._waiting.pop(0))
            self._waiting.append(request)
            self._changed.notify()
            return gone

    def remove(self, voids: Callable[[T], bool]) -> Sequence[T]:
        """Drop the waiting requests that are void, and return them. Returns at once, from any thread."""
        with self._changed:
            return self._taken([each for each in self._waiting if voids(each)])

    def stop(self, patience: float = 1.0) -> None:
        """Serve no more. Returns when the last call has ended, or after `patience` s."""
        self._ended.set()
        with self._changed:
            self._changed.notify()
        if self._thread.ident is not None:
            self._thread.join(patience)

    def _run(self) -> None:
        while not self._ended.is_set():
            requests = self._next()
            if requests:
                self._guard(lambda: self._serve(requests))  # noqa: B023  called at once
                self.answered += len(requests)
            if self._tend is not None:
                self._guard(self._tend)
            if requests:
                self._ended.wait(self._pace)
        if self._last is not None:
            self._guard(self._last)

    def _next(self) -> Sequence[T]:
        """Return the next requests; empty: none came within the period, or the queue ends."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._ended.is_set(), self._period)
            if self._ended.is_set() or not self._waiting:
                return []
            return self._taken(self._choose(self._waiting))

    def _taken(self, requests: Sequence[T]) -> Sequence[T]:
        """Take these out of the queue, and return them. The caller holds the lock."""
        gone = {id(each) for each in requests}
        self._waiting = [each for each in self._waiting if id(each) not in gone]
        return requests

    def _guard(self, call: Callable[[], None]) -> None:
        try:
            call()
        except Exception as error:  # noqa: BLE001  the next request may be a stop
            with suppress(Exception):  # the log too
                self._tell(f"{self.name}: {type(error).__name__}: {error}")
