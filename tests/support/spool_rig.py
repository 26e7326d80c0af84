"""Spool folders, limits and messages of the streaming tests."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from twind.learn.streaming.spool import SpoolLimits
from twind.learn.streaming.stream_samples import ROWS, PostMessage, StreamedRobot, StreamSample

MEMORY = Path("/dev/shm")  # a thousand syncs to a disk would take minutes, and show nothing more
WIDE = SpoolLimits(1 << 30, 1e9)


@contextmanager
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as name:
        yield Path(name) / "spool"


def carrying(text: str) -> PostMessage:
    return PostMessage(text.encode(), {"Content-Type": "text/plain"}, 1)


ROBOT = StreamedRobot("h24", "one", "0.1.0", "live")


def some(tick: int, position: float | None = 0.1234567891, imu: dict[str, Any] | None = None) -> StreamSample:
    rows: list[list[float | None]] = [[position, -0.0] for _ in ROWS]
    return StreamSample(tick / 100.0, tick, ["l_knee", "r_knee"], rows, imu)
