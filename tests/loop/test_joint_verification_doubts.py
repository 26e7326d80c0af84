"""Joints whose devices fell silent, restarted, had an error or lost their turn, and are identified anew."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.verification_rig import HIP, KNEE, MIDDLE, PLACES, SCALE, TOE, WHOLE, Verifying, at_middle
from twind.loop.bus.bus_port import PortState
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.robot.finding import Finding, ReasonCode
from twind.safety.device_rules import ALERT


@pytest.fixture
def whole() -> Verifying:
    return at_middle()


def waits() -> Procedure:
    while True:
        yield


def identifications(robot: Verifying) -> list[int]:
    """Count the identifications of each bus that were begun."""
    return [port.identified for port in robot.ports]


# ------------------------------------------------------------------------------- errors and restarts


def test_a_device_with_an_error_is_identified_anew_once_it_is_gone(whole: Verifying) -> None:
    slow = whole.rig.hardware.slow
    whole.readings.alerts[KNEE] = ALERT | 1
    whole.verified.mar([Finding(ReasonCode.SERVO_ALERT, KNEE), Finding(ReasonCode.SERVO_ALERT)])
    whole.tick(9)
    assert identifications(whole) == [0, 0] and whole.joints == [True, False, True]
    whole.readings.alerts[KNEE] = 1
    slow.fault[KNEE] = 4
    whole.tick(9)
    assert identifications(whole) == [0, 0], "its error bits are still there"
    slow.fault[KNEE] = -1
    whole.tick()
    assert identifications(whole) == [1, 0]
    whole.tick(9)
    assert identifications(whole) == [1, 0], "it is being identified"
    whole.identify(0)
    whole.tick(3)
    assert whole.joints == [True] * 3 and identifications(whole) == [1, 0]


def test_a_device_with_an_error_in_its_register_stays_unverified(whole: Verifying) -> None:
    whole.ports[0].identify()
    whole.tick()
    whole.rig.hardware.slow.fault[HIP] = 4
    whole.identify(0)
    whole.tick(3)
    assert whole.known == [True] * 3 and whole.joints == [False, True, True]


def test_an_identification_in_which_a_device_is_missing_heals_the_others_alone(whole: Verifying) -> None:
    whole.verified.mar([Finding(ReasonCode.SERVO_ALERT, KNEE), Finding(ReasonCode.SERVO_ALERT, HIP)])
    whole.tick()
    whole.identify(0, fits=[True, False])
    whole.identify(0, fits=[True, False])
    whole.ports[0].link = PortState.CONNECTED
    whole.rig.own(Priority.DISARM, waits)
    whole.tick(4)
    assert whole.joints == [True, False, True]


@pytest.mark.parametrize("prevents", ["a procedure", "a request", "silence", "a closed bus"])
def test_a_healed_device_waits_for_what_is_under_way(whole: Verifying, prevents: str) -> None:
    whole.verified.mar([Finding(ReasonCode.SERVO_ALERT, KNEE)])
    if prevents == "a procedure":
        whole.rig.own(Priority.DISARM, waits)
    elif prevents == "a request":
        whole.ports[0].tasks.append("reboot")
    elif prevents == "silence":
        whole.heard[KNEE] = False
    else:
        whole.ports[0].link = PortState.CLOSED
    whole.tick(5)
    assert identifications(whole) == [0, 0]


def test_a_restart_forgets_the_turn_and_an_error_does_not(whole: Verifying) -> None:
    whole.rig.own(Priority.HOME, waits)
    whole.rig.torque.begin_energising()  # no turn is chosen meanwhile
    whole.verified.mar([Finding(ReasonCode.SERVO_ALERT, HIP)])
    assert whole.known == [True] * 3
    whole.verified.restarted([Finding(ReasonCode.SERVO_REBOOTED, KNEE), Finding(ReasonCode.SERVO_REBOOTED)])
    assert whole.known == [True, False, True] and whole.joints == [False, False, True]


def test_a_doubted_turn_is_chosen_by_three_readings(whole: Verifying) -> None:
    whole.rig.own(Priority.HOME, waits)
    whole.verified.restarted([Finding(ReasonCode.SERVO_REBOOTED, KNEE)])
    whole.tick(2)
    assert whole.known == [True, False, True]
    whole.tick(1)
    assert whole.known == [True] * 3


# ------------------------------------------------------------------------------- silences


def silence(robot: Verifying, joint: int, ticks: int) -> None:
    robot.heard[joint] = False
    robot.tick(ticks)
    robot.heard[joint] = True
    robot.tick()


@pytest.mark.parametrize(("ticks", "doubted"), [(9, False), (11, True)])
@pytest.mark.parametrize("joint", [HIP, TOE])
def test_a_limp_device_that_was_silent_for_a_tenth_of_a_second_is_identified_identifications(
    whole: Verifying, joint: int, ticks: int, doubted: bool
) -> None:
    silence(whole, joint, ticks)
    bus = joint == TOE
    assert identifications(whole) == [doubted and not bus, doubted and bus]
    assert whole.joints[joint] is not doubted


@pytest.mark.parametrize(("ticks", "doubted"), [(3, False), (4, True)])
def test_at_a_low_rate_lost_replies_are_no_silence(ticks: int, doubted: bool) -> None:
    robot = Verifying(0.05)
    robot.raw[TOE] = MIDDLE
    robot.identified()
    silence(robot, KNEE, ticks)
    assert identifications(robot) == [doubted, False]


def test_a_silence_counts_from_a_tenth_of_a_second_on() -> None:
    robot = Verifying(0.005)
    robot.raw[TOE] = MIDDLE
    robot.identified()
    silence(robot, KNEE, 21)
    assert identifications(robot) == [1, 0]


def test_a_silence_that_an_identification_ends_needs_no_other_one(whole: Verifying) -> None:
    whole.heard[KNEE] = False
    whole.tick(20)
    whole.ports[0].identify()
    whole.heard[KNEE] = True
    whole.tick(2)
    whole.identify(0)
    whole.tick(5)
    assert identifications(whole) == [1, 0] and whole.joints == [True] * 3


@pytest.mark.parametrize("holds", ["armed", "energising"])
def test_a_device_that_was_silent_under_torque_is_identified_anew_when_torque_is_off(
    whole: Verifying, holds: str
) -> None:
    if holds == "armed":
        whole.hold()
    else:
        whole.rig.torque.begin_energising()
    silence(whole, KNEE, 20)
    whole.tick(20)
    assert identifications(whole) == [0, 0] and whole.joints[KNEE]
    whole.let_go()
    whole.tick()
    assert identifications(whole) == [1, 0] and not whole.joints[KNEE]
    whole.tick()
    whole.identify(0)
    whole.tick(9)
    assert identifications(whole) == [1, 0] and whole.joints == [True] * 3


def test_the_silence_of_an_inhibited_daemon_is_not_that_of_its_devices(whole: Verifying) -> None:
    whole.rig.torque.inhibit()
    silence(whole, KNEE, 30)
    assert identifications(whole) == [0, 0]
    whole.rig.torque.lift_inhibit()
    whole.tick(5)
    assert identifications(whole) == [0, 0] and whole.joints == [True] * 3


def test_a_silence_before_the_identification_does_not_count() -> None:
    robot = Verifying()
    for port in robot.ports:
        port.link = PortState.IDENTIFYING
    robot.heard[KNEE] = False
    robot.tick(30)
    robot.identify()
    robot.tick(5)
    robot.heard[KNEE] = True
    robot.tick(4)
    assert identifications(robot) == [0, 0] and robot.known == [True, True, False]


def test_a_joint_of_a_long_travel_is_doubted_as_soon_as_it_is_silent(whole: Verifying) -> None:
    whole.hold()
    whole.heard[TOE] = whole.heard[KNEE] = False
    whole.tick(9)
    assert whole.known == [True] * 3
    whole.tick(2)
    assert whole.known == [True, True, False]


# ------------------------------------------------------------------------------- turns that were lost


def leap(robot: Verifying, joint: int, counts: float) -> None:
    """A reading was dropped that was so far off."""
    robot.readings.jumps[joint] = 1
    robot.readings.leaps[joint] = counts * SCALE
    robot.tick()
    robot.readings.jumps[joint] = 0


@pytest.mark.parametrize(("counts", "doubted"), [(2047, False), (2048, True)])
def test_a_jump_of_half_a_turn_lets_the_turn_be_chosen_identifications(
    whole: Verifying, counts: float, doubted: bool
) -> None:
    leap(whole, KNEE, counts)
    assert whole.known == [True, not doubted, True]
    whole.tick(3)
    assert whole.known == [True] * 3


def test_a_jump_that_is_over_doubts_no_turn_beside_that_of_another_joint(whole: Verifying) -> None:
    whole.readings.leaps[KNEE] = 4096 * SCALE
    leap(whole, HIP, 1.0)
    assert whole.known == [True] * 3


def test_a_joint_inside_its_travel_on_another_turn_keeps_it() -> None:
    robot = Verifying()
    robot.raw[:] = (PLACES[HIP], PLACES[KNEE] + 2 * WHOLE, MIDDLE)
    robot.identified()
    for _ in range(150):
        robot.tick()
        assert robot.known == [True] * 3


@pytest.mark.parametrize("holds", ["armed", "energising"])
def test_under_torque_a_jump_changes_no_turn(whole: Verifying, holds: str) -> None:
    if holds == "armed":
        whole.hold()
    else:
        whole.rig.torque.begin_energising()
    leap(whole, KNEE, 4096)
    assert whole.known == [True] * 3


def test_a_jump_of_a_joint_without_a_travel_changes_nothing(whole: Verifying) -> None:
    turns = whole.rig.robot.joints.turns
    turns.known[KNEE] = False
    leap(whole, KNEE, 4096)
    assert whole.known == [True] * 3


def test_a_limp_joint_out_of_its_travel_for_a_second_takes_the_turn_that_fits(whole: Verifying) -> None:
    whole.raw[KNEE] += WHOLE
    whole.tick(100)
    assert whole.places[KNEE] == PLACES[KNEE] + WHOLE and whole.turned == []
    whole.tick(5)
    assert whole.joints == [True] * 3 and whole.places[KNEE] == PLACES[KNEE]
    assert whole.turned == [0]


def back_in_between(robot: Verifying) -> None:
    robot.tick(60)
    robot.raw[KNEE] -= WHOLE
    robot.tick()
    robot.raw[KNEE] += WHOLE
    robot.tick(60)


def on_another_joint(robot: Verifying) -> None:
    robot.tick(60)
    robot.raw[KNEE] -= WHOLE
    robot.raw[TOE] = -100
    robot.tick(60)


def no_turn_fits(robot: Verifying) -> None:
    robot.raw[KNEE] = 3000
    robot.tick(150)


def with_torque(robot: Verifying) -> None:
    robot.rig.hardware.slow.torque[KNEE] = 1
    robot.tick(150)


@pytest.mark.parametrize("stays", [back_in_between, on_another_joint, no_turn_fits, with_torque])
def test_a_joint_out_of_its_travel_keeps_its_turn_otherwise(
    whole: Verifying, stays: Callable[[Verifying], None]
) -> None:
    whole.raw[KNEE] += WHOLE
    stays(whole)
    assert whole.known == [True] * 3 and whole.turned == []


def test_a_joint_of_a_long_travel_that_hangs_out_of_it_keeps_its_turn(whole: Verifying) -> None:
    whole.raw[TOE] = -100  # a turn further is in its travel
    whole.tick(150)
    assert whole.known == [True] * 3 and whole.places[TOE] == -100


# ------------------------------------------------------------------------------- places


def test_joints_of_a_transmission_have_a_place_with_all_their_actuators_alone() -> None:
    robot = Verifying()
    lower = robot.rig.hardware.pairs[0][1]
    lower.linked = (SimpleNamespace(rows=np.array([0, 1])),)
    for port in robot.ports:
        port.link = PortState.IDENTIFYING
    robot.identify(0, fits=[True, False])
    robot.tick(4)
    assert robot.known == [True, False, False] and np.isnan(robot.places).all()
    robot.identify(0)
    robot.tick(1)
    assert robot.places[:2] == list(PLACES[:2])


def test_counts_are_used_as_read_where_no_turn_is_measured() -> None:
    robot = Verifying()
    robot.rig.robot.joints.turns = None
    robot.raw[KNEE] = 9 * WHOLE
    for port in robot.ports:
        port.link = PortState.IDENTIFYING
    robot.tick()
    assert robot.known == [False] * 3
    robot.identify(0)
    assert robot.known == [True, True, False] and robot.places[KNEE] == 9 * WHOLE
    assert robot.verified.ambiguous_turn(TOE) is None and robot.verified.doubts() == []


def test_an_actuator_without_a_measured_travel_counts_as_read() -> None:
    robot = Verifying()
    robot.rig.robot.joints.turns.known[TOE] = False
    robot.raw[TOE] = 5 * WHOLE
    robot.identified()
    assert robot.joints == [True] * 3 and robot.places[TOE] == 5 * WHOLE
