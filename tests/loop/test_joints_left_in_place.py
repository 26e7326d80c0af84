"""Joints that stay where they are while the others go to the rest pose, on scripted buses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import ratings
from tests.support.procedure_rig import PLACE, REST, ProcedureRig
from twind.loop.procedures.lowering import NEAR, USUAL, lower
from twind.loop.procedures.torque_takeover import take_over
from twind.robot.arrays import Bools

NONE = np.zeros(3, np.bool_)
HIP, KNEE, TOE = np.eye(3, dtype=np.bool_)


def robot(support: str = "gantry", legs: Bools = NONE, groups: tuple[Any, ...] = ()) -> ProcedureRig:
    rig = ProcedureRig(support=support)
    rig.robot.description = replace(rig.robot.description, ratings=replace(ratings(3), leg=legs))
    rig.robot.joints.transmission_groups = groups
    rig.hold()
    return rig


def lowered(rig: ProcedureRig) -> bool:
    done = rig.run(lower(rig, USUAL, rig.extended.append))
    assert isinstance(done, bool)
    return done


def silent(rig: ProcedureRig, age: float = 0.2) -> None:
    """The toe's actuator does not answer; the others follow their goals."""

    def note() -> None:
        rig.read(position=rig.robot.written, age=np.array([0.0, age, age]))

    note()
    rig.watched = note


# --------------------------------------------------------------------------------------------- transmissions

SHARED = (np.array([1, 2]),)


def test_joints_of_a_transmission_with_a_silent_actuator_stay_and_the_others_are_lowered() -> None:
    rig = robot(groups=SHARED)
    silent(rig)
    assert lowered(rig)
    assert rig.robot.written == pytest.approx([REST[0], PLACE[1], PLACE[2]], abs=0.02)
    [event] = rig.book.events
    assert (event.level, event.code) == ("error", "DEVICE_MISSING")
    assert event.message == "knee, toe stay where they are: not all their actuators answer"


@pytest.mark.parametrize(("age", "stays"), [(0.1, False), (0.11, True), (np.inf, True), (np.nan, True)])
def test_an_actuator_is_silent_after_a_tenth_of_a_second(age: float, stays: bool) -> None:
    rig = robot(groups=SHARED)
    silent(rig, age)
    lowered(rig)
    assert rig.robot.written[1] == pytest.approx(PLACE[1] if stays else REST[1], abs=0.02)


def test_a_silent_joint_with_an_actuator_of_its_own_is_sent_on_its_way_all_the_same() -> None:
    """It may still hear its goals."""
    rig = robot(groups=(np.array([0]),))
    silent(rig)
    assert lowered(rig)
    assert rig.robot.written == pytest.approx(REST, abs=0.02)
    assert rig.book.events == []


def test_where_no_joint_may_be_moved_the_robot_is_released_where_it_is() -> None:
    rig = robot(groups=(np.array([0, 1, 2]),))
    silent(rig)
    assert lowered(rig)
    assert rig.robot.written.tolist() == PLACE.tolist()


@pytest.mark.parametrize("why", ["left_out", "away", "back"])
def test_a_joint_that_gets_no_goals_has_no_way(why: str) -> None:
    """Its device refused, or its bus was lost."""
    rig = robot()
    setattr(rig.hardware, why, TOE)
    assert lowered(rig)
    assert rig.robot.written == pytest.approx([REST[0], REST[1], PLACE[2]], abs=0.02)


@pytest.mark.parametrize(("groups", "held"), [((), [True, False, True]), (SHARED, [True, False, False])])
def test_beside_an_actuator_that_was_found_without_torque_the_others_of_its_transmission_get_no_goals(
    groups: tuple[Any, ...], held: list[bool]
) -> None:
    rig = ProcedureRig()
    rig.robot.joints.transmission_groups = groups
    rig.found((1, 0, 1))
    assert rig.run(take_over(rig, lambda: NONE, False))
    assert rig.torque.held.tolist() == held
    assert rig.torque.limp.tolist() == [False, True, False]
    assert rig.book.events == []


def test_where_all_with_torque_share_their_joints_with_a_limp_actuator_nothing_is_lowered() -> None:
    rig = ProcedureRig()
    rig.robot.joints.transmission_groups = (np.array([0, 1, 2]),)
    rig.found((1, 0, 1))
    assert not rig.run(take_over(rig, lambda: NONE, False))
    assert rig.hardware.log == []


# --------------------------------------------------------------------------------------------- legs


@pytest.mark.parametrize("why", ["left_out", "away"])
@pytest.mark.parametrize(
    ("support", "legs", "away", "begins"),
    [
        ("free", TOE, NEAR + 0.01, False),
        ("free", TOE, -NEAR - 0.01, False),
        ("free", TOE, np.nan, False),
        ("free", HIP | TOE, NEAR + 0.01, False),
        ("free", TOE, NEAR, True),
        ("free", HIP | KNEE, NEAR + 0.01, True),
        ("gantry", TOE, NEAR + 0.01, True),
    ],
)
def test_a_robot_on_its_own_feet_is_not_lowered_while_one_leg_stays_away_from_the_rest_pose(
    support: str, legs: Bools, away: float, begins: bool, why: str
) -> None:
    """It would be driven to its fall; its joints yield at once instead."""
    rig = robot(support, legs)
    setattr(rig.hardware, why, TOE)
    place = PLACE.copy()
    place[2] = REST[2] + away
    rig.read(position=place)
    assert lowered(rig) is (support == "gantry")
    assert (rig.robot.written != PLACE).any() == begins
    told = [(each.level, each.code, each.message) for each in rig.book.events]
    if not begins:
        message = "toe cannot come to the rest pose: no way there on the other leg"
        assert told == [("error", "SETTLE", message)]


def test_a_leg_whose_transmission_has_a_silent_actuator_stays_too() -> None:
    rig = robot("free", KNEE | TOE, SHARED)
    silent(rig)
    assert not lowered(rig)
    assert rig.codes() == ["DEVICE_MISSING", "SETTLE"]
    assert rig.robot.written.tolist() == PLACE.tolist()


@pytest.mark.parametrize(
    ("support", "legs", "short", "begins"),
    [
        ("free", TOE, NEAR + 0.01, False),
        ("free", TOE, NEAR - 0.01, True),
        ("free", HIP, NEAR + 0.01, True),
        ("gantry", TOE, NEAR + 0.01, True),
    ],
)
def test_a_leg_whose_measured_travel_ends_before_the_rest_pose_stays_away_from_it(
    support: str, legs: Bools, short: float, begins: bool
) -> None:
    """The other would crouch alone, and torque would go off beside the rest pose."""
    rig = robot(support, legs)
    lower_end = np.full(3, -9.0)
    lower_end[2] = REST[2] + short
    limits = replace(rig.robot.limits, lower=lower_end, upper=np.full(3, 9.0))
    rig.robot.description = replace(rig.robot.description, limits=limits)
    rig.executor.limits = limits
    assert lowered(rig) is begins
    assert (rig.robot.written != PLACE).any() == begins
    assert rig.codes() == ([] if begins else ["SETTLE"])


@pytest.mark.parametrize(("legs", "begins"), [(TOE, False), (HIP | KNEE, True)])
def test_a_leg_on_a_lost_bus_stays_away_from_the_rest_pose(legs: Bools, begins: bool) -> None:
    rig = robot("free", legs)
    rig.hardware.away = TOE
    lowered(rig)
    assert (rig.robot.written != PLACE).any() == begins
