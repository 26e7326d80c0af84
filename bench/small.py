"""`small.missed_100hz`: the loop with a quarter of its core, as on a small computer beside other work.

A load of higher priority takes 75 % of each 2 ms of the core that the loop is pinned to; servos, front and
client have the others.
"""

import os
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from bench.base_commit import SourceTree, base_tree, own_tree
from bench.c_servos import ServoSettings, on_c_servos
from bench.compiled import compiled
from bench.daemon import await_state, scratch
from bench.harness import FigureSpec, MeasuredFigure, Measurement, MeasurementUnavailable
from bench.motion import kept_moving
from bench.stalls import TickCount, count_ticks, require_fifo, sentinel

PERIOD = 2000  # µs
BUSY = 1500  # µs of each period
PRIORITY = 80  # SCHED_FIFO of the load: above the loop and the servos
SPAN = 60.0  # s
SPARE = 20  # s that the load may outlast the span


def take() -> Mapping[str, MeasuredFigure]:
    """Share of missed ticks of both trees, one after the other."""
    require_fifo()
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        raise MeasurementUnavailable("it needs two cores: one for the loop, one for the servos")
    with scratch() as folder, base_tree(folder) as base:
        counts = {tree.name: _count(tree, folder, cores) for tree in (own_tree(), base)}
    ours = counts[own_tree().name][0]
    note = f"24 servos in C, load of priority {PRIORITY}: {BUSY} of each {PERIOD} µs; "
    note += f"{'; '.join(f'{name}: {count.note()}' for name, (count, _) in counts.items())}; "
    note += counts[own_tree().name][1]
    peers = {f"base {base.name}": counts[base.name][0].share}
    return {"small.missed_100hz": MeasuredFigure(ours.share, note, peers)}


def _count(tree: SourceTree, folder: Path, cores: list[int]) -> tuple[TickCount, str]:
    loops, *others = cores
    servos = ServoSettings(core=others[-1])
    robot = tree.built_in_robot("h24")
    with sentinel(folder, 0.01) as log, on_c_servos(tree, folder, robot, servos=servos) as daemon:
        for task in Path(f"/proc/{daemon.pid}/task").iterdir():
            with suppress(ProcessLookupError):
                os.sched_setaffinity(int(task.name), {loops})
        with suppress(ProcessLookupError):
            os.sched_setaffinity(daemon.front, set(others))
        with kept_moving(daemon):
            await_state(daemon, "armed")
            with _load(folder, loops):
                time.sleep(1.0)
                return count_ticks(daemon, log, SPAN), log.note()


@contextmanager
def _load(folder: Path, core: int) -> Iterator[None]:
    """Load on `core`; it ends by itself. Raises MeasurementUnavailable."""
    bounds = (PERIOD, BUSY, round(SPAN) + SPARE)
    command = [str(compiled("core_load", folder)), str(core), str(PRIORITY), *map(str, bounds)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        if process.stdout.readline() != "ready\n":
            raise MeasurementUnavailable("the load did not start")
        yield
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


MEASUREMENTS = (Measurement({"small.missed_100hz": FigureSpec("%", "< 0.1")}, take),)
