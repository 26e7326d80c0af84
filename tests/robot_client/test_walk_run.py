"""A walk ends at rest, or says why it did not: refusals, a silent IMU, a fall, a command too fast."""

import math
from collections.abc import Callable, Iterator, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mink", reason="the extra walk")

from twind.client import MotionFailed, Refused
from twind.config.robot_file import load_robot
from twind.exceptions import InvalidInput
from twind.robot_client.goal_stream import StreamReport
from twind.robot_client.state_message import ImuReading
from twind.robot_client.walk_run import FASTEST, MOST_REFUSED, WalkOutcome, run_walk, velocity
from twind.walk.walking_engine import WalkingEngine

ROBOT = load_robot("h24-standing")
PERIOD = 0.01
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
LYING = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)


class StandInStream:
    """Takes goals in virtual time."""

    def __init__(self, robot: "StandInRobot") -> None:
        self.period = PERIOD
        self.report = StreamReport()
        self._robot = robot

    def __enter__(self) -> "StandInStream":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[float]:
        for tick in range(10_000):
            self._robot.now = tick * PERIOD
            yield self._robot.now

    def send(self, goals: Any) -> None:
        self._robot.goals = goals
        self.report.sent += 1
        if self._robot.now >= self._robot.refuses_from:
            self.report.refused += 1
            found = [{"code": self._robot.code, "message": ""}]
            self.report.refusal = Refused("io.twind.Control.Refused", {"findings": found})


class StandInRobot:
    """Follows at once; `imu`: its reading at a time."""

    name = "h24-standing"
    names = ROBOT.names

    def __init__(self, imu: Callable[[float], ImuReading | None], *, armed: bool = True) -> None:
        self.engine = WalkingEngine(ROBOT)
        self.goals: Any = self.engine.stance
        self.now = 0.0
        self.refuses_from = math.inf
        self.last_state = math.inf  # s, when it was sent
        self.code = "VEL_LIMIT"  # of its refusals
        self.stopped: list[str] = []
        self.moved: list[Mapping[str, float]] = []
        self._imu = imu
        self._armed = armed

    @property
    def joints(self) -> Any:
        goals = self.goals if self._armed else [None] * len(self.names)
        return {name: SimpleNamespace(goal=goal) for name, goal in zip(self.names, goals, strict=True)}

    @property
    def state(self) -> Any:
        held = min(self.now, self.last_state)
        return SimpleNamespace(message=SimpleNamespace(inertial=self._imu(held)), elapsed=self.now - held)

    def move(self, goals: Mapping[str, float], *, retime: bool = False) -> None:
        self.moved.append(goals)

    def stream(self, *, rate: float, strict: bool) -> Any:
        return StandInStream(self)

    def estop(self, *, reason: str) -> None:
        self.stopped.append(reason)

    def walk(
        self, command: tuple[float, float, float] = (0.1, 0.0, 0.0), seconds: float = 3.0
    ) -> WalkOutcome:
        return run_walk(self, self.engine, lambda _: command, seconds)


def reading(quaternion: tuple[float, ...] = UPRIGHT, age: float = 0.01) -> ImuReading:
    return ImuReading(np.zeros(3), np.zeros(3), np.array(quaternion), age)


def test_a_walk_ends_at_rest_in_its_stance() -> None:
    robot = StandInRobot(lambda now: reading())
    outcome = robot.walk()
    assert robot.engine.standing and outcome.steps > 2 and outcome.refused == 0
    assert np.abs(robot.goals - robot.engine.stance).max() < 0.2


def test_the_fastest_tried_velocity_is_taken() -> None:
    forward, left, turn = FASTEST.tolist()
    assert np.array_equal(velocity((forward, -left, -turn)), FASTEST * [1.0, -1.0, -1.0])


@pytest.mark.parametrize(
    ("wanted", "name"),
    [((0.13, 0.0, 0.0), "forward"), ((0.0, -0.04, 0.0), "left"), ((0.0, 0.0, float("nan")), "turn")],
)
def test_a_velocity_beyond_what_was_tried_is_refused_before_anything_moves(
    wanted: tuple[float, float, float], name: str
) -> None:
    robot = StandInRobot(lambda now: reading())
    with pytest.raises(InvalidInput, match=name):
        robot.walk(wanted)
    assert robot.now == 0.0 and not robot.moved


@pytest.mark.parametrize("inertial", [None, reading(age=30.0)])
def test_a_robot_without_a_fresh_imu_does_not_walk(inertial: ImuReading | None) -> None:
    robot = StandInRobot(lambda now: inertial)
    with pytest.raises(InvalidInput, match="IMU"):
        robot.walk()
    assert robot.now == 0.0


def test_a_robot_without_goals_does_not_walk() -> None:
    with pytest.raises(InvalidInput, match="arm"):
        StandInRobot(lambda now: reading(), armed=False).walk()


def test_a_robot_that_refuses_goals_is_sent_no_more() -> None:
    robot = StandInRobot(lambda now: reading())
    robot.refuses_from = 1.5
    with pytest.raises(Refused):
        robot.walk()
    assert robot.now <= 1.5 + (MOST_REFUSED + 2) * PERIOD


@pytest.mark.parametrize("code", ["FAULT_LATCHED", "ESTOP_LATCHED"])
def test_a_latch_ends_the_walk_without_an_e_stop_which_would_replace_the_reaction(code: str) -> None:
    robot = StandInRobot(lambda now: reading(LYING if now > 1.5 else UPRIGHT))
    robot.code = code
    robot.refuses_from = 1.5
    with pytest.raises(Refused):
        robot.walk()
    assert robot.stopped == []
    assert robot.now == pytest.approx(1.5 + PERIOD)


def test_a_robot_whose_imu_falls_silent_stands_and_says_so() -> None:
    robot = StandInRobot(lambda now: reading(age=0.01 if now < 1.5 else now))
    with pytest.raises(MotionFailed, match="IMU fell silent"):
        robot.walk(seconds=60.0)
    assert robot.engine.standing and robot.now < 10.0


@pytest.mark.parametrize(("age", "steps"), [(0.05, 4), (0.06, 0)])
def test_readings_of_up_to_five_ticks_balance_a_walk(age: float, steps: int) -> None:
    robot = StandInRobot(lambda now: reading(age=age if now > 0.5 else 0.01))
    if steps:
        assert robot.walk().steps >= steps
    else:
        with pytest.raises(MotionFailed, match="IMU fell silent"):
            robot.walk()


def test_a_state_that_no_newer_one_follows_balances_no_walk() -> None:
    robot = StandInRobot(lambda now: reading())
    robot.last_state = 1.5
    with pytest.raises(MotionFailed, match="IMU fell silent"):
        robot.walk(seconds=60.0)
    assert robot.engine.standing and robot.now < 10.0


def test_a_command_that_becomes_too_fast_ends_the_walk_in_its_stance() -> None:
    robot = StandInRobot(lambda now: reading())
    with pytest.raises(InvalidInput, match="forward"):
        run_walk(robot, robot.engine, lambda now: (0.1 if now < 1.5 else 1.0, 0.0, 0.0))
    assert robot.engine.standing and robot.now < 10.0


@pytest.mark.parametrize("quaternion", [LYING, (math.nan,) * 4])
def test_a_robot_that_fell_is_stopped(quaternion: tuple[float, ...]) -> None:
    robot = StandInRobot(lambda now: reading(UPRIGHT if now < 1.5 else quaternion))
    with pytest.raises(MotionFailed, match="fell"):
        robot.walk()
    assert robot.stopped and robot.now == pytest.approx(1.5)
