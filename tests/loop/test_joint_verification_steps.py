"""Verification of joints tick by tick: which are verified, and why the others are not."""

import numpy as np
import pytest

from tests.support.verification_rig import HIP, KNEE, MIDDLE, PLACES, TOE, WHOLE, Verifying, at_middle
from twind.loop.bus.bus_port import PortState
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode

WAITS = Finding(ReasonCode.CALIB_MISMATCH, message="its turn is not known yet: wait")
MARRED = Finding(
    ReasonCode.CALIB_MISMATCH,
    message="was silent, restarted or had an error: wait until it has been identified anew",
)


@pytest.fixture
def robot() -> Verifying:
    return Verifying().identified()


@pytest.fixture
def whole() -> Verifying:
    return at_middle()


def named(finding: Finding, joint: int) -> Finding:
    return Finding(finding.code, joint, message=finding.message)


def waits() -> Procedure:
    while True:
        yield


# ------------------------------------------------------------------------------- verified


def test_before_its_bus_is_identified_no_joint_is_verified_and_none_has_a_place() -> None:
    robot = Verifying()
    assert robot.readings.placed.tolist() == [False] * 3
    robot.tick(9)
    assert robot.joints == robot.known == [False] * 3
    assert robot.verified.unjudged.tolist() == [True] * 3
    assert np.isnan(robot.places).all() and robot.verified.findings() == []


@pytest.mark.parametrize(("readings", "known"), [(2, False), (3, True)])
def test_three_readings_that_agree_choose_a_turn(readings: int, known: bool) -> None:
    robot = Verifying()
    robot.heard[:] = False
    for port in robot.ports:
        port.link = PortState.IDENTIFYING
    robot.tick(2)
    robot.identify()
    robot.heard[:] = True
    robot.tick(readings)
    assert robot.joints == [known, known, False]


def test_a_single_wrong_reading_begins_the_count_anew() -> None:
    robot = Verifying()
    robot.raw[TOE] = MIDDLE
    robot.heard[:] = False
    robot.identified()
    robot.heard[:] = True
    robot.tick(2)
    robot.raw[KNEE] += WHOLE
    robot.tick(1)
    robot.raw[KNEE] -= WHOLE
    robot.tick(2)
    assert robot.known == [True, False, True]
    robot.tick(1)
    assert robot.known == [True] * 3


def test_readings_of_a_joint_that_is_silent_in_between_count_together() -> None:
    robot = Verifying()
    robot.heard[:] = False
    robot.identified()
    robot.heard[:] = True
    robot.tick(2)
    robot.heard[KNEE] = False
    robot.raw[KNEE] += WHOLE
    robot.tick(4)
    assert robot.known == [True, False, False]
    robot.heard[KNEE] = True
    robot.raw[KNEE] -= WHOLE
    robot.tick(1)
    assert robot.known == [True, True, False]


@pytest.mark.parametrize("turns", [-2, 0, 3])
def test_a_turn_is_chosen_by_the_travel_and_gives_the_place(turns: int) -> None:
    robot = Verifying()
    robot.raw[KNEE] += turns * WHOLE
    robot.identified()
    assert robot.places[:2] == list(PLACES[:2]) and np.isnan(robot.places[2])
    assert robot.readings.shift.tolist() == [0, -turns * WHOLE, 0]
    assert robot.turned == [0] * bool(turns), "the turns of a bus are set where they change"
    assert robot.joints == [True, True, False]


def test_a_joint_without_a_calibration_is_not_verified(robot: Verifying) -> None:
    robot.rig.robot.joints.calibrated = (False, True, True)
    assert robot.joints == [False, True, False]


@pytest.mark.parametrize("link", [PortState.CLOSED, PortState.IDENTIFYING])
def test_joints_of_a_bus_that_is_not_connected_are_not_verified(whole: Verifying, link: PortState) -> None:
    whole.ports[1].link = link
    assert whole.joints == [True, True, False]
    whole.ports[1].link = PortState.CONNECTED
    whole.ports[0].link = link
    assert whole.joints == [False, False, True]


def test_a_device_that_differs_from_the_calibration_is_not_verified(whole: Verifying) -> None:
    mismatch = ReasonCode.CALIB_MISMATCH
    whole.verified.mismatches = (Finding(mismatch, message="of the file"), Finding(mismatch, KNEE))
    assert whole.joints == [True, False, True]


def test_a_servo_that_a_search_has_not_restored_is_not_verified(whole: Verifying) -> None:
    unrestored = Finding(ReasonCode.CALIB_MISMATCH, KNEE, message="not restored")
    whole.verified.unrestored = unrestored
    assert whole.joints == [True, False, True]
    assert whole.verified.doubts() == whole.verified.findings() == [unrestored]


def test_devices_that_are_missing_do_not_concern_the_others_of_their_bus() -> None:
    robot = Verifying()
    for port in robot.ports:
        port.link = PortState.IDENTIFYING
    robot.identify(0, fits=[True, False])
    robot.tick(4)
    assert robot.known == [True, False, False]
    robot.identify(0)
    assert robot.known == [True, True, False]


# ------------------------------------------------------------------------------- why not


def test_a_joint_whose_turn_is_not_chosen_yet_is_named(robot: Verifying) -> None:
    robot.verified.restarted([Finding(ReasonCode.SERVO_REBOOTED, KNEE)])
    robot.raw[KNEE] += WHOLE
    robot.rig.own(Priority.HOME, waits)
    [several, marred] = robot.verified.findings()
    assert (several.joint, marred) == (TOE, named(MARRED, KNEE))
    assert robot.verified.unjudged.tolist() == [False, True, False]
    robot.identify(0)
    [_, waiting] = robot.verified.findings()
    assert waiting == named(WAITS, KNEE)


def test_a_joint_that_another_finding_names_is_not_named_again(robot: Verifying) -> None:
    robot.verified.mar([Finding(ReasonCode.SERVO_ALERT, TOE), Finding(ReasonCode.SERVO_ALERT, HIP)])
    robot.bars.append(Finding(ReasonCode.SERVO_ALERT, HIP))
    [finding] = robot.verified.findings()
    assert finding.joint == TOE and "its turn is unknown" in finding.message


def test_an_error_that_a_can_actuator_keeps_is_named_with_its_remedy(whole: Verifying) -> None:
    whole.rig.hardware.slow.fault[:] = 1
    whole.verified.mar([Finding(ReasonCode.SERVO_ALERT, TOE), Finding(ReasonCode.SERVO_ALERT, KNEE)])
    knee, toe = whole.verified.findings()
    assert knee == named(MARRED, KNEE)
    assert (toe.code, toe.joint, toe.value) == (ReasonCode.SERVO_ALERT, TOE, 1.0)
    assert whole.joints == [True, False, False]


@pytest.mark.parametrize("quiet", ["armed", "sim"])
def test_nothing_is_found_against_joints_under_torque_and_in_mode_sim(robot: Verifying, quiet: str) -> None:
    robot.verified.mar([Finding(ReasonCode.SERVO_ALERT, KNEE)])
    robot.verified.unrestored = Finding(ReasonCode.CALIB_MISMATCH, KNEE)
    assert len(robot.verified.doubts()) == 2
    if quiet == "armed":
        robot.hold()
    else:
        robot.rig.condition.mode = Mode.SIM
    assert robot.verified.findings() == robot.verified.doubts() == []


def test_without_all_buses_only_places_are_doubted(robot: Verifying) -> None:
    robot.verified.mar([Finding(ReasonCode.SERVO_ALERT, KNEE)])
    robot.rig.hardware.connected = False
    assert [each.joint for each in robot.verified.findings()] == [TOE]


def test_a_joint_that_left_its_travel_is_doubted(whole: Verifying) -> None:
    whole.raw[KNEE] = 2021
    whole.tick()
    [finding] = whole.verified.doubts()
    assert (finding.joint, finding.value) == (KNEE, 2021.0)
    assert whole.joints == [True, False, True]
    whole.raw[KNEE] = 2020
    whole.tick()
    assert whole.verified.doubts() == []


# ------------------------------------------------------------------------------- turns that are refused


def test_a_turn_that_several_fit_is_reported_once(robot: Verifying) -> None:
    robot.tick(20)
    [event] = robot.rig.book.events
    assert (event.level, event.code) == ("warning", ReasonCode.CALIB_MISMATCH)
    [finding] = event.findings
    assert finding.joint == TOE and event.message == finding.message
    assert robot.verified.refused_turns([TOE]) == [finding] == robot.verified.doubts()
    assert robot.verified.refused_turns([HIP, KNEE]) == []
    assert robot.verified.ambiguous_turn(TOE) == finding
    assert robot.verified.ambiguous_turn(KNEE) is None
    robot.raw[TOE] -= 5
    robot.tick(5)
    assert len(robot.rig.book.events) == 1
    assert robot.verified.doubts()[0].value == PLACES[TOE] - 5


def test_a_joint_that_is_refused_is_chosen_where_its_place_is_alone(robot: Verifying) -> None:
    robot.raw[TOE] = MIDDLE
    robot.tick(1)
    assert robot.known == [True] * 3 and robot.verified.doubts() == []
    assert robot.verified.ambiguous_turn(TOE) is None
    robot.raw[TOE] = PLACES[TOE]
    robot.tick(9)
    assert robot.verified.ambiguous_turn(TOE) is None, "its turn is known"


def test_another_joint_that_is_refused_is_reported_too(robot: Verifying) -> None:
    robot.ports[0].identify()
    robot.tick()
    robot.raw[KNEE] = 3000  # out of its travel on each turn
    robot.identify(0)
    robot.tick(5)
    assert [event.findings[0].joint for event in robot.rig.book.events] == [TOE, KNEE]
    assert {each.joint for each in robot.verified.doubts()} == {KNEE, TOE}


def test_joints_that_are_refused_together_are_reported_by_the_first(robot: Verifying) -> None:
    robot.ports[0].identify()
    robot.tick()
    robot.raw[HIP] = 3500
    robot.raw[KNEE] = 3000
    robot.identify(0)
    robot.tick(5)
    _, event = robot.rig.book.events
    assert [each.joint for each in event.findings] == [HIP, KNEE]
    assert event.message == event.findings[0].message != event.findings[1].message
    assert robot.verified.ambiguous_turn(KNEE) is None, "no turn fits"


def test_a_refused_turn_of_a_bus_that_is_identified_anew_is_forgotten(robot: Verifying) -> None:
    robot.ports[1].identify()
    robot.tick()
    assert robot.verified.refused_turns([TOE]) == []


def test_a_turn_beyond_the_register_is_refused_and_not_set(robot: Verifying) -> None:
    robot.ports[0].identify()
    robot.raw[HIP] += WHOLE
    robot.tick()
    robot.identify(0)
    robot.tick(5)
    assert robot.known == [False, True, False] and robot.turned == []
    [finding] = robot.verified.refused_turns([HIP])
    assert "Position mode covers one turn" in finding.message and "torque off" not in finding.message


def test_the_remedy_of_a_refused_turn_under_torque_switches_it_off_first() -> None:
    robot = Verifying()
    robot.raw[HIP] += WHOLE
    robot.rig.hardware.slow.torque[:] = 1
    robot.identified()
    [finding] = robot.verified.refused_turns([HIP])
    assert "switch its torque off" in finding.message


# ------------------------------------------------------------------------------- buses that come and go


@pytest.mark.parametrize("held", [True, False])
def test_a_bus_that_is_identified_anew_forgets_turns_where_this_daemon_does_not_hold_it(
    whole: Verifying, held: bool
) -> None:
    if held:
        whole.hold()
    whole.ports[0].identify()
    whole.tick()
    assert whole.known == [held, held, True]
    whole.tick(4)
    assert whole.known == [held, held, True], "a device that did not answer yet is not judged"
    whole.identify(0)
    whole.tick(3)
    assert whole.known == [True] * 3


def test_a_held_joint_keeps_the_turn_that_it_has(whole: Verifying) -> None:
    whole.hold()
    whole.ports[0].identify()
    whole.tick()
    whole.raw[KNEE] += WHOLE
    whole.identify(0)
    whole.tick(5)
    assert whole.known == [True, False, True] and whole.turned == []
    assert whole.places[KNEE] == PLACES[KNEE] + WHOLE, "a joint that gets goals has a place"
    whole.let_go()
    whole.tick(2)
    assert whole.joints == [True] * 3 and whole.places[KNEE] == PLACES[KNEE]


def test_a_joint_that_is_left_out_of_a_held_bus_gets_no_turn(whole: Verifying) -> None:
    whole.hold()
    whole.rig.hardware.left_out[KNEE] = True
    whole.ports[0].identify()
    whole.tick()
    whole.identify(0)
    whole.tick(5)
    assert whole.known == [True, False, True] and np.isnan(whole.places[KNEE])


def test_no_turn_is_set_while_torque_is_switched(robot: Verifying) -> None:
    robot.ports[0].identify()
    robot.tick()
    robot.raw[KNEE] += WHOLE
    robot.rig.torque.begin_energising()
    robot.identify(0)
    robot.tick(5)
    assert robot.turned == [] and robot.known == [True, False, False]


def test_the_joints_of_a_lost_bus_are_unknown_until_it_is_identified(whole: Verifying) -> None:
    whole.ports[0].link = PortState.CLOSED
    whole.tick()
    assert whole.known == [False, False, True]
    whole.tick(9)
    whole.ports[0].link = PortState.IDENTIFYING
    whole.tick(9)
    assert whole.known == [False, False, True], "it was not identified"
    whole.identify(0)
    assert whole.joints == [True] * 3


def test_a_device_that_does_not_fit_any_more_loses_its_turn() -> None:
    robot = Verifying()
    for port in robot.ports:
        port.link = PortState.IDENTIFYING
    robot.tick()
    robot.identify(0, fits=[False, True])
    robot.tick(3)
    assert robot.known == [False, True, False]
    robot.identify(0, fits=[True, False])
    robot.tick(3)
    assert robot.known == [True, False, False]
