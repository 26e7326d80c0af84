"""Samples on their way from the receiving thread to the writing thread: batches, in a bounded queue.

A put never waits. Batches that find no room are lost, the oldest first, and counted.
"""

import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace

from twind.client.clock_pair import ClockPair
from twind.learn.streaming.stream_samples import PostMessage, SampleBatch, StreamedRobot, StreamSample

ROOM = 64  # closed batches, and pictures: 20 s at 100 Hz


class SampleBatcher:
    """For one thread that takes, and any that put."""

    def __init__(
        self,
        size: int,
        age: float,
        now: Callable[[], float],
        clocks: Callable[[], ClockPair],
        room: int = ROOM,
    ) -> None:
        """A batch is closed at `size` samples, or `age` s after its first."""
        self._size = size
        self._age = age
        self._now = now
        self._clocks = clocks
        self._room = room
        self._changed = threading.Condition()
        self._open: list[StreamSample] = []
        self._robot: StreamedRobot | None = None
        self._begun = 0.0
        self._stamp = ClockPair(0.0, 0)
        self._lost = {"daemon": 0, "here": 0}
        self._closed: deque[SampleBatch | PostMessage] = deque()
        self.samples = 0  # that came so far
        self.latest: StreamSample | None = None
        self.dropped = 0  # batches and pictures that found no room

    def put(self, sample: StreamSample, robot: StreamedRobot) -> None:
        """Add a sample of `robot`. A batch has one robot, one mode and the same joints."""
        with self._changed:
            self.samples += 1
            self.latest = sample
            if self._open and (self._robot is not robot or self._open[0].names != sample.names):
                self._close()
            if sample.dropped and self._open:
                self._close()  # so that a loss is reported where it was
            self._lost["daemon"] += sample.dropped
            if not self._open:
                self._begun = self._now()
                self._stamp = self._clocks()
                self._robot = robot
            self._open.append(sample)
            if len(self._open) >= self._size:
                self._close()

    def add(self, picture: PostMessage) -> None:
        """Add a message that is complete already."""
        with self._changed:
            self._keep(picture)

    def take(self, timeout: float) -> SampleBatch | PostMessage | None:
        """The oldest that is closed, waiting for one at most `timeout` s."""
        with self._changed:
            if not self._closed:
                self._changed.wait(timeout)
            if self._open and self._now() - self._begun >= self._age:
                self._close()
            return self._closed.popleft() if self._closed else None

    def give_back(self, batch: SampleBatch | PostMessage) -> None:
        """Return a batch that could not be written: it is the oldest again, and the first to be dropped."""
        with self._changed:
            self._closed.appendleft(batch)
            self._fit()

    @property
    def untaken_count(self) -> int:
        """Batches and pictures that were not taken."""
        with self._changed:
            return len(self._closed)

    def end(self) -> None:
        """Close what is open: nothing more comes."""
        with self._changed:
            if self._open:
                self._close()

    def _close(self) -> None:
        assert self._robot is not None
        batch = SampleBatch(self._robot, self._stamp, tuple(self._open), dict(self._lost))
        self._open = []
        self._lost = dict.fromkeys(self._lost, 0)
        self._keep(batch)

    def _keep(self, batch: SampleBatch | PostMessage) -> None:
        self._closed.append(batch)
        self._fit()
        self._changed.notify()

    def _fit(self) -> None:
        """Drop the oldest batches until the queue fits.

        The next batch carries the number of samples that are missing before it.
        """
        while len(self._closed) > self._room:
            gone = self._closed.popleft()
            self.dropped += 1
            if isinstance(gone, SampleBatch):
                self._report_loss({**gone.lost, "here": gone.lost["here"] + len(gone.samples)})

    def _report_loss(self, lost: Mapping[str, int]) -> None:
        for place, each in enumerate(self._closed):
            if isinstance(each, SampleBatch):
                self._closed[place] = replace(each, lost=_sum(each.lost, lost))
                return
        self._lost = _sum(self._lost, lost)


def _sum(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
    return {who: count + other[who] for who, count in one.items()}
