"""Columns of a recorded file: one reader for pictures, replay and export.

`open_recording` reads an .mcap (of ours, or any with JointState messages in it) or a .flight file, also where
its end is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Parameters = Mapping[str, Any]  # an object of the interface, as the daemon sent it


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One recorded message, as the daemon sent it: an event, a verdict, a status."""

    time: float  # s since `RobotRecording.start_ns`
    what: Parameters


@dataclass(frozen=True, slots=True)
class RecordedEpisode:
    """Marked stretch of a recording. Times in s since the start; NaN: not in this file."""

    task: str
    begin: float
    end: float
    success: bool | None  # None: not stated


@dataclass(frozen=True, slots=True)
class SlowColumns:
    """Values of each joint that the daemon sends a few times a second. `time` (m,); the others (m, n), NaN:
    unknown."""

    time: Floats  # s
    temperature: Floats  # °C
    voltage: Floats  # V
    torque: Floats  # 1 on, 0 off
    age: Floats  # s


@dataclass(frozen=True, slots=True)
class ExternalColumns:
    """Torque from outside as the daemon estimated it. `time` (m,); the others (m, n), NaN: no estimate.

    Every tick of a flight file; of an .mcap the slow messages of joints.
    """

    time: Floats  # s
    torque: Floats  # N·m
    deviation: Floats  # N·m, one standard deviation
    contact: NDArray[np.bool_]  # CONTACT was present


@dataclass(frozen=True, slots=True)
class LatencyColumns:
    """Latency of one hop. Every column (m,), in ms, NaN: unknown; `violations` a count."""

    time: Floats  # s
    columns: Mapping[str, Floats]  # now_ms, mean_ms, std_ms, min_ms, max_ms, p50_ms, p99_ms, violations
    histogram: Sequence[Parameters]  # of the run, as last reported: {"upper_ms", "count"}


@dataclass(frozen=True, slots=True)
class ImuColumns:
    """IMU readings in the axes of the base; in mode sim the simulation's. Rows as `RobotRecording.time`.

    NaN where no new reading arrived.
    """

    gyro: Floats  # rad/s, (k, 3)
    acceleration: Floats  # m/s², (k, 3)
    quaternion: Floats  # w x y z, (k, 4)


@dataclass(frozen=True, slots=True)
class RobotRecording:
    """One file. Rows (k, n): k readings, n joints in `joints`' order; NaN where nothing is known.

    `time` is in s since `start_ns` and never goes back; every other time here is of the same clock.
    """

    path: Path
    start_ns: int  # wall clock, ns since 1970, of time 0
    joints: tuple[str, ...]
    time: Floats  # (k,)
    measured: Floats  # rad; in mode sim there is nothing to measure
    velocity: Floats  # rad/s
    effort: Floats  # N·m
    goal: Floats  # rad
    simulated: Floats  # rad
    imu: ImuColumns | None = None  # None: there is none in it
    external: ExternalColumns | None = None  # None: no torque from outside was ever estimated
    events: tuple[RecordedMessage, ...] = ()  # Event of the interface
    verdicts: tuple[RecordedMessage, ...] = ()  # Verdict
    statuses: tuple[RecordedMessage, ...] = ()  # Status
    notes: tuple[RecordedMessage, ...] = ()  # of who recorded: drops, steps of the clock
    slow: SlowColumns | None = None
    latency: Mapping[str, LatencyColumns] = field(default_factory=dict)  # by hop
    episodes: tuple[RecordedEpisode, ...] = ()
    meta: Mapping[str, str] = field(default_factory=dict)  # version, robot, individual, mode, clocks …
    robot: Parameters | None = None  # as GetRobot answers
    calibration: Parameters | None = None
    mjcf: str | None = None
    damage: str = ""  # why it is not whole, in words; empty: it is

    @property
    def duration(self) -> float:
        """s from the first reading to the last."""
        return float(self.time[-1] - self.time[0]) if self.time.size else 0.0

    @property
    def live(self) -> NDArray[np.bool_]:
        """(k,) bool: commands went to the robot at each reading, not to the simulation.

        Without a status: true where there is no simulation.
        """
        if not self.statuses:
            return np.asarray(~np.isfinite(self.simulated).any(axis=1))
        times = np.array([said.time for said in self.statuses])
        live = np.array([said.what.get("mode") == "live" for said in self.statuses])
        return np.asarray(live[np.clip(np.searchsorted(times, self.time, "right") - 1, 0, None)])

    @property
    def target(self) -> Floats:
        """(k, n), rad: the positions of whatever commands went to, which are to follow `goal`."""
        return np.where(self.live[:, None], self.measured, self.simulated)


def marked(events: Sequence[RecordedMessage]) -> tuple[RecordedEpisode, ...]:
    """The episodes that events mark, in order; a begin ends whatever is still open."""
    found: list[RecordedEpisode] = []
    task = ""
    begin = float("nan")
    is_open = False
    for said in events:
        mark = said.what.get("annotation") or {}
        if mark.get("kind") not in ("begin", "end"):
            continue
        if mark["kind"] == "end" or is_open:
            end = mark if mark["kind"] == "end" else {}
            found.append(RecordedEpisode(task or end.get("task") or "", begin, said.time, end.get("success")))
        is_open = mark["kind"] == "begin"
        task, begin = (mark.get("task") or "", said.time) if is_open else ("", float("nan"))
    if is_open:
        found.append(RecordedEpisode(task, begin, float("nan"), None))
    return tuple(found)
