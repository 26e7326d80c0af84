"""Counts and angles: one arithmetic, exact both ways."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.config.counts import angle_of, rad_per_tick, tick_range, ticks_of
from twind.config.robot_file import load_robot
from twind.config.robot_spec import JointSpec

KNEE = next(joint for joint in load_robot("h24").joints if joint.name == "l_knee")

joints = st.builds(
    lambda sign, ratio, turn: replace(
        KNEE, sign=sign, ratio=ratio, type=replace(KNEE.type, ticks_per_turn=turn)
    ),
    st.sampled_from([1, -1]),
    st.floats(0.05, 20.0),
    st.sampled_from([1024, 4096, 303_454]),
)
zeros = st.integers(-10_000, 10_000)


@given(joints, zeros, st.integers(-(2**20), 2**20))
def test_any_count_of_any_joint_comes_back(joint: JointSpec, zero: int, ticks: int) -> None:
    assert ticks_of(joint, zero, angle_of(joint, zero, ticks)) == ticks


@given(joints, zeros, st.floats(-6.0, 6.0))
def test_rounding_is_to_the_nearest_count_on_both_sides_of_zero(
    joint: JointSpec, zero: int, angle: float
) -> None:
    error = angle_of(joint, zero, ticks_of(joint, zero, angle)) - angle
    assert abs(error) <= 0.5 * abs(rad_per_tick(joint)) * (1 + 1e-9)


def test_the_worked_example_of_the_manual() -> None:
    assert rad_per_tick(KNEE) == pytest.approx(2 * math.pi / 4096)
    assert tick_range(KNEE, 2051, -0.05, 2.1) == (2019, 3419)  # limits rounded inwards
    assert (ticks_of(KNEE, 2051, -0.10), ticks_of(KNEE, 2051, 2.17)) == (1986, 3466)


def test_a_turn_has_4096_steps_not_4095() -> None:
    assert angle_of(KNEE, 0, 4096) == pytest.approx(2 * math.pi, abs=1e-12)
    assert angle_of(replace(KNEE, sign=-1), 0, 4096) == pytest.approx(-2 * math.pi, abs=1e-12)


@given(joints, zeros, st.floats(-3.0, 3.0), st.floats(0.01, 3.0))
def test_a_range_holds_exactly_the_counts_whose_angles_are_inside(
    joint: JointSpec, zero: int, lower: float, width: float
) -> None:
    upper = lower + width
    first, last = tick_range(joint, zero, lower, upper)
    tiny = 1e-6 * abs(rad_per_tick(joint))
    for ticks in range(first, last + 1, max(1, (last - first) // 50)):
        assert lower - tiny <= angle_of(joint, zero, ticks) <= upper + tiny
    for outside in (first - 1, last + 1):
        assert not lower + tiny <= angle_of(joint, zero, outside) <= upper - tiny
