"""What the monitor costs a tick of h24, in motion: `python -m tests.proof.evil.cost`."""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.proof.busmon.monitor import Monitor
from tests.proof.busmon.watched import Watched
from tests.support.daemon_rig import Rig
from twind import link
from twind.robot.trajectory import Trajectory
from twind.virtual.virtual_robot_spec import save

TICKS = 2000


def day(folder: Path) -> tuple[Watched, list[tuple[str, Any]], int]:
    """Everything that a monitor was given while every joint moved, and where the motion began."""
    rig = Rig("h24")
    save(rig.made, folder / "calibration.yaml")
    watched = Watched(rig, folder / "calibration.yaml")
    monitor = watched.monitors["main"]
    log = list[tuple[str, Any]]()
    for name in ("sent", "answered", "told"):
        given = getattr(monitor, name)

        def noted(*what: Any, name: str = name, given: Any = given, **facts: Any) -> None:
            log.append((name, (what, facts)))
            given(*what, **facts)

        setattr(monitor, name, noted)
    rig.connect()
    rig.seconds(0.6)
    rig.call(link.AcquireLease)
    assert rig.call(link.Arm).error is None
    limits = rig.loop.limits
    here = rig.loop.measured.position
    away = here + 0.5 * (0.5 * (limits.lower + limits.upper) - here)
    rows = np.array([away if k % 2 else here for k in range(18)])
    rig.submit(
        Trajectory(np.arange(1.0, 19.0) * 1.5, rows, np.ones(len(here), np.bool_), np.zeros_like(rows))
    )
    begun = len(log)
    for tick in range(TICKS):
        if tick % 40 == 0:
            rig.send(link.RenewLease)
        rig.ticks(1)
    rig.close()
    return watched, log, begun


def main() -> None:
    """Play it to a fresh monitor."""
    with tempfile.TemporaryDirectory() as folder:
        watched, log, begun = day(Path(folder))
    monitor = Monitor(watched.monitors["main"].limits)
    start = 0.0
    for number, (name, (what, facts)) in enumerate(log):
        if number == begun:
            start = time.process_time()
        getattr(monitor, name)(*what, **facts)
    spent = (time.process_time() - start) / TICKS
    print(f"{spent * 1e6:.0f} us a tick, {len(log) - begun} chunks, {monitor.goal_packets} goal packets")
    print(f"violations: {len(monitor.violations)}")


if __name__ == "__main__":
    main()
