"""Bernstein bounds: the decision is the truth, at the edge of a double."""

from math import comb, inf, nan, nextafter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.safety.polynomial_bounds import elevate, evaluate, exceeds, halves, square, summit

NUMBERS = st.floats(-10.0, 10.0, allow_subnormal=False)
CURVES = st.integers(0, 8).flatmap(lambda d: st.lists(NUMBERS, min_size=d + 1, max_size=d + 1)).map(np.array)


def bernstein(curve: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Independently: sum of binomials."""
    d = len(curve) - 1
    return sum(comb(d, i) * u**i * (1 - u) ** (d - i) * c for i, c in enumerate(curve))


def alone(curve: np.ndarray, bound: float) -> float:
    return float(exceeds([(curve[:, None], np.array([bound]))])[0])


@given(CURVES)
def test_the_forms_agree_on_the_values(curve: np.ndarray) -> None:
    u = np.linspace(0.0, 1.0, 11)
    values = bernstein(curve, u)
    assert np.allclose(evaluate(curve[:, None], u), values, atol=1e-11)
    assert np.allclose(evaluate(elevate(curve[:, None], len(curve) + 2), u), values, atol=1e-11)
    assert np.allclose(evaluate(square(curve[:, None]), u), values**2, atol=1e-9)
    left, right = halves(curve[:, None])
    assert np.allclose(evaluate(left, u), bernstein(curve, u / 2), atol=1e-11)
    assert np.allclose(evaluate(right, u), bernstein(curve, 0.5 + u / 2), atol=1e-11)


@given(CURVES, NUMBERS)
def test_a_curve_declared_below_its_bound_stays_below_it(curve: np.ndarray, bound: float) -> None:
    values = bernstein(curve, np.linspace(0.0, 1.0, 257))
    u = alone(curve, bound)
    if np.isnan(u):
        assert (values <= bound + 1e-12).all()
    else:
        assert bernstein(curve, np.array([u]))[0] > bound - 1e-9


@given(CURVES)
def test_a_bound_a_hair_above_the_peak_passes_and_one_below_does_not(curve: np.ndarray) -> None:
    values = bernstein(curve, np.linspace(0.0, 1.0, 4097))
    slack = 1e-5 * (np.abs(curve).max() + 1.0)  # of looking at 4097 places only
    assert np.isnan(alone(curve, values.max() + slack))
    assert not np.isnan(alone(curve, values.max() - 1e-9))


def test_the_ends_are_decided_to_the_last_bit() -> None:
    curve = np.array([0.0, 0.3, 1.7, 1.7])
    assert np.isnan(alone(curve, 1.7))
    assert alone(curve, nextafter(1.7, 0.0)) == 1.0
    assert alone(curve[::-1], nextafter(1.7, 0.0)) == 0.0


def test_a_touch_between_the_ends_is_decided_within_rounding() -> None:
    curve = np.array([0.0, 1.0, 0.0])  # peak 0.5 in the middle
    assert np.isnan(alone(curve, 0.5))
    assert np.isnan(alone(curve, 0.5 + 1e-9))
    assert alone(curve, 0.5 - 1e-9) == 0.5
    off = np.array([0.0, 1.0, 0.1])  # peak 1/1.9, at no binary fraction
    peak = 1.0 / 1.9
    assert np.isnan(alone(off, peak + 1e-12))
    assert not np.isnan(alone(off, peak - 1e-12))


def test_a_single_alternative_suffices_at_each_point() -> None:
    falling = np.array([[1.0], [0.0]])
    rising = np.array([[0.0], [1.0]])
    enough = np.array([0.5])
    short = np.array([0.49])
    assert np.isnan(exceeds([(falling, enough), (rising, enough)])[0])
    assert exceeds([(falling, short), (rising, short)])[0] == 0.5


def test_nothing_known_is_above_every_bound() -> None:
    for curve in ([nan, 0.0], [0.0, nan, 0.0], [0.0, inf], [-inf, inf, 0.0]):
        with np.errstate(invalid="ignore"):
            assert not np.isnan(alone(np.array(curve), 1.0))
    assert not np.isnan(alone(np.array([0.0, 0.0]), nan))


def test_a_place_that_halving_never_isolates_counts_as_above() -> None:
    falling = np.array([[1.0], [0.0]])
    rising = np.array([[0.0], [1.0]])
    third = exceeds([(falling, np.array([2.0 / 3.0])), (rising, np.array([1.0 / 3.0]))])[0]
    assert third == pytest.approx(1.0 / 3.0, abs=1e-7)


def test_more_such_places_than_a_curve_of_ours_can_have_count_as_above() -> None:
    n = 20  # the Chebyshev polynomial of degree n is 0 at n places, none of them a binary fraction
    waves = np.array([(-1) ** (n - i) * comb(2 * n, 2 * i) / comb(n, i) for i in range(n + 1)])[:, None]
    assert not np.isnan(exceeds([(waves, np.zeros(1)), (-waves, np.zeros(1))])[0])


@examples(40)
@given(st.lists(st.lists(NUMBERS, min_size=5, max_size=5), min_size=1, max_size=6), st.data())
def test_the_summit_of_each_group_is_its_highest_point(
    curves: list[list[float]], data: st.DataObject
) -> None:
    rows = np.array(curves).T
    places = st.integers(0, 1)
    group = np.array(data.draw(st.lists(places, min_size=len(curves), max_size=len(curves))))
    columns, u = summit(lambda c, u: evaluate(rows[:, c, None], u), np.zeros(len(curves)), group)
    assert list(group[columns]) == sorted(set(group))
    for column, at in zip(columns, u, strict=True):
        reached = bernstein(rows[:, column], np.array([at]))[0]
        looked = max(float(rows[[0, -1], c].max()) for c in np.flatnonzero(group == group[column]))
        assert reached >= looked - 1e-12


def test_the_summit_is_found_to_a_billionth() -> None:
    rows = np.array([[0.0, 1.0, 0.1], [0.0, 0.2, 0.1]]).T
    columns, u = summit(lambda c, u: evaluate(rows[:, c, None], u), np.array([1.0, 1.0]), np.array([0, 0]))
    assert list(columns) == [0]
    assert abs(evaluate(rows[:, :1], u)[0] - 1.0 / 1.9) < 1e-9
