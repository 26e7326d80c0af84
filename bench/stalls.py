"""Seconds in which the machine itself stood still, and what happened in them, counted apart.

A sentinel on each core wakes every millisecond above all other priorities. Where it was late, a hypervisor or
firmware had the core, and no program of this machine could have been in time.
"""

import os
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from bench.compiled import compiled
from bench.daemon import BenchDaemon
from bench.harness import MeasurementUnavailable

PRIORITY = 95  # SCHED_FIFO, above the daemon, the servos and every load
MARGIN = 0.1  # s around a stall: the status is that of the last published tick


class StallLog:
    """Stalls so far, as (time, s late); filled by threads."""

    def __init__(self, least: float) -> None:
        """`least` (s): shorter stalls do not count."""
        self.least = least
        self.stalls: list[tuple[float, float]] = []
        self.watched = False  # False: no right to SCHED_FIFO, so nothing is known

    def between(self, first: float, last: float) -> bool:
        """Return whether a stall touched these seconds."""
        return any(at < last + MARGIN and first - MARGIN < at + late for at, late in self.stalls)

    def note(self) -> str:
        """For a note: how many there were, or that nobody watched."""
        if not self.watched:
            return "no sentinel: it needs SCHED_FIFO"
        worst = max((late for _, late in self.stalls), default=0.0)
        return (
            f"sentinel: {len(self.stalls)} stalls above {self.least * 1e3:g} ms, worst {worst * 1e3:.1f} ms"
        )


@contextmanager
def sentinel(folder: Path, period: float) -> Iterator[StallLog]:
    """Yield the log of a sentinel on every core that this process may use. Raises MeasurementUnavailable.

    `period` (s) of the loop: stalls of half of it count, which leave a tick no time.
    """
    program = compiled("stall_sentinel", folder)
    log = StallLog(0.5 * period)
    with ExitStack() as stack:
        started = [stack.enter_context(_watching(program, core, log)) for core in os.sched_getaffinity(0)]
        log.watched = all(started)
        yield log


@contextmanager
def _watching(program: Path, core: int, log: StallLog) -> Iterator[bool]:
    command = [str(program), str(core), str(PRIORITY), str(round(log.least * 1e6))]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    output = process.stdout
    assert output is not None
    ready = output.readline() == "ready\n"

    def read() -> None:
        for line in output:
            at, late = line.split()
            log.stalls.append((float(at), float(late)))

    reader = threading.Thread(target=read)
    reader.start()
    try:
        yield ready
    finally:
        process.terminate()
        process.wait()
        reader.join()
        output.close()


@dataclass(frozen=True, slots=True)
class TickCount:
    """Ticks of a span, and those of its seconds with a stall."""

    ticks: int  # planned, missed ones included
    missed: int
    stalled_ticks: int
    stalled_missed: int
    errors: int  # exchanges in which a device did not answer
    policy: str
    state: str  # of the robot at the end

    @property
    def share(self) -> float:
        """Missed ticks of the seconds without a stall, %."""
        return 100.0 * self.missed / max(1, self.ticks)

    @property
    def _end(self) -> str:
        return f"policy {self.policy}, at the end {self.state}"

    def note(self) -> str:
        """For a note."""
        apart = f"{self.stalled_missed} of {self.stalled_ticks} in stalled seconds apart"
        return f"{self.missed} of {self.ticks} ticks, {apart}, {self.errors} bad exchanges, {self._end}"


def count_ticks(daemon: BenchDaemon, log: StallLog, span: float) -> TickCount:
    """Watch a running daemon for `span` s, second by second."""
    rows: list[tuple[float, int, int]] = []
    statuses: list[dict[str, Any]] = []
    begin = time.monotonic()
    with daemon.client() as client:
        for second in range(round(span) + 1):
            time.sleep(max(0.0, begin + second - time.monotonic()))
            status = client.call("GetStatus")["status"]
            rows.append((time.monotonic(), status["loop"]["ticks"], status["loop"]["missed"]))
            statuses = [*statuses[:1], status]
    first, last = statuses[0], statuses[-1]
    errors = sum(bus["errors"] for bus in last["buses"]) - sum(bus["errors"] for bus in first["buses"])
    policy = last["loop"]["realtime"]["scheduler"]
    time.sleep(MARGIN)  # the sentinel's last lines
    return TickCount(*sorted_ticks(rows, log), errors, policy, last["state"])


def sorted_ticks(rows: Sequence[tuple[float, int, int]], log: StallLog) -> tuple[int, int, int, int]:
    """Planned and missed ticks, of seconds without and with a stall."""
    counts = {False: [0, 0], True: [0, 0]}
    for (since, ticks, missed), (until, more, worse) in pairwise(rows):
        count = counts[log.between(since, until)]
        count[0] += more - ticks + worse - missed
        count[1] += worse - missed
    return (*counts[False], *counts[True])  # type: ignore[return-value]


def require_fifo() -> None:
    """Raises MeasurementUnavailable without the right to SCHED_FIFO."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, *before)
    except PermissionError:
        raise MeasurementUnavailable("it needs the right to SCHED_FIFO (root, or `ulimit -r`)") from None
