"""Properties of the gate for any input: tighter limits, slower paths, other orders of the joints."""

from dataclasses import replace

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.support import gate_rig as w
from tests.support.examples import examples
from twind.robot.finding import ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.gate import GateResult, TrajectoryRequest, check
from twind.safety.trajectory_validation import PointRow, form

SHARES = st.lists(st.sampled_from((1.0, 1.0, 0.95, 0.7, 0.3)), min_size=2, max_size=2).map(np.array)
FACTORS = st.floats(1.001, 50.0)
POLICIES = st.sampled_from(("reject", "retime"))


def judge(
    path: Trajectory, limits: JointLimits, before: Reference, demand: TrajectoryRequest | None = None
) -> GateResult:
    snapshot = w.snapshot(len(limits.lower), reference=before)
    return check(path, snapshot, limits, demand or TrajectoryRequest(), w.TH)


@st.composite
def tightened(draw: st.DrawFn, limits: JointLimits) -> JointLimits:
    """Every bound as it is, or stricter."""
    lower = limits.lower * draw(SHARES)
    upper = limits.upper * draw(SHARES)
    return replace(
        limits,
        lower=lower,
        upper=upper,
        hard_lower=np.maximum(lower, limits.hard_lower * draw(SHARES)) - 0.05 * draw(SHARES),
        hard_upper=np.minimum(upper, limits.hard_upper * draw(SHARES)) + 0.05 * draw(SHARES),
        velocity=limits.velocity * draw(SHARES),
        acceleration=limits.acceleration * draw(SHARES),
    )


@examples(120)
@given(st.data(), w.paths(), w.REFERENCES, st.booleans())
def test_tightening_a_limit_never_turns_a_refusal_into_an_acceptance(
    data: st.DataObject, path: Trajectory, before: Reference, near: bool
) -> None:
    """G2."""
    before = w.at_rest(path.position[0]) if near else before
    loose = w.limits()
    tight = data.draw(tightened(loose))
    assume((tight.hard_lower >= loose.hard_lower).all() and (tight.hard_upper <= loose.hard_upper).all())
    if not judge(path, loose, before).verdict.accepted:
        assert not judge(path, tight, before).verdict.accepted


@examples(120)
@given(w.paths(), w.REFERENCES, FACTORS, st.booleans())
def test_stretching_never_creates_a_velocity_refusal(
    path: Trajectory, before: Reference, factor: float, near: bool
) -> None:
    """G4. From rest, and from a reference that moves evenly and within its limit."""
    before = w.at_rest(path.position[0]) if near else before
    fast = ReasonCode.VEL_LIMIT in w.codes(judge(path, w.limits(), before))
    slower = w.codes(judge(path.stretched(factor), w.limits(), before))
    assert fast or ReasonCode.VEL_LIMIT not in slower


def swapped(path: Trajectory, limits: JointLimits, before: Reference, order: np.ndarray) -> tuple:
    """The same of a robot whose joints come in another order."""
    rows = [None if given is None else given[:, order] for given in (path.velocity, path.acceleration)]
    names = ("lower", "upper", "hard_lower", "hard_upper", "velocity", "acceleration", "effort")
    return (
        Trajectory(path.time, path.position[:, order], path.commanded[order], *rows),
        JointLimits(**{name: getattr(limits, name)[order] for name in names}),
        Reference(before.position[order], before.velocity[order], before.acceleration[order]),
    )


def joint_findings(judged: GateResult, order: np.ndarray) -> list[set[tuple]]:
    """Refusals, warnings and changes, joints by their place in the first order."""
    verdict = judged.verdict
    return [
        {
            (f.code, None if f.joint is None else int(order[f.joint]), f.point, f.time, f.value, f.bound)
            for f in findings
        }
        for findings in (verdict.refusals, verdict.warnings, verdict.changes)
    ]


@examples(80)
@given(w.paths(joints=3), st.permutations(range(3)), POLICIES, st.booleans(), st.booleans())
def test_the_order_of_the_joints_has_no_effect(
    path: Trajectory, order: list[int], policy: str, stop: bool, some: bool
) -> None:
    """G5, in the gate."""
    order = np.array(order)
    commanded = np.array([True, not some, True])
    path = replace(path, commanded=commanded)
    before = w.at_rest(path.position[0] * 0.9)
    limits = w.limits(3, velocity=np.array([4.0, 2.0, 1.0]), acceleration=np.array([20.0, 10.0, 50.0]))
    demand = TrajectoryRequest(policy, stop)
    straight = judge(path, limits, before, demand)
    other_path, other_limits, other_before = swapped(path, limits, before, order)
    turned = judge(other_path, other_limits, other_before, demand)
    assert joint_findings(turned, order) == joint_findings(straight, np.arange(3))
    np.testing.assert_array_equal(turned.path.time, straight.path.time)
    np.testing.assert_array_equal(
        turned.path.position[:, commanded[order]], straight.path.position[:, order][:, commanded[order]]
    )


@given(st.permutations(range(3)), st.integers(1, 3), st.booleans())
def test_the_order_of_the_names_in_a_message_has_no_effect(
    order: list[int], count: int, broken: bool
) -> None:
    """G5, at the edge."""
    known = ("a", "b", "c")
    names = [known[i] for i in order][:count]
    value = {"a": 0.1, "b": 0.2, "c": float("nan") if broken else 0.3}

    def rows(named: list[str]) -> list[PointRow]:
        return [PointRow(t, [value[name] * t for name in named], None, None) for t in (1.0, 2.0)]

    path, findings = form(names, rows(names), known)
    sorted_path, sorted_findings = form(sorted(names), rows(sorted(names)), known)
    assert {(f.code, f.joint) for f in findings} == {(f.code, f.joint) for f in sorted_findings}
    if path is not None and sorted_path is not None:
        np.testing.assert_array_equal(path.commanded, sorted_path.commanded)
        np.testing.assert_array_equal(
            path.position[:, path.commanded], sorted_path.position[:, path.commanded]
        )
