"""Samples of a motion from a recording, or from messages of a daemon."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twind.exceptions import InvalidInput
from twind.gap.motion_samples import MotionSamples
from twind.observe.recording.recording_columns import RobotRecording

COLUMNS = ("goal", "position", "velocity", "effort")
LONGEST_PERIOD = 0.05  # s between two samples: beyond, goals between them are not known


def require_sent_goals(robot: Mapping[str, Any] | None) -> None:
    """Raise InvalidInput for a described robot whose servos got other goals than its states hold."""
    if robot is not None and robot.get("compensate_gravity"):
        raise InvalidInput(
            "its goals had an offset against gravity that states do not hold: set loop.compensate_gravity to "
            "false, restart the daemon, and record again"
        )


def recorded_motion(recording: RobotRecording) -> MotionSamples:
    """Return the samples of mode live; goals are NaN elsewhere, as they did not reach the robot."""
    fresh = np.concatenate([[True], np.diff(recording.time) > 0.0])[: len(recording.time)]
    return MotionSamples(
        names=tuple(recording.joints),
        time=recording.time[fresh],
        goal=np.where(recording.live[:, None], recording.goal, np.nan)[fresh],
        position=recording.measured[fresh],
        velocity=recording.velocity[fresh],
        effort=recording.effort[fresh],
    )


def received_motion(messages: Sequence[Mapping[str, Any]]) -> MotionSamples:
    """Return the samples of messages of topic `state`, at least one, of mode live only."""
    names = tuple(str(joint["name"]) for joint in messages[0]["joints"])
    told = {
        key: np.array([[_number(joint[key]) for joint in one["joints"]] for one in messages])
        for key in COLUMNS
    }
    live = np.array([one.get("mode") == "live" for one in messages])
    return MotionSamples(
        names=names,
        time=np.array([float(one["time"]) for one in messages]),
        goal=np.where(live[:, None], told["goal"], np.nan),
        position=told["position"],
        velocity=told["velocity"],
        effort=told["effort"],
    )


def control_period(samples: MotionSamples) -> float | None:
    """Return the control period that samples were taken at, s; None: too long to know all goals."""
    period = samples.period
    return 1.0 / round(1.0 / period) if 1e-3 <= period <= LONGEST_PERIOD else None


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
