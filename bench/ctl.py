"""`ctl.status_cpu`: one `twindctl status` as a process, beside an interpreter that does nothing."""

import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

from bench.daemon import scratch, twind
from bench.harness import (
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    cpu_of_command,
    interleaved,
    medians,
    spread,
)

ROUNDS = 20


def take() -> Mapping[str, MeasuredFigure]:
    """CPU time, user and system, from exec to exit."""
    command = Path(sys.executable).with_name("twindctl")
    if shutil.which(str(command)) is None:
        raise MeasurementUnavailable("twindctl is not installed beside this interpreter")
    with scratch() as folder, twind(folder, "--mode", "sim"):
        status = [str(command), "--socket", str(folder), "status"]
        bare = [sys.executable, "-c", "pass"]
        found = interleaved(
            ROUNDS,
            {
                "twind": lambda: cpu_of_command(status) * 1e3,
                "interpreter": lambda: cpu_of_command(bare) * 1e3,
            },
        )
    middle = medians(found)
    note = f"whole process, user and system; {spread(found['twind'], 'ms')}"
    return {
        "ctl.status_cpu": MeasuredFigure(middle["twind"], note, {"bare interpreter": middle["interpreter"]})
    }


MEASUREMENTS = (Measurement({"ctl.status_cpu": FigureSpec("ms", "≤ 80")}, take),)
