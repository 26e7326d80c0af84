"""Differentials and linkage tables: there and back, no power lost, and the refusal of what has no inverse."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.support.transmission_strategies import placed, tables
from twind.robot.linkage_table import LinkageTable
from twind.robot.table_cells import TableCell
from twind.robot.transmission import (
    Differential,
    Transmission,
    back,
    condition,
    fair,
    forth,
)


@given(placed())
def test_there_and_back_is_where_it_was(case: tuple[Transmission, np.ndarray]) -> None:
    law, place = case
    assert law.inverse(law.forward(place)) == pytest.approx(place, abs=1e-7)


@given(placed(), st.lists(st.floats(-5.0, 5.0), min_size=6, max_size=6))
def test_no_power_is_lost(case: tuple[Transmission, np.ndarray], numbers: list[float]) -> None:
    law, place = case
    count = place.size
    jacobian = law.jacobian(place)
    # of the actuators
    torque = np.array(numbers[:count])
    speed = np.array(numbers[-count:])
    joints = np.linalg.solve(jacobian.T, torque)
    assert joints @ (jacobian @ speed) == pytest.approx(torque @ speed, abs=1e-6)


@given(placed())
def test_the_jacobian_is_the_slope_of_the_way_forward(case: tuple[Transmission, np.ndarray]) -> None:
    law, place = case
    step = 1e-6
    for column in range(place.size):
        moved = place.copy()
        moved[column] += step
        ahead = law.forward(moved)
        assume(np.isfinite(ahead).all())
        if isinstance(law, LinkageTable):  # not across an edge between two cells
            axis = law.axes[column]
            assume(not any(place[column] < edge <= moved[column] for edge in axis))
        slope = (ahead - law.forward(place)) / step
        assert slope == pytest.approx(law.jacobian(place)[:, column], abs=1e-4)


@given(tables())
def test_the_whole_table_is_found_again_and_only_once(law: LinkageTable) -> None:
    for place in law.checked:
        found = law.preimages(law.forward(place))
        assert found
        for one in found:
            assert one == pytest.approx(place, abs=1e-7)


@given(placed(), st.lists(st.floats(0.1, 10.0), min_size=6, max_size=6))
def test_all_joints_at_their_fair_bounds_ask_no_actuator_for_too_much(
    case: tuple[Transmission, np.ndarray], numbers: list[float]
) -> None:
    law, place = case
    count = place.size
    bound = np.array(numbers[:count])
    own = np.array(numbers[-count:])
    speed = fair(back(law), bound, own)
    assert (speed > 0.0).all() and (speed <= own).all()
    inverse = np.linalg.inv(law.jacobian(place))
    for signs in np.ndindex(*[2] * count):
        asked = inverse @ (speed * (1.0 - 2.0 * np.array(signs)))
        assert (np.abs(asked) <= bound * (1.0 + 1e-6)).all()


def test_a_joint_alone_may_what_its_actuators_can() -> None:
    law = Differential([[0.5, 0.5], [0.5, -0.5]])
    alone = fair(back(law), np.array([4.0, 4.0]), np.array([np.inf, 1e-6]))
    assert alone == pytest.approx([4.0, 1e-6], rel=1e-5)
    both = fair(back(law), np.array([4.0, 4.0]), np.array([np.inf, np.inf]))
    assert both == pytest.approx([2.0, 2.0])
    torque = fair(forth(law).T, np.array([3.0, np.nan]), np.array([np.inf, np.inf]))
    assert np.isnan(torque).all()


def test_a_differential_is_written_as_in_the_robot_file() -> None:
    law = Differential([[-0.25, 0.25], [0.2, 0.2]])
    assert law.forward(np.array([1.0, 1.0])) == pytest.approx([0.0, 0.4])
    assert law.inverse(np.array([0.5, 0.0])) == pytest.approx([-1.0, 1.0])
    assert condition(law) == pytest.approx(1.25)
    assert law == Differential([(-0.25, 0.25), (0.2, 0.2)]) != Differential([[1.0, 0.0], [0.0, 1.0]])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "not square"),
        ([[1.0, 2.0]], "not square"),
        ([[1.0, 2.0], [2.0, 4.0]], "no inverse"),
        ([[1.0, math.nan], [0.0, 1.0]], "not finite"),
    ],
)
def test_a_matrix_that_is_no_differential_is_refused(rows: list[list[float]], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Differential(rows)


def test_a_table_that_folds_has_no_condition_or_two_places_for_one() -> None:
    fold = LinkageTable([[0.0, 1.0, 2.0]], [[0.0], [1.0], [0.2]])
    assert len({round(float(place[0]), 6) for place in fold.preimages(np.array([0.5]))}) == 2
    flat = LinkageTable([[0.0, 1.0, 2.0]], [[0.0], [1.0], [1.0]])
    assert condition(flat) == math.inf


SQUARE = LinkageTable([[-1.0, 1.0], [-1.0, 0.5, 1.0]], [[x, y] for x in (-1, 1) for y in (-1, 0.5, 1)])


@given(st.sampled_from([math.nan, math.inf, -math.inf, 1.0001, -1.0001, 1.0 + 1e-7]), st.booleans())
def test_outside_a_table_joints_cannot_be_sent(place: float, first: bool) -> None:
    angles = np.array([place, 0.0] if first else [0.0, place])
    assert np.isnan(SQUARE.inverse(angles)).all()


@given(placed(), st.floats(1e-6, 3.0), st.floats(1e-6, 3.0))
def test_beyond_a_table_joints_are_beyond_what_it_gives(
    case: tuple[Transmission, np.ndarray], by: float, also: float
) -> None:
    law, _ = case
    assume(isinstance(law, LinkageTable))
    assert isinstance(law, LinkageTable)
    edge = np.array([axis[-1] for axis in law.axes])
    found = law.forward(edge + np.array([by, also])[: edge.size])
    assert np.isnan(law.inverse(found)).all()
    just = law.forward(edge + 1e-7)
    assert just == pytest.approx(law.forward(edge), abs=1e-5)


@pytest.mark.parametrize("place", [math.nan, math.inf, -math.inf])
def test_a_non_finite_angle_gives_nan(place: float) -> None:
    for angles in (np.array([place, 0.0]), np.array([0.0, place])):
        assert np.isnan(SQUARE.forward(angles)).all()
        assert np.isnan(SQUARE.jacobian(angles)).all()


@pytest.mark.parametrize(
    ("axes", "values", "message"),
    [
        ([[0.0, 1.0]] * 3, [[0.0] * 3] * 8, "one or two actuators"),
        ([[0.0]], [[0.0]], "two places at least"),
        ([[0.0, 0.0]], [[0.0], [1.0]], "ascending"),
        ([[0.0, 1.0]], [[0.0]], "not the grid"),
        ([[0.0, 1.0]], [[0.0], [math.nan]], "finite"),
        ([[0.0, math.nan]], [[0.0], [1.0]], "ascending"),
        ([[0.0, math.inf]], [[0.0], [1.0]], "finite"),
    ],
)
def test_an_invalid_linkage_table_is_refused(
    axes: list[list[float]], values: list[list[float]], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        LinkageTable(axes, values)


def test_a_position_in_a_large_table_is_searched_in_few_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """64 x 64 places are as quick as 8 x 8, also where the cells are long and lie askew."""
    axis = np.linspace(-1.0, 1.0, 64).tolist()
    rows = [[(a + b) / 2 + 0.01 * math.sin(a), 0.03 * (a - b) / 2] for a in axis for b in axis]
    law = LinkageTable([axis, axis], rows)
    tried = []
    solved = []
    hold = TableCell.may_hold
    solve = TableCell.solve
    monkeypatch.setattr(TableCell, "may_hold", lambda cell, wanted: tried.append(cell) or hold(cell, wanted))
    monkeypatch.setattr(TableCell, "solve", lambda cell, wanted: solved.append(cell) or solve(cell, wanted))
    for place in np.random.default_rng(0).uniform(-0.9, 0.9, (50, 2)):
        before = len(tried), len(solved)
        assert law.inverse(law.forward(place)) == pytest.approx(place, abs=1e-7)
        assert len(tried) - before[0] <= 12
        assert len(solved) - before[1] == 1
