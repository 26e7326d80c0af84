"""The bound that a finding names is the one that was passed."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twind.robot.joint_limits import JointLimits


def limits(lower: float, upper: float) -> JointLimits:
    one = np.array([1.0, 1.0])
    return JointLimits(np.array([0.0, lower]), np.array([0.0, upper]), *(one,) * 5)


@given(st.floats(-3.0, 0.0), st.floats(0.0, 3.0), st.floats(-9.0, 9.0))
def test_the_nearest_limit_is_the_nearest(lower: float, upper: float, position: float) -> None:
    bound = limits(lower, upper).nearest(1, position)
    other = lower if bound == upper else upper
    assert abs(position - bound) <= abs(position - other)


def test_a_value_beyond_a_limit_gets_that_limit_as_bound() -> None:
    assert limits(-1.0, 2.0).nearest(1, 2.1) == 2.0
    assert limits(-1.0, 2.0).nearest(1, -1.1) == -1.0
    assert limits(-1.0, 2.0).nearest(1, float("inf")) in (-1.0, 2.0)


def test_a_nan_value_gets_a_limit_as_bound() -> None:
    assert limits(-1.0, 2.0).nearest(1, float("nan")) in (-1.0, 2.0)
