"""Recordings of an armed robot of two joints, as arrays."""

from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from twind.observe.recording.recording_columns import RobotRecording

JOINTS = ("hip", "knee")


def recording(count: int = 300, rate: float = 100.0, **more: Any) -> RobotRecording:
    """A robot that was armed and live all the time, from 0 s on."""
    time = np.arange(count) / rate
    rows = {name: np.full((count, 2), 0.5) for name in ("measured", "velocity", "effort", "goal")}
    given: dict[str, Any] = {"path": Path("a.mcap"), "start_ns": 0, "joints": JOINTS, "time": time}
    given["simulated"] = np.full((count, 2), nan)
    return RobotRecording(**given | rows | more)
