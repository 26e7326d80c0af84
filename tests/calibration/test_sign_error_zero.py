"""A sign that is wrong may have brought a wrong zero with it, from the same travel: no proof either."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.proof_rig import ANY, BASES, H24, NOISE, TORQUE, judged, place
from twind.config.calibration_file import JointCalibration
from twind.config.counts import angle_of, ticks_of
from twind.config.homing_config import JointEndstops
from twind.robot.arrays import Floats
from twind.virtual.virtual_robot_spec import calibration, make_spec
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator, slots
from twind_calibration.calibrating.zero_placement import by_ends, by_pose
from twind_calibration.proving.expected_loads import mirror, offsets
from twind_calibration.proving.sign_proof import GROSS, ContradictionKind, SignProofStatus

MADE = calibration(make_spec(H24))
TRUE_ZERO = 2048
SHORT = st.floats(0.0, 0.1)  # rad that a hand leaves out at an end


def slot_of(name: str) -> CalibrationActuator:
    return slots(H24)[place(name)]


def sweep_entry(slot: CalibrationActuator, ends: tuple[float, float], *, wrong: bool) -> JointCalibration:
    """A joint that was moved by hand between these true angles (rad); its zero is nothing yet."""
    true = replace(slot.joint, sign=-slot.joint.sign) if wrong else slot.joint
    low, high = sorted(ticks_of(true, TRUE_ZERO, end) for end in ends)
    return replace(MADE.by_name[slot.name], sweep_ticks=(low, high))


def error(slot: CalibrationActuator, entry: JointCalibration, *, wrong: bool) -> float:
    """Rad by which the zero of an entry is off; of a wrong sign, what true and told angle add up to."""
    off = angle_of(slot.joint, TRUE_ZERO, entry.zero_ticks)
    return -off if wrong else off


def by_its_ends(slot: CalibrationActuator, entry: JointCalibration) -> JointCalibration:
    """As `zero --from-sweep` places it."""
    stops = slot.joint.stops
    ends = (stops.lower, stops.upper) if stops.endstops_by_side else (slot.lower, slot.upper)
    return replace(entry, zero_ticks=by_ends(slot, entry.sweep_ticks, *ends).ticks)


@given(st.sampled_from(BASES), ANY, st.booleans(), SHORT, SHORT, st.floats(0.0, 1.0), TORQUE, NOISE)
def test_a_wrong_sign_whose_zero_came_of_its_travel_is_never_proved_nor_plausible(
    base: str, name: str, known: bool, a: float, b: float, where: float, stretch: float, noise: Floats
) -> None:
    """By its stops; or by its limits, beyond which it really goes. Wherever in its travel it is shown."""
    slot = slot_of(name)
    stops = slot.joint.stops
    assert stops.lower is not None and stops.upper is not None
    if not known:
        slot = replace(slot, joint=replace(slot.joint, stops=JointEndstops()))
    ends = (stops.lower + a, stops.upper - b) if known else (slot.lower - 3.0 * a, slot.upper + 3.0 * b)
    entry = by_its_ends(slot, sweep_entry(slot, ends, wrong=True))
    low, high = mirror(slot.joint, entry)
    off = error(slot, entry, wrong=True)
    assert low - 0.002 <= off <= high + 0.002
    at = slot.lower + 0.3 + where * max(slot.upper - slot.lower - 0.6, 0.0)
    found = judged(base, name, wrong=True, off=-off, at=at, stretch=stretch, noise=noise, entry=entry)
    assert found.proof in (SignProofStatus.UNOBSERVABLE, SignProofStatus.CONTRADICTED)
    if found.foreseen.observable:
        assert (found.proof, found.against) in (
            (SignProofStatus.CONTRADICTED, ContradictionKind.SIGN),
            (SignProofStatus.CONTRADICTED, ContradictionKind.ZERO),
        )


@given(st.sampled_from(BASES), ANY, st.floats(0.0, 1.0), TORQUE, NOISE)
def test_a_wrong_sign_whose_zero_came_of_a_pose_is_never_proved_nor_plausible(
    base: str, name: str, share: float, stretch: float, noise: Floats
) -> None:
    slot = slot_of(name)
    stops = slot.joint.stops
    assert stops.lower is not None and stops.upper is not None
    entry = sweep_entry(slot, (stops.lower, stops.upper), wrong=True)
    angle = slot.lower + share * (slot.upper - slot.lower)  # at which the pose has it
    reads = ticks_of(replace(slot.joint, sign=-slot.joint.sign), TRUE_ZERO, angle)
    zero = by_pose(slot, entry.sweep_ticks, float(reads), 0.0, 9, angle).ticks
    entry = replace(entry, zero_ticks=zero)
    off = error(slot, entry, wrong=True)
    assert abs(off - 2.0 * angle) < 0.002 or abs(abs(off - 2.0 * angle) - 2.0 * pi) < 0.002
    found = judged(base, name, wrong=True, off=-off, stretch=stretch, noise=noise, entry=entry)
    assert found.proof in (SignProofStatus.UNOBSERVABLE, SignProofStatus.CONTRADICTED)


@given(st.sampled_from(BASES), ANY, SHORT, SHORT, TORQUE, NOISE)
def test_a_right_sign_whose_zero_came_of_its_travel_is_never_contradicted(
    base: str, name: str, a: float, b: float, stretch: float, noise: Floats
) -> None:
    slot = slot_of(name)
    stops = slot.joint.stops
    assert stops.lower is not None and stops.upper is not None
    entry = by_its_ends(slot, sweep_entry(slot, (stops.lower + a, stops.upper - b), wrong=False))
    off = error(slot, entry, wrong=False)
    assert abs(off) <= 0.95 * GROSS
    found = judged(base, name, off=off, stretch=stretch, noise=noise, entry=entry)
    assert found.proof is not SignProofStatus.CONTRADICTED
    assert (found.proof is SignProofStatus.PROVED) == found.foreseen.observable


@pytest.mark.parametrize(
    ("base", "name", "at", "observable"),
    [
        ("back", "l_hip_pitch", 0.0, True),
        ("back", "l_knee", 0.0, False),  # much the same the other way round, 2.15 rad away
        ("back", "l_knee", 1.05, True),  # in the middle of its travel it stands where its mirror image does
        ("left", "l_shoulder_roll", 0.0, False),
        ("left", "l_shoulder_roll", 1.0, True),
        ("left", "l_hip_roll", 0.0, True),
    ],
)
def test_a_mirrored_zero_is_detected_where_the_position_makes_it_observable(
    base: str, name: str, at: float, observable: bool
) -> None:
    assert (judged(base, name, at=at).proof is SignProofStatus.PROVED) is observable
    low, high = mirror(slot_of(name).joint, None)
    caught = judged(base, name, wrong=True, off=-(low + high) / 2.0, at=at).proof
    assert caught is SignProofStatus.CONTRADICTED or (
        caught is SignProofStatus.UNOBSERVABLE and not observable
    )


def test_the_mirror_image_is_where_each_end_of_the_travel_was_the_other() -> None:
    slot = slot_of("l_knee")  # -0.15 to 2.3 rad between its stops
    assert mirror(slot.joint, None) == pytest.approx((2.15, 2.15))
    short = sweep_entry(slot, (-0.15, 2.1), wrong=False)
    short = replace(short, zero_ticks=TRUE_ZERO)
    assert mirror(slot.joint, short) == pytest.approx((1.95, 2.15), abs=0.002)
    tried = offsets((1.95, 2.15))
    assert (tried[0], tried[-1]) == pytest.approx((-2.15 - GROSS, -1.95 + GROSS))
    assert np.diff(tried).max() <= GROSS / 2.0 + 1e-9
    unknown = replace(slot.joint, stops=JointEndstops())
    assert mirror(unknown, None) == pytest.approx((2.1, 2.1))


def test_a_zero_that_is_grossly_off_is_doubted_before_the_sign() -> None:
    """Hanging, a hip whose zero is off by the sum of its ends is the image of one whose sign is wrong."""
    low, high = mirror(slot_of("l_hip_pitch").joint, None)
    found = judged("upright", "l_hip_pitch", off=(low + high) / 2.0)
    assert (found.proof, found.against) == (SignProofStatus.CONTRADICTED, ContradictionKind.ZERO)
