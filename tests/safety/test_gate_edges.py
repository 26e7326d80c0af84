"""The edges of the gate's rules, one by one, in numbers that can be worked out by hand."""

from typing import Any

import numpy as np
import pytest

from tests.support import gate_rig as w
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Reference
from twind.safety import curve_rules
from twind.safety.gate import GateResult, TrajectoryRequest, checking
from twind.safety.polynomial_bounds import elevate, evaluate, exceeds, summit


def warned(judged: GateResult) -> list[Finding]:
    return [finding for finding in judged.verdict.warnings if finding.code is ReasonCode.JERK_LIMIT]


def of(code: ReasonCode, judged: GateResult) -> list[Finding]:
    return [finding for finding in judged.verdict.refusals if finding.code is code]


# ------------------------------------------------------------------------------------------ curves


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("share", [0.999, 1.001])
def test_a_quintic_is_warned_of_by_its_jerk(sign: float, share: float) -> None:
    # the same all the way
    T = 0.004
    jerk = sign * share * 5000.0
    path = w.path([0.0, T], [0.0, jerk * T**3 / 6.0], [0.0, jerk * T**2 / 2.0], [0.0, jerk * T])
    judged = w.ask(path, w.limits(1, acceleration=1e4), w.at_rest([0.0]))
    found = [(finding.value, finding.bound) for finding in warned(judged)]
    assert found == ([(pytest.approx(share * 5000.0), 5000.0)] if share > 1.0 else [])


def test_a_quintic_of_one_acceleration_has_no_jerk() -> None:
    T = 0.004
    a = 10.0
    path = w.path([0.0, T], [0.0, a * T**2 / 2.0], [0.0, a * T], [a, a])
    assert not warned(w.ask(path, w.limits(1), w.at_rest([0.0])))


def test_the_jerk_of_lines_is_what_the_corners_change_by_over_the_line_between() -> None:
    slopes = np.array([0.0, 0.0, 0.05, -0.05, 0.0, 0.0])
    T = 0.002
    place = np.cumsum(slopes) * T
    corners = np.diff([0.0, *slopes, 0.0]) / T
    corners[[0, -1]] *= 2.0  # half of one line alone
    expected = np.abs(np.diff(corners)) / T
    judged = w.ask(
        w.path(list(np.arange(1, 7) * T), list(place)), w.limits(1, acceleration=1e3), w.at_rest([0.0])
    )
    [told] = warned(judged)
    assert told.value == pytest.approx(expected.max(), rel=1e-9)
    assert told.bound == 5000.0


def test_an_error_at_the_reference_is_reported_for_the_first_point() -> None:
    moving = Reference(np.array([0.0]), np.array([4.5]), np.zeros(1))
    [told] = of(ReasonCode.VEL_LIMIT, w.ask(w.path([1.0], [0.0], [0.0]), w.limits(1), moving))
    assert (told.point, told.time, told.value) == (0, 0.0, 4.5)


def test_a_single_joint_outside_its_limits_may_return_beside_joints_inside() -> None:
    for outside in ([2.02, 0.0], [0.0, 2.02]):
        path = w.path([1.0], [[0.9 * each for each in outside]])
        assert w.ask(path, w.limits(), w.at_rest(outside)).verdict.accepted


def test_a_place_that_is_only_held_needs_no_acceleration() -> None:
    assert w.ask(w.path([0.0], [0.5]), w.limits(1, acceleration=1e-3)).verdict.accepted


@pytest.mark.parametrize(("high", "low", "reported"), [(2.3, -0.7, 2.3), (2.1, -0.7, -0.7)])
def test_the_limit_exceeded_by_more_radians_is_reported(high: float, low: float, reported: float) -> None:
    limit = w.limits(1, lower=-0.5, upper=2.0, hard_lower=-3.0, hard_upper=3.0)
    [finding] = of(
        ReasonCode.POS_LIMIT, w.ask(w.path([2.0, 6.0, 8.0], [high, low, 0.0]), limit, w.at_rest([0.0]))
    )
    assert (finding.value, finding.bound) == (reported, 2.0 if reported > 0.0 else -0.5)


def test_a_smooth_path_that_begins_at_once_is_held_to_the_step_at_its_start() -> None:
    moving = Reference(np.array([0.0]), np.array([0.5]), np.zeros(1))
    still = w.path([0.0, 0.1], [0.0, 0.0], [0.0, 0.0])
    [told] = of(ReasonCode.ACC_LIMIT, w.ask(still, w.limits(1, acceleration=5.0), moving))
    assert (told.point, told.time, told.bound) == (0, 0.0, 5.0)
    assert told.value == pytest.approx(10.0)  # 0.5 rad/s over half of 0.1 s
    goes_on = w.path([0.0, 1.0], [0.0, 0.25], [0.5, 0.0])
    assert w.ask(goes_on, w.limits(1, acceleration=0.6), moving).verdict.accepted


def test_the_joint_with_the_largest_relative_excess_is_reported_first() -> None:
    limit = w.limits(acceleration=np.array([20.0, 2.0]))
    path = w.path([0.1, 5.0], [[0.15, 0.03], [0.15, 0.03]])  # corners of 30 and 6 rad/s²
    found = of(ReasonCode.ACC_LIMIT, w.ask(path, limit, w.at_rest([0.0, 0.0])))
    assert [finding.joint for finding in found] == [1, 0]


def test_the_upper_of_two_equal_excesses_is_reported() -> None:
    path = w.path([2.0, 4.0, 6.0], [-2.25, 2.25, 0.0])
    [told] = of(ReasonCode.POS_LIMIT, w.ask(path, w.limits(1), w.at_rest([0.0])))
    assert told.value == 2.25


def test_limits_on_one_side_of_zero_are_checked() -> None:
    for lower, upper, end in ((0.5, 2.0, 0.25), (-2.0, -0.5, -0.25)):
        judged = w.ask(w.path([4.0], [end]), w.limits(1, lower=lower, upper=upper), w.at_rest([4.0 * end]))
        [told] = of(ReasonCode.POS_LIMIT, judged)
        assert told.value == end


@pytest.mark.parametrize("strongest", [0.1, 0.6])
def test_a_joint_with_low_acceleration_needs_more_braking_distance(strongest: float) -> None:
    path = w.path([5.0], [1.9])  # 0.3 rad/s: 1.25 rad or 0.21 to stop in, of which 0.15 are left
    judged = w.ask(path, w.limits(1, acceleration=strongest), w.at_rest([0.4]))
    assert ReasonCode.BRAKE_DISTANCE in w.codes(judged)


def test_room_to_stop_is_looked_for_on_either_side_of_zero() -> None:
    path = w.path([13.0 / 3.0], [0.6])  # down at 0.3 rad/s: 0.21 rad to stop in, of which 0.15 are left
    limit = w.limits(1, lower=0.5, acceleration=0.6)
    assert ReasonCode.BRAKE_DISTANCE in w.codes(w.ask(path, limit, w.at_rest([1.9])))
    up = w.path([13.0 / 3.0], [-0.6])
    limit = w.limits(1, upper=-0.5, acceleration=0.6)
    assert ReasonCode.BRAKE_DISTANCE in w.codes(w.ask(up, limit, w.at_rest([-1.9])))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_room_to_stop_counts_at_each_moment(sign: float) -> None:
    u = np.linspace(0.0, 1.0, 100_001)
    place = 3.0 * u**2 - 2.0 * u**3
    speed = 6.0 * u * (1.0 - u)
    furthest = (place + (speed + 0.2) ** 2 / 20.0).max()
    path = w.path([1.0], [sign], [0.0])
    for more, passes in ((1e-6, True), (-1e-6, False)):
        limit = w.limits(1, acceleration=10.0, hard_upper=furthest + more, hard_lower=-furthest - more)
        assert w.ask(path, limit, w.at_rest([0.0])).verdict.accepted is passes


def test_a_place_that_is_left_by_little_is_seen_behind_many_that_only_seem_to_be() -> None:
    """Nine humps reach 1.9975 and their hulls 2.03: more than are looked at first."""
    speed = [0.39 * (-1.0) ** i for i in range(18)]
    path = w.path(list(np.arange(1.0, 21.0)), [1.9] * 18 + [2.001, 1.9], [*speed, 0.0, 0.0])
    [told] = of(ReasonCode.POS_LIMIT, w.ask(path, w.limits(1), w.at_rest([1.9])))
    assert (told.point, told.value) == (18, 2.001)


def looked_at(monkeypatch: pytest.MonkeyPatch, *asked: Any) -> list[int]:
    """Return the number of segments, of all joints, that each step decides."""
    counts: list[int] = []

    def counting(alternatives: Any) -> np.ndarray:
        counts.append(alternatives[0][0].shape[1])
        return exceeds(alternatives)

    monkeypatch.setattr(curve_rules, "exceeds", counting)
    w.ask(*asked)
    return counts


@pytest.mark.parametrize(
    ("wrong", "looked"), [((40, 40), [16]), ((40, 0), [8]), ((16, 0), [16]), ((17, 0), [8])]
)
def test_a_path_that_is_wrong_everywhere_costs_little(
    monkeypatch: pytest.MonkeyPatch, wrong: tuple[int, int], looked: list[int]
) -> None:
    rows = 3.0 + 0.01 * (np.arange(40) * 17 % 40)[:, None] * np.ones(2)
    rows = np.where(np.arange(40)[:, None] >= 40 - np.array(wrong), rows, 1.9)
    path = w.path(list(np.arange(1.0, 41.0)), list(rows))
    limit = w.limits(hard_lower=-10.0, hard_upper=10.0)
    assert looked_at(monkeypatch, path, limit, w.at_rest([1.9, 1.9])) == looked


def test_nothing_is_looked_at_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """The nine humps are alike, and are decided together; then what is left."""
    speed = [0.39 * (-1.0) ** i for i in range(18)]
    path = w.path(list(np.arange(1.0, 21.0)), [1.9] * 18 + [2.001, 1.9], [*speed, 0.0, 0.0])
    assert looked_at(monkeypatch, path, w.limits(1), w.at_rest([1.9])) == [9, 2]


def test_lines_that_begin_at_once_are_judged_at_their_corners_alone() -> None:
    moving = Reference(np.array([0.0]), np.array([0.5]), np.zeros(1))
    path = w.path([0.0, 1.0, 5.0], [0.0, 0.5, 1.5])  # goes on at 0.5 rad/s, then 0.25, then rest
    assert w.ask(path, w.limits(1, acceleration=0.2), moving).verdict.accepted
    slower = w.path([0.0, 1.0], [0.0, 0.25])  # from 0.5 rad/s to 0.25, and to rest: 0.5 rad/s² both
    assert w.ask(slower, w.limits(1, acceleration=0.6), moving).verdict.accepted


@pytest.mark.parametrize(("step", "pauses"), [(10, 1), (9, 3)])
def test_after_a_pause_a_slice_is_as_long_as_before(step: int, pauses: int) -> None:
    path = w.path(list(np.arange(1, 11) * 0.01), [1.99] * 10)
    snapshot = w.snapshot(1, reference=w.at_rest([2.01]))
    work = checking(path, snapshot, w.limits(1), TrajectoryRequest("retime"), w.TH, points_per_step=step)
    assert len(list(work)) == pauses  # one segment and nine, and the same again, slower


@pytest.mark.parametrize(("time", "before"), [(0.0, 2.02), (1.0, 2.02)])
def test_a_single_point_out_of_place_is_the_first(time: float, before: float) -> None:
    [told] = of(ReasonCode.POS_LIMIT, w.ask(w.path([time], [2.01]), w.limits(1), w.at_rest([before])))
    assert (told.point, told.time, told.value, told.bound) == (0, time, 2.01, 2.0)


# ------------------------------------------------------------------------------------------ bounds


def test_a_polynomial_is_written_in_the_degree_asked_for() -> None:
    for degree in (1, 2, 5):
        assert len(elevate(np.array([[0.0], [1.0]]), degree)) == degree + 1


def test_many_columns_are_decided_as_one_is() -> None:
    peak = 1.0 / 1.9
    curves = np.repeat(np.array([[0.0], [1.0], [0.1]]), 20, axis=1)
    assert np.isnan(exceeds([(curves, np.full(20, peak + 1e-9))])).all()
    assert not np.isnan(exceeds([(curves, np.full(20, peak - 1e-9))])).any()


def highest(rows: list[list[float]]) -> int:
    """The column that is told of one group, its first u being 0.5 in all."""
    curves = np.array(rows).T
    group = np.zeros(curves.shape[1], np.int64)
    [column], _ = summit(lambda c, u: evaluate(curves[:, c, None], u), group + 0.5, group)
    return int(column)


def test_among_many_the_one_that_is_highest_at_an_end_is_found() -> None:
    flat = [[1.0, 1.0]] * 5
    assert highest([*flat, [-10.0, 1.05]]) == 5
    assert highest([*flat, [1.05, -10.0]]) == 5


def test_nothing_outside_of_the_segment_counts() -> None:
    assert highest([*[[0.0, 1.0]] * 5, [1.05, 1.05]]) == 5
    assert highest([*[[1.0, 0.0]] * 5, [1.05, 1.05]]) == 5


def test_a_peak_that_the_first_look_misses_is_found_among_four() -> None:
    peak = [1.0005 - 0.05**2, 1.0005 - 0.05**2 + 0.05, 1.0005 - 0.95**2]  # 1.0005 - (u - 0.05)²
    assert highest([*[[1.0, 1.0, 1.0]] * 3, peak]) == 3


@pytest.mark.parametrize("peak", [0.05, 0.31234, 0.57721, 0.95])
def test_a_peak_is_found_to_a_hundred_thousandth_of_a_segment(peak: float) -> None:
    curve = np.array([[-(peak**2)], [peak - peak**2], [-((1.0 - peak) ** 2)]])  # -(u - peak)²
    zero = np.zeros(1, np.int64)
    _, [u] = summit(lambda c, u: evaluate(curve[:, c, None], u), zero + 0.5, zero)
    assert u == pytest.approx(peak, abs=0.5 / 6**6)
