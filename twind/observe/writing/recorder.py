"""One run of `twindctl record`: over any number of daemons, until a user or the disk stops it."""

import argparse
import contextlib
import sys
import threading
import time
import traceback
from dataclasses import dataclass

from twind.client import ClientError
from twind.client.clock_pair import STEP, ClockPair, clocks
from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, REFUSED, Rejected, complain, operator, show
from twind.observe.writing.record_encoder import note
from twind.observe.writing.record_subscriber import RecordSubscriber
from twind.observe.writing.record_writer import RecordCounts, RecordWriter

AGAIN = 0.5  # s between two attempts to reach a daemon that is gone
TOLD = 1.0  # s between two lines for people, and two looks at the clock
MARKED = 1.0  # s in which a mark that the daemon took comes back as an event


@dataclass(slots=True)
class Recorder:
    """Run of the verb: `run` returns the exit code."""

    options: argparse.Namespace
    writer: RecordWriter
    stop: threading.Event
    begun: float = 0.0  # s, monotonic, of the first connection
    ours: ClockPair | None = None  # of the file
    failed: bool = False  # a defect was reported
    named: int = 0  # files that were named
    parted: int = 0  # ns that the wall clock is off from them, as last noted

    def run(self) -> int:
        """Record. Raises ClientError where there is no daemon to begin with."""
        first = RecordSubscriber(self.options, self.writer)
        listening: RecordSubscriber | None = first
        self.begun = time.monotonic()
        with ProgressLine(self.options, "record", seconds=self.options.seconds) as progress:
            self.send_mark(first, "begin")
            while listening is not None:
                self._follow(listening, progress)
                gone = listening.ended
                if not gone and self.writer.tally.episode is not None:
                    self.send_mark(listening, "end")
                listening.close()
                self.writer.end()
                if self._is_over():
                    break
                self._print_line(progress, f"the daemon is gone; waiting for it ({gone})")
                self._explain(listening.failure)
                listening = self._reach()
        return self._finish()

    def _is_over(self) -> bool:
        limit = self.options.seconds
        past = limit is not None and time.monotonic() - self.begun >= limit
        return self.stop.is_set() or bool(self.writer.stopped) or past

    def _follow(self, listening: RecordSubscriber, progress: ProgressLine) -> None:
        """Until it is over, or the daemon is gone."""
        last = time.monotonic()
        count = listening.answers
        if self.options.per_episode:  # no file before the first episode
            self._print_line(
                progress, f"recording episodes of {listening.session.robot} into {self.writer.folder}"
            )
        while not (self._is_over() or listening.ended):
            self.stop.wait(0.1)
            self.name_files(progress, listening.session.robot)
            now = time.monotonic()
            if now - last >= TOLD:
                rate = (listening.answers - count) / (now - last)
                last = now
                count = listening.answers
                progress.update(line(self.writer.tally, rate))
                self.check_clock(listening)

    def name_files(self, progress: ProgressLine, robot: str) -> None:
        """Each file by its name, once, as soon as it is there."""
        files = self.writer.tally.files
        for path in files[self.named :]:
            self._print_line(progress, f"recording {robot} into {path}")
        self.named = len(files)

    def check_clock(self, listening: RecordSubscriber) -> None:
        """Note that the wall clock was set. Times in the file go on as they were."""
        now = clocks()
        begun = listening.session.clocks
        ours = self.writer.clocks or begun
        if ours is not self.ours:
            self.ours = ours
            self.parted = 0
        parted = now.wall_ns - ours.wall(now.monotonic)
        if abs(parted - self.parted) > STEP:
            self.parted = parted
            said = {"wall_ns": now.wall_ns, "expected_ns": ours.wall(now.monotonic)}
            self.writer.put(note(begun, now.monotonic, "clock_step", monotonic=now.monotonic, **said))

    def _reach(self) -> RecordSubscriber | None:
        """The next daemon; None: it is over before there is one."""
        while not (self.stop.wait(AGAIN) or self._is_over()):
            with contextlib.suppress(ClientError):
                return RecordSubscriber(self.options, self.writer)
        return None

    def _explain(self, failure: Exception | None) -> None:
        """Print the traceback of a defect once: it may come back at every connection."""
        if failure is not None and not self.failed:
            self.failed = True
            traceback.print_exception(failure)

    def send_mark(self, listening: RecordSubscriber, kind: str) -> None:
        """The episode of --task; by the daemon, so that everybody knows, or where we may not, in the file."""
        if self.options.task is None:
            return
        try:
            with operator(self.options) as client:
                client.call("Mark", kind=kind, task=self.options.task)
        except ClientError as error:
            said: dict[str, object] = {"kind": kind, "task": self.options.task}
            why = f"the daemon did not receive the mark: {error}"
            told = note(listening.session.clocks, time.monotonic(), "episode", annotation=said, text=why)
            self.writer.put(told._replace(mark=said))
        limit = time.monotonic() + MARKED
        while (self.writer.tally.episode is None) == (kind == "begin") and time.monotonic() < limit:
            time.sleep(0.02)

    # ------------------------------------------------------------------------------------------ output

    def _print_line(self, progress: ProgressLine, text: str) -> None:
        progress.clear()
        if not self.options.json:
            print(text, file=sys.stderr, flush=True)

    def _finish(self) -> int:
        whole = self.writer.close()
        tally = self.writer.tally
        if not whole:
            stuck = f"{tally.path}: the disk takes nothing any more; `twindctl recover` reads what it took"
            self.writer.stopped = self.writer.stopped or stuck
        seconds = time.monotonic() - self.begun
        data = {
            "files": [str(path) for path in tally.files],
            "seconds": round(seconds, 3),
            "messages": tally.messages,
            "dropped": tally.dropped,
            "dropped_by_daemon": tally.missed,
            "episodes": tally.episodes,
            "removed": tally.removed,
            "stopped": self.writer.stopped or None,
        }
        show(self.options, data, summary(tally, seconds))
        if self.writer.stopped and not self.options.json:
            complain(self.options, Rejected(self.writer.stopped))
        return REFUSED if self.writer.stopped else DONE


def line(tally: RecordCounts, rate: float) -> str:
    """One line for people while it runs."""
    parts = [f"{rate:.0f} messages/s", megabytes(tally.bytes)]
    lost = tally.dropped + tally.missed
    if lost:
        parts.append(f"{lost} DROPPED")
    if tally.episode is not None:
        parts.append(f"episode {tally.episode.task}".rstrip())
    parts.append(tally.path.name if tally.path else "between two episodes")  # what a narrow terminal cuts
    return "  ".join(parts)


def summary(tally: RecordCounts, seconds: float) -> str:
    """Summary of a recording as text."""
    if not tally.files:
        return "nothing was recorded"
    lines = [str(path) for path in tally.files]
    told = f"{seconds:.1f} s, {tally.messages} messages"
    if tally.episodes:
        told += f", {tally.episodes} episode{'s' if tally.episodes > 1 else ''}"
    lost = "nothing dropped"
    if tally.dropped or tally.missed:
        lost = f"dropped: {tally.missed} by the daemon, {tally.dropped} here (the disk was too slow)"
    gone = f"; {tally.removed} old recordings made room" if tally.removed else ""
    return "\n".join([*lines, f"{told}; {lost}{gone}"])


def megabytes(count: int) -> str:
    """Bytes for people."""
    return f"{count / (1 << 20):.1f} MiB"
