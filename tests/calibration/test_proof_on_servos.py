"""A daemon's measurements on servos that MuJoCo moves, and their proofs: real bytes, under a fake clock."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import radians

import pytest

from tests.support.mujoco_servo_rig import H24, BodyRig
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth
from twind_calibration.proving.load_comparison import weigh
from twind_calibration.proving.proof_report import ProofVerdict
from twind_calibration.proving.proof_sweep import mean_loads, sweeps
from twind_calibration.proving.sign_proof import ContradictionKind, SignProofStatus
from twind_calibration.wiggling.joint_move import MoveResult
from twind_calibration.wiggling.move_evidence import answer
from twind_calibration.wiggling.posed_model import PosedModel

pytestmark = pytest.mark.slow
BACK = PosedModel(H24, "back")
UPRIGHT = PosedModel(H24)


@contextmanager
def hung(truth: dict[str, JointGroundTruth]) -> Iterator[BodyRig]:
    """Armed, hanging upright; its waist is propped."""
    rig = BodyRig(truth=RobotGroundTruth(truth))
    try:
        rig.arm()
        rig.virtual["main"].faults.lock(id=12)
        yield rig
    finally:
        rig.close()


def proved(rig: BodyRig, body: PosedModel, name: str) -> ProofVerdict:
    """Verdict on a joint that was swept through its places."""
    place = H24.names.index(name)
    joint = H24.joints[place]
    home = float(rig.loop.executor.reference.position[place])
    way = sweeps(home, joint.lower, joint.upper, radians(15.0))[0]
    stays = rig.traced(way.path(name)).visits(place, way.visits)
    assert stays is not None
    shown = mean_loads(way, stays)
    return ProofVerdict(
        joint=name,
        bus=joint.bus,
        id=joint.id,
        base=body.base,
        gone=MoveResult(way.farthest),
        seen=answer(shown.ends, place, way.farthest),
        weighed=weigh(body, place, shown, 0.1),
        names=H24.names,
    )


def test_a_rough_joint_with_play_is_proved_on_its_back_and_upright_it_is_not() -> None:
    with hung({"l_hip_pitch": JointGroundTruth(friction_nm=0.15, backlash_ticks=4.0)}) as rig:
        upright = proved(rig, UPRIGHT, "l_hip_pitch")
        assert upright.proof is SignProofStatus.UNOBSERVABLE
        assert upright.record("2026-11-22T09:00:00Z") is None
        rig.virtual["main"].faults.lay("back")
        rig.seconds(0.5)
        back = proved(rig, BACK, "l_hip_pitch")
        assert back.proof is SignProofStatus.PROVED
        assert back.weighed is not None
        assert back.weighed.judged.slope_ratio == pytest.approx(1.0, abs=0.05)
        assert back.weighed.judged.friction < 0.2


def test_a_wrong_sign_is_no_pass_upright_and_is_caught_on_its_back() -> None:
    """The shoulder hangs from what does not feel it, so that upright nothing at all tells."""
    with hung({"l_shoulder_pitch": JointGroundTruth(sign=-1)}) as rig:
        assert proved(rig, UPRIGHT, "l_shoulder_pitch").proof is SignProofStatus.UNOBSERVABLE
        rig.virtual["main"].faults.lay("back")
        rig.seconds(0.5)
        back = proved(rig, BACK, "l_shoulder_pitch")
        assert (back.proof, back.against) == (SignProofStatus.CONTRADICTED, ContradictionKind.SIGN)
        assert "r_shoulder_pitch" in back.to_json()["like"]  # before the sign is touched


def test_exchanged_twins_look_like_a_wrong_sign_and_the_twin_is_named() -> None:
    with hung({"l_hip_pitch": JointGroundTruth(swapped_with="r_hip_pitch")}) as rig:
        rig.virtual["main"].faults.lay("back")
        rig.seconds(0.5)
        found = proved(rig, BACK, "l_hip_pitch")
        assert (found.proof, found.against) == (SignProofStatus.CONTRADICTED, ContradictionKind.SIGN)
        assert found.to_json()["like"] == ["r_hip_pitch"]
        assert any("servo of r_hip_pitch" in line for line in found.lines())
