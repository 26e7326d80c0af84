"""Recordings of a robot of two joints that does marked episodes, for data sets."""

import math
from pathlib import Path
from typing import Any

from tests.support.sample_recordings import SteppedWriter, mark, state, status

EPISODES = (("pick", True), ("put", False), ("pick", None), ("pick", True))  # 2 s each, one every 3 s


def record(folder: Path, *answers: dict[str, Any]) -> Path:
    """Write a recording of these answers; return its file."""
    folder.mkdir(exist_ok=True)
    rig = SteppedWriter(folder)
    rig.take(*answers)
    rig.writer.close()
    return rig.writer.tally.files[0]


def stretch(begin: float, end: float, **more: Any) -> list[dict[str, Any]]:
    """State at 100 Hz; each goal is of its moment."""
    times = [round(begin + k / 100, 2) for k in range(round((end - begin) * 100))]
    return [state(time, **{"goal": math.cos(time), "effort": math.sin(3 * time)} | more) for time in times]


def record_episodes(folder: Path) -> Path:
    """Write a recording of EPISODES; in between the robot stands, not armed."""
    answers = [status(100.0)]
    for number, (task, success) in enumerate(EPISODES):
        begin = 100.0 + 3 * number
        answers += [mark(begin, "begin", task), *stretch(begin, begin + 2.0)]
        answers += [mark(begin + 2.0, "end", task, success), *stretch(begin + 2.0, begin + 3.0, goal=None)]
    return record(folder, *answers)
