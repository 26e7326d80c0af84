"""Turns of joints that a stated place chooses, tick by tick."""

import pytest

from tests.support.verification_rig import KNEE, PLACES, TOE, WHOLE, Verifying, at_middle
from twind.loop.bus.bus_port import PortState
from twind.robot.finding import Finding, ReasonCode
from twind.safety.multiturn import StatedPlace


@pytest.fixture
def robot() -> Verifying:
    return Verifying().identified()


@pytest.fixture
def whole() -> Verifying:
    return at_middle()


def stated(turns: int = 0, off: int = 0) -> StatedPlace:
    return StatedPlace(PLACES[TOE] + turns * WHOLE + off, 512, "a test")


@pytest.mark.parametrize("turns", [0, 1])
def test_a_stated_place_chooses_the_turn_after_three_readings(robot: Verifying, turns: int) -> None:
    assert robot.verified.locate(TOE, stated(turns, 500)) is None
    assert robot.verified.waiting([TOE]) and robot.verified.waiting([KNEE, TOE])
    assert not robot.verified.waiting([KNEE]) and not robot.verified.waiting([])
    robot.tick(2)
    assert robot.known == [True, True, False]
    robot.tick(1)
    assert robot.joints == [True] * 3 and robot.places[TOE] == PLACES[TOE] + turns * WHOLE
    assert not robot.verified.waiting([TOE])
    assert robot.turned == [1] * turns


def test_a_stated_place_that_the_reading_contradicts_is_refused_at_once(robot: Verifying) -> None:
    finding = robot.verified.locate(TOE, stated(off=513))
    assert finding is not None and (finding.code, finding.joint) == (ReasonCode.CALIB_MISMATCH, TOE)
    assert not robot.verified.waiting([TOE])


def test_a_joint_that_is_moved_from_its_stated_place_gets_no_turn(robot: Verifying) -> None:
    assert robot.verified.locate(TOE, stated()) is None
    robot.raw[TOE] += 600
    robot.tick(3)
    assert robot.known == [True, True, False] and not robot.verified.waiting([TOE])
    assert [each.joint for each in robot.verified.refused_turns([TOE])] == [TOE]


def test_a_place_is_compared_once_its_own_joint_is_chosen(robot: Verifying) -> None:
    robot.ports[0].identify()
    robot.tick()
    robot.raw[KNEE] = 3000  # refused in each tick
    robot.identify(0)
    robot.tick(5)
    robot.verified.locate(TOE, stated())
    robot.raw[TOE] += 600
    robot.tick(1)
    assert len(robot.verified.refused_turns([TOE])) == 1 and robot.verified.waiting([TOE])
    robot.tick(2)
    assert not robot.verified.waiting([TOE])


def test_a_known_turn_is_only_compared_with_a_stated_place(whole: Verifying) -> None:
    assert whole.verified.locate(KNEE, StatedPlace(PLACES[KNEE] + 9, 512, "a test")) is None
    assert not whole.verified.waiting([KNEE])
    finding = whole.verified.locate(KNEE, StatedPlace(PLACES[KNEE] + WHOLE, 512, "a test"))
    text = "its turn is known, and a test puts it on another one: nothing was changed"
    assert finding == Finding(ReasonCode.CALIB_MISMATCH, KNEE, message=text)
    whole.tick(5)
    assert whole.places[KNEE] == PLACES[KNEE]


def test_a_withdrawn_place_chooses_nothing(robot: Verifying) -> None:
    robot.verified.locate(TOE, stated())
    assert robot.verified.withdraw([KNEE, TOE]) == [TOE]
    assert robot.verified.withdraw([TOE]) == []
    robot.tick(5)
    assert robot.known == [True, True, False]


def test_a_place_is_forgotten_when_its_joint_is_doubted(robot: Verifying) -> None:
    robot.verified.locate(TOE, stated())
    robot.verified.restarted([Finding(ReasonCode.SERVO_REBOOTED, TOE)])
    assert not robot.verified.waiting([TOE])


def test_a_place_of_a_closed_bus_chooses_nothing_when_it_is_back(robot: Verifying) -> None:
    """Nobody sees whether the joint is moved meanwhile."""
    port = robot.ports[1]
    port.link = PortState.CLOSED
    robot.tick()
    assert robot.verified.locate(TOE, stated()) is None
    robot.tick()
    port.link = PortState.IDENTIFYING
    robot.raw[TOE] = PLACES[TOE]
    robot.tick()
    robot.identify(1)
    robot.tick(5)
    assert robot.known == [True, True, False]
