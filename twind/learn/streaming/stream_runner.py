"""One run of `twindctl stream`: three threads that each wait for one thing only, and this one, which reports.

listening: the daemon → the basket (memory, bounded) · keeping: the basket → the spool (disk, bounded) ·
sending: the spool → the endpoint. One that hangs delays no other: before it the oldest is dropped.
"""

import argparse
import queue
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any, Protocol

from twind.client import Client, ClientError
from twind.client.clock_pair import clocks
from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, harmless, observer, show
from twind.ctl.status_table import stream_text
from twind.learn.streaming.http_endpoint import HttpEndpoint, shown
from twind.learn.streaming.reading_subscriber import ReadingSubscriber
from twind.learn.streaming.sample_batcher import SampleBatcher
from twind.learn.streaming.spool import Spool
from twind.learn.streaming.spool_sender import SpoolSender
from twind.learn.streaming.spool_writer import SpoolWriter
from twind.protocol.messages import StreamingMessage

LOOK = 0.5  # s between two looks at the others
REPORT = 1.0  # s between two reports to the daemon
PATIENCE = 2.0  # s that the daemon has to take one
GRACE = 2.0  # s at the end for what waits: to the disk, and to the endpoint


class MessageSource(Protocol):
    """Something else that puts messages into the basket: a camera."""

    def start(self) -> None:
        """Begin."""

    def stop(self) -> None:
        """End, soon."""


class StreamRunner:
    """Running streamer. `run` returns the exit code."""

    def __init__(
        self, options: argparse.Namespace, spool: Spool, endpoint: HttpEndpoint, stop: threading.Event
    ) -> None:
        self._options = options
        self._spool = spool
        self._stop = stop
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.tell = self._lines.put
        self.basket = SampleBatcher(options.batch, options.age, time.monotonic, clocks)
        self._listening = ReadingSubscriber(options, self.basket, time.monotonic, self.tell)
        self._sender = SpoolSender(spool, endpoint, self.tell)
        self._keeping = SpoolWriter(
            self.basket,
            spool,
            self._sender.wake,
            self.tell,
            ndjson=options.ndjson,
            zipped=options.gzip,
            patience=min(max(options.age / 2.0, 0.02), 0.5),
        )
        self._reporter: Client | None = None
        self._rate = 0.0

    def run(self, sources: Sequence[MessageSource] = ()) -> int:
        """Run until a stop signal, or --seconds."""
        workers: list[Any] = [self._sender, self._keeping, self._listening, *sources]
        for each in workers:
            each.start()
        try:
            with ProgressLine(self._options, "stream", seconds=self._options.seconds) as progress:
                self._watch(progress)
        finally:
            for source in (self._listening, *sources):
                source.stop()
            self._keeping.finish(GRACE)
            self._sender.finish(GRACE)
            if self.basket.untaken_count:
                self.tell(
                    f"{self.basket.untaken_count} messages are lost with this process: {self._keeping.error}"
                )
            self._report()
            if self._reporter is not None:
                self._reporter.close()
        self._print()
        figures = self.streaming()
        show(self._options, figures, stream_text(figures))
        return DONE

    def _watch(self, progress: ProgressLine) -> None:
        begun = last = time.monotonic()
        count = self.basket.samples
        while not self._stop.wait(LOOK):
            now = time.monotonic()
            self._sender.abort_if_overdue(now)
            if not self._lines.empty():
                progress.clear()
                self._print()
            if now - last >= REPORT:
                self._rate = (self.basket.samples - count) / (now - last)
                last = now
                count = self.basket.samples
                self._report()
                progress.update(stream_text(self.streaming()))
            if self._options.seconds is not None and now - begun >= self._options.seconds:
                break

    def streaming(self) -> StreamingMessage:
        """`Streaming` of the interface. `error`: the first that is in the way, seen from the endpoint."""
        tally = self._spool.tally
        return {
            "name": tally.stream,
            "endpoint": shown(self._options.url),
            "rate_hz": round(self._rate, 3),
            "sent": tally.sent,
            "waiting": tally.waiting,
            "dropped": tally.dropped + self._keeping.dropped_messages,
            "dead": tally.dead,
            "failures": self._sender.failures,
            "error": self._sender.error or self._keeping.error or self._listening.error or None,
        }

    def _report(self) -> None:
        """Send the figures to the daemon, for its clients; do nothing without a daemon."""
        try:
            if self._reporter is None:
                self._reporter = observer(self._options)
                self._reporter.timeout = PATIENCE
            self._reporter.call("ReportStream", stream=self.streaming())
        except ClientError:
            if self._reporter is not None:
                self._reporter.close()
            self._reporter = None

    def _print(self) -> None:
        while not self._lines.empty():
            print(f"twindctl: {harmless(self._lines.get())}", file=sys.stderr, flush=True)
