"""Changes by the gate: a path slowed down as a whole, a ramp to rest; both judged and reported again."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest
from hypothesis import given

from tests.support import gate_rig as w
from tests.support.examples import examples
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.gate import TrajectoryRequest
from twind.safety.retime import changed, needed

RETIME = TrajectoryRequest("retime")
STOP = TrajectoryRequest(append_stop=True)
BOTH = TrajectoryRequest("retime", append_stop=True)


def factor(judged: object) -> float:
    (change,) = judged.verdict.changes
    assert change.code is ReasonCode.RETIMED
    return change.value


@examples(100)
@given(w.paths(most=4))
def test_a_retimed_path_passes_the_same_gate_and_hardly_a_faster_one_does(path: Trajectory) -> None:
    limit = w.limits(velocity=1.5, acceleration=8.0)
    before = w.at_rest(path.position[0])
    judged = w.ask(path, limit, before, RETIME)
    plain = w.ask(path, limit, before)
    if ReasonCode.RETIMED not in {change.code for change in judged.verdict.changes}:
        assert judged.verdict == plain.verdict
        return
    stretch = factor(judged)
    assert stretch > 1.0
    assert w.codes(judged) <= {ReasonCode.END_NOT_AT_REST}
    assert not w.oracle_faults(judged.path, before, limit)
    assert np.allclose(judged.path.time, path.time * stretch)
    assert np.array_equal(judged.path.position, path.position)
    again = w.ask(judged.path, limit, before)
    assert again.verdict.refusals == judged.verdict.refusals
    faster = w.ask(path.stretched(stretch * (1.0 - 1e-6)), limit, before)
    assert w.codes(faster) & {ReasonCode.VEL_LIMIT, ReasonCode.ACC_LIMIT, ReasonCode.BRAKE_DISTANCE}


def test_twice_too_fast_takes_twice_as_long() -> None:
    path = w.path([1.0, 2.0], [0.5, 1.0])
    judged = w.ask(path, w.limits(1, velocity=0.25), w.at_rest([0.0]), RETIME)
    assert factor(judged) == pytest.approx(2.0, rel=1e-8)
    assert judged.verdict.accepted
    assert judged.spline.duration == pytest.approx(4.0, rel=1e-8)


def test_four_times_too_hard_takes_twice_as_long() -> None:
    path = w.path([1.0], [0.5], [0.0])  # a cubic from rest to rest: 6 h / T² = 3 rad/s²
    judged = w.ask(path, w.limits(1, acceleration=0.75), w.at_rest([0.0]), RETIME)
    assert factor(judged) == pytest.approx(2.0, rel=1e-8)


def test_too_fast_towards_the_limit_slows_down_to_what_can_still_stop() -> None:
    path = w.path([10.0, 11.0], [0.0, 1.5])
    limit = w.limits(1, hard_upper=1.6, acceleration=5.0)  # 0.1 rad to stop in: sqrt(2 * 5 * 0.1) - 0.2
    judged = w.ask(path, limit, w.at_rest([0.0]), RETIME)
    assert factor(judged) == pytest.approx(1.5 / 0.8, rel=1e-8)
    assert judged.verdict.accepted


def test_a_place_is_never_healed_by_time() -> None:
    path = w.path([1.0, 1.1], [0.5, 2.1])
    plain = w.ask(path, w.limits(1), w.at_rest([0.0]))
    judged = w.ask(path, w.limits(1), w.at_rest([0.0]), RETIME)
    assert judged.verdict == plain.verdict
    assert ReasonCode.POS_LIMIT in w.codes(judged)
    assert judged.path is path


def test_a_jump_at_zero_is_not_healed_and_one_that_time_heals_is() -> None:
    jump = w.ask(w.path([0.0, 0.1], [0.2, 1.2]), w.limits(1), w.at_rest([0.0]), RETIME)
    assert w.codes(jump) == {ReasonCode.START_JUMP}
    later = w.ask(w.path([0.1, 2.0], [1.0, 1.0]), w.limits(1), w.at_rest([0.0]), RETIME)
    assert later.verdict.accepted


def test_a_path_that_would_take_more_than_a_minute_is_refused_as_it_is() -> None:
    path = w.path([30.0], [1.0])
    judged = w.ask(path, w.limits(1, velocity=0.01), w.at_rest([0.0]), RETIME)
    assert w.codes(judged) == {ReasonCode.START_JUMP, ReasonCode.VEL_LIMIT}
    assert judged.verdict.changes == ()
    assert judged.path is path


def test_a_moving_reference_is_allowed_for() -> None:
    moving = Reference(np.array([0.0]), np.array([0.9]), np.zeros(1))
    limit = w.limits(1, velocity=1.0)
    for hurried in (w.path([0.3, 0.6], [0.5, 0.9]), w.path([0.3, 0.6], [0.5, 0.9], [2.0, 0.0])):
        judged = w.ask(hurried, limit, moving, RETIME)
        assert judged.verdict.accepted
        assert 1.0 < factor(judged) < 3.0
        assert not w.oracle_faults(judged.path, moving, limit)


def test_a_corner_from_a_moving_reference_gets_softer_too() -> None:
    backwards = Reference(np.array([0.0]), np.array([-2.0]), np.zeros(1))
    limit = w.limits(1, acceleration=1.0)
    judged = w.ask(w.path([1.0], [0.5]), limit, backwards, RETIME)
    assert judged.verdict.accepted
    assert not w.oracle_faults(judged.path, backwards, limit)


def test_a_reference_that_no_slower_path_can_follow_ends_in_a_refusal() -> None:
    outwards = Reference(np.array([1.9]), np.array([1.0]), np.zeros(1))
    racing = Reference(np.array([0.0]), np.array([1.2]), np.zeros(1))
    cubic = w.path([0.1], [1.9], [0.0])
    wide = w.limits(1, acceleration=5.0)
    slow = w.limits(1, velocity=1.0)
    for path, limit, before in ((cubic, wide, outwards), (w.path([1.0], [0.6], [0.0]), slow, racing)):
        judged = w.ask(path, limit, before, RETIME)
        assert judged.verdict.refusals == w.ask(path, limit, before).verdict.refusals != ()
        assert judged.verdict.changes == ()


def test_a_violation_that_no_stretch_cures_needs_an_infinite_one() -> None:
    assert needed([Finding(ReasonCode.VEL_LIMIT, value=1.0, bound=0.0)]) == float("inf")
    assert np.isnan(
        needed(
            [
                Finding(ReasonCode.ACC_LIMIT, value=nan, bound=1.0),
                Finding(ReasonCode.VEL_LIMIT, value=2.0, bound=1.0),
            ]
        )
    )
    assert needed(
        [Finding(ReasonCode.POS_LIMIT, value=9.0, bound=1.0), Finding(ReasonCode.BUSY)]
    ) == pytest.approx(1.0)
    judged = w.ask(w.path([1.0], [0.5]), w.limits(1, velocity=0.0), w.at_rest([0.0]), RETIME)
    assert ReasonCode.VEL_LIMIT in w.codes(judged)


# ------------------------------------------------------------------------------------------ the stop


@pytest.mark.parametrize("accelerations", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_moving_end_gets_a_ramp_to_rest_and_a_change_in_the_verdict(
    sign: float, accelerations: bool
) -> None:
    rest = [[0.0], [0.0]] if accelerations else None
    path = w.path([1.0, 2.0], [[0.0], [sign * 0.5]], [[0.0], [sign * 1.0]], rest)
    before = w.at_rest([0.0])
    assert w.codes(w.ask(path, w.limits(1), before)) == {ReasonCode.END_NOT_AT_REST}
    judged = w.ask(path, w.limits(1), before, STOP)
    assert judged.verdict.accepted
    (change,) = judged.verdict.changes
    T = (0.1 if accelerations else 0.05) * (1.0 + 1e-9)
    assert (change.code, change.point, change.time, change.value) == (
        ReasonCode.STOP_APPENDED,
        1,
        2.0,
        pytest.approx(T),
    )
    assert judged.path.velocity[-1] == 0.0
    assert judged.path.position[-1] == pytest.approx(sign * (0.5 + 0.5 * T))
    assert np.array_equal(judged.path.time[:-1], path.time)


def test_all_joints_stop_together_and_the_slow_ones_softly() -> None:
    path = w.path([2.0], [[0.5, 0.1]], [[1.0, -0.2]])
    judged = w.ask(path, w.limits(), w.at_rest([0.0, 0.0]), STOP)
    assert judged.verdict.accepted
    assert list(judged.path.position[-1]) == pytest.approx([0.525, 0.095])


def test_an_end_at_rest_needs_no_ramp() -> None:
    for path in (w.path([2.0], [0.5]), w.path([2.0], [0.5], [0.05])):
        judged = w.ask(path, w.limits(1), w.at_rest([0.0]), STOP)
        assert judged.verdict.changes == ()
        assert judged.path is path


def test_a_ramp_that_leaves_the_limits_is_refused() -> None:
    path = w.path([2.0], [1.99], [1.0])
    judged = w.ask(path, w.limits(1, hard_upper=9.0), w.at_rest([1.0]), STOP)
    assert ReasonCode.POS_LIMIT in w.codes(judged)
    assert ReasonCode.END_NOT_AT_REST not in w.codes(judged)


def test_joints_that_do_not_take_part_do_not_lengthen_the_ramp() -> None:
    path = w.path([2.0], [[0.5, 0.0]], [[1.0, 900.0]])
    path = replace(path, commanded=np.array([True, False]))
    judged = w.ask(path, w.limits(), w.at_rest([0.0, 0.0]), STOP)
    assert judged.verdict.accepted
    assert judged.path.time[-1] == pytest.approx(2.05)


def test_ramp_and_stretch_go_together() -> None:
    limit: JointLimits = w.limits(1, velocity=1.0, acceleration=5.0)
    judged = w.ask(w.path([0.5, 1.0], [0.5, 1.2], [1.5, 1.5]), limit, w.at_rest([0.0]), BOTH)
    assert judged.verdict.accepted
    assert [change.code for change in judged.verdict.changes] == [
        ReasonCode.STOP_APPENDED,
        ReasonCode.RETIMED,
    ]
    assert not w.oracle_faults(judged.path, w.at_rest([0.0]), limit)


# ----------------------------------------------------------------------------------------- told again


def same(one: Trajectory, other: Trajectory) -> bool:
    pairs = [
        (getattr(one, name), getattr(other, name))
        for name in ("time", "position", "velocity", "acceleration")
    ]
    return all((a is None and b is None) or np.array_equal(a, b, equal_nan=True) for a, b in pairs)


@examples(150)
@given(w.paths(most=4))
def test_the_changes_of_a_verdict_make_the_path_that_was_judged_to_the_last_bit(path: Trajectory) -> None:
    limit = w.limits(velocity=1.5, acceleration=8.0)
    before = w.at_rest(path.position[0])
    for demand in (TrajectoryRequest(), RETIME, STOP, BOTH):
        judged = w.ask(path, limit, before, demand)
        assert same(changed(path, judged.verdict.changes), judged.path)


def test_a_finding_that_is_no_change_changes_nothing() -> None:
    path = w.path([1.0], [0.5], [0.0])
    assert changed(path, [Finding(ReasonCode.POS_LIMIT, value=2.0)]) is path
    assert changed(path, []) is path
