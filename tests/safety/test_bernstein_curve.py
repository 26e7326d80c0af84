"""Coefficients of the gate's curves: each derivative belongs to the curve above it."""

from itertools import pairwise

import numpy as np
import pytest

from twind.robot.splines import Knots
from twind.safety.bernstein_curve import smooth

TIME = np.array([0.0, 0.7, 2.0])  # s


@pytest.mark.parametrize("quintic", [False, True])
def test_a_curve_goes_through_its_knots_with_their_rates(quintic: bool) -> None:
    position, velocity, acceleration = np.random.default_rng(1).normal(size=(3, 3, 2))
    curve = smooth(Knots(TIME, position, velocity, acceleration if quintic else None), velocity, 0, 2)
    for rows, given in ((curve.position, position), (curve.velocity, velocity)):
        np.testing.assert_array_equal(rows[0], given[:-1])
        np.testing.assert_array_equal(rows[-1], given[1:])
    if quintic:
        np.testing.assert_array_equal(curve.acceleration[0], acceleration[:-1])
        np.testing.assert_array_equal(curve.acceleration[-1], acceleration[1:])


@pytest.mark.parametrize("quintic", [False, True])
def test_differences_of_coefficients_are_the_derivative(quintic: bool) -> None:
    """The derivative of a Bernstein polynomial: degree times difference, over the segment's time."""
    position, velocity, acceleration = np.random.default_rng(2).normal(size=(3, 3, 2))
    curve = smooth(Knots(TIME, position, velocity, acceleration if quintic else None), velocity, 0, 2)
    span = np.diff(TIME)[:, None]
    for rows, slopes in pairwise((curve.position, curve.velocity, curve.acceleration, curve.jerk)):
        degree = len(rows) - 1
        assert len(slopes) == degree
        for (a, b), slope in zip(pairwise(rows), slopes, strict=True):
            np.testing.assert_allclose(degree * (b - a) / span, slope, atol=1e-12)
