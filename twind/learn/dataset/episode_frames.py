"""Readings at the times that they came, as frames on a fixed grid. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twind.learn.dataset.episode_spans import EpisodeSpan, ReadingRun
from twind.observe.recording import RobotRecording
from twind.robot.arrays import Floats

Singles = NDArray[np.float32]

STATE = "observation.state"
VELOCITY = "observation.velocity"
EFFORT = "observation.effort"
ACTION = "action"
IMU = "observation.imu"
FELT = tuple(f"{what}_{axis}" for what in ("gyro", "acceleration") for axis in "xyz")
FELT += tuple(f"quaternion_{axis}" for axis in "wxyz")
FASTER = 1.05  # so much more than the median of its readings a frame may ask for, for the jitter of ticks


@dataclass(frozen=True, slots=True)
class EpisodeFrames:
    """One episode on the grid: frame k is at `time` + k / fps. Columns (k, n), NaN where nothing is known.

    Those of the IMU are `FELT`, all others of the joints.
    """

    recording: str
    task: str
    success: bool | None  # None: not marked
    time: float  # s since the recording's start
    columns: Mapping[str, Singles]  # by feature

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.columns[STATE])


def frames(
    recording: RobotRecording, part: EpisodeSpan, run: ReadingRun, fps: int, gap: float
) -> EpisodeFrames:
    """Return one stretch from its first reading on.

    Measured values lie on the line between the two readings around. A goal is the last one sent, and an IMU's
    reading the last one, at most `gap` s old.
    """
    rows = slice(run.first, run.last + 1)
    measured_rows = ~np.isnan(recording.measured[rows]).all(axis=1)
    time = recording.time[rows][measured_rows]
    count = int(np.floor((time[-1] - time[0]) * fps + 1e-6)) + 1
    grid = np.minimum(time[0] + np.arange(count) / fps, time[-1])

    def measured(column: Floats) -> Singles:
        return between(time, column[rows][measured_rows], grid).astype(np.float32)

    held = np.searchsorted(time, grid + 1e-9, "right") - 1
    columns = {
        STATE: measured(recording.measured),
        VELOCITY: measured(recording.velocity),
        EFFORT: measured(recording.effort),
        IMU: imu_rows(recording, grid, gap).astype(np.float32),
        ACTION: recording.goal[rows][measured_rows][held].astype(np.float32),
    }
    return EpisodeFrames(recording.path.name, part.task, part.success, float(time[0]), columns)


def between(time: Floats, column: Floats, at: Floats) -> Floats:
    """(j, n) on the line between the rows of `column` (k, n) around each time `at`, which is within `time`.

    At a time that is one of `time` it is that row, bit for bit.
    """
    after = np.clip(np.searchsorted(time, at, "left"), 0, len(time) - 1)
    before = np.where(time[after] > at, after - 1, after)
    span = time[after] - time[before]
    share = np.divide(at - time[before], span, out=np.zeros_like(at), where=span > 0.0)[:, None]
    found = column[before] + share * (column[after] - column[before])
    return np.where(share > 0.0, found, column[before])


def imu_rows(recording: RobotRecording, at: Floats, gap: float) -> Floats:
    """Return the IMU's last reading (j, 10) at each time; NaN: none, or older than `gap` s."""
    if recording.imu is None:
        return np.full((len(at), len(FELT)), np.nan)
    imu = recording.imu
    numbers = np.concatenate([imu.gyro, imu.acceleration, imu.quaternion], axis=1)
    known_rows = np.flatnonzero(~np.isnan(numbers).any(axis=1))
    if not known_rows.size:
        return np.full((len(at), len(FELT)), np.nan)
    last = np.searchsorted(recording.time[known_rows], at + 1e-9, "right") - 1
    row = known_rows[np.maximum(last, 0)]
    known = (last >= 0) & (at - recording.time[row] <= gap)
    return np.where(known[:, None], numbers[row], np.nan)


def rate(recording: RobotRecording, run: ReadingRun) -> float:
    """Readings a second, by their median; infinite for one reading."""
    time = recording.time[run.first : run.last + 1]
    return float(1.0 / np.median(np.diff(time))) if time.size > 1 else float("inf")


def too_fast(recording: RobotRecording, run: ReadingRun, fps: int) -> bool:
    """True if frames would come faster than readings did: most of them would be made up."""
    return fps > rate(recording, run) * FASTER
