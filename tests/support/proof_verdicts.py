"""Verdicts of the proof of one joint."""

from twind.config.robot_file import load_robot
from twind_calibration.proving.load_comparison import LoadComparisonResult
from twind_calibration.proving.proof_report import ProofVerdict
from twind_calibration.proving.sign_proof import (
    ContradictionKind,
    LoadPrediction,
    LoadVerdict,
    SignProofStatus,
)
from twind_calibration.wiggling.joint_move import MoveResult
from twind_calibration.wiggling.move_evidence import EncoderObservation, EncoderResponse

H24 = load_robot("h24")
KNEE = H24.names.index("l_knee")


def verdict(
    proof: SignProofStatus = SignProofStatus.PROVED,
    against: ContradictionKind = ContradictionKind.NOTHING,
    *,
    joint: str = "l_knee",
    motion: EncoderResponse = EncoderResponse.FOLLOWS,
    others: tuple[int, ...] = (),
    off: float = 0.0,
    confirmed: bool | None = None,
    gone: MoveResult | None = None,
) -> ProofVerdict:
    judged = LoadVerdict(
        proof, against, LoadPrediction(0.1, 0.85, 0.5, 0.05), 0.94, 0.01, 0.8, 0.04, 0.1, 0.05
    )
    return ProofVerdict(
        joint=joint,
        bus="main",
        id=16,
        base="back",
        gone=gone or MoveResult(0.3),
        seen=EncoderObservation(motion, 0.3, 0.3, 0.3, off, others, (0.2,) * len(others)),
        weighed=LoadComparisonResult(
            judged, like=(KNEE,) if against is not ContradictionKind.NOTHING else ()
        ),
        confirmed=confirmed,
        names=H24.names,
    )


CONTRADICTED = verdict(SignProofStatus.CONTRADICTED, ContradictionKind.SIGN)
