"""Shared parts of all figures: rounds, quantiles, CPU time as the system counts it, and the table."""

import gc
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path

ROUNDS = 5  # of every figure at least; peers run in the same round, in turning order
RESULTS = Path(__file__).with_name("results.json")
_CPUCLOCK_SCHED = 2  # <linux/posix-timers.h>: the clock id of another process's CPU time


class MeasurementUnavailable(Exception):
    """A figure that this machine or this state of things does not give. The message is its note."""


@dataclass(frozen=True, slots=True)
class FigureSpec:
    """A figure that is published: what it is counted in and what it should be."""

    unit: str
    aim: str = "—"


@dataclass(frozen=True, slots=True)
class MeasuredFigure:
    """One measured figure. A peer that could not be taken is None, with its reason in the note."""

    value: float | None
    note: str = ""
    peers: Mapping[str, float | None] = field(default_factory=dict)

    def as_json(self, unit: str) -> dict[str, object]:
        """As it stands in `results.json`. `ratio` is ours over the peer's."""
        ratio = {
            name: None if not (self.value and peer) else self.value / peer
            for name, peer in self.peers.items()
        }
        return {
            "value": self.value,
            "unit": unit,
            "peers": dict(self.peers),
            "ratio": ratio,
            "note": self.note,
        }


@dataclass(frozen=True, slots=True)
class Measurement:
    """Figures that are taken together, in the same rounds. `take` gives one Figure for each of `keys`."""

    keys: Mapping[str, FigureSpec]
    take: Callable[[], Mapping[str, MeasuredFigure]]


# ------------------------------------------------------------------------------------------ rounds


def interleaved(rounds: int, takes: Mapping[str, Callable[[], float]]) -> dict[str, list[float]]:
    """Each of `takes` once a round, in an order that turns from round to round; results by name."""
    names = list(takes)
    found: dict[str, list[float]] = {name: [] for name in names}
    for place in range(rounds):
        turn = place % len(names)
        for name in names[turn:] + names[:turn]:
            found[name].append(takes[name]())
    return found


def medians(found: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """The median of each row."""
    return {name: statistics.median(values) for name, values in found.items()}


def quantile(values: Sequence[float], share: float) -> float:
    """The value that `share` of `values` do not exceed. Raises CannotTake when there are none."""
    if not len(values):
        raise MeasurementUnavailable("nothing was measured")
    ordered = sorted(values)
    return float(ordered[max(0, ceil(share * len(ordered)) - 1)])


def spread(values: Sequence[float], unit: str) -> str:
    """Least to most, for a note: medians of a noisy machine say little alone."""
    return f"{min(values):.3g} to {max(values):.3g} {unit} over {len(values)} rounds"


# ------------------------------------------------------------------------------------------ CPU time


def cpu_of(pid: int) -> float:
    """CPU time (s) of a process so far, all threads, user and system, by the scheduler's own account."""
    return time.clock_gettime((~pid << 3) | _CPUCLOCK_SCHED)


def cpu_per_call(call: Callable[[int], object], count: int) -> float:
    """CPU time (s) of one `call(i)`, averaged over i = 0 … count - 1."""
    before = time.process_time()
    for i in range(count):
        call(i)
    return (time.process_time() - before) / count


def cpu_of_command(command: Sequence[str], expected: int = 0) -> float:
    """CPU time (s) of a whole process from exec to exit. Raises CannotTake when it fails."""
    null = os.open(os.devnull, os.O_RDWR)
    try:
        actions = [(os.POSIX_SPAWN_DUP2, null, fd) for fd in (0, 1, 2)]
        pid = os.posix_spawn(command[0], list(command), dict(os.environ), file_actions=actions)
        _, status, usage = os.wait4(pid, 0)
    finally:
        os.close(null)
    if os.waitstatus_to_exitcode(status) != expected:
        raise MeasurementUnavailable(
            f"{' '.join(command[-2:])}: exit code {os.waitstatus_to_exitcode(status)}"
        )
    return usage.ru_utime + usage.ru_stime


@contextmanager
def as_in_the_loop() -> Iterator[None]:
    """The garbage collector as the daemon's loop has it: frozen and off."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


# ------------------------------------------------------------------------------------------ results


def save(found: Mapping[str, dict[str, object]], path: Path = RESULTS, *, whole: bool) -> None:
    """Write the figures; a run of some of them replaces those and leaves the others."""
    kept: dict[str, object] = {} if whole or not path.exists() else json.loads(path.read_text())
    path.write_text(json.dumps(kept | dict(found), indent=1, ensure_ascii=False) + "\n")


def table(found: Mapping[str, dict[str, object]], keys: Mapping[str, FigureSpec]) -> str:
    """The figures as Markdown."""
    rows = ["| figure | value | unit | aim | peers (ours / theirs) | how |", "|---|---|---|---|---|---|"]
    for name, row in found.items():
        peers = row["peers"]
        ratio = row["ratio"]
        assert isinstance(peers, dict)
        assert isinstance(ratio, dict)
        beside = ", ".join(
            f"{peer} {_number(value)} ({_number(ratio[peer])} ×)" for peer, value in peers.items()
        )
        aim = keys[name].aim if name in keys else "—"
        cells = (f"`{name}`", _number(row["value"]), row["unit"], aim, beside or "—", row["note"])
        rows.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(rows)


def _number(value: object) -> str:
    return (
        "—" if not isinstance(value, int | float) else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    )


@contextmanager
def responder_port(module: str, *arguments: str) -> Iterator[str]:
    """Start a responder process; yield its port, whose path is the first line of its output."""
    process = subprocess.Popen([sys.executable, "-m", module, *arguments], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        path = process.stdout.readline().strip()
        if not path:
            raise MeasurementUnavailable(f"{module} did not start")
        yield path
    finally:
        process.kill()
        process.wait()
