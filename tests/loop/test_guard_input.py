"""Input of the guard: each value as it is in this tick, and no joint without goals counts as held."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import NAMES, PERIOD, PLACE, REST, ProcedureRig
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.loop.tick.guard_input import facts
from twind.robot.joint_state import JointState
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.trajectory import Reference
from twind.safety.guard_types import GuardInput

NOW = 101.0
LIMP = np.array([False, True, False])
ZERO = np.zeros(len(NAMES))
GOAL = Reference(REST, ZERO, ZERO)


class Input(ProcedureRig):
    """Live and connected; every register of the buses has a value of its own."""

    def __init__(self) -> None:
        super().__init__()
        count = len(NAMES)
        slow = vars(self.hardware.slow)
        slow.update({name: np.full(count, place) for place, name in enumerate(("fault", "tick", "voltage"))})
        slow.update({name: np.full(count, 40.0) for name in ("temperature", "health_time")})
        readings = vars(self.hardware.readings)
        readings.update({name: np.full(count, 7) for name in ("alerts", "jumps", "leaps")})
        readings["loads"] = lambda now: np.full(count, now)
        self.hardware.last_exchange = SimpleNamespace(discarded=5, traffic=("lower", "upper"))
        self.hardware.is_whole = True
        self.clock.slept = 0.25
        self.figures: Any = SimpleNamespace(lateness=0.003, missed_in_a_row=2)

    def facts(
        self, reference: Reference | None = GOAL, target: JointState | None = None, *, held: bool = False
    ) -> GuardInput:
        return facts(self, self.figures, reference, target or self.robot.measured, NOW, lease_held=held)


@pytest.fixture
def rig() -> Input:
    return Input()


def waits() -> Procedure:
    while True:
        yield


# ------------------------------------------------------------------------------------------- one by one


def test_time_state_and_motion_are_those_of_the_tick(rig: Input) -> None:
    rig.hold()
    given = rig.facts()
    assert (given.now, given.period, given.lateness, given.missed_in_a_row) == (NOW, PERIOD, 0.003, 2)
    assert (given.mode, given.state, given.motion) == (Mode.LIVE, RobotState.ARMED, Motion.HOLDING)
    assert given.suspended == 0.25
    assert given.setpoint_age is None


def test_registers_and_traffic_are_those_that_were_read_last(rig: Input) -> None:
    given = rig.facts()
    slow = rig.hardware.slow
    assert given.torque is slow.torque
    assert given.watchdog is slow.watchdog
    assert (given.status_time, given.health_time) == (pytest.approx(slow.status_time), slow.health_time)
    assert (given.fault, given.tick, given.voltage) == (slow.fault, slow.tick, slow.voltage)
    assert given.temperature is slow.temperature
    readings = rig.hardware.readings
    assert (given.alerts, given.jumps, given.leaps) == (readings.alerts, readings.jumps, readings.leaps)
    assert (given.discarded, given.traffic) == (5, ("lower", "upper"))
    assert given.load is not None
    assert given.load.tolist() == [NOW] * 3


def test_a_goal_is_compared_with_the_last_one_that_left_and_without_one_nothing_is(rig: Input) -> None:
    rig.robot.written = PLACE
    assert (rig.facts().goal, rig.facts().previous) == (GOAL, PLACE)
    assert (rig.facts(None).goal, rig.facts(None).previous) == (None, None)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("owned", [False, True])
def test_a_motion_goes_on_under_a_lease_or_by_a_procedure_which_leaves_torque_unsettled(
    rig: Input, held: bool, owned: bool
) -> None:
    if owned:
        rig.own(Priority.FAULT, waits)
    given = rig.facts(held=held)
    assert given.lease_ok is (held or owned)
    assert given.torque_settled is not owned


def test_torque_is_expected_of_a_robot_that_this_daemon_holds(rig: Input) -> None:
    assert not rig.facts().torque_expected
    rig.hold()
    assert rig.facts().torque_expected


def test_joints_are_limp_by_request_alone(rig: Input) -> None:
    assert rig.facts().limp is None
    rig.torque.leave_limp(LIMP)
    limp = rig.facts().limp
    assert limp is not None
    assert limp.tolist() == LIMP.tolist()


def test_clearance_and_torque_from_outside_are_judged_where_the_robot_has_them(rig: Input) -> None:
    given = rig.facts()
    assert (given.outlook, given.external) == (None, None)
    assert given.simulated is rig.robot.simulated
    rig.robot.outlook = SimpleNamespace(look=lambda executor: ("ahead", executor))  # type: ignore[assignment]
    rig.robot.observer = SimpleNamespace(external="push")  # type: ignore[assignment]
    given = rig.facts()
    assert (given.outlook, given.external) == (("ahead", rig.executor), "push")


def test_the_watchdog_of_a_joint_that_was_left_out_is_not_judged(rig: Input) -> None:
    rig.hardware.slow.watchdog[:] = (5, 255, 255)
    rig.hardware.left_out = LIMP
    assert rig.facts().watchdog.tolist() == [5, -1, 255]


# ------------------------------------------------------------------------------------------- what is measured


@pytest.mark.parametrize(
    ("age", "fresh", "there"),
    [
        ((np.inf, np.inf, np.inf), (False, False, False), False),
        ((np.inf, 0.3, np.inf), (False, False, False), True),
        ((np.inf, np.inf, np.inf), (False, True, False), True),
        ((0.0, 0.0, 0.0), (True, True, True), True),
    ],
)
def test_nothing_is_measured_before_the_first_reading_of_a_joint(
    rig: Input, age: Any, fresh: Any, there: bool
) -> None:
    rig.read(age=np.array(age), heard=np.array(fresh))
    assert (rig.facts().measured is not None) is there


def test_the_state_that_follows_commands_is_judged(rig: Input) -> None:
    simulated = rig.state(REST)
    assert rig.facts(target=simulated).measured is simulated


def test_joints_that_get_no_goals_beside_held_ones_count_as_not_read(rig: Input) -> None:
    """A bus that was lost and is back, or a joint that was left out: it follows nothing."""
    rig.hold()
    rig.hardware.is_whole = False
    rig.hardware.left_out = LIMP
    rig.read(heard=np.array([True, True, False]))
    measured = rig.facts().measured
    assert measured is not None
    assert measured.heard.tolist() == [True, False, False]
    assert measured.position is rig.robot.measured.position


@pytest.mark.parametrize(("holds", "whole"), [(False, False), (True, True), (False, True)])
def test_without_held_joints_or_with_all_of_them_each_reading_counts(
    rig: Input, holds: bool, whole: bool
) -> None:
    if holds:
        rig.hold()
    rig.hardware.is_whole = whole
    rig.hardware.left_out = LIMP
    assert rig.facts().measured is rig.robot.measured
