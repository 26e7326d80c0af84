"""From the spool to the endpoint: the oldest first, one at a time, until it has arrived or is a dead letter.

A thread of its own: no other thread waits for the endpoint.
"""

import contextlib
import random
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable

from twind.client.monitor_stream import RepeatedFaultFilter
from twind.exceptions import OperationFailed
from twind.learn.streaming.delivery_outcome import DeliveryBackoff, DeliveryOutcome, fate, retry_after
from twind.learn.streaming.http_endpoint import HttpEndpoint, HttpReply
from twind.learn.streaming.spool import Spool, SpooledMessage

PERIOD = 1.0 / 30.0  # s between two sends at least
LONGEST = 30.0  # s of one send: an endpoint that sends a byte now and then is disconnected
IDLE = 0.5  # s between two looks into a spool that is empty


class SpoolSender:
    """`tell` gets a line when something goes wrong, and when it is over."""

    def __init__(self, spool: Spool, endpoint: HttpEndpoint, tell: Callable[[str], None]) -> None:
        self._spool = spool
        self._endpoint = endpoint
        self._tell = tell
        self._backoff = DeliveryBackoff(random.Random())
        self._once = RepeatedFaultFilter()
        self._dead = RepeatedFaultFilter()
        # s, monotonic
        self._next = 0.0
        self._deadline = float("inf")
        self._after = 0  # sequence number of the last that is done with
        self._owed: deque[tuple[int, str | None]] = deque()  # done with, but the disk does not take that
        self._woken = threading.Event()
        self._stopping = threading.Event()
        self.failures = 0
        self.error = ""  # what is in the way now
        self._thread = threading.Thread(target=self._run, name="sending", daemon=True)

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def wake(self) -> None:
        """There is something new."""
        self._woken.set()

    def abort_if_overdue(self, now: float) -> None:
        """A send that takes too long ends now. Called a few times a second."""
        if now > self._deadline:
            self._endpoint.abort()

    def finish(self, grace: float) -> None:
        """Send what waits for at most `grace` s; the rest stays in the spool."""
        until = time.monotonic() + grace
        while self._thread.is_alive() and time.monotonic() < until:
            if self.error or not (self._spool.tally.waiting or self._owed):
                break
            time.sleep(0.02)
        self._stopping.set()
        self._woken.set()
        self._endpoint.abort()
        self._thread.join(1.0)
        if not self._thread.is_alive():
            self._endpoint.close()

    # ------------------------------------------------------------------------------------------ the thread

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._settle()
                kept = self._spool.oldest(self._after)
            except sqlite3.Error as error:
                self._wrong(f"the spool: {error}")
                self._stopping.wait(1.0)
                continue
            if kept is None:
                self._woken.wait(IDLE)
                self._woken.clear()
                continue
            self._wait_until(max(self._next, self._backoff.until))
            if not self._stopping.is_set():
                self._send(kept)

    def _wait_until(self, due: float) -> None:
        self._stopping.wait(max(0.0, due - time.monotonic()))

    def _send(self, kept: SpooledMessage) -> None:
        now = time.monotonic()
        self._next = now + PERIOD
        self._deadline = now + LONGEST
        headers = {**kept.message.headers, "Idempotency-Key": f"{self._spool.tally.stream}-{kept.sequence}"}
        try:
            answer = self._endpoint.post(kept.message.body, headers)
        except OperationFailed as failure:
            if not self._stopping.is_set():
                self._schedule_retry(str(failure), 0.0)
        else:
            self._answered(kept, answer)
        finally:
            self._deadline = float("inf")

    def _answered(self, kept: SpooledMessage, answer: HttpReply) -> None:
        decided = fate(answer.status)
        if decided is DeliveryOutcome.AGAIN:
            self._schedule_retry(answer.summary, retry_after(answer.retry_after, time.time()))
            return
        self._after = kept.sequence
        self._owed.append((kept.sequence, answer.summary if decided is DeliveryOutcome.DEAD else None))
        self._backoff.went_well()
        if decided is DeliveryOutcome.DEAD:
            self._report_dead(kept.sequence, answer.summary)
        with contextlib.suppress(sqlite3.Error):  # tried again, and reported, before the next one
            self._settle()
            self._wrong("")

    def _report_dead(self, sequence: int, why: str) -> None:
        if self._dead.is_transition(why, time.monotonic()):
            self._tell(
                f"message {sequence} is a dead letter ({why}); `twindctl stream --dead` lists them all"
            )

    def _settle(self) -> None:
        """Report the outcomes to the spool. Raises sqlite3.Error; none of them is lost then."""
        while self._owed:
            sequence, reason = self._owed[0]
            if reason is None:
                self._spool.acknowledge(sequence)
            else:
                self._spool.bury(sequence, reason)
            self._owed.popleft()

    def _schedule_retry(self, why: str, asked: float) -> None:
        self.failures += 1
        self._backoff.failed(time.monotonic(), asked)
        self._wrong(why)

    def _wrong(self, why: str) -> None:
        self.error = why
        if self._once.is_transition(why, time.monotonic()):
            waiting = f"{self._spool.tally.waiting} messages wait"
            self._tell(f"{why}; {waiting}, tried again" if why else f"it takes messages again; {waiting}")
