"""A robot that falls is seen before it hits the floor and reacts as its file says; a standing one is left."""

from collections.abc import Iterator
from contextlib import closing
from math import pi

import pytest

from tests.support.fall_rig import FallRig
from tests.support.hand_rig import Hands
from twind import link
from twind.robot.fall_settings import FallReaction, FallState
from twind.robot.finding import ReasonCode
from twind.robot.modes import RobotState

DEADLY = 4.0  # N·s
BORNE = 1.0


@pytest.fixture
def holding() -> Iterator[FallRig]:
    with closing(FallRig(FallReaction.HOLD)) as rig:
        rig.stand()
        yield rig


@pytest.mark.parametrize("reaction", FallReaction)
def test_a_fall_is_detected_before_the_ground_and_latches(reaction: FallReaction) -> None:
    with closing(FallRig(reaction)) as rig:
        rig.stand()
        fall = rig.push(DEADLY, 0.0, 3.0)
        assert fall.detected + 0.1 < fall.ground
        assert rig.state is FallState.FALLEN
        assert rig.trips[0].stop == {"hold": "hold", "soft": "damp", "fold": "settle"}[reaction]
        assert rig.loop.condition.state is RobotState.FAULT
        assert ReasonCode.FALLING in rig.loop.condition.latches
        assert rig.loop.torque.armed == (reaction is FallReaction.HOLD)


def test_setpoints_after_a_fall_are_refused(holding: FallRig) -> None:
    holding.push(DEADLY, 0.0, 0.5)
    refused = holding.call(link.Setpoint, joints=[0], positions=[0.0])
    assert "FAULT_LATCHED" in str(refused.parameters)
    assert "FALLING" in str(refused.parameters)


def test_a_push_that_the_stance_bears_is_no_fall(holding: FallRig) -> None:
    fall = holding.push(BORNE, pi / 2, 2.0)
    assert not fall.fell
    assert holding.state is FallState.UPRIGHT
    assert holding.trips == []


def test_a_robot_without_torque_is_carried_lying_without_an_event_and_armed_only_upright() -> None:
    with closing(FallRig(FallReaction.HOLD)) as rig:
        rig.connect()
        rig.call(link.AcquireLease)
        assert rig.body is not None
        turned = [0.0]
        hands: object = Hands(rig.body, "torso", lambda time: (0.1, turned[0], 0.0))
        rig.body.crane = hands  # type: ignore[assignment]
        rig.seconds(0.3)
        turned[0] = 1.0
        rig.seconds(1.0)
        assert rig.trips == []
        refused = rig.call(link.Arm)
        assert "FALLING" in str(refused.parameters)
        turned[0] = 0.0
        rig.seconds(1.5)
        assert rig.trips == []
        rig.lease()
        assert rig.call(link.Arm).error is None


def test_without_the_section_nothing_is_detected() -> None:
    with closing(FallRig()) as rig:
        rig.stand()
        assert rig.loop.parts.guard.falls is None
        rig.push(DEADLY, 0.0, 1.0)
        assert rig.events(ReasonCode.FALLING) == []
