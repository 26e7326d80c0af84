from math import inf, nan

import pytest

from tests.support.gate_rig import path
from twind.motion.goal_conditions import STOPPED, GoalTolerances, without_past
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Trajectory

# ------------------------------------------------------------------------------------------ tolerances


def test_zero_and_nothing_keep_the_default_and_minus_one_erases_it() -> None:
    given_ = GoalTolerances.from_entries(4, [(0, 0.1, 0.2), (1, 0.0, -1.0), (2, None, None)])
    assert given_.path.tolist() == [0.1, inf, inf, inf]
    assert given_.goal.tolist() == [0.2, inf, inf, inf]


def test_a_default_for_the_end_is_kept_replaced_or_erased_by_each_joint() -> None:
    given_ = GoalTolerances.from_entries(
        5, [(0, 0.1, 0.3), (1, 0.0, -1.0), (2, 0.1, None), (3, -1.0, 0.0)], 0.2
    )
    assert given_.path.tolist() == [0.1, inf, 0.1, inf, inf]
    assert given_.goal.tolist() == [0.3, inf, 0.2, 0.2, 0.2]


def test_only_a_joint_with_a_goal_tolerance_of_its_own_must_stop() -> None:
    given_ = GoalTolerances.from_entries(4, [(0, 0.1, 0.3), (1, 0.0, -1.0), (2, 0.1, None)], 0.2)
    assert given_.speed.tolist() == [STOPPED, inf, inf, inf]


@pytest.mark.parametrize("value", [nan, -0.5, -2.0, -inf])
def test_a_tolerance_that_means_nothing_is_an_error(value: float) -> None:
    with pytest.raises(ValueError, match="of joint 1"):
        GoalTolerances.from_entries(2, [(1, value, None)])


@pytest.mark.parametrize("joint", [-1, 2])
def test_a_tolerance_of_no_joint_is_an_error(joint: int) -> None:
    with pytest.raises(ValueError, match=r"joints 0\.\.1"):
        GoalTolerances.from_entries(2, [(joint, 0.1, None)])


# ------------------------------------------------------------------------------------------ past starts


def three() -> Trajectory:
    return path([0.5, 1.0, 1.5], [1.0, 2.0, 3.0], [0.1, 0.2, 0.0], [0.3, 0.4, 0.5])


@pytest.mark.parametrize("start_in", [0.0, 0.4, 20.0])
def test_a_start_that_is_not_past_drops_nothing(start_in: float) -> None:
    whole = three()
    assert without_past(whole, start_in) is whole


@pytest.mark.parametrize(
    ("start_in", "left"), [(-0.4, [0.1, 0.6, 1.1]), (-0.5, [0.5, 1.0]), (-1.2, [0.3]), (-1.499, [0.001])]
)
def test_waypoints_in_the_past_are_dropped_with_all_their_columns(start_in: float, left: list[float]) -> None:
    found = without_past(three(), start_in)
    assert isinstance(found, Trajectory)
    assert found.time.tolist() == pytest.approx(left)
    assert found.velocity is not None
    assert found.acceleration is not None
    assert [len(found.position), len(found.velocity), len(found.acceleration)] == [len(left)] * 3
    assert found.position[-1, 0] == 3.0


def test_positions_alone_lose_their_past_too() -> None:
    found = without_past(path([0.5, 1.0], [1.0, 2.0]), -0.7)
    assert isinstance(found, Trajectory)
    assert (found.time.tolist(), found.velocity, found.acceleration) == (pytest.approx([0.3]), None, None)


@pytest.mark.parametrize("start_in", [-1.5, -2.0, -inf, nan])
def test_when_every_waypoint_is_past_it_is_refused(start_in: float) -> None:
    found = without_past(three(), start_in)
    assert isinstance(found, Finding)
    assert found.code is ReasonCode.CMD_EXPIRED
