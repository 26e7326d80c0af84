"""The rules on a curve: what passes is inside everywhere, what is refused is outside somewhere."""

from dataclasses import replace
from math import inf, nextafter, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support import gate_rig as w
from tests.support.examples import examples
from twind.robot.finding import ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.curve_rules import JudgedCurve, judge, relaxed, some, start
from twind.safety.gate import GateThresholds, TrajectoryRequest, check

CURVE = {ReasonCode.POS_LIMIT, ReasonCode.VEL_LIMIT, ReasonCode.ACC_LIMIT, ReasonCode.BRAKE_DISTANCE}
LIMITS = st.sampled_from(
    (
        w.limits(),
        w.limits(lower=np.array([-0.4, -1.0]), upper=np.array([0.5, 0.3])),
        w.limits(velocity=1.0),
        w.limits(velocity=60.0, acceleration=300.0),
        w.limits(velocity=60.0, acceleration=3.0),
    )
)


@examples(150)
@given(w.paths(), w.REFERENCES, LIMITS)
def test_the_gate_and_the_exact_oracle_agree(path: Trajectory, before: Reference, limit: JointLimits) -> None:
    judged = w.codes(w.ask(path, limit, before)) & CURVE
    seen = w.oracle_faults(path, before, limit)
    assert seen <= judged


@examples(100)
@given(w.paths(), LIMITS)
def test_a_finding_names_a_place_of_the_curve_that_is_outside(path: Trajectory, limit: JointLimits) -> None:
    judged = w.ask(path, limit)
    before = w.at_rest(path.position[0])
    for finding in judged.verdict.refusals:
        if finding.code not in CURVE or (path.velocity is None and finding.code is ReasonCode.ACC_LIMIT):
            continue
        segments = w.oracle_segments(path, before, finding.joint)
        starts = np.cumsum([0.0] + [float(T) for T, _ in segments]) + (
            path.time[0] if path.time[0] == 0 else 0
        )
        index = min(max(int(np.searchsorted(starts, finding.time, "right")) - 1, 0), len(segments) - 1)
        near = []
        for i in (index, max(index - 1, 0)) if segments else ():
            s = w.Fraction(finding.time - starts[i])
            p, v, a = (float(w.value_at(segments[i][1], s, d)) for d in range(3))
            near.append(
                {ReasonCode.POS_LIMIT: p, ReasonCode.VEL_LIMIT: abs(v), ReasonCode.ACC_LIMIT: abs(a)}.get(
                    finding.code, abs(v)
                )
            )
        if finding.time == 0.0 == path.time[0] and path.velocity is not None and len(path.time) > 1:
            step = abs(path.velocity[0, finding.joint] - before.velocity[finding.joint])
            near.append(
                step / (0.5 * path.time[1])
            )  # the step at the start, as at a corner of lines (ACC_LIMIT)
        if segments:
            assert min(abs(value - finding.value) for value in near) < 1e-6 * (1.0 + abs(finding.value))
            assert abs(finding.value) >= abs(finding.bound) or finding.code is ReasonCode.POS_LIMIT


@examples(40)
@given(w.paths(most=3), st.integers(0, 1))
def test_limits_a_hair_above_the_largest_values_pass(path: Trajectory, joint: int) -> None:
    """Tight: no refusal of a curve that is inside by a thousandth, and none slips by above by a billionth."""
    before = w.at_rest(path.position[0])
    values = np.array(
        [
            [
                [float(w.value_at(c, T * k / 100, d)) for d in range(3)]
                for k in range(101)
                for T, c in segments
            ]
            for segments in (w.oracle_segments(path, before, j) for j in range(2))
        ]
    )
    if not values.size:
        return
    top = values.max(axis=1)
    low = values.min(axis=1)
    slack = 1e-3 * (1.0 + np.abs(values).max(axis=(0, 1)))  # of looking at 101 places per segment only
    fast = np.maximum(np.abs(top), np.abs(low)) + slack
    wide = w.limits(
        lower=low[:, 0] - slack[0], upper=top[:, 0] + slack[0], velocity=fast[:, 1], acceleration=fast[:, 2]
    )
    refused = w.codes(w.ask(path, wide))
    assert ReasonCode.POS_LIMIT not in refused
    assert ReasonCode.VEL_LIMIT not in refused
    if path.velocity is not None and path.time[0] > 0.0:
        assert ReasonCode.ACC_LIMIT not in refused
    if path.position[:, joint].max() <= before.position[joint]:
        return  # it only comes in from there, which is allowed
    row = top[joint, 0] - 1e-9
    assert ReasonCode.POS_LIMIT in w.codes(
        w.ask(path, replace(wide, upper=np.where(np.arange(2) == joint, row, wide.upper)))
    )


@examples(100)
@given(
    w.paths(),
    st.sampled_from(("lower", "upper", "hard_lower", "hard_upper", "velocity", "acceleration")),
    st.floats(1e-12, 0.5),
)
def test_tightening_a_limit_never_lets_a_path_in(path: Trajectory, name: str, by: float) -> None:
    loose = w.limits(velocity=6.0, acceleration=60.0)
    sign = 1.0 if "lower" in name else -1.0
    row = getattr(loose, name)
    tight = replace(loose, **{name: row + sign * by * (1.0 if "er" in name else row)})
    if not w.ask(path, loose).verdict.accepted:
        assert not w.ask(path, tight).verdict.accepted


@examples(100)
@given(w.paths(), st.floats(1.0, 5.0), st.sampled_from((0.5, 2.0)))
def test_stretching_time_never_makes_a_path_too_fast(path: Trajectory, factor: float, fastest: float) -> None:
    limit = w.limits(velocity=fastest)
    if ReasonCode.VEL_LIMIT not in w.codes(w.ask(path, limit)):
        assert ReasonCode.VEL_LIMIT not in w.codes(w.ask(path.stretched(factor), limit))


# ------------------------------------------------------------------------------------------ edges


@pytest.mark.parametrize("rates", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_position_limit_is_inclusive_to_the_last_bit(rates: int, sign: float) -> None:
    zeros = [0.0, 0.0]
    given = [zeros if rates > i else None for i in range(2)]
    before = w.at_rest([sign * 1.5])
    for end, passes in ((2.0, True), (nextafter(2.0, 0.0), True), (nextafter(2.0, 3.0), False)):
        judged = w.ask(w.path([2.0, 4.0], [sign * 1.7, sign * end], *given), w.limits(1), before)
        assert (ReasonCode.POS_LIMIT not in w.codes(judged)) is passes
        if not passes:
            (finding,) = [one for one in judged.verdict.refusals if one.code is ReasonCode.POS_LIMIT]
            assert (finding.joint, finding.point, finding.time) == (0, 1, 4.0)
            assert (finding.value, finding.bound) == (sign * end, sign * 2.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_curve_that_leaves_the_limits_between_its_points_is_seen(sign: float) -> None:
    path = w.path([1.0, 2.0], [sign * 1.95, sign * 1.95], [sign * 0.4, sign * -0.4])
    judged = w.ask(path, w.limits(1), w.at_rest([sign * 1.8]))
    (finding,) = [one for one in judged.verdict.refusals if one.code is ReasonCode.POS_LIMIT]
    assert finding.point == 0
    assert finding.time == pytest.approx(1.5, abs=1e-4)
    assert finding.value == pytest.approx(sign * 2.05, abs=1e-9)
    assert finding.bound == sign * 2.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_velocity_limit_is_inclusive_to_the_last_bit(sign: float) -> None:
    wide = w.limits(1, acceleration=1e4)
    for v, passes in ((1.5, True), (nextafter(1.5, 0.0), True), (nextafter(1.5, 2.0), False)):
        lines = w.path([1.0], [sign * v])
        cubics = w.path([1.0, 2.0], [sign * 0.5, sign * 0.6], [sign * v, 0.0])
        for path in (lines, cubics):
            judged = w.ask(path, replace(wide, velocity=np.array([1.5])), w.at_rest([0.0]))
            assert (ReasonCode.VEL_LIMIT not in w.codes(judged)) is passes


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_acceleration_at_the_points_is_inclusive_to_the_last_bit(sign: float) -> None:
    for a, passes in ((3.0, True), (nextafter(3.0, 0.0), True), (nextafter(3.0, 4.0), False)):
        path = w.path([1.0, 3.0], [0.0, 0.0], [0.0, 0.0], [0.0, sign * a])
        judged = w.ask(path, w.limits(1, acceleration=3.0), w.at_rest([0.0]))
        assert (ReasonCode.ACC_LIMIT not in w.codes(judged)) is passes


def test_the_corner_of_two_lines_counts_over_half_of_both() -> None:
    path = w.path([1.0, 2.0, 4.0], [0.0, 1.0, 1.0])  # 0, 1, 0 rad/s; corners over 1 and 1.5 s
    for a, passes in ((1.0, True), (nextafter(1.0, 0.0), False)):
        judged = w.ask(path, w.limits(1, acceleration=a), w.at_rest([0.0]))
        assert judged.verdict.accepted is passes
    (finding,) = judged.verdict.refusals
    assert (finding.code, finding.point, finding.time, finding.value) == (ReasonCode.ACC_LIMIT, 0, 1.0, 1.0)


def test_the_first_line_takes_over_the_speed_of_the_reference() -> None:
    moving = Reference(np.array([0.0]), np.array([-1.0]), np.zeros(1))
    path = w.path([1.0, 2.0], [0.5, 0.5])  # from -1 to 0.5 rad/s over half of a second
    for a, passes in ((3.0, True), (nextafter(3.0, 0.0), False)):
        assert w.ask(path, w.limits(1, acceleration=a), moving).verdict.accepted is passes


def test_the_last_line_ends_at_rest() -> None:
    path = w.path([4.0, 5.0], [0.0, 1.0])  # from 1 rad/s to rest over half of a second
    for a, passes in ((2.0, True), (nextafter(2.0, 0.0), False)):
        judged = w.ask(path, w.limits(1, acceleration=a), w.at_rest([0.0]))
        assert judged.verdict.accepted is passes
    (finding,) = judged.verdict.refusals
    assert (finding.point, finding.time, finding.value, finding.bound) == (1, 5.0, 2.0, nextafter(2.0, 0.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_speed_towards_a_limit_must_leave_room_to_stop(sign: float) -> None:
    end = 1.5
    v = 2.0
    path = w.path([10.0, 11.0], [sign * (end - v), sign * end])
    for hard, passes in ((end + 2.2**2 / 40.0 + 1e-9, True), (end + 2.2**2 / 40.0 - 1e-9, False)):
        limit = w.limits(1, hard_upper=hard, hard_lower=-hard)
        judged = w.ask(path, limit, w.at_rest([sign * (end - v)]))
        assert (ReasonCode.BRAKE_DISTANCE not in w.codes(judged)) is passes
    (finding,) = judged.verdict.refusals
    assert finding.value == pytest.approx(2.0)
    assert finding.bound == pytest.approx(2.0, abs=1e-6)
    assert finding.time == pytest.approx(11.0)
    away = w.path([10.0, 11.0], [sign * end, sign * (end - v)])
    assert ReasonCode.BRAKE_DISTANCE not in w.codes(w.ask(away, limit, w.at_rest([sign * end])))


def test_creeping_to_the_limit_is_free() -> None:
    for v, passes in ((0.05, True), (nextafter(0.05, 1.0), False)):
        limit = w.limits(1, upper=0.5, hard_upper=0.5, acceleration=1.0)
        judged = w.ask(w.path([0.5 / v], [0.5]), limit, w.at_rest([0.0]))
        assert judged.verdict.accepted is passes


def test_jerk_only_warns() -> None:
    path = w.path([0.1, 0.12], [0.0, 0.0002], [0.0, 0.0], [0.0, 101.0])
    judged = w.ask(path, w.limits(1, acceleration=1e3), w.at_rest([0.0]))
    assert judged.verdict.accepted
    assert {finding.code for finding in judged.verdict.warnings} == {ReasonCode.JERK_LIMIT}
    lines = w.path([1.0, 1.001, 1.002], [0.0, 0.00001, 0.0])
    judged = w.ask(lines, w.limits(1), w.at_rest([0.0]))
    assert judged.verdict.accepted
    assert {finding.code for finding in judged.verdict.warnings} == {ReasonCode.JERK_LIMIT}


# ------------------------------------------------------------------------------------------ the start


def test_a_joint_outside_may_come_in_but_never_go_further_out() -> None:
    limit = w.limits(1)
    for first, passes in ((1.99, True), (2.01, False), (2.03, False)):
        judged = w.ask(w.path([1.0], [first]), limit, w.at_rest([2.02]))
        assert (ReasonCode.POS_LIMIT not in w.codes(judged)) is passes
    outwards = Reference(np.array([2.02]), np.array([0.04]), np.zeros(1))
    cubic = w.path([1.0], [1.9], [0.0])
    assert ReasonCode.POS_LIMIT in w.codes(w.ask(cubic, limit, outwards))
    assert w.ask(cubic, limit, w.at_rest([2.02])).verdict.accepted


def test_a_path_that_begins_at_once_must_take_over_the_speed_of_the_reference() -> None:
    moving = Reference(np.array([0.0]), np.array([0.5]), np.zeros(1))
    path = w.path([0.0, 1.0], [0.0, 0.25], [0.0, 0.0])
    for a, passes in ((2.0, True), (nextafter(1.0, 0.0), False)):
        judged = w.ask(path, w.limits(1, acceleration=a), moving)
        assert (ReasonCode.ACC_LIMIT not in w.codes(judged)) is passes
    goes_on = w.path([0.0, 1.0], [0.0, 0.25], [0.5, 0.0])
    assert w.ask(goes_on, w.limits(1, acceleration=2.0), moving).verdict.accepted


def test_a_single_point_at_zero_is_a_place_to_hold() -> None:
    assert w.ask(w.path([0.0], [0.5]), w.limits(1)).verdict.accepted
    assert w.codes(w.ask(w.path([0.0], [2.001]), w.limits(1))) == {ReasonCode.POS_LIMIT}
    moving = Reference(np.array([0.0]), np.array([0.06]), np.zeros(1))
    (finding,) = w.ask(w.path([0.0], [0.0]), w.limits(1), moving).verdict.refusals
    assert (finding.code, finding.value) == (ReasonCode.ACC_LIMIT, inf)
    moving = replace(moving, velocity=np.array([0.05]))
    assert w.ask(w.path([0.0], [0.0]), w.limits(1), moving).verdict.accepted
    assert w.ask(w.path([0.0], [0.0], [0.05]), w.limits(1), moving).verdict.accepted


# ------------------------------------------------------------------------------------------ slices


@examples(40)
@given(w.paths(most=12), w.REFERENCES, st.integers(1, 4))
def test_slices_find_what_the_whole_finds(path: Trajectory, before: Reference, step: int) -> None:
    snap = w.snapshot(2, reference=before)
    whole = check(path, snap, w.limits(), TrajectoryRequest(), w.TH).verdict
    parts = check(path, snap, w.limits(), TrajectoryRequest(), w.TH, points_per_step=step).verdict
    assert {(f.code, f.joint) for f in whole.refusals} == {(f.code, f.joint) for f in parts.refusals}
    for one, other in zip(whole.refusals, parts.refusals, strict=True):
        if one.joint == other.joint and one.value is not None:
            # Two places may be equally bad on either side: which one is told is chance.
            assert abs(one.value) == pytest.approx(abs(other.value), rel=1e-6, abs=1e-6)


def test_a_path_that_is_wrong_everywhere_names_each_joint_once_per_rule_at_its_worst() -> None:
    n = 5
    k = 400
    time = np.arange(1, k + 1) * 0.05
    wave = np.sin(time[:, None] * 2.0 + np.arange(n)) * np.linspace(2.5, 3.5, k)[:, None]
    path = Trajectory(time, wave, np.ones(n, np.bool_))
    refusals = w.ask(path, w.limits(n, velocity=1.0)).verdict.refusals
    where = [(f.code, f.joint) for f in refusals]
    assert len(where) == len(set(where))
    positions = [f for f in refusals if f.code is ReasonCode.POS_LIMIT]
    assert len(positions) == n
    for finding in positions:
        assert abs(finding.value) == np.abs(wave[:, finding.joint]).max()
        assert wave[finding.point, finding.joint] == finding.value
    speeds = [f for f in refusals if f.code is ReasonCode.VEL_LIMIT]
    assert [f.value for f in speeds] == sorted((f.value for f in speeds), reverse=True)
    slopes = np.abs(np.diff(wave, axis=0)).max(axis=0) / 0.05
    for finding in speeds:
        assert finding.value == pytest.approx(slopes[finding.joint], rel=1e-9)


def test_nothing_that_is_not_commanded_is_judged() -> None:
    position = np.array([[0.1, np.nan, 9.0], [0.2, np.nan, -9.0]])
    path = Trajectory(np.array([1.0, 2.0]), position, np.array([True, False, False]))
    assert w.ask(path, w.limits(3), w.at_rest([0.0, np.nan, 7.0])).verdict.accepted


def test_limits_that_are_unknown_refuse() -> None:
    path = w.path([1.0, 2.0], [0.1, 0.0], [0.0, 0.0])
    for name in ("lower", "upper", "hard_lower", "hard_upper", "velocity", "acceleration"):
        limit = replace(w.limits(1), **{name: np.array([np.nan])})
        assert not w.ask(path, limit, w.at_rest([0.0])).verdict.accepted, name


@examples(40)
@given(w.paths(), st.sampled_from((np.nan, inf, -inf, 0.0, 1e308)))
def test_any_limits_get_a_verdict(path: Trajectory, value: float) -> None:
    bounds = {"lower": -value, "upper": value, "hard_lower": -value, "hard_upper": value}
    for rates in (
        {"velocity": value},
        {"acceleration": value},
        {"velocity": value, "acceleration": value},
        {},
    ):
        judged = w.ask(
            path, w.limits(**bounds, **rates), w.at_rest([0.0, 0.0]), TrajectoryRequest("retime", True)
        )
        assert not (judged.verdict.accepted and np.isnan(value))


def test_the_parts_are_pure_functions_of_their_arguments() -> None:
    from twind.robot.splines import knots

    path = w.path([1.0, 2.0], [3.0, 0.0])
    before = w.at_rest([0.0])
    limit = some(w.limits(3), np.array([1]))
    th = GateThresholds()
    subject = JudgedCurve(knots(path, before), np.array([1]), limit, before.velocity, 1)
    assert {spot.finding.joint for spot in judge(subject, 0, 2, limit, th)} == {1}
    assert start(subject, th) == []
    assert relaxed(subject) is None
    assert sqrt(judge(subject, 0, 1, limit, th)[0].score) > 0.0


def test_the_gates_numbers_are_those_of_the_page() -> None:
    th = w.TH
    assert (th.latency_warn, th.latency_block, th.stale, th.start_jump) == (0.05, 0.1, 0.1, 0.05)
    assert (th.jerk_warn, th.max_points, th.max_duration, th.min_dt) == (5000.0, 2000, 60.0, 0.001)
    assert (th.brake_floor, th.brake_margin, th.end_velocity) == (0.05, 0.2, 0.05)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("end_velocity", "peak"), [(0.1, 0.4), (0.3, 0.6), (0.0, 0.6)])
def test_a_cubic_is_held_to_its_acceleration_at_either_end(
    sign: float, end_velocity: float, peak: float
) -> None:
    path = w.path([1.0], [[sign * 0.1]], [[sign * end_velocity]])  # a(0) = 6h - 2v, a(1) = 4v - 6h
    for strongest, fine in ((peak * 1.001, True), (peak * 0.999, False)):
        judged = w.ask(path, w.limits(1, acceleration=strongest), w.at_rest([0.0]))
        assert (ReasonCode.ACC_LIMIT not in w.codes(judged)) is fine


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("share", [0.999, 1.001])
def test_a_cubic_is_warned_of_by_its_jerk(sign: float, share: float) -> None:
    # from rest to rest the jerk is 12 h / T³
    h = share * 5000.0 * 0.05**3 / 12.0
    T = 0.05
    judged = w.ask(w.path([T], [[sign * h]], [[0.0]]), w.limits(1, acceleration=1e4), w.at_rest([0.0]))
    assert any(f.code is ReasonCode.JERK_LIMIT for f in judged.verdict.warnings) is (share > 1.0)
