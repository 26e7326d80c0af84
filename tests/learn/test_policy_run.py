"""A drive from state to setpoint: what the gate refuses is counted, and what ends it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.support.policy_world import PERIOD, World
from twind.client import Disconnected, Refused
from twind.learn.policy.policy_run import PolicyRun
from twind_drivers.clock import FakeClock


class Robot(World):
    """The controller's world with connections: states are always fresh, `refuse` is what the gate says."""

    def __init__(self) -> None:
        super().__init__()
        self.status: dict[str, Any] = {"mode": "live", "armed": True, "state": "armed", "faults": []}
        self.ended = ""
        self.kept = 0
        self.said = list[str]()
        self.refuse: Callable[[int], str] = lambda number: ""
        self.tried = self.settled = 0
        self.clock = FakeClock()
        self.clock.time = self.now
        self.drive = PolicyRun(self.controller, self, self, PERIOD, 0.01, self.clock, self.said.append)  # type: ignore[arg-type]

    @property
    def newest(self) -> Any:
        return self.state_message()

    def next_states(self) -> list[Any]:
        return [self.state_message()]

    def send(self, position: np.ndarray, velocity: np.ndarray, *, wait: bool) -> None:
        assert wait is (self.controller.holding is not None)
        self.tried += 1
        code = self.refuse(self.tried)
        if code:
            found = {"code": code, "joint": "knee", "message": "no"}
            raise Refused("io.twind.Control.Refused", {"findings": [found]})
        self.goal = position + velocity * PERIOD

    def take(self) -> None: ...

    def settle(self) -> None:
        self.settled += 1

    def lapses(self, missed: int) -> bool:
        return missed >= 2

    def keep(self) -> None:
        self.kept += 1

    def run(self, seconds: float = 0.4, each: Callable[[], None] = lambda: None) -> tuple[bool, str]:
        def stop() -> bool:
            each()
            self.now = self.clock.now()  # the controller's
            return False

        return self.drive.run(seconds, stop, lambda drive: None)

    def report(self) -> dict[str, Any]:
        return self.drive.log.plain(self.controller, self.drive.timer)


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_a_policy_run_ends_after_its_duration(robot: Robot) -> None:
    good, why = robot.run(0.2)
    told = robot.report()
    assert good and why == "0.2 s are over" and robot.settled == 1
    assert told["steps"] == 10 and told["missed"] == 0 and told["refused"] == 0 and robot.kept == 0


@pytest.mark.parametrize(("pause", "missed", "steps", "holds"), [(0.03, 1, 9, 0), (0.05, 2, 7, 1)])
def test_missed_periods_are_counted_and_not_made_up(
    robot: Robot, pause: float, missed: int, steps: int, holds: int
) -> None:
    def slow(number: int) -> str:
        robot.clock.time += pause if number == 3 else 0.0
        return ""

    robot.refuse = slow
    good, _ = robot.run(0.2)
    told = robot.report()
    assert good and told["missed"] == missed and told["steps"] == steps
    assert told["holds"] == holds  # 0.06 s after a setpoint the gate holds, and so does the controller
    assert all("2 periods were missed" in said for said in robot.said) and len(robot.said) == holds


def test_a_refusal_is_counted_by_code_and_joint_and_holds(robot: Robot) -> None:
    robot.refuse = lambda number: "POS_LIMIT" if number == 3 else ""
    good, _ = robot.run()
    assert good and robot.report()["refusals"] == {"POS_LIMIT": {"knee": 1}}
    assert robot.said == ["refused: POS_LIMIT knee"] and robot.kept > 0


@pytest.mark.parametrize("code", ["LEASE_MISSING", "ESTOP_LATCHED", "NOT_ARMED", "MODE_DENIES"])
def test_a_refusal_of_everything_is_the_end(robot: Robot, code: str) -> None:
    robot.refuse = lambda number: code if number == 2 else ""
    good, why = robot.run()
    assert not good and code in why and robot.tried == 2


@pytest.mark.parametrize(
    ("status", "message"),
    [
        ({"mode": "mirror"}, "the mode is now mirror, it was live"),
        ({"armed": False, "state": "fault"}, "no longer armed: fault"),
    ],
)
def test_another_state_of_the_robot_is_the_end(robot: Robot, status: dict[str, Any], message: str) -> None:
    good, why = robot.run(each=lambda: robot.status.update(status))
    assert not good and message in why and robot.tried == 0


def test_a_daemon_that_is_gone_is_the_end(robot: Robot) -> None:
    robot.ended = "the daemon closed the connection"
    assert robot.run() == (False, "the daemon closed the connection")


def test_a_connection_that_breaks_is_the_end(robot: Robot) -> None:
    def broken(_number: int) -> str:
        raise Disconnected("gone")

    robot.refuse = broken
    assert robot.run() == (False, "gone")
