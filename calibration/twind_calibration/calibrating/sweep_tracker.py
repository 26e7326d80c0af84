"""Progress of every actuator of a sweep, reading by reading: motion, travel, completion. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from twind_calibration.calibrating.calibration_actuators import CalibrationActuator
from twind_calibration.calibrating.encoder_unwrap import EncoderSample, UnwrappedEncoder
from twind_calibration.calibrating.travel_verdict import (
    TravelVerdict,
    UnexpectedMotion,
    find_unexpected_motion,
    judge,
)

NEAR = 0.03  # rad: a joint that rested so close to the end of its travel rested at it
TO_BOTH_ENDS = "move it slowly to both ends and rest half a second at each"
ENDS = ("end of lowest counts", "end of highest counts")
BEFORE = "Where it lay before its first motion does not count"
ALL = 0.9  # of the way between its limits: below it a rest may be one half-way, and only a person knows


class SweepStage(StrEnum):
    """Stage of one actuator in a sweep."""

    STILL = "still"  # not moved yet
    MOVING = "moving"
    DONE = "done"  # rested at both ends of a travel that fits
    WRONG = "wrong"  # rested at both ends of one that does not


@dataclass(frozen=True, slots=True)
class SweepProgress:
    """Present progress of one actuator."""

    name: str
    stage: SweepStage
    judged: TravelVerdict
    ends: tuple[bool, bool]  # rested at its lowest, at its highest count
    range: float  # rad, as described


@dataclass(frozen=True, slots=True)
class SweepEvent:
    """Event to report at once. `what`: done, wrong, lost or strayed."""

    what: str
    name: str
    text: str


class SweepTracker:
    """Progress of all actuators. `asked`: those to sweep; the others are watched for unexpected motion."""

    def __init__(
        self, slots: Sequence[CalibrationActuator], asked: Sequence[str], *, wide: bool = False
    ) -> None:
        self.asked = tuple(asked)
        self._slots = {slot.name: slot for slot in slots}
        self._tracks = {slot.name: UnwrappedEncoder(slot.joint.type.ticks_per_turn) for slot in slots}
        self._kept: dict[str, tuple[int, int]] = {}
        self._stages = dict.fromkeys(self._slots, SweepStage.STILL)
        self._lost: dict[str, str] = {}  # why an actuator that now stands still began anew
        self._told: set[str] = set()
        self._wide = wide

    def take(self, readings: Mapping[str, EncoderSample]) -> list[SweepEvent]:
        """Process one reading of all actuators that answered."""
        news = [each for name, sample in readings.items() for each in self._process_sample(name, sample)]
        stray = self._stray()
        if stray is not None and not self._told.issuperset(stray.moved):
            self._told.update(stray.moved)
            news.append(SweepEvent("strayed", stray.moved[0], str(stray)))
        return news

    def progress(self, name: str) -> SweepProgress:
        """Return the progress of one actuator."""
        slot = self._slots[name]
        track = self._tracks[name]
        low, high = self._kept.get(name, (track.low, track.high))
        span = max(track.span, high - low)
        ends = (True, True) if name in self._kept else self._rested(name)
        return SweepProgress(name, self._stages[name], self._judge(slot, span), ends, slot.range)

    def travel(self, name: str, *, at_once: bool = False) -> tuple[int, int] | None:
        """Return lowest and highest count of a completed actuator.

        `at_once`: of any whose travel fits, whether or not it has rested at the ends; one whose limits are
        not known must have rested.
        """
        if name in self._kept:
            return self._kept[name]
        track = self._tracks[name]
        slot = self._slots[name]
        has_ends = not slot.is_open or self._rested(name) == (True, True)
        if at_once and has_ends and self._judge(slot, track.span).is_acceptable:
            return track.low, track.high
        return None

    def open_reason(self, name: str) -> str:
        """Return why an actuator has no complete travel, and what to do next."""
        progress = self.progress(name)
        if progress.stage is SweepStage.STILL:
            return self._lost.get(name, f"it was not moved; {TO_BOTH_ENDS}")
        if not progress.judged.wrong:
            missing = [end for end, rested in zip(ENDS, progress.ends, strict=True) if not rested]
            went = f"it went {progress.judged.radians:.2f} rad, too little of the way between its limits"
            text = f"it did not rest at its {' and its '.join(missing)}" if missing else went
            return f"{text}; {TO_BOTH_ENDS}. {BEFORE}"
        text = describe_mismatch(progress.judged)
        return text if progress.judged.share >= 1.0 else f"{text}; {TO_BOTH_ENDS}"

    @property
    def is_finished(self) -> bool:
        """True when all requested actuators are complete."""
        return all(self._stages[name] in (SweepStage.DONE, SweepStage.WRONG) for name in self.asked)

    def _process_sample(self, name: str, sample: EncoderSample) -> list[SweepEvent]:
        track = self._tracks[name]
        before = self._stages[name]
        why = track.take(sample)
        if why:
            self._stages[name] = SweepStage.DONE if name in self._kept else SweepStage.STILL
            text = f"{why}: a reading may be lost; move {name} again, from end to end"
            self._lost[name] = text
            return [SweepEvent("lost", name, text)] if name in self.asked and name not in self._kept else []
        if before is SweepStage.STILL and track.span > self._slots[name].ticks(NEAR):
            self._stages[name] = SweepStage.MOVING
        if name not in self.asked or self._rested(name) != (True, True):
            return []
        return self._finish_actuator(name, before)

    def _finish_actuator(self, name: str, before: SweepStage) -> list[SweepEvent]:
        """Return whether the actuator has rested at both ends of its present travel."""
        track = self._tracks[name]
        judged = self._judge(self._slots[name], track.span)
        if judged.is_acceptable and judged.radians >= ALL * (
            self._slots[name].upper - self._slots[name].lower
        ):
            low, high = self._kept.get(name, (0, 0))
            if track.span > high - low:
                self._kept[name] = (track.low, track.high)
            self._stages[name] = SweepStage.DONE
        elif judged.share >= 1.0:  # shorter ones may have rested half-way
            self._kept.pop(name, None)
            self._stages[name] = SweepStage.WRONG
        after = self._stages[name]
        if after is before or after not in (SweepStage.DONE, SweepStage.WRONG):
            return []
        said = (
            f"{judged.radians:.2f} rad, {100 * judged.share:.0f} % of the described {self._range(name):.2f}"
        )
        return [SweepEvent(after.value, name, describe_mismatch(judged) if judged.wrong else said)]

    def _rested(self, name: str) -> tuple[bool, bool]:
        return self._tracks[name].rested(max(4, self._slots[name].ticks(NEAR)))

    def _range(self, name: str) -> float:
        return self._slots[name].range

    def _judge(self, slot: CalibrationActuator, span: int) -> TravelVerdict:
        judged = judge(slot, span, tuple(self._slots.values()))
        return TravelVerdict(judged.radians, judged.share) if judged.wide and self._wide else judged

    def _stray(self) -> UnexpectedMotion | None:
        shares = {
            name: track.span * abs(self._slots[name].rad_per_tick) / self._slots[name].range
            for name, track in self._tracks.items()
        }
        return find_unexpected_motion(shares, self.asked)


def describe_open_limits(names: Sequence[str], end: str) -> str:
    """Return what ends the sweep of joints whose limits are not known. `end`: key or option that ends it."""
    return (
        f"limits_rad of {', '.join(names)}: open, so the sweep cannot tell when they are done; rest at both "
        f"ends, {end} takes them"
    )


def describe_mismatch(judged: TravelVerdict) -> str:
    """Describe a travel that does not fit: the error, and its likely causes."""
    wide = "; `--wide` takes it as it is" if judged.wide else ""
    return f"{judged.wrong}; likely: {', or '.join(judged.causes)}{wide}"
