"""The curve that the gate judges is the curve that the executor follows."""

import numpy as np
import pytest
from hypothesis import given

from tests.support import gate_rig as w
from tests.support.examples import examples
from twind.robot.splines import curve, hold, interpolate, knots, passed
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.bernstein_curve import smooth
from twind.safety.polynomial_bounds import evaluate


@examples(60)
@given(w.paths(), w.REFERENCES)
def test_the_curve_is_the_exact_polynomial_through_its_points(path: Trajectory, before: Reference) -> None:
    spline = interpolate(path, before)
    for joint in range(2):
        t0 = 0.0
        for i, (T, coefficients) in enumerate(w.oracle_segments(path, before, joint)):
            for u in (0.0, 0.3, 1.0):
                s = float(T) * u
                at = spline.inside(i, spline.time[i] + s)
                for d, row in enumerate((at.position, at.velocity, at.acceleration)):
                    exact = float(w.value_at(coefficients, w.Fraction(s), d))
                    assert row[joint] == pytest.approx(exact, rel=1e-9, abs=1e-9 / max(float(T), 1e-3) ** d)
            t0 += float(T)
    assert spline.duration == pytest.approx(float(path.time[-1]))
    assert np.array_equal(spline.end, path.position[-1])


@examples(60)
@given(w.paths(), w.REFERENCES)
def test_the_bernstein_form_is_the_same_curve(path: Trajectory, before: Reference) -> None:
    through = knots(path, before)
    if through.velocity is None or len(through.time) < 2:
        return
    spline = curve(through)
    form = smooth(through, through.velocity, 0, len(through.time) - 1)
    for u in (0.0, 0.25, 0.7, 1.0):
        for i in range(len(through.time) - 1):
            at = spline.inside(i, spline.time[i] + u * (spline.time[i + 1] - spline.time[i]))
            T = float(spline.time[i + 1] - spline.time[i])
            rows = (form.position, form.velocity, form.acceleration)
            for d, (row, expected) in enumerate(
                zip(rows, (at.position, at.velocity, at.acceleration), strict=True)
            ):
                value = evaluate(np.stack([c[i] for c in row]), np.array([u, u]))
                assert value == pytest.approx(expected, rel=1e-8, abs=1e-8 / T**d)


def test_uncommanded_joints_keep_their_position_whatever_their_columns() -> None:
    path = Trajectory(
        np.array([1.0]), np.array([[0.5, np.nan]]), np.array([True, False]), np.array([[0.1, np.nan]])
    )
    before = Reference(np.array([0.0, 0.7]), np.array([0.0, 3.0]), np.zeros(2))
    for t in (0.0, 0.4, 1.0, 2.0):
        assert interpolate(path, before).sample(t).position[1] == 0.7


def test_before_the_start_there_is_nothing_and_after_the_end_rest() -> None:
    spline = interpolate(w.path([1.0], [0.5], [0.3]), w.at_rest([0.0]))
    assert spline.sample(-0.1) is None
    assert spline.sample(float("nan")) is None
    after = spline.sample(1.0)
    assert (after.position[0], after.velocity[0], after.acceleration[0]) == (0.5, 0.0, 0.0)


def test_a_hold_is_a_curve_without_duration() -> None:
    spline = hold(np.array([0.1, 0.2]))
    assert spline.duration == 0.0
    assert spline.sample(9.0).position.tolist() == [0.1, 0.2]


def test_points_are_passed_one_after_the_other() -> None:
    path = w.path([1.0, 2.0, 3.0], [0.0, 0.0, 0.0])
    assert [passed(path, t) for t in (-1.0, 0.0, 1.0, 1.9, 2.0, 3.0, 99.0)] == [0, 0, 0, 0, 1, 2, 2]


def test_accelerations_without_velocities_are_no_quintic() -> None:
    path = w.path([1.0], [0.5], None, [0.3])
    assert interpolate(path, w.at_rest([0.0])).coefficients.shape == (1, 2, 1)
