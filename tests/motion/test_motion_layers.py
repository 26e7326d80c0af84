import numpy as np
import pytest

from tests.support.gate_rig import at_rest, limits, path
from twind.motion.motion_layers import MotionLayer, ScheduledGoal, begun, choose, overlay, without
from twind.robot.trajectory import Trajectory

PERIOD = 0.01


def layer(to: list[float], joints: list[bool], start: int = 0, seconds: float = 1.0) -> MotionLayer:
    way = path([seconds], [to], [[0.0] * 3])
    goal = ScheduledGoal(
        "a", Trajectory(way.time, way.position, np.array(joints), way.velocity), start, None, None
    )
    return begun(goal, at_rest([0.0, 0.0, 0.0]), limits(3), PERIOD)


def test_a_layer_begins_at_the_reference_and_ends_on_its_last_point() -> None:
    one = layer([0.1, 0.2, 0.3], [True, True, True], start=50)
    assert one.whole
    assert one.reference_at(50).position.tolist() == [0.0, 0.0, 0.0]
    assert not one.is_finished(149)
    assert one.is_finished(150)
    assert one.reference_at(150).position.tolist() == [0.1, 0.2, 0.3]
    assert [one.fraction(tick) for tick in (50, 100, 150, 900)] == pytest.approx([0.0, 0.5, 1.0, 1.0])


@pytest.mark.parametrize("seconds", [0.3, 0.07, 0.29, 0.57, 1.13])
def test_the_tick_of_the_end_is_at_the_end_whatever_the_rounding(seconds: float) -> None:
    one = layer([0.1, 0.1, 0.1], [True, True, True], start=12345, seconds=seconds)
    end = 12345 + round(seconds / PERIOD)
    assert one.elapsed(end) == seconds
    assert one.is_finished(end)


def test_a_path_of_one_point_at_zero_has_come_all_the_way_at_once() -> None:
    here = ScheduledGoal("a", path([0.0], [[0.0, 0.0, 0.0]]), 0, None, None)
    one = begun(here, at_rest([0.0, 0.0, 0.0]), limits(3), PERIOD)
    assert one.is_finished(0)
    assert one.fraction(0) == 1.0


def test_joints_leave_a_layer_and_one_that_all_have_left_is_gone() -> None:
    first = layer([1, 1, 1], [True, True, False])
    second = layer([2, 2, 2], [False, False, True])
    left = without([first, second], np.array([True, False, True]))
    assert [one.joints.tolist() for one in left] == [[False, True, False]]
    assert not left[0].whole
    assert without(left, np.array([False, True, False])) == []
    assert first.joints.tolist() == [True, True, False]


def test_each_joint_follows_its_own_layer_and_the_rest_the_base() -> None:
    layers = [layer([1, 1, 1], [True, False, False]), layer([2, 2, 2], [False, True, False])]
    mixed = overlay(at_rest([7.0, 7.0, 7.0]), layers, 100)
    assert mixed.position.tolist() == [1.0, 2.0, 7.0]
    moving = overlay(at_rest([7.0, 7.0, 7.0]), layers, 50)
    assert moving.velocity.tolist() == pytest.approx([1.5, 3.0, 0.0])


def test_choosing_takes_all_three_rows() -> None:
    one = choose(np.array([True, False]), at_rest([1.0, 1.0]), at_rest([2.0, 2.0]))
    assert one.position.tolist() == [1.0, 2.0]
