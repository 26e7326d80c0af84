"""From the basket onto the disk: the one thread that appends to the spool, and waits for the disk alone."""

import sqlite3
import threading
import time
from collections.abc import Callable

from twind.client.monitor_stream import RepeatedFaultFilter
from twind.learn.streaming.sample_batcher import SampleBatcher
from twind.learn.streaming.spool import Spool
from twind.learn.streaming.stream_samples import SampleBatch, message

AGAIN = 0.5  # s between two tries of a disk that takes nothing
UPKEEP = 10.0  # s between two looks for what has become too old


class SpoolWriter:
    """`kept` is called after each message that is on the disk; `tell` gets a line when the disk fails."""

    def __init__(
        self,
        batcher: SampleBatcher,
        spool: Spool,
        kept: Callable[[], None],
        tell: Callable[[str], None],
        *,
        ndjson: bool = False,
        zipped: bool = False,
        patience: float = 0.25,
    ) -> None:
        """`patience`: s between two looks at the age of a batch that is not full."""
        self._basket = batcher
        self._spool = spool
        self._kept = kept
        self._tell = tell
        self._ndjson = ndjson
        self._zipped = zipped
        self._patience = patience
        self._once = RepeatedFaultFilter()
        self._stopping = threading.Event()
        self._counted = 0  # of what the basket dropped, in the spool's tally already
        self._upkeep = 0.0
        self.error = ""
        self._thread = threading.Thread(target=self._run, name="keeping", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def finish(self, patience: float) -> None:
        """Write what is there, trying for at most `patience` s."""
        self._basket.end()
        self._stopping.set()
        self._thread.join(patience)

    @property
    def dropped_messages(self) -> int:
        """Messages that found no room before the disk took them, beyond those in the spool's tally."""
        return self._basket.dropped - self._counted

    def _run(self) -> None:
        while True:
            taken = self._basket.take(self._patience)
            if taken is not None:
                written = (
                    message(taken, ndjson=self._ndjson, zipped=self._zipped)
                    if isinstance(taken, SampleBatch)
                    else taken
                )
                lost = self.dropped_messages
                if self._tried(lambda: self._spool.append(written, time.monotonic(), time.time(), lost)):  # noqa: B023
                    self._counted += lost
                    self._kept()
                    continue
                self._basket.give_back(taken)
                time.sleep(AGAIN)
            elif self._stopping.is_set():
                return
            elif time.monotonic() - self._upkeep > UPKEEP:
                self._upkeep = time.monotonic()
                self._tried(lambda: self._spool.expire(time.monotonic(), time.time()))

    def _tried(self, do: Callable[[], object]) -> bool:
        """Run a write; return True if it succeeded. An error is reported when it begins and when it ends."""
        try:
            do()
            self.error = ""
        except sqlite3.Error as error:
            self.error = f"the spool takes nothing: {error}"
        if self._once.is_transition(self.error, time.monotonic()):
            self._tell(self.error or f"the spool takes messages again; {self._basket.dropped} were dropped")
        return not self.error
