"""Limp joints in the reference: they follow the hand that moves them, and no motion moves them."""

import numpy as np
import pytest

from tests.support.executor_rig import LIMITS, PERIOD, holding, run, smooth
from tests.support.gate_rig import at_rest
from twind.motion.limp_joints import LimpJoints
from twind.robot.trajectory import Reference

FIRST = np.array([True, False])


def limp(place: float) -> LimpJoints:
    """The first joint is limp, and a hand holds it at `place`, rad."""
    return LimpJoints(FIRST, np.array([place, 1.5]))


def test_a_limp_joint_follows_the_hand_within_its_limits_and_the_others_are_held() -> None:
    executor = holding([0.2, -0.2])
    executor.limp = limp(1.0)
    track = [at_rest([0.2, -0.2]), *run(executor, 2.0)]
    velocity = np.array([reference.velocity[0] for reference in track])
    assert np.abs(velocity).max() <= LIMITS.velocity[0] + 1e-9
    assert np.abs(np.diff(velocity)).max() <= LIMITS.acceleration[0] * PERIOD + 1e-9
    assert track[-1].position == pytest.approx([1.0, -0.2])


@pytest.mark.parametrize(("place", "end"), [(9.0, 2.05), (-9.0, -2.05)])
def test_a_hand_takes_it_to_its_hard_limit_and_no_further(place: float, end: float) -> None:
    executor = holding()
    executor.limp = limp(place)
    assert run(executor, 3.0)[-1].position == pytest.approx([end, 0.0])


def test_a_motion_moves_the_other_joints_alone() -> None:
    executor = holding()
    executor.limp = limp(0.0)
    assert executor.submit("wave", smooth([1.0, 1.0])) is None
    assert run(executor, 3.0)[-1].position == pytest.approx([0.0, 1.0])


def test_the_reference_ahead_and_the_plan_leave_it_at_rest_where_it_is() -> None:
    executor = holding()
    assert executor.submit("wave", smooth([1.0, 1.0])) is None
    executor.limp = limp(1.2)
    run(executor, 0.3)
    here = executor.reference
    assert here is not None and here.velocity[0] > 0.0
    later = executor.ahead(3.0)
    assert later.position == pytest.approx([here.position[0], 1.0])
    assert later.velocity[0] == 0.0
    plan = executor.plan
    assert plan is not None and plan.changing
    assert plan.reference.position.tolist() == here.position.tolist()
    assert plan.reference.velocity.tolist() == [0.0, here.velocity[1]]


def test_it_rests_in_a_path_and_the_path_of_the_others_goes_on() -> None:
    moving = Reference(np.array([0.3, 0.4]), np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    held = limp(0.0).hold(moving, at_rest([0.7, 0.8]))
    assert held.position.tolist() == [0.7, 0.4]
    assert held.velocity.tolist() == [0.0, 2.0]
    assert held.acceleration.tolist() == [0.0, 4.0]
