"""Span of actuators while their joints stay in a box: no place in the box leads beyond it, or it is NaN."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.support.transmission_strategies import placed, tables
from twind.robot.linkage_table import LinkageTable
from twind.robot.transmission import Differential, Transmission, span

SHARES = st.floats(0.0, 1.0)
ROUNDING = 1e-6  # rad


def squared(places: int, law: Callable[[float, float], tuple[float, float]]) -> LinkageTable:
    """So many places on each of two axes within 1.15 rad."""
    axis = np.linspace(-1.15, 1.15, places).tolist()
    return LinkageTable([axis, axis], [law(a, b) for a in axis for b in axis])


def pushed(a: float, b: float) -> tuple[float, float]:
    return 0.45 * a, 0.3 * b + 0.3 * a * a


def waved(a: float, b: float) -> tuple[float, float]:
    return 0.45 * a, 0.35 * b + 0.2 * math.cos(2.2 * a)


def edges(lower: np.ndarray, upper: np.ndarray, count: int) -> np.ndarray:
    """Places (m, 2) along all four edges of a box."""
    along = np.linspace(lower, upper, count)
    sides = [np.stack([along[:, 0], np.full(count, end)], axis=1) for end in (lower[1], upper[1])]
    sides += [np.stack([np.full(count, end), along[:, 1]], axis=1) for end in (lower[0], upper[0])]
    return np.concatenate(sides)


@given(placed())
def test_the_span_of_a_box_contains_every_position_in_it(case: tuple[Transmission, np.ndarray]) -> None:
    law, place = case
    centre = law.forward(place)
    lower = centre - 0.01
    upper = centre + 0.01
    low, high = span(law, lower, upper)
    assume(np.isfinite(low).all() and np.isfinite(high).all())
    assert (place >= low - 1e-6).all() and (place <= high + 1e-6).all()


@given(placed(), st.lists(st.floats(0.0, 0.3), min_size=3, max_size=3), st.data())
def test_no_pose_of_the_box_leads_an_actuator_beyond_its_span(
    case: tuple[Transmission, np.ndarray], half: list[float], data: st.DataObject
) -> None:
    law, place = case
    centre = law.forward(place)
    sizes = np.array(half[: place.size])
    lower = centre - sizes
    upper = centre + sizes
    low, high = span(law, lower, upper)
    assume(np.isfinite(low).all() and np.isfinite(high).all())
    shares = np.array(data.draw(st.lists(SHARES, min_size=place.size, max_size=place.size)))
    inside = lower + shares * (upper - lower)
    angles = law.inverse(inside)  # a place that is not known is in no span
    assert (angles >= low - ROUNDING).all() and (angles <= high + ROUNDING).all()


@given(tables(), SHARES, SHARES, st.floats(0.0, 0.3), st.floats(0.0, 0.3))
def test_the_ends_of_a_span_are_where_the_joints_are_in_the_box(
    law: LinkageTable, one: float, other: float, wide: float, high: float
) -> None:
    ends = np.array([[axis[0], axis[-1]] for axis in law.axes])
    shares = np.array([one, other])[: len(ends)]
    centre = law.forward(ends[:, 0] + shares * (ends[:, 1] - ends[:, 0]))
    sizes = np.array([wide, high])[: len(ends)]
    found = law.extremes(centre - sizes, centre + sizes)
    assume(np.isfinite(found).all())
    for place in found:
        assert (np.abs(law.forward(place) - centre) <= sizes + ROUNDING).all()


@pytest.mark.parametrize("places", [4, 5, 6, 8, 12, 15, 30])
@pytest.mark.parametrize("law", [pushed, waved])
def test_kinks_of_a_table_between_any_two_places_of_an_edge_count(
    law: Callable[[float, float], tuple[float, float]], places: int
) -> None:
    table = squared(places, law)
    lower = np.array([-0.4, -0.1])
    upper = np.array([0.37, 0.1])
    angles = np.array([table.inverse(place) for place in edges(lower, upper, 401)])
    low, high = span(table, lower, upper)
    if np.isnan(angles).any():
        assert np.isnan([*low, *high]).all()
    else:
        assert (angles >= low - ROUNDING).all() and (angles <= high + ROUNDING).all()


@pytest.mark.parametrize(("top", "known"), [(0.344, True), (0.346, False), (0.36, False)])
def test_a_box_whose_edge_leaves_the_table_between_its_corners_has_no_span(top: float, known: bool) -> None:
    table = squared(7, pushed)
    lower = np.array([-0.4, 0.3])
    upper = np.array([0.4, top])
    assert np.isfinite([table.inverse(np.array([pitch, top])) for pitch in (-0.4, 0.4)]).all()
    assert np.isfinite(span(table, lower, upper)).all() == known


def test_a_box_that_is_the_whole_table_has_the_whole_table_as_its_span() -> None:
    axis = [-1.0, -0.25, 0.5, 1.0]
    table = LinkageTable([axis, axis], [[0.3 * a, -0.7 * b] for a in axis for b in axis])
    low, high = span(table, np.array([-0.3, -0.7]), np.array([0.3, 0.7]))
    assert low == pytest.approx([-1.0, -1.0]) and high == pytest.approx([1.0, 1.0])
    low, _ = span(table, np.array([-0.3, -0.7]), np.array([0.3, 0.7 + 1e-6]))
    assert np.isnan(low).all()


def test_a_matrix_spans_what_its_corners_do() -> None:
    low, high = span(Differential([[-0.25, 0.25], [0.2, 0.2]]), np.array([-0.1, -0.2]), np.array([0.1, 0.4]))
    assert low == pytest.approx([-0.7, -0.7]) and high == pytest.approx([1.2, 1.2])
