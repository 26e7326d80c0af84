"""`start.ready`: from exec of `twind` in mode sim to READY=1 on a real notification socket."""

from collections.abc import Mapping

from bench.daemon import scratch, twind
from bench.harness import FigureSpec, MeasuredFigure, Measurement, cpu_of, medians, quantile, spread

ROUNDS = 11


def take() -> Mapping[str, MeasuredFigure]:
    """Wall time of fresh starts, one after the other."""
    wall = []
    cpu = []
    for _ in range(ROUNDS):
        with scratch() as folder, twind(folder, "--mode", "sim") as daemon:
            wall.append(daemon.started)
            cpu.append(cpu_of(daemon.pid))
    note = (
        f"median; p99 {quantile(wall, 0.99):.2f} s, CPU of the loop's process {medians({'': cpu})['']:.2f} s"
    )
    return {"start.ready": MeasuredFigure(quantile(wall, 0.5), f"{note}; {spread(wall, 's')}")}


MEASUREMENTS = (Measurement({"start.ready": FigureSpec("s", "≤ 1.5")}, take),)
