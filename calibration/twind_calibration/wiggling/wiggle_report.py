"""The verdict on one joint, in words and for programs."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, isfinite

from twind_calibration.wiggling.joint_move import MoveResult
from twind_calibration.wiggling.move_evidence import (
    EncoderObservation,
    EncoderResponse,
    TorqueObservation,
    TorqueResponse,
    came_back,
)

# Why a joint answers as it does.
CAUSES = {
    EncoderResponse.SHORT: (
        "less than the twin does: load, low position gain, a cap on its current, or it is held"
    ),
    EncoderResponse.STILL: "it did not move: something holds it, its torque is off, or its motor is dead",
    EncoderResponse.BACKWARDS: (
        "its encoder goes against its goal: look at its drive mode (10), then at its encoder"
    ),
    EncoderResponse.FAR: "further than the twin does: something else moves it, or its encoder slips",
    EncoderResponse.UNHEARD: "its readings are missing: look at `twindctl monitor`",
}
BLIND = (
    "an encoder cannot tell sign, gear ratio and which joint it sits at: goal and reading share them. They "
    "were seen by load or by eye where a line says so, and nowhere else"
)
NOT_COMPARED = "only the simulation is moved, and it is what would be compared with: no robot is seen"


@dataclass(frozen=True, slots=True)
class WiggleVerdict:
    """Everything about one joint. `seen` None: it was not moved; `confirmed` None: not known."""

    joint: str
    bus: str
    id: int
    gone: MoveResult
    seen: EncoderObservation | None = None
    weighed: TorqueObservation | None = None
    looks: str = ""  # what a person should have seen
    confirmed: bool | None = None
    names: Sequence[str] = ()  # of all joints, by place

    @property
    def is_consistent(self) -> bool:
        """Nothing speaks against this joint. Not: everything speaks for it."""
        if not self.gone.moved or self.gone.ended or self.seen is None or self.confirmed is False:
            return False
        if self.seen.motion is EncoderResponse.SIMULATED:
            return True
        load = TorqueResponse.UNKNOWN if self.weighed is None else self.weighed.load
        alien = self.weighed is not None and bool(self.weighed.like)
        by_load = load not in (TorqueResponse.REVERSED, TorqueResponse.NEITHER) and not alien
        return (
            self.seen.motion is EncoderResponse.FOLLOWS
            and not self.seen.others
            and came_back(self.seen)
            and by_load
        )

    @property
    def open(self) -> bool:
        """Nothing speaks against it, and nothing has shown sign and place: neither its load nor a person."""
        if not self.is_consistent or self.seen is None or self.seen.motion is EncoderResponse.SIMULATED:
            return False
        return self.confirmed is None and (
            self.weighed is None or self.weighed.load is not TorqueResponse.AGREES
        )

    def to_json(self) -> dict[str, object]:
        """One line of JSON; what is not known is null."""
        seen = self.seen
        weighed = self.weighed
        return {
            "joint": self.joint,
            "bus": self.bus,
            "id": self.id,
            "good": self.is_consistent,
            "open": self.open,
            "refused": list(self.gone.refused),
            "ended": list(self.gone.ended),
            "left_rad": self.gone.left,
            "asked_rad": self.gone.way,
            "motion": None if seen is None else seen.motion.value,
            "expected_rad": None if seen is None else null_if_nan(seen.expected),
            "moved_rad": None if seen is None else null_if_nan(seen.moved),
            "off_rad": None if seen is None else null_if_nan(seen.off),
            "others": []
            if seen is None
            else dict(zip(self._joint_names(seen.others), seen.ways, strict=True)),
            "load": TorqueResponse.UNKNOWN.value if weighed is None else weighed.load.value,
            "measured_nm": None if weighed is None else null_if_nan(weighed.measured),
            "model_nm": None if weighed is None else null_if_nan(weighed.model),
            "reversed_nm": None if weighed is None else null_if_nan(weighed.reversed),
            "like": [] if weighed is None else self._joint_names(weighed.like),
            "looks": self.looks,
            "confirmed": self.confirmed,
        }

    def lines(self) -> list[str]:
        """For a person."""
        word = "open" if self.open else "ok  " if self.is_consistent else "LOOK"
        head = f"{word} {self.joint} ({self.bus} id {self.id}): "
        if not self.gone.moved:
            return [head + "not moved, the daemon refuses: " + "; ".join(self.gone.refused)]
        said = [head + self._motion()]
        said += [f"     it was ended on the way: {each}" for each in self.gone.ended]
        if self.gone.left:
            said.append(
                f"     it holds {_deg(self.gone.left)} from where it was: `twindctl move` brings it back"
            )
        if self.seen is None or self.seen.motion in (EncoderResponse.SIMULATED, EncoderResponse.ENDED):
            return said
        if self.seen.motion in CAUSES:
            said.append(f"     {CAUSES[self.seen.motion]}")
        ways = zip(self._joint_names(self.seen.others), self.seen.ways, strict=True)
        said += [
            f"     {name} went {_deg(way)} with it: a second id (12), a linkage, a cable"
            for name, way in ways
        ]
        if self.seen.motion is not EncoderResponse.UNHEARD and not came_back(self.seen):
            said.append(f"     it stands {_deg(self.seen.off)} from where it stood")
        return [*said, *self._load(), self._eye()]

    def _motion(self) -> str:
        if self.seen is None:
            return "moved, and nothing was recorded of it"
        if self.seen.motion is EncoderResponse.SIMULATED:
            return f"the gate takes {_deg(self.gone.way)} and back"
        if self.seen.motion is EncoderResponse.ENDED:
            return "not judged"
        if self.seen.motion is EncoderResponse.UNHEARD:
            return "not heard while it moved"
        went = f"went {_deg(self.seen.moved)} of {_deg(self.seen.asked)}"
        return f"{self.seen.motion.value}: {went}, its twin {_deg(self.seen.expected)}"

    def _load(self) -> list[str]:
        w = self.weighed
        if w is None or w.load is TorqueResponse.UNKNOWN:
            return ["     by load: not known (no torque is measured, or the ground carries some of it)"]
        felt = f"measured {w.measured:+.2f} N·m, model {w.model:+.2f}, with the other sign {w.reversed:+.2f}"
        says = {
            TorqueResponse.AGREES: f"     by load: sign and joint agree: {felt}",
            TorqueResponse.REVERSED: (
                f"     by load: THE SIGN LOOKS WRONG, or another joint's servo answers: {felt}"
            ),
            TorqueResponse.NEITHER: (
                f"     by load: it fits neither sign: zero, joint or model is wrong: {felt}"
            ),
            TorqueResponse.UNOBSERVABLE: f"     by load: the sign cannot be told in this pose: {felt}",
        }
        names = " or ".join(self._joint_names(w.like))
        like = f"     it measures what {names} should: are their servos exchanged?"
        return [says[w.load], *([like] if w.like else [])]

    def _eye(self) -> str:
        state = {True: "confirmed", False: "contradicted", None: "not confirmed"}[self.confirmed]
        return f"     by eye: {self.looks or 'it moves'}, and back: {state}"

    def _joint_names(self, places: Sequence[int]) -> list[str]:
        return [self.names[place] for place in places]


def _deg(radians: float) -> str:
    return f"{degrees(radians):+.2f}°"


def null_if_nan(number: float) -> float | None:
    """Return the number for JSON; None for NaN and infinity."""
    return number if isfinite(number) else None
