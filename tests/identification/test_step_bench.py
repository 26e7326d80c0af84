"""A step asks the gate for less after a refusal, and a warm joint is not stepped."""

from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.described_joint import JOINT
from twind.client import Refused
from twind.command_line.verb import Rejected
from twind.identification.live_excitation import SMALLER
from twind.identification.step_bench import StepBench

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


class TriedRobot(RefusingRobot):
    """Takes gains, while another client reloads the files."""

    def __init__(self) -> None:
        super().__init__(COLD, goal=0.0)
        self.state = SimpleNamespace(stamp=0.0)
        self.moved = False

    def states(self) -> list[SimpleNamespace]:
        return [self.state]

    def try_gains(self, kind: str, gains: dict[str, float]) -> None: ...

    def arm(self) -> None: ...

    def move(self, *_: object, **__: object) -> None:
        self.moved = True


class Describing(NoStates):
    """An observer that says which gains are in force."""

    def __enter__(self) -> "Describing":
        return self

    def __exit__(self, *_: object) -> None: ...

    def call(self, _method: str) -> dict[str, Any]:
        known = {**JOINT, "type": {"gains": {"p": 800, "i": 0, "d": 0}}}
        return {"robot": {"joints": [known]}}


def test_gains_that_another_client_replaced_end_the_tuning_before_a_step() -> None:
    robot = TriedRobot()
    given = {"p": 800.0, "i": 0.0, "d": 0.0}
    made = StepBench(robot, Describing, {"elbow": JOINT}, given, 0.2)  # type: ignore[arg-type]
    made.apply(given)
    assert robot.moved
    robot.moved = False
    with pytest.raises(Rejected, match="another client changed the gains"):
        made.apply({**given, "p": 1120.0})
    assert not robot.moved
