"""Proof of a joint's sign and zero by gravity, and its limits: pure, on the loads of models."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.proof_rig import (
    ANY,
    BASES,
    FRICTION,
    H24,
    LSB,
    NOISE,
    PLACES,
    TORQUE,
    body,
    judged,
    place,
)
from twind.robot.arrays import Floats
from twind_calibration.proving.expected_loads import ExpectedLoads, at_places, look_ahead, mirror
from twind_calibration.proving.sign_proof import (
    GROSS,
    ContradictionKind,
    SignProofStatus,
    apart,
    judge,
    misfits,
    slack,
)


@given(st.sampled_from(BASES), ANY, st.floats(-0.95, 0.95), TORQUE, st.floats(0.0, 0.1), NOISE)
@example("upright", "waist_pitch", 0.46875, 1.25, 0.0, np.array([1.0, 1.0, 0.0, 1.0]))  # between two rows
def test_a_joint_that_is_right_is_never_contradicted(
    base: str, name: str, off: float, stretch: float, rubs: float, noise: Floats
) -> None:
    """Whatever its torque per ampere, friction left and rounding; its zero off by less than 5 degrees."""
    found = judged(base, name, off=off * GROSS, stretch=stretch, rubs=rubs, noise=noise)
    assert found.proof is not SignProofStatus.CONTRADICTED
    assert (found.proof is SignProofStatus.PROVED) == found.foreseen.observable
    if np.isfinite(found.offset):
        assert abs(found.offset - off * GROSS) <= found.offset_unsure + 1e-9


@given(st.sampled_from(BASES), ANY, st.floats(-0.95, 0.95), TORQUE, st.floats(0.0, 0.1), NOISE)
def test_a_wrong_sign_is_never_proved_and_is_contradicted_where_observable(
    base: str, name: str, off: float, stretch: float, rubs: float, noise: Floats
) -> None:
    found = judged(base, name, wrong=True, off=off * GROSS, stretch=stretch, rubs=rubs, noise=noise)
    assert found.proof in (SignProofStatus.UNOBSERVABLE, SignProofStatus.CONTRADICTED)
    if found.foreseen.observable:
        assert (found.proof, found.against) == (SignProofStatus.CONTRADICTED, ContradictionKind.SIGN)
        assert found.slope_ratio < 0.0


@pytest.mark.parametrize("name", ["l_hip_pitch", "l_hip_roll", "l_knee"])
def test_upright_a_wrong_sign_regresses_with_slope_one_and_is_no_pass(name: str) -> None:
    found = judged("upright", name, wrong=True)
    assert found.proof is SignProofStatus.UNOBSERVABLE
    assert found.slope_ratio == pytest.approx(1.0, abs=0.02)
    assert found.foreseen.span > 0.2 and found.foreseen.flip < 0.01


@pytest.mark.parametrize(
    ("base", "name", "observable"),
    [
        ("back", "l_hip_pitch", True),
        ("back", "l_shoulder_pitch", True),
        ("back", "l_hip_roll", False),
        ("left", "l_hip_roll", True),
        ("left", "l_hip_pitch", False),
        ("upright", "l_hip_pitch", False),
        ("back", "l_ankle_pitch", False),  # less than friction, whatever the pose
        ("back", "l_elbow", False),
    ],
)
def test_which_base_pose_shows_a_sign_is_known_before_anything_moves(
    base: str, name: str, observable: bool
) -> None:
    body().lie(base)
    ahead = look_ahead(body(), np.zeros(len(H24.names)), place(name), PLACES, FRICTION)
    assert ahead.observable is observable
    found = judged(base, name)
    assert (found.proof is SignProofStatus.PROVED) is observable
    assert found.foreseen.flip == pytest.approx(ahead.flip, abs=0.01)


def test_more_friction_than_reckoned_with_makes_a_sign_unobservable() -> None:
    assert judged("back", "l_shoulder_pitch", rubs=0.05).proof is SignProofStatus.PROVED
    rough = judged("back", "l_shoulder_pitch", rubs=0.6)
    assert rough.friction == pytest.approx(0.6)
    assert rough.proof is SignProofStatus.UNOBSERVABLE


def test_evidence_that_is_no_proof_is_called_plausible() -> None:
    """The knee on its back: 0.17 N·m to a wrong sign, less where torque per ampere is 40 % less."""
    assert judged("back", "l_knee").proof is SignProofStatus.PLAUSIBLE
    assert judged("back", "l_knee", wrong=True).proof is SignProofStatus.CONTRADICTED
    assert judged("back", "l_ankle_pitch").proof is SignProofStatus.UNOBSERVABLE


def test_a_load_that_fits_both_signs_is_unobservable() -> None:
    """A knee that tells half of its load: one with the other sign that tells 1.4 of it is as near."""
    weak = judged("back", "l_knee", stretch=0.55)
    assert weak.foreseen.visible and not weak.foreseen.observable
    assert weak.proof is SignProofStatus.UNOBSERVABLE


@pytest.mark.parametrize("off", [-0.4, -0.2, 0.2, 0.4])
def test_a_grossly_wrong_zero_is_contradicted_where_the_span_suffices(off: float) -> None:
    found = judged("upright", "l_hip_pitch", off=off)
    assert (found.proof, found.against) == (SignProofStatus.CONTRADICTED, ContradictionKind.ZERO)
    assert abs(found.offset - off) <= found.offset_unsure
    small = judged("upright", "l_hip_pitch", off=0.03)
    assert small.against is ContradictionKind.NOTHING
    assert abs(small.offset - 0.03) <= small.offset_unsure < 0.1


def test_an_inverted_torque_reading_is_reported_as_inverted_current() -> None:
    """A reverse bit that turns position and not current: slope -1 where everything hangs."""
    one = body()
    joint = place("l_hip_pitch")
    one.lie("upright")
    expected = ExpectedLoads(one, at_places(np.zeros(len(H24.names)), joint, PLACES), joint)
    wrong = expected.loads_with_wrong_sign(mirror(H24.joints[joint], None))
    loads = -np.array([one.torque(pose)[joint] for pose in at_places(np.zeros(24), joint, PLACES)])
    found = judge(loads, loads, expected.right(), wrong, FRICTION, LSB)
    assert (found.proof, found.against) == (SignProofStatus.CONTRADICTED, ContradictionKind.CURRENT)
    assert found.slope_ratio == pytest.approx(-1.0, abs=0.02)


@pytest.mark.parametrize("stretch", [0.2, 2.5])
def test_another_ratio_or_mass_is_no_right_sign(stretch: float) -> None:
    found = judged("back", "l_hip_pitch", stretch=stretch)
    assert (found.proof, found.against) == (SignProofStatus.CONTRADICTED, ContradictionKind.NEITHER)


@pytest.mark.parametrize("where", [0, 3])
def test_a_load_that_is_no_number_proves_nothing(where: int) -> None:
    noise = np.zeros(4)
    noise[where] = np.nan
    assert judged("back", "l_hip_pitch", noise=noise).proof is SignProofStatus.UNOBSERVABLE


ROWS = st.lists(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3), min_size=1, max_size=4).map(np.array)


@given(ROWS, ROWS, st.floats(0.6, 1.4), st.floats(0.6, 1.4), st.data())
def test_no_load_is_nearer_to_both_families_than_half_their_distance(
    one: Floats, other: Floats, s: float, t: float, data: st.DataObject
) -> None:
    between = apart(one, other)
    first = data.draw(st.sampled_from(list(one)))
    second = data.draw(st.sampled_from(list(other)))
    assert np.sqrt(((s * first - t * second) ** 2).mean()) >= between - 1e-6
    measured = (s * first + t * second) / 2.0
    near = max(misfits(measured, one).min(), misfits(measured, other).min())
    assert near >= between / 2.0 - 1e-6
    assert apart(other, one) == pytest.approx(between, abs=1e-6)
    assert apart(one, one) < 1e-6


def test_a_joint_without_a_torque_unit_still_has_its_friction() -> None:
    assert slack(0.1, float("nan")) == pytest.approx(0.05)
    assert slack(0.1, 0.01) == pytest.approx(0.06)
