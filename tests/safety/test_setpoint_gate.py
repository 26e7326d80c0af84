"""A setpoint inside the limits passes as it is; anything else is refused, or brought in and reported."""

from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.robot.finding import ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.safety.setpoint_gate import LONGEST, SetpointResult, judge

N = 4
LIMITS = JointLimits(
    lower=np.array([-1.0, -0.5, 0.0, -2.0]),
    upper=np.array([1.0, 0.5, 1.5, -1.0]),
    hard_lower=np.array([-1.05, -0.55, -0.05, -2.05]),
    hard_upper=np.array([1.05, 0.55, 1.55, -0.95]),
    velocity=np.array([2.0, 3.0, 4.0, 5.0]),
    acceleration=np.full(N, 20.0),
    effort=np.full(N, nan),
)
EDGES = [*LIMITS.lower, *LIMITS.upper, *LIMITS.velocity, *-LIMITS.velocity]
NUMBERS = st.one_of(
    st.floats(),
    st.floats(-3.0, 3.0),
    st.sampled_from([float(edge) for edge in EDGES]),
    st.sampled_from([float(np.nextafter(edge, way)) for edge in EDGES for way in (-inf, inf)]),
)


@st.composite
def setpoints(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    joints = draw(st.lists(st.integers(-1, N), max_size=N + 1))
    numbers = st.lists(NUMBERS, min_size=len(joints), max_size=len(joints)).map(
        lambda row: np.array(row, np.float64)
    )
    return np.array(joints, np.int64), draw(numbers), draw(st.none() | numbers)


def ask(joints: Any, position: Any, velocity: Any = None, **more: Any) -> SetpointResult:
    given: dict[str, Any] = {"valid_for": 0.1, "allow_clamp": False} | more
    speeds = None if velocity is None else np.array(velocity, np.float64)
    return judge(np.array(joints, np.int64), np.array(position, np.float64), speeds, LIMITS, **given)


def codes(aim: SetpointResult) -> list[ReasonCode]:
    return [finding.code for finding in aim.verdict.refusals]


@examples(120)
@given(setpoints(), st.booleans(), st.one_of(st.floats(), st.floats(0.0, 1.0)))
def test_nothing_outside_the_limits_passes(
    asked: tuple[np.ndarray, np.ndarray, np.ndarray | None], clamp: bool, valid_for: float
) -> None:
    joints, position, velocity = asked
    aim = judge(joints, position, velocity, LIMITS, valid_for=valid_for, allow_clamp=clamp)
    if aim.verdict.refusals:
        return
    assert 0.0 < valid_for <= LONGEST
    assert len(joints)
    assert (aim.position >= LIMITS.lower[joints]).all()
    assert (aim.position <= LIMITS.upper[joints]).all()
    changed = {(finding.code, finding.joint) for finding in aim.verdict.changes}
    moved = {(ReasonCode.POS_LIMIT, int(joint)) for joint in joints[aim.position != position]}
    if velocity is not None:
        assert aim.velocity is not None
        assert (np.abs(aim.velocity) <= LIMITS.velocity[joints]).all()
        moved |= {(ReasonCode.VEL_LIMIT, int(joint)) for joint in joints[aim.velocity != velocity]}
    assert changed == moved  # whatever was brought in is told, and nothing else
    assert clamp or not moved


@examples(50)
@given(st.lists(st.floats(0.0, 1.0), min_size=N, max_size=N), st.booleans())
def test_a_setpoint_inside_the_limits_passes_unchanged(shares: list[float], clamp: bool) -> None:
    position = LIMITS.lower + np.array(shares) * (LIMITS.upper - LIMITS.lower)
    position = np.clip(position, LIMITS.lower, LIMITS.upper)  # the sum above may round over the edge
    velocity = (np.array(shares) * 2.0 - 1.0) * LIMITS.velocity
    aim = ask(range(N), position, velocity, allow_clamp=clamp)
    assert aim.verdict.accepted
    assert aim.verdict.changes == ()
    assert aim.position.tolist() == position.tolist()
    assert aim.velocity is not None
    assert aim.velocity.tolist() == velocity.tolist()


def test_a_refusal_names_joint_value_and_bound() -> None:
    (position, velocity) = ask([2, 1], [1.6, 0.0], [0.0, -3.5]).verdict.refusals
    assert (position.code, position.joint, position.value, position.bound) == (
        ReasonCode.POS_LIMIT,
        2,
        1.6,
        1.5,
    )
    assert (velocity.code, velocity.joint, velocity.value, velocity.bound) == (
        ReasonCode.VEL_LIMIT,
        1,
        -3.5,
        -3.0,
    )


def test_only_on_demand_is_it_brought_in_and_then_reported() -> None:
    aim = ask([2, 1], [1.6, 0.0], [0.0, -3.5], allow_clamp=True)
    assert aim.verdict.accepted
    assert aim.position.tolist() == [1.5, 0.0]
    assert aim.velocity is not None
    assert aim.velocity.tolist() == [0.0, -3.0]
    assert [finding.code for finding in aim.verdict.changes] == [ReasonCode.POS_LIMIT, ReasonCode.VEL_LIMIT]


@pytest.mark.parametrize("wrong", [nan, inf, -inf])
def test_a_non_finite_setpoint_is_refused_even_with_clamping(wrong: float) -> None:
    assert codes(ask([0, 1], [0.0, wrong], allow_clamp=True)) == [ReasonCode.NONFINITE]
    assert codes(ask([0, 1], [0.0, 0.0], [wrong, 0.0], allow_clamp=True)) == [ReasonCode.NONFINITE]


@pytest.mark.parametrize(
    ("joints", "position", "velocity", "expected"),
    [
        ([], [], None, ReasonCode.NO_JOINTS),
        ([0, 0], [0.0, 0.0], None, ReasonCode.DUP_JOINT),
        ([N], [0.0], None, ReasonCode.UNKNOWN_JOINT),
        ([-1], [0.0], None, ReasonCode.UNKNOWN_JOINT),
        ([0, 1], [0.0], None, ReasonCode.BAD_SHAPE),
        ([0], [0.0, 0.0], None, ReasonCode.BAD_SHAPE),
        ([0], [0.0], [], ReasonCode.BAD_SHAPE),
    ],
)
def test_a_malformed_setpoint_is_refused(
    joints: Any, position: Any, velocity: Any, expected: ReasonCode
) -> None:
    assert codes(ask(joints, position, velocity, allow_clamp=True)) == [expected]


@pytest.mark.parametrize(
    ("valid_for", "expected"),
    [
        (0.0, [ReasonCode.CMD_EXPIRED]),
        (-1.0, [ReasonCode.CMD_EXPIRED]),
        (nan, [ReasonCode.CMD_EXPIRED]),
        (-inf, [ReasonCode.CMD_EXPIRED]),
        (float(np.nextafter(LONGEST, inf)), [ReasonCode.VALID_TOO_LONG]),
        (inf, [ReasonCode.VALID_TOO_LONG]),
        (LONGEST, []),
        (1e-9, []),
    ],
)
def test_a_setpoint_is_valid_for_a_moment_and_no_longer(valid_for: float, expected: list[ReasonCode]) -> None:
    assert codes(ask([0], [0.0], valid_for=valid_for)) == expected
