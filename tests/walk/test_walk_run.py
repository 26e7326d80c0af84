"""A walk ends at once when the daemon has latched a fault: an e-stop would replace the reaction to it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twind.client import MotionFailed, Refused
from twind.robot_client.goal_stream import StreamReport
from twind.robot_client.walk_run import FALLEN, run_walk

STILL = np.zeros(3)


class Stream:
    """Stand-in of a stream of ten periods; the third goal is refused for `code`."""

    period = 0.01

    def __init__(self, code: str) -> None:
        self.report = StreamReport()
        self._refused = Refused("io.twind.Control.Refused", {"findings": [{"code": code, "message": ""}]})

    def __enter__(self) -> "Stream":
        return self

    def __exit__(self, *_: object) -> None: ...

    def __iter__(self) -> Any:
        return iter(np.arange(10) * self.period)

    def send(self, goals: object) -> None:
        self.report.sent += 1
        if self.report.sent == 3:
            self.report.refused += 1
            self.report.refusal = self._refused


class Robot:
    """Stand-in of a robot that lies on its side once its goals are refused."""

    def __init__(self, code: str) -> None:
        self.made = Stream(code)
        self.joints = {"knee": SimpleNamespace(goal=0.0)}
        self.stops: list[str] = []

    @property
    def state(self) -> Any:
        tilt = 2 * FALLEN if self.made.report.refused else 0.0
        quaternion = np.array([np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0])
        inertial = SimpleNamespace(quaternion=quaternion, gyro=np.zeros(3), age=0.0)
        return SimpleNamespace(message=SimpleNamespace(inertial=inertial))

    def stream(self, **_: object) -> Any:
        return self.made

    def estop(self, *, reason: str) -> None:
        self.stops.append(reason)


ENGINE: Any = SimpleNamespace(stance=np.zeros(1), standing=False, steps=0, advance=lambda *given: np.zeros(1))


@pytest.mark.parametrize("code", ["FAULT_LATCHED", "ESTOP_LATCHED"])
def test_a_latch_ends_the_walk_without_an_e_stop(code: str) -> None:
    robot: Any = Robot(code)
    with pytest.raises(Refused):
        run_walk(robot, ENGINE, lambda now: STILL)
    assert robot.made.report.sent == 3
    assert robot.stops == []


def test_a_fall_that_the_daemon_does_not_detect_is_stopped_by_the_client() -> None:
    robot: Any = Robot("VEL_LIMIT")
    with pytest.raises(MotionFailed):
        run_walk(robot, ENGINE, lambda now: STILL)
    assert len(robot.stops) == 1
