"""Contacts begin and end with hysteresis, and hold the robot only beyond the bound of the joint."""

import numpy as np
import pytest

from tests.support.guard_rig import LIMITS, N, facts
from twind.robot.arrays import Floats
from twind.robot.external_torque import ExternalTorque
from twind.robot.finding import ReasonCode
from twind.robot.modes import RobotState
from twind.safety.contact_rules import ContactRules
from twind.safety.guard import Guard, Reaction

BEGIN = 5.0  # standard deviations at which a contact begins ...
END = 2.5  # ... and below which it ends
LOST = 0.2  # s
SD = 0.1
HOLD = 1.0
BOUND = np.array([HOLD, np.inf, HOLD])


def external_of(*torque: float) -> ExternalTorque:
    return ExternalTorque(np.array(torque), np.full(N, SD))


def codes(rules: ContactRules, *torque: float) -> set[tuple[ReasonCode, int | None]]:
    found = rules.judge(facts(external=external_of(*torque)))
    return {(one.finding.code, one.finding.joint) for one in found}


@pytest.fixture
def rules() -> ContactRules:
    return ContactRules(BOUND, ["arm"] * N)


def test_contact_begins_in_the_second_tick_and_lasts_until_its_lower_threshold(rules: ContactRules) -> None:
    contact = {(ReasonCode.CONTACT, 1)}
    assert codes(rules, 0.0, BEGIN * SD * 1.01, 0.0) == set()
    assert codes(rules, 0.0, BEGIN * SD * 1.01, 0.0) == contact
    assert codes(rules, 0.0, END * SD * 1.01, 0.0) == contact
    assert codes(rules, 0.0, END * SD * 0.99, 0.0) == set()
    assert codes(rules, 0.0, END * SD * 1.01, 0.0) == set()


def test_less_than_five_standard_deviations_are_no_contact(rules: ContactRules) -> None:
    for _ in range(3):
        assert codes(rules, 0.0, BEGIN * SD * 0.99, 0.0) == set()


def test_a_second_joint_is_in_contact_after_two_ticks_of_its_own(rules: ContactRules) -> None:
    first, both = {(ReasonCode.CONTACT, 1)}, {(ReasonCode.CONTACT, 1), (ReasonCode.CONTACT, 2)}
    codes(rules, 0.0, 9.0, 0.0)
    assert codes(rules, 0.0, 9.0, 0.0) == first
    assert codes(rules, 0.0, 9.0, 0.6) == first
    assert codes(rules, 0.0, 9.0, 0.6) == both


def test_all_joints_may_be_in_contact_at_once(rules: ContactRules) -> None:
    codes(rules, 0.6, 0.6, 0.6)
    assert codes(rules, 0.6, 0.6, 0.6) == {(ReasonCode.CONTACT, joint) for joint in range(N)}
    assert rules.touched.all()


def test_a_contact_ends_exactly_at_its_lower_threshold(rules: ContactRules) -> None:
    codes(rules, 0.0, 9.0, 0.0)
    codes(rules, 0.0, 9.0, 0.0)
    assert codes(rules, 0.0, END * SD, 0.0) == set()


def test_a_contact_is_reported_with_its_torque_and_stops_nothing(rules: ContactRules) -> None:
    codes(rules, 0.0, -9.0, 0.0)
    (found,) = rules.judge(facts(external=external_of(0.0, -9.0, 0.0)))
    assert (found.finding.value, found.reaction) == (-9.0, Reaction.NONE)


def test_torque_less_its_uncertainty_exactly_at_the_bound_holds_nothing() -> None:
    rules = ContactRules(BOUND, ["arm"] * N)
    for other in (0.0, 9.0):  # also beside a joint in contact
        external = ExternalTorque(np.array([1.5, other, 0.0]), np.array([0.5, SD, SD]))
        assert not rules.judge(facts(external=external))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("beyond", "held"), [(-1e-6, False), (1e-6, True)])
def test_robot_is_held_where_torque_less_its_uncertainty_exceeds_the_bound(
    sign: float, beyond: float, held: bool
) -> None:
    guard = Guard(LIMITS, contact=ContactRules(BOUND, ["arm"] * N))
    decision = guard.judge(facts(external=external_of(sign * (HOLD + SD + beyond), 0.0, 0.0)))
    assert (decision.reaction is Reaction.HOLD) is held
    assert held is any(one.code is ReasonCode.CONTACT_HOLD for one in decision.causes)
    assert not decision.latches


def test_joint_without_a_bound_holds_nothing(rules: ContactRules) -> None:
    assert codes(rules, 0.0, 100.0, 0.0) == set()
    assert codes(rules, 0.0, 100.0, 0.0) == {(ReasonCode.CONTACT, 1)}


def test_robot_without_own_torque_is_not_held(rules: ContactRules) -> None:
    assert not rules.judge(facts(external=external_of(9.0, 0.0, 0.0), torque_expected=False))


def test_a_hold_lasts_while_the_torque_is_unknown(rules: ContactRules) -> None:
    hold = {(ReasonCode.CONTACT_HOLD, 0)}
    assert hold <= codes(rules, 9.0, 0.0, 0.0)
    found = rules.judge(facts(external=None))
    assert [one.finding.code for one in found] == [ReasonCode.CONTACT_HOLD]
    assert not rules.judge(facts(external=external_of(0.0, 0.0, 0.0)))
    assert not rules.judge(facts(external=None))


def test_a_hold_of_unknown_torque_does_not_stop_the_way_down(rules: ContactRules) -> None:
    codes(rules, 9.0, 0.0, 0.0)
    (found,) = rules.judge(facts(external=None, state=RobotState.SETTLING))
    assert found.reaction is Reaction.NONE


def test_a_hold_of_unknown_torque_ends_without_own_torque(rules: ContactRules) -> None:
    codes(rules, 9.0, 0.0, 0.0)
    assert not rules.judge(facts(external=None, torque_expected=False))
    assert not rules.judge(facts(external=None))


@pytest.mark.parametrize("bound", [BOUND, np.full(N, np.inf)])
def test_torque_unknown_for_long_is_reported_where_contacts_would_hold(bound: Floats) -> None:
    rules = ContactRules(bound, ["arm"] * N)
    rules.judge(facts(now=1.0, external=external_of(0.0, 0.0, 0.0)))
    assert not rules.judge(facts(now=1.0 + LOST, external=None))
    found = rules.judge(facts(now=1.0 + LOST + 1e-6, external=None))
    reported = [(one.finding.code, one.reaction) for one in found]
    assert reported == ([(ReasonCode.DETECTION_LOST, Reaction.NONE)] if bound is BOUND else [])


def test_torque_unknown_for_exactly_that_long_is_not_reported_yet(rules: ContactRules) -> None:
    rules.judge(facts(now=0.0, external=external_of(0.0, 0.0, 0.0)))
    assert not rules.judge(facts(now=LOST, external=None))


def test_torque_that_was_never_known_is_reported_at_once(rules: ContactRules) -> None:
    (found,) = rules.judge(facts(external=None))
    assert found.finding.code is ReasonCode.DETECTION_LOST


def test_the_time_of_unknown_torque_counts_from_when_the_robot_has_torque(rules: ContactRules) -> None:
    rules.judge(facts(now=1.0, external=None, torque_expected=False))
    rules.judge(facts(now=9.0, external=None, torque_expected=False))
    assert not rules.judge(facts(now=9.0 + 0.9 * LOST, external=None))
    assert rules.judge(facts(now=9.0 + 1.1 * LOST, external=None))


def test_unknown_torque_ends_a_contact(rules: ContactRules) -> None:
    contact = {(ReasonCode.CONTACT, 1)}
    codes(rules, 0.0, 9.0, 0.0)
    assert codes(rules, 0.0, 9.0, 0.0) == contact
    assert not rules.judge(facts(external=None, torque_expected=False))
    assert not rules.touched.any()
    assert codes(rules, 0.0, 9.0, 0.0) == set()
    assert codes(rules, 0.0, 9.0, 0.0) == contact
