"""Clock protocol, the monotonic clock and the fake clock: the one module of the core that uses `time.*`.

`MonotonicClock` reads the kernel's clock. `FakeClock` advances only in a wait, so that a test runs an hour of
the loop in minutes. Both wait for bytes through one method, `wait`, so the loop has a single code path.
"""

import select
import time
from collections.abc import Sequence
from math import ceil
from typing import Protocol

ASK_MS = 1  # ms between checks of a source without descriptor, which cannot wake a poll


class WaitableSource(Protocol):
    """Source of bytes: a port with a descriptor, or an in-process bus that schedules their arrival."""

    def fileno(self) -> int:
        """Return the descriptor to poll, -1 for none (then `arrival` gives the time)."""

    def arrival(self) -> float:
        """Return the time (s) at which the next bytes can be read; `inf`: none pending. In-process only."""


class Clock(Protocol):
    """Monotonic time in seconds, and the two ways of letting it pass."""

    def now(self) -> float:
        """Monotonic time, s."""

    def suspended(self) -> float:
        """Time that the machine was suspended since it started, s. Monotonic time stands still meanwhile."""

    def sleep_until(self, deadline: float) -> None:
        """Return at `deadline` (s) or later; at once if it has passed."""

    def wait(self, sources: Sequence[WaitableSource], deadline: float) -> Sequence[int]:
        """Return when a source has bytes (or has failed), at `deadline` at the latest, +1 ms of rounding.

        Returns the indices of the ready sources; none at the deadline.
        """


class MonotonicClock:
    """Clock CLOCK_MONOTONIC. `time.sleep` is clock_nanosleep on an absolute deadline since CPython 3.11."""

    def __init__(self) -> None:
        # By descriptors: their poll, and the place of each.
        self.polls: dict[tuple[int, ...], tuple[select.poll, dict[int, int]]] = {}

    def now(self) -> float:
        """Monotonic time, s."""
        return time.monotonic()

    def suspended(self) -> float:
        """Time with suspension less time without; some µs off, since the two are read one after the other."""
        return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)

    def sleep_until(self, deadline: float) -> None:
        """Sleep until the absolute `deadline`."""
        remaining = deadline - time.monotonic()
        if remaining > 0.0:
            time.sleep(remaining)

    def wait(self, sources: Sequence[WaitableSource], deadline: float) -> Sequence[int]:
        """Poll all descriptors once. Errors and hang-ups end the wait too; the next read reports them.

        A source without descriptor cannot end a poll, so it is checked every millisecond.
        """
        key = tuple([source.fileno() for source in sources])
        if -1 in key:
            return self._poll_and_check(sources, deadline)
        found = self.polls.get(key)
        if found is None:
            if len(self.polls) > 64:  # descriptors of replugged ports: do not grow for ever
                self.polls.clear()
            found = self.polls[key] = select.poll(), {fd: place for place, fd in enumerate(key)}
            for fd in key:
                found[0].register(fd, select.POLLIN)
        poll, places = found
        return [places[fd] for fd, _ in poll.poll(max(0, ceil((deadline - time.monotonic()) * 1e3)))]

    def _poll_and_check(self, sources: Sequence[WaitableSource], deadline: float) -> Sequence[int]:
        poll = select.poll()
        places = {source.fileno(): place for place, source in enumerate(sources)}
        mute = [place for place, source in enumerate(sources) if source.fileno() < 0]
        for fd in places.keys() - {-1}:
            poll.register(fd, select.POLLIN)
        while True:
            now = time.monotonic()
            ready = [place for place in mute if sources[place].arrival() <= now]
            left = 0 if ready or now >= deadline else min(ASK_MS, ceil((deadline - now) * 1e3))
            ready += [places[fd] for fd, _ in poll.poll(left)]
            if ready or now >= deadline:
                return ready


class FakeClock:
    """Clock that advances only in a wait. Deterministic: the same run gives the same times."""

    def __init__(self, time: float = 0.0) -> None:
        self.time = time
        self.slept = 0.0  # s that a test lets the machine sleep

    def now(self) -> float:
        """Time set by the last wait, s."""
        return self.time

    def suspended(self) -> float:
        """Suspended time that the test has set, s."""
        return self.slept

    def sleep_until(self, deadline: float) -> None:
        """Jump to `deadline`, never back."""
        self.time = max(self.time, deadline)

    def wait(self, sources: Sequence[WaitableSource], deadline: float) -> Sequence[int]:
        """Jump to the next arrival or to `deadline`, whichever is first, never back.

        Returns the indices of the sources with bytes.
        """
        arrivals = [source.arrival() for source in sources]
        self.time = max(self.time, min(*arrivals, deadline)) if arrivals else max(self.time, deadline)
        return [place for place, arrival in enumerate(arrivals) if arrival <= self.time]
