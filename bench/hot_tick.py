"""`loop.tick_hot`: CPU time of a tick under the fake clock, armed and moving, beside the base commit.

Each tree runs `bench/hot_tick_worker.py` in a process of its own; their rounds take turns.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bench.base_commit import SourceTree, base_tree, own_tree
from bench.daemon import scratch
from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    interleaved,
    medians,
    spread,
)

WORKER = Path(__file__).with_name("hot_tick_worker.py")


def take() -> Mapping[str, MeasuredFigure]:
    """Median round of each tree, with the virtual servos' own share in the note."""
    with scratch() as folder, ExitStack() as stack:
        base = stack.enter_context(base_tree(folder))
        workers = {tree.name: stack.enter_context(_worker(tree)) for tree in (own_tree(), base)}
        servos: dict[str, float] = {}

        def taking(name: str) -> Callable[[], float]:
            def take_round() -> float:
                row = workers[name]()
                servos[name] = row["servos"]
                return row["tick"]

            return take_round

        rounds = interleaved(ROUNDS, {name: taking(name) for name in workers})
    middle = medians(rounds)
    own = own_tree().name
    bare = {name: middle[name] - servos[name] for name in middle}
    note = f"armed, 24 joints moving, virtual servos in the same process ({servos[own]:.0f} µs of it); "
    note += (
        f"without them {bare[own]:.0f}, base {bare[base.name]:.0f} ({bare[own] / bare[base.name]:.2f} ×); "
    )
    note += spread(rounds[own], "µs")
    return {"loop.tick_hot": MeasuredFigure(middle[own], note, {f"base {base.name}": middle[base.name]})}


@contextmanager
def _worker(tree: SourceTree) -> Iterator[Callable[[], dict[str, float]]]:
    """Yield a function that takes one round in a process of `tree`. Raises MeasurementUnavailable."""
    process = subprocess.Popen(
        [sys.executable, str(WORKER)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=tree.environment(),
        cwd=tree.folder,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    to_worker = process.stdin
    from_worker = process.stdout

    def take_round() -> dict[str, float]:
        to_worker.write("round\n")
        to_worker.flush()
        line = from_worker.readline()
        if not line:
            raise MeasurementUnavailable(
                f"{tree.name}: the process of the fake clock ended; its messages are above"
            )
        row: dict[str, float] = json.loads(line)
        return row

    try:
        if from_worker.readline() != "ready\n":
            raise MeasurementUnavailable(
                f"{tree.name}: no daemon under the fake clock; its messages are above"
            )
        yield take_round
    finally:
        to_worker.close()
        process.wait(60.0)
        from_worker.close()


MEASUREMENTS = (Measurement({"loop.tick_hot": FigureSpec("µs", "≤ 0.4 × 2d1dfd9")}, take),)
