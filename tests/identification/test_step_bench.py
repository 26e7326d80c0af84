"""A step asks the gate for less after a refusal, and a warm joint is not stepped."""

from types import SimpleNamespace
from typing import Any

import pytest

from twind.client import Refused
from twind.command_line.verb import Rejected
from twind.identification.live_excitation import SMALLER
from twind.identification.step_bench import StepBench

JOINT = {
    "name": "elbow",
    "lower": -1.0,
    "upper": 1.0,
    "velocity_limit": 4.0,
    "acceleration_limit": 20.0,
    "type": {"name": "xl430", "heat": {"cool": 47.0}},
}
COLD = 30.0


class RefusingRobot:
    """An armed robot whose gate refuses every motion."""

    def __init__(self, temperature: float, goal: float, armed: bool = True) -> None:
        self.status = {"mode": "live"}
        self.armed = armed
        self.limits = {"elbow": (-1.0, 1.0)}
        self.joints = {"elbow": SimpleNamespace(goal=goal, temperature=temperature)}
        self.asked: list[float] = []

    def submit(self, trajectory: dict[str, Any]) -> None:
        self.asked.append(trajectory["points"][0]["positions"][0])
        raise Refused("io.twind.Control.Refused", {"findings": [{"code": "SELF_COLLISION"}]})


class NoStates:
    """An observer that receives nothing."""

    def stream(self, *_: object, **__: object) -> list[Any]:
        return []

    def close(self) -> None: ...


def bench(robot: RefusingRobot) -> StepBench:
    joints = {"elbow": JOINT}
    return StepBench(robot, NoStates, joints, {"p": 800.0, "i": 0.0, "d": 0.0}, 0.2)  # type: ignore[arg-type]


def test_a_refused_step_is_tried_the_other_way_and_smaller_within_the_limits() -> None:
    robot = RefusingRobot(COLD, goal=0.9)
    with pytest.raises(Rejected, match="the gate refuses a step"):
        bench(robot).step("elbow")
    steps = [round(at - 0.9, 6) for at in robot.asked]
    assert steps[0] == -0.2 and all(-1.0 <= at <= 1.0 for at in robot.asked)
    assert {abs(step) for step in steps} == {round(0.2 * share, 6) for share in SMALLER}


def test_a_warm_joint_is_not_stepped() -> None:
    robot = RefusingRobot(48.0, goal=0.0)
    with pytest.raises(Rejected, match="48 °C"):
        bench(robot).step("elbow")
    assert robot.asked == []


def test_a_robot_without_torque_is_not_tuned() -> None:
    with pytest.raises(Rejected, match="twindctl arm"):
        bench(RefusingRobot(COLD, goal=0.0, armed=False))
