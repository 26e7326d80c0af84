"""The edges of form, setpoints, retiming and headroom, one by one: what is told, and of which point."""

from dataclasses import replace
from math import inf, nan, nextafter

import numpy as np
import pytest

from tests.support import gate_rig as w
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Trajectory
from twind.safety.gate import TrajectoryRequest, check
from twind.safety.headroom import headroom
from twind.safety.retime import needed, with_stop
from twind.safety.setpoint_gate import judge
from twind.safety.trajectory_validation import form, wellformed

NAMES = ("hip_a", "hip_b", "hip_c", "hip_d")


# ------------------------------------------------------------------------------------------ form


def findings_of(
    *rows: object, names: tuple[str, ...] = ("hip_a",)
) -> list[tuple[ReasonCode, int | None, float | None]]:
    path, findings = form(names, rows, NAMES)
    assert path is None
    return [(finding.code, finding.point, finding.bound) for finding in findings]


def test_an_unknown_name_is_reported_with_the_three_nearest() -> None:
    [finding] = form(["hip_"], [(0.0, [0.0], None, None)], NAMES)[1]
    assert sum(name in finding.message for name in NAMES) == 3


def test_at_most_32_unknown_names_are_reported() -> None:
    found = form([f"no{i}" for i in range(40)], [(0.0, [0.0] * 40, None, None)], NAMES)[1]
    assert len(found) == 32


def test_every_malformed_point_is_reported() -> None:
    assert findings_of((0.0,), (1.0, [0.0])) == [(ReasonCode.BAD_SHAPE, 0, 4), (ReasonCode.BAD_SHAPE, 1, 4)]


def test_accelerations_are_looked_at_where_velocities_are_missing() -> None:
    found = findings_of((0.0, [0.0], None, [0.0, 0.0]), (1.0, [0.0], None, [0.0]))
    assert found == [
        (ReasonCode.BAD_SHAPE, 0, 1),
        (ReasonCode.BAD_SHAPE, 0, None),
        (ReasonCode.BAD_SHAPE, 1, None),
    ]


def test_a_step_may_be_short_by_rounding_and_no_more() -> None:
    for short, passes in ((0.95e-12, True), (1e-12, True), (1.05e-12, False)):
        path = w.path([0.001 - short], [0.0])
        assert (not wellformed(path, 1, 2000, 60.0, 0.001)) is passes


def test_a_path_that_is_too_long_is_reported_with_its_last_time() -> None:
    [finding] = wellformed(w.path([1.0, 61.0], [0.0, 0.0]), 1, 2000, 60.0, 0.001)
    assert (finding.code, finding.point) == (ReasonCode.TOO_MANY_POINTS, 1)
    assert (finding.time, finding.value, finding.bound) == (61.0, 61.0, 60.0)


def test_a_path_that_begins_in_the_past_is_held_against_zero() -> None:
    [finding] = wellformed(w.path([-0.5, 1.0], [0.0, 0.0]), 1, 2000, 60.0, 0.001)
    assert (finding.code, finding.point, finding.time) == (ReasonCode.TIME_ORDER, 0, -0.5)
    assert (finding.value, finding.bound) == (-0.5, 0.0)


def test_the_first_non_finite_value_of_each_joint_is_reported() -> None:
    path = w.path([1.0, 2.0, 3.0], [[0.0, 0.0], [nan, 0.0], [inf, -inf]])
    found = [(f.code, f.joint, f.point, f.time) for f in wellformed(path, 2, 2000, 60.0, 0.001)]
    assert found == [(ReasonCode.NONFINITE, 0, 1, 2.0), (ReasonCode.NONFINITE, 1, 2, 3.0)]


def test_a_number_beyond_every_double_is_endless() -> None:
    [finding] = form(["hip_a"], [(1.0, [10**400], None, None)], NAMES)[1]
    assert (finding.code, finding.value) == (ReasonCode.NONFINITE, inf)


def test_the_first_non_finite_time_is_reported() -> None:
    found = wellformed(w.path([1.0, nan, nan], [0.0] * 3), 1, 2000, 60.0, 0.001)
    assert [finding.point for finding in found if finding.code is ReasonCode.NONFINITE] == [1]


@pytest.mark.parametrize("place", [0, 1])
def test_a_non_finite_velocity_or_acceleration_is_reported(place: int) -> None:
    rates = [np.zeros((2, 1)), np.zeros((2, 1))]
    rates[place][1] = nan
    path = w.path([1.0, 2.0], [0.0, 0.0], *rates)
    [finding] = wellformed(path, 1, 2000, 60.0, 0.001)
    assert (finding.code, finding.point) == (ReasonCode.NONFINITE, 1)


def test_a_message_without_joint_names_has_one_finding() -> None:
    [finding] = form([], [(1.0, [], None, None)], NAMES)[1]
    assert (finding.code, finding.message) == (ReasonCode.NO_JOINTS, "no joint is named")


def test_places_that_are_missing_are_none() -> None:
    [finding] = form(["hip_a"], [(1.0, None, None, None)], NAMES)[1]
    assert (finding.code, finding.value, finding.bound) == (ReasonCode.BAD_SHAPE, 0, 1)


def test_a_path_without_places_is_empty() -> None:
    for time, rows in (([1.0, 2.0], 0), ([], 2)):
        path = Trajectory(np.array(time), np.zeros((rows, 1)), np.ones(1, np.bool_))
        assert wellformed(path, 1, 2000, 60.0, 0.001)[0].code is ReasonCode.EMPTY


def test_a_name_given_three_times_has_one_finding() -> None:
    [finding] = form(["hip_b"] * 3, [(1.0, [0.0] * 3, None, None)], NAMES)[1]
    assert (finding.code, finding.joint, finding.value, finding.bound) == (ReasonCode.DUP_JOINT, 1, 3, 1)


# ------------------------------------------------------------------------------------------ setpoints


def test_a_joint_that_is_not_there_is_held_against_the_last_one() -> None:
    asked = {"valid_for": 0.1, "allow_clamp": False}
    [finding] = judge(np.array([3]), np.zeros(1), None, w.limits(3), **asked).verdict.refusals
    assert (finding.code, finding.bound) == (ReasonCode.UNKNOWN_JOINT, 2.0)


def test_a_setpoint_is_valid_for_a_tenth_of_a_second_at_most() -> None:
    for valid, passes in ((0.1, True), (nextafter(0.1, 1.0), False)):
        aim = judge(np.array([0]), np.zeros(1), None, w.limits(1), valid_for=valid, allow_clamp=False)
        assert aim.verdict.accepted is passes


def test_a_setpoint_that_has_expired_is_held_against_now() -> None:
    asked = {"valid_for": -0.1, "allow_clamp": False}
    [finding] = judge(np.array([0]), np.zeros(1), None, w.limits(1), **asked).verdict.refusals
    assert (finding.code, finding.value, finding.bound) == (ReasonCode.CMD_EXPIRED, -0.1, 0.0)


# ------------------------------------------------------------------------------------------ retiming


def test_a_stretch_to_the_very_longest_is_let_in() -> None:
    path = w.path([0.05, 0.1], [[0.05], [0.0]])
    snapshot = w.snapshot(1)
    [factor] = [
        f.value for f in check(path, snapshot, w.limits(1), TrajectoryRequest("retime"), w.TH).verdict.changes
    ]
    for longest, passes in ((0.1 * factor, True), (nextafter(0.1 * factor, 0.0), False)):
        threshold = replace(w.TH, max_duration=longest)
        verdict = check(path, snapshot, w.limits(1), TrajectoryRequest("retime"), threshold).verdict
        assert verdict.accepted is passes


def test_an_uncommanded_joint_needs_no_ramp() -> None:
    rows = np.array([[0.0, nan], [0.1, nan]])
    path = Trajectory(np.array([1.0, 2.0]), rows, np.array([True, False]), 0.0 * rows)
    stopped, changes = with_stop(path, w.limits(), w.TH)
    assert stopped is path
    assert changes == []


def test_a_ramp_to_rest_begins_where_the_path_ends() -> None:
    path = w.path([1.0, 2.0], [0.0, 0.1], [0.0, 0.5])
    stopped, [told_of] = with_stop(path, w.limits(1, acceleration=2.0), w.TH)
    assert stopped.time[-1] == pytest.approx(2.25)
    assert (told_of.code, told_of.point, told_of.time) == (ReasonCode.STOP_APPENDED, 1, 2.0)
    assert told_of.value == pytest.approx(0.25)
    assert stopped.position[-1, 0] == pytest.approx(0.1 + 0.5 * 0.5 * 0.25)


def test_a_stretch_leaves_a_billionth_to_rounding() -> None:
    assert needed([]) == 1.0 + 1e-9


def test_a_stretch_is_by_default_the_first_estimate() -> None:
    hard = [Finding(ReasonCode.ACC_LIMIT, value=40.0, bound=10.0)]
    assert needed(hard) == needed(hard, first=True) == pytest.approx(2.0)
    assert needed(hard, first=False) == pytest.approx(4.0)
    assert needed([Finding(ReasonCode.VEL_LIMIT, value=8.0, bound=4.0)]) == pytest.approx(2.0)
    assert needed([Finding(ReasonCode.VEL_LIMIT)]) == needed([])


# ------------------------------------------------------------------------------------------ room to begin


def test_a_fresh_nan_reading_counts_as_not_read() -> None:
    ill = w.condition(1, temperature=np.array([nan]))
    [finding] = headroom(ill, np.ones(1, np.bool_), 1.0)
    assert finding.message.startswith("not read yet")
