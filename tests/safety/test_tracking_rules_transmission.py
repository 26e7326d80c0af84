"""A frozen encoder where two actuators turn two joints together: it is an actuator's, and so it is found."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.guard_rig import LIMITS, PERIOD, facts, reading
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import Finding, ReasonCode
from twind.robot.linkage_table import LinkageTable
from twind.robot.modes import Motion
from twind.robot.trajectory import Reference
from twind.robot.transmission import Differential, MappedTransmission, Transmission
from twind.safety.guard import Guard

AXIS = np.linspace(-2.0, 2.0, 6).tolist()
LAWS = [
    Differential([[0.5, 0.5], [0.5, -0.5]]),
    LinkageTable([AXIS, AXIS], [[0.5 * a + 0.5 * b, 0.5 * a - 0.45 * b] for a in AXIS for b in AXIS]),
]
PACE = np.array([0.5, 0.3])  # rad/s, of the actuators
ALIKE = np.array([0.4, 0.4])  # rad/s: joint 2 hardly turns


def watching(law: Transmission) -> Guard:
    """A guard of a robot whose joints 0 and 2 are turned by two actuators."""
    away = np.full(2, np.inf)
    return Guard(LIMITS, support="gantry", linked=[MappedTransmission(np.array([0, 2]), law, -away, away)])


def found(law: Transmission, speeds: np.ndarray, read: np.ndarray, ticks: int = 40) -> list[Finding]:
    """Actuators of joints 0 and 2 go at `speeds` (rad/s), and say so; `read` is the share of their way that
    their encoders show."""
    guard = watching(law)
    told = []
    guard.limit(LIMITS, ActuatorRatings.unknown(len(LIMITS.lower)))
    for tick in range(ticks):
        now = 10.0 + tick * PERIOD
        goal = np.zeros(3)
        place = np.zeros(3)
        speed = np.zeros(3)
        goal[[0, 2]] = law.forward(tick * PERIOD * speeds)
        place[[0, 2]] = law.forward(tick * PERIOD * speeds * read)
        speed[[0, 2]] = law.jacobian(tick * PERIOD * speeds * read) @ speeds
        measured = replace(reading(place.tolist(), time=now), velocity=speed)
        over = {"now": now, "measured": measured, "goal": Reference(goal, speed, np.zeros(3))}
        judged = guard.judge(facts(**over, previous=goal, motion=Motion.STREAMING, setpoint_age=0.0))
        told += [one for one in judged.findings if one.code is ReasonCode.SENSE_FROZEN]
    return told


@pytest.mark.parametrize("law", LAWS, ids=["differential", "table"])
@pytest.mark.parametrize("stuck", [0, 1])
@pytest.mark.parametrize("pace", [PACE, ALIKE])
def test_sense_frozen_a_still_encoder_of_a_turning_motor_is_reported_by_its_joint(
    law: Transmission, pace: np.ndarray, stuck: int
) -> None:
    read = np.ones(2)
    read[stuck] = 0.0
    assert [one.joint for one in found(law, pace, read)][:1] == [[0, 2][stuck]]


@pytest.mark.parametrize("law", LAWS, ids=["differential", "table"])
def test_sense_frozen_leaves_readings_and_goals_of_the_joints_as_they_are(law: Transmission) -> None:
    guard = watching(law)
    place, speed, goal = np.array([[0.3, 0.0, 0.1], [0.4, 0.0, 0.2], [0.35, 0.0, 0.15]])
    measured = replace(reading(place.tolist()), velocity=speed)
    guard.judge(facts(measured=measured, previous=goal))
    assert measured.position.tolist() == [0.3, 0.0, 0.1]
    assert measured.velocity.tolist() == [0.4, 0.0, 0.2]
    assert goal.tolist() == [0.35, 0.0, 0.15]


@pytest.mark.parametrize("law", LAWS, ids=["differential", "table"])
@given(speeds=st.sampled_from([(0.5, 0.0), (0.0, 0.5), (0.4, 0.4), (0.4, -0.4), (0.0, 0.0)]))
def test_sense_frozen_a_following_joint_gives_no_finding_although_one_actuator_rests(
    law: Transmission, speeds: tuple[float, float]
) -> None:
    assert found(law, np.array(speeds), np.ones(2)) == []
