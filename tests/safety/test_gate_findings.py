"""Findings of the gate, with retiming and unknown positions, and the pauses of its work."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest

from tests.support import gate_rig as w
from twind.robot.finding import ReasonCode, Verdict
from twind.robot.modes import RobotState
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.admission import admit
from twind.safety.gate import TrajectoryRequest, check, checking

BOTH = np.ones(2, np.bool_)
MOVE = w.path([1.0, 2.0], [[0.2, 0.1], [0.3, 0.0]])


def codes(verdict: Verdict) -> list[ReasonCode]:
    return [finding.code for finding in verdict.refusals]


def test_at_most_64_findings_per_code_are_reported() -> None:
    n = 70
    far = w.path([1.0], [[3.0] * n])
    judged = check(far, w.snapshot(n), w.limits(n), TrajectoryRequest(), w.TH)
    assert sum(finding.code is ReasonCode.POS_LIMIT for finding in judged.verdict.refusals) == 64


def test_a_start_in_the_past_is_reported_against_now() -> None:
    verdict = check(MOVE, w.snapshot(2), w.limits(), TrajectoryRequest(start_in=-0.5), w.TH).verdict
    assert [(f.code, f.value, f.bound) for f in verdict.refusals] == [(ReasonCode.CMD_EXPIRED, -0.5, 0.0)]


@pytest.mark.parametrize("state", [RobotState.FAULT, RobotState.INHIBITED])
def test_a_latched_state_names_itself_where_no_code_is_known(state: RobotState) -> None:
    [finding] = [
        f
        for f in admit(w.snapshot(state=state), BOTH, w.TH).refusals
        if f.code in (ReasonCode.FAULT_LATCHED, ReasonCode.ESTOP_LATCHED)
    ]
    assert f"state is {state}" in finding.message
    verdict = admit(w.snapshot(state=state, latched=(ReasonCode.OVERTEMP,)), BOTH, w.TH)
    assert any(f.message.startswith("OVERTEMP;") for f in verdict.refusals)


def test_the_default_slice_of_a_check_is_500_points() -> None:
    def pauses(k: int) -> int:
        path = w.path(list(np.arange(1, k + 1) * 0.01), np.zeros((k, 2)))
        return len(list(checking(path, w.snapshot(2), w.limits(), TrajectoryRequest(), w.TH)))

    assert [pauses(k) for k in (500, 501)] == [0, 1]


def test_work_that_just_fits_into_a_slice_needs_no_pause() -> None:
    def pauses(step: int, before: Reference, demand: TrajectoryRequest, size: float = 0.0) -> int:
        path = w.path(list(np.arange(1, 11) * 0.01), np.zeros((10, 2)) + size)
        snapshot = w.snapshot(2, reference=before)
        return len(list(checking(path, snapshot, w.limits(), demand, w.TH, points_per_step=step)))

    outside, twice = (
        w.at_rest([2.01, 0.0]),
        TrajectoryRequest("retime"),
    )  # one segment alone, then nine; ten, then ten again
    assert [pauses(step, outside, TrajectoryRequest()) for step in (10, 9)] == [0, 1]
    assert [pauses(step, w.at_rest([0.0, 0.0]), twice, 0.05) for step in (20, 19)] == [0, 1]


def test_a_retimed_path_reports_its_factor_against_one() -> None:
    quick = w.path([0.05, 0.1], [[0.05, 0.0], [0.0, 0.0]])
    verdict = check(quick, w.snapshot(2), w.limits(), TrajectoryRequest("retime"), w.TH).verdict
    [told] = verdict.changes
    assert (told.code, told.bound) == (ReasonCode.RETIMED, 1.0)
    assert told.value is not None and told.value > 1.0


def test_a_retimed_path_names_the_joint_that_slows_it_and_both_durations() -> None:
    quick = w.path([0.05, 0.1], [[0.04, 0.05], [0.0, 0.0]])
    [told] = check(quick, w.snapshot(2), w.limits(), TrajectoryRequest("retime"), w.TH).verdict.changes
    assert told.joint == 1 and told.value is not None
    assert f"to {0.1 * told.value:.2f} s instead of 0.10 s, for ACC_LIMIT" in told.message


def test_a_finding_before_the_first_point_says_that_it_lies_on_the_way_there() -> None:
    judged = check(
        w.path([1.0], [[9.0, 0.0]], [[0.0, 0.0]]), w.snapshot(2), w.limits(), TrajectoryRequest(), w.TH
    )
    told = {each.code: each for each in judged.verdict.refusals}
    assert told[ReasonCode.POS_LIMIT].point == told[ReasonCode.VEL_LIMIT].point == 0
    assert told[ReasonCode.POS_LIMIT].message == ""
    assert told[ReasonCode.VEL_LIMIT].message == "on the way to this point"


def retimed(path: Trajectory) -> Verdict:
    return check(path, w.snapshot(2), w.limits(velocity=0.1), TrajectoryRequest("retime"), w.TH).verdict


def test_no_stretch_makes_a_path_longer_than_the_longest() -> None:
    verdict = retimed(w.path([1.0, 50.0], [[0.14, 0.0], [0.14, 0.0]]))
    assert codes(verdict) == [ReasonCode.VEL_LIMIT]
    assert verdict.changes == ()


def test_a_path_outside_its_position_limits_is_not_retimed() -> None:
    verdict = retimed(w.path([1.0, 2.0], [[2.5, 0.0], [0.0, 0.0]]))
    assert codes(verdict)[0] is ReasonCode.POS_LIMIT
    assert verdict.changes == ()


def test_a_stretched_path_that_is_only_jerky_is_let_in_with_a_warning() -> None:
    zigzag = 2e-5 * (-1.0) ** np.arange(20)
    path = w.path(list(np.arange(1, 21) * 0.001), np.stack([zigzag, zigzag], axis=1))
    verdict = check(path, w.snapshot(2), w.limits(), TrajectoryRequest("retime"), w.TH).verdict
    assert verdict.accepted
    assert {finding.code for finding in verdict.changes} == {ReasonCode.RETIMED}
    assert {finding.code for finding in verdict.warnings} == {ReasonCode.JERK_LIMIT}


@pytest.mark.parametrize("unknown", ["position", "velocity", "acceleration"])
def test_an_unknown_reference_gives_only_a_start_jump_finding(unknown: str) -> None:
    before = replace(w.at_rest([0.1, 0.0]), **{unknown: np.full(2, nan)})
    for rates in (None, [[0.0, 0.0]] * 2):
        path = w.path([0.01, 5.0], [[0.1, 0.0], [1.0, 0.0]], rates)
        refusals = w.ask(path, w.limits(), before).verdict.refusals
        found = [(each.code, each.joint, each.point, each.time) for each in refusals]
        assert found == [(ReasonCode.START_JUMP, joint, 0, 0.01) for joint in (0, 1)]


def test_a_jump_at_the_start_is_reported_for_the_first_point() -> None:
    path = w.path([0.5, 9.0], [[1.9, 0.0], [1.9, 0.0]])
    slow = w.limits(velocity=1.0)
    [told] = [
        f
        for f in w.ask(path, slow, w.at_rest([0.0, 0.0])).verdict.refusals
        if f.code is ReasonCode.START_JUMP
    ]
    assert (told.joint, told.point, told.time, told.value) == (0, 0, 0.5, 1.9)
    assert told.bound == pytest.approx(0.05 + 0.5)


@pytest.mark.parametrize(
    ("state", "text"), [(RobotState.FAULT, "state is fault"), (RobotState.CONNECTED, "connected")]
)
def test_not_armed_repeats_no_steps_that_a_latch_names(state: RobotState, text: str) -> None:
    [finding] = [
        f for f in admit(w.snapshot(state=state), BOTH, w.TH).refusals if f.code is ReasonCode.NOT_ARMED
    ]
    assert text in finding.message
    assert ("arm" in finding.message) is (state is RobotState.CONNECTED)


def test_a_commanded_joint_that_stays_limp_is_refused_by_name() -> None:
    limp = np.array([True, False])
    found = admit(w.snapshot(limp=limp), BOTH, w.TH).refusals
    assert [(each.code, each.joint) for each in found] == [(ReasonCode.JOINT_LIMP, 0)]
    assert admit(w.snapshot(limp=limp), ~limp, w.TH).accepted


@pytest.mark.parametrize(("speed", "where"), [(5.0, ""), (0.0, "on the way to this point")])
def test_a_finding_before_the_first_point_says_whether_it_is_on_the_way_there(
    speed: float, where: str
) -> None:
    """A start that is too fast, at once; a way to the first point that is too fast later."""
    before = replace(w.at_rest([0.0, 0.0]), velocity=np.array([speed, 0.0]))
    path = w.path([0.3, 9.0], [[0.0 if speed else 0.9, 0.0]] * 2, [[0.0, 0.0]] * 2)
    [told] = [f for f in w.ask(path, w.limits(), before).verdict.refusals if f.code is ReasonCode.VEL_LIMIT]
    assert (told.joint, told.point) == (0, 0)
    assert (told.time == 0.0) is (where == "")
    assert told.message.startswith(where) and ("way" in told.message) is bool(where)


@pytest.mark.parametrize("rate", ["velocity", "acceleration"])
def test_no_time_is_named_where_a_joint_moves_at_the_start(rate: str) -> None:
    path = w.path([0.5, 0.6], [[0.0, 0.0], [0.7, 0.1]])  # 7 rad/s, at most 4
    for moving, text in ((0.0, True), (0.01, False)):
        before = replace(w.at_rest([0.0, 0.0]), **{rate: np.array([0.0, moving])})
        refusals = w.ask(path, w.limits(), before).verdict.refusals
        assert refusals[0].code is ReasonCode.VEL_LIMIT
        assert ("the whole path needs" in refusals[0].message) is text
