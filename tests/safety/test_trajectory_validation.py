"""The form of a trajectory: names, shapes, numbers and times, all that is wrong said at once."""

from math import inf, nan, nextafter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.robot.finding import ReasonCode
from twind.robot.trajectory import Trajectory
from twind.safety.trajectory_validation import PointRow, form, wellformed

NAMES = ("l_hip", "l_knee", "r_knee")


def codes(names: list[str], *rows: object, **over: object) -> list[ReasonCode]:
    path, findings = form(names, rows, NAMES, **over)
    assert (path is None) is bool(findings)
    return [finding.code for finding in findings]


def test_a_message_becomes_arrays_in_the_order_of_the_robot() -> None:
    rows = [PointRow(0.5, [1, 2.0], [0.1, 0.2]), PointRow(1.0, [3.0, 4.0], [0.0, 0.0])]
    path, findings = form(["r_knee", "l_hip"], rows, NAMES)
    assert findings == ()
    assert path.commanded.tolist() == [True, False, True]
    assert path.time.tolist() == [0.5, 1.0]
    assert path.position[:, [0, 2]].tolist() == [[2.0, 1.0], [4.0, 3.0]]
    assert path.velocity[:, [0, 2]].tolist() == [[0.2, 0.1], [0.0, 0.0]]
    assert path.acceleration is None
    assert np.isnan(path.position[:, 1]).all()  # what is not asked for is no number


def test_accelerations_come_along() -> None:
    path, _ = form(["l_hip"], [(1.0, [0.1], [0.2], [0.3])], NAMES)
    assert path.acceleration[0, 0] == 0.3


def test_a_wrong_name_is_answered_with_the_nearest() -> None:
    (finding,) = form(["l_kne"], [PointRow(1.0, [0.0])], NAMES)[1]
    assert finding.code is ReasonCode.UNKNOWN_JOINT
    assert "'l_kne'" in finding.message
    assert "nearest: l_knee" in finding.message
    (finding,) = form(["xyz"], [PointRow(1.0, [0.0])], [f"joint_{place}" for place in range(24)])[1]
    assert finding.message.count("joint_") == 3
    assert "`twindctl status --joints` lists all" in finding.message


def test_missing_wrong_and_repeated_names_are_all_reported() -> None:
    assert codes([], PointRow(1.0, [])) == [ReasonCode.NO_JOINTS]
    assert codes(["l_hip", "l_hip"], PointRow(1.0, [0.0, 0.0])) == [ReasonCode.DUP_JOINT]
    assert codes(["a", "b", "l_hip", "l_hip"]) == [
        ReasonCode.UNKNOWN_JOINT,
        ReasonCode.UNKNOWN_JOINT,
        ReasonCode.DUP_JOINT,
        ReasonCode.EMPTY,
    ]


def test_a_flood_of_wrong_names_gets_a_short_answer() -> None:
    findings = form([f"joint{i}" for i in range(5000)], [PointRow(1.0, [0.0])] * 2000, NAMES)[1]
    assert len(findings) <= 64


def test_no_points_are_no_trajectory() -> None:
    assert codes(["l_hip"]) == [ReasonCode.EMPTY]


@pytest.mark.parametrize(
    "row",
    [
        (1.0, [0.0]),
        (1.0, [0.0], None, None, [0.0]),  # efforts are not ours
        (1.0, [], None, None),
        (1.0, None, [0.0], None),
        (1.0, [0.0, 0.0], None, None),
        (1.0, [0.0], [0.0, 0.0], None),
        (1.0, [0.0], [0.0], []),
        (1.0, [0.0], None, [0.0]),
        (1.0, [True], None, None),
        (1.0, ["0"], None, None),
        (1.0, [None], None, None),
        (1.0, [[0.0]], None, None),
        (True, [0.0], None, None),
        ("1", [0.0], None, None),
        (None, [0.0], None, None),
    ],
)
def test_a_point_of_the_wrong_shape_or_kind_is_refused(row: tuple) -> None:
    assert codes(["l_hip"], row) == [ReasonCode.BAD_SHAPE]


def test_points_are_all_as_rich_as_the_first() -> None:
    plain = PointRow(1.0, [0.0])
    fast = PointRow(2.0, [0.0], [0.0])
    full = PointRow(3.0, [0.0], [0.0], [0.0])
    for rows in ((plain, fast), (fast, PointRow(2.5, [0.0])), (fast, full)):
        findings = form(["l_hip"], rows, NAMES)[1]
        assert [(f.code, f.point) for f in findings] == [(ReasonCode.BAD_SHAPE, 1)]


def test_too_many_points_and_too_long_a_path_share_a_code() -> None:
    rows = [PointRow(0.01 * i, [0.0]) for i in range(2001)]
    assert codes(["l_hip"], *rows[:2000]) == []
    assert codes(["l_hip"], *rows) == [ReasonCode.TOO_MANY_POINTS]
    assert codes(["l_hip"], PointRow(60.0, [0.0])) == []
    assert codes(["l_hip"], PointRow(nextafter(60.0, 61.0), [0.0])) == [ReasonCode.TOO_MANY_POINTS]
    assert codes(["l_hip"], *rows[:3], max_points=2) == [ReasonCode.TOO_MANY_POINTS]


@pytest.mark.parametrize("bad", [nan, inf, -inf, 10**400, -(10**400)])
def test_numbers_that_are_not_finite_are_refused_where_they_stand(bad: float) -> None:
    for row in ((1.0, [0.0, bad], None, None), (1.0, [0.0, 0.0], [0.0, bad], None)):
        (finding,) = form(["l_hip", "l_knee"], [row], NAMES)[1]
        assert (finding.code, finding.joint, finding.point) == (ReasonCode.NONFINITE, 1, 0)
    (finding,) = form(["l_hip"], [(1.0, [0.0], [0.0], [bad])], NAMES)[1]
    assert finding.message == "acceleration"


def test_times_that_are_not_finite_are_refused() -> None:
    assert ReasonCode.NONFINITE in codes(["l_hip"], PointRow(nan, [0.0]))
    assert ReasonCode.NONFINITE in codes(["l_hip"], PointRow(0.5, [0.0]), PointRow(inf, [0.0]))
    assert ReasonCode.NONFINITE in codes(["l_hip"], PointRow(-inf, [0.0]))


@pytest.mark.parametrize(
    ("times", "point"),
    [
        ([-0.1, 1.0], 0),
        ([-5e-324], 0),
        ([0.0005], 0),  # a first segment shorter than 1 ms
        ([0.0, 0.0], 1),
        ([0.5, 0.4, 0.3], 1),
        ([0.5, 0.5009], 1),
        ([1.0, 2.0, 2.0], 2),
    ],
)
def test_times_must_begin_at_zero_or_later_and_increase_by_a_millisecond(
    times: list[float], point: int
) -> None:
    findings = form(["l_hip"], [PointRow(t, [0.0]) for t in times], NAMES)[1]
    assert [(f.code, f.point) for f in findings] == [(ReasonCode.TIME_ORDER, point)]


def test_a_thousand_points_a_second_are_in_order_whatever_rounding_does() -> None:
    for begin in (0.0, 7.3, 58.9):
        rows = [PointRow(begin + i * 0.001, [0.0]) for i in range(1000)]
        assert codes(["l_hip"], *rows) == []


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=6,
)
NUMBERS = st.lists(st.floats() | st.integers(-3, 3), max_size=3)
ROWS = st.tuples(
    ANYTHING | st.floats(0.0, 9.0), NUMBERS | st.none(), NUMBERS | st.none(), NUMBERS | st.none()
)


@examples(150)
@given(st.lists(st.sampled_from((*NAMES, "x", "")), max_size=4), st.lists(ROWS, max_size=4))
def test_any_message_gets_a_path_or_findings(names: list[str], rows: list[tuple]) -> None:
    path, findings = form(names, rows, NAMES)
    assert (path is None) is bool(findings)
    if path is not None:
        assert path.commanded.sum() == len(names)
        assert np.isfinite(path.position[:, path.commanded]).all()
        assert wellformed(path, 3, 2000, 60.0, 0.001) == []


def test_arrays_that_do_not_fit_together_are_named() -> None:
    time = np.array([1.0, 2.0])
    rows = np.zeros((2, 2))
    both = np.ones(2, np.bool_)
    for path, word in (
        (Trajectory(time[:, None], rows, both), "time"),
        (Trajectory(time, np.zeros((2, 3)), both), "position"),
        (Trajectory(time, rows, np.ones(3, np.bool_)), "commanded"),
        (Trajectory(time, rows, both, np.zeros((1, 2))), "velocity"),
        (Trajectory(time, rows, both, rows, np.zeros((2, 1))), "acceleration"),
        (Trajectory(time, rows, both, None, rows), "accelerations need velocities"),
    ):
        findings = wellformed(path, 2, 2000, 60.0, 0.001)
        assert [finding.code for finding in findings] == [ReasonCode.BAD_SHAPE]
        assert word in findings[0].message
