"""The verdict on one joint, in words, for programs and for the calibration file."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from twind.config.config_reader import Plain
from twind_calibration.proving.load_comparison import MOST_NAMED, LoadComparisonResult
from twind_calibration.proving.sign_proof import ContradictionKind, LoadVerdict, SignProofStatus
from twind_calibration.wiggling.joint_move import MoveResult
from twind_calibration.wiggling.move_evidence import EncoderObservation, EncoderResponse, came_back
from twind_calibration.wiggling.wiggle_report import CAUSES, null_if_nan

SAYS = {
    ContradictionKind.MOTION: "it does not move as it is told to, or not alone",
    ContradictionKind.SIGN: (
        "THE LOAD FITS THE OTHER SIGN. Before the sign is touched: is it the right servo?"
    ),
    ContradictionKind.ZERO: (
        "its zero is grossly off: measure it in a pose (`twindctl calibrate zero --pose NAME`)"
    ),
    ContradictionKind.CURRENT: "its torque is told the wrong way round: drive mode (10), bit 0",
    ContradictionKind.OTHERS: (
        "others' loads change as if its sign were wrong, or theirs: is it the right servo?"
    ),
    ContradictionKind.PLACE: "another joint was moved",
    ContradictionKind.NEITHER: (
        "the load fits neither sign: joint, gear ratio, mass or another joint's zero is wrong"
    ),
    ContradictionKind.EYE: "who watched saw something else",
}
BLIND = (
    "unobservable is no pass: `twindctl calibrate prove --plan` says which base pose and angles show more, "
    "else your eye. Whole limbs that are exchanged are seen by eye alone"
)


@dataclass(frozen=True, slots=True)
class ProofVerdict:
    """Result of one joint.

    `weighed` None: not measured; `confirmed` None: no visual confirmation is possible.
    """

    joint: str
    bus: str
    id: int
    base: str
    gone: MoveResult
    seen: EncoderObservation | None = None
    weighed: LoadComparisonResult | None = None
    looks: str = ""
    confirmed: bool | None = None
    names: Sequence[str] = ()  # of all joints, by place

    @property
    def is_measured(self) -> bool:
        """True when the joint went its whole way and its readings arrived."""
        heard = self.seen is not None and self.seen.motion not in (
            EncoderResponse.UNHEARD,
            EncoderResponse.ENDED,
        )
        return self.gone.moved and not self.gone.ended and heard

    @property
    def against(self) -> ContradictionKind:
        """The contradiction, if any."""
        if not self.is_measured or self.seen is None:
            return ContradictionKind.NOTHING
        if self.seen.motion is not EncoderResponse.FOLLOWS or self.seen.others or not came_back(self.seen):
            return ContradictionKind.MOTION
        if self.weighed is not None and self.weighed.judged.against is not ContradictionKind.NOTHING:
            return self.weighed.judged.against
        return ContradictionKind.EYE if self.confirmed is False else ContradictionKind.NOTHING

    @property
    def proof(self) -> SignProofStatus | None:
        """Present status of the proof; None: nothing was measured."""
        if not self.is_measured:
            return None
        if self.against is not ContradictionKind.NOTHING:
            return SignProofStatus.CONTRADICTED
        found = SignProofStatus.UNOBSERVABLE if self.weighed is None else self.weighed.judged.proof
        return SignProofStatus.CONFIRMED if self.confirmed and found is not SignProofStatus.PROVED else found

    @property
    def is_consistent(self) -> bool:
        """True when it was measured without contradiction; this does not mean proved."""
        return self.proof not in (None, SignProofStatus.CONTRADICTED)

    @property
    def open(self) -> bool:
        """True when gravity proves nothing here and nothing contradicts: a visual check may decide."""
        return self.proof in (SignProofStatus.UNOBSERVABLE, SignProofStatus.PLAUSIBLE)

    @property
    def by_eye(self) -> bool:
        """True when the status rests on visual confirmation."""
        return self.proof is SignProofStatus.CONFIRMED

    def record(self, at: str) -> Plain:
        """Record for the calibration file; None: this proves nothing."""
        if self.proof not in (SignProofStatus.PROVED, SignProofStatus.CONFIRMED):
            return None
        judged = None if self.weighed is None else self.weighed.judged
        return {
            "sign": "gravity" if self.proof is SignProofStatus.PROVED else "operator",
            "base_pose": self.base,
            "slope_ratio": None if judged is None else null_if_nan(judged.slope_ratio),
            "offset_residual_rad": None if judged is None else null_if_nan(judged.offset),
            "offset_unsure_rad": None if judged is None else null_if_nan(judged.offset_unsure),
            "at": at,
        }

    def to_json(self) -> dict[str, object]:
        """Return one line of JSON; unknown values are null."""
        weighed = self.weighed
        seen = self.seen
        return {
            "joint": self.joint,
            "bus": self.bus,
            "id": self.id,
            "base_pose": self.base,
            "proof": None if self.proof is None else self.proof.value,
            "against": self.against.value or None,
            "refused": list(self.gone.refused),
            "ended": list(self.gone.ended),
            "left_rad": self.gone.left,
            "motion": None if seen is None else seen.motion.value,
            "others": []
            if seen is None
            else dict(zip(self._joint_names(seen.others), seen.ways, strict=True)),
            "looks": self.looks,
            "confirmed": self.confirmed,
            **({} if weighed is None else self._numbers(weighed)),
        }

    def _numbers(self, comparison: LoadComparisonResult) -> dict[str, object]:
        judged = comparison.judged
        return {
            "span_nm": null_if_nan(judged.foreseen.span),
            "flip_nm": null_if_nan(judged.foreseen.flip),
            "apart_nm": null_if_nan(judged.foreseen.apart),
            "slack_nm": null_if_nan(judged.foreseen.slack),
            "slope_ratio": null_if_nan(judged.slope_ratio),
            "misfit_nm": null_if_nan(judged.misfit),
            "misfit_reversed_nm": null_if_nan(judged.misfit_reversed),
            "offset_residual_rad": null_if_nan(judged.offset),
            "offset_unsure_rad": null_if_nan(judged.offset_unsure),
            "friction_nm": null_if_nan(judged.friction),
            "like": self._joint_names(comparison.like),
            "bent": self._joint_names(comparison.bent),
            "untold": self._joint_names(comparison.untold),
        }

    def lines(self) -> list[str]:
        """Return the verdict as text."""
        word = "not done" if self.proof is None else self.proof.value
        head = f"{word:12} {self.joint} ({self.bus} id {self.id})"
        if not self.gone.moved:
            return [f"{head}: not moved, the daemon refuses: {'; '.join(self.gone.refused)}"]
        said = [f"{head}: {self._load()}"]
        said += [f"it was ended on the way: {each}" for each in self.gone.ended]
        if self.gone.left:
            said.append(
                f"it holds {self.gone.left:+.3f} rad from where it was: `twindctl move` brings it back"
            )
        if self.against in SAYS:
            said.append(SAYS[self.against])
        if self.against is ContradictionKind.MOTION:
            said += self._motion()
        if self.weighed is not None and self.proof is SignProofStatus.CONTRADICTED:
            like = self._joint_names(self.weighed.like)
            bent = self._joint_names(self.weighed.bent)
            said += [f"it measures what the servo of {each} should: are the two exchanged?" for each in like]
            said += [f"it measures what a wrong sign of {each} would make of it" for each in bent]
        if self.weighed is not None and self.is_consistent and 0 < len(self.weighed.untold) <= MOST_NAMED:
            named = " or ".join(self._joint_names(self.weighed.untold))
            said.append(f"exchanged with the servo of {named} it would measure the same")
        if self.confirmed:
            said.append(f"seen: {self.looks or 'it moves'}, and back")
        return [said[0], *(f"             {each}" for each in said[1:])]

    def _load(self) -> str:
        if not self.is_measured:
            return "not judged" if self.gone.ended else "not heard while it moved"
        if self.weighed is None or not isfinite(self.weighed.judged.misfit):
            return (
                "its load is not judged: no torque is told, the ground bears it, or a transmission turns it"
            )
        judged = self.weighed.judged
        ahead = judged.foreseen
        if self.proof is SignProofStatus.UNOBSERVABLE:
            return f"here a wrong sign is {ahead.flip:.2f} N·m off, little beside friction; {_zero(judged)}"
        slope = f"slope {judged.slope_ratio:+.2f}, " if isfinite(judged.slope_ratio) else ""
        off = f"off by {judged.misfit:.2f} N·m, with the other sign {judged.misfit_reversed:.2f}"
        return f"{slope}{off} (may be {ahead.slack:.2f}); {_zero(judged)}"

    def _motion(self) -> list[str]:
        seen = self.seen
        if seen is None:
            return []
        said = [f"{seen.motion.value}: {CAUSES[seen.motion]}"] if seen.motion in CAUSES else []
        ways = zip(self._joint_names(seen.others), seen.ways, strict=True)
        said += [
            f"{name} went {way:+.3f} rad with it: a second id (12), a linkage, a cable" for name, way in ways
        ]
        return [*said, *([] if came_back(seen) else [f"it stands {seen.off:+.3f} rad from where it stood"])]

    def _joint_names(self, places: Sequence[int]) -> list[str]:
        return [self.names[place] for place in places]


def _zero(judged: LoadVerdict) -> str:
    if not isfinite(judged.offset):
        return "its zero cannot be told here"
    return f"zero off by {judged.offset:+.2f} ± {judged.offset_unsure:.2f} rad"
