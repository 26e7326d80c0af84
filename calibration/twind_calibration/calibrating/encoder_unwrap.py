"""The way that an actuator went, from readings that know one turn. Pure: readings and their stamps in.

Readings may jump by whole turns (an encoder's seam, a servo that was restarted); the way between two of them
is the shortest. That is right for as long as no reading is missing while it moves fast: where one may be, the
way is not guessed, it begins anew.
"""

from dataclasses import dataclass

QUARTER = 0.25  # turns: a longer step between two readings is no step that a hand makes in 20 ms
GAP = 0.040  # s: two readings at 50 Hz; what is longer is a gap
FAST = 0.125  # turns that it may have gone within a gap: by its speed before, or across it
FASTEST = 3.0  # turns/s that a hand may turn a shaft: the other way round within a gap must need more
STILL = 0.004  # turns, what a joint at rest may waver by
DWELL = 0.4  # s that it must stay to have rested


def shortest(step: int, ticks_per_turn: int) -> int:
    """The same step without whole turns: within half a turn, the upper half-turn where both are as long."""
    half = ticks_per_turn // 2
    return (step + half - 1) % ticks_per_turn - (half - 1)


def find_gap_reason(step: int, gap: float, speed: float, ticks_per_turn: int) -> str:
    """Why a reading may be missing before this one; "": none can be. `speed`: ticks/s before it."""
    turns = abs(step) / ticks_per_turn
    if turns > QUARTER:
        return f"it stepped {turns:.2f} turns between two readings"
    if gap > GAP:
        went = max(turns, abs(speed) / ticks_per_turn * gap)
        if went > FAST or gap * FASTEST >= 1.0 - turns:
            return f"{1e3 * gap:.0f} ms without a reading while it may have moved {went:.2f} turns"
    return ""


@dataclass(frozen=True, slots=True)
class EncoderSample:
    """One reading of one actuator."""

    time: float  # s, when it was received
    ticks: int  # as on the wire


class UnwrappedEncoder:
    """One actuator: where it is, how far it went either way, and whether it rested there.

    Counts are those of the first reading, going on over the seam: `framed` names them as the file does.
    """

    def __init__(self, ticks_per_turn: int) -> None:
        self.turn = ticks_per_turn
        self.heard = False
        self.place = self.low = self.high = 0
        self._last = EncoderSample(0.0, 0)
        self._speed = 0.0
        self._anchor = 0
        self._since = 0.0
        self._rests: tuple[int | None, int | None] = (None, None)

    def take(self, sample: EncoderSample) -> str:
        """One more reading; why the way begins anew from here, or "". An old or the same one is left out."""
        if not self.heard:
            self._begin(sample)
            return ""
        gap = sample.time - self._last.time
        if not gap > 0.0:
            return ""
        step = shortest(sample.ticks - self._last.ticks, self.turn)
        why = find_gap_reason(step, gap, self._speed, self.turn)
        if why:
            moved = self.span > self._still
            self._begin(sample)
            return why if moved else ""
        self._speed = step / gap
        self._last = sample
        self.place += step
        self.low, self.high = min(self.low, self.place), max(self.high, self.place)
        self._rest(sample.time)
        return ""

    @property
    def span(self) -> int:
        """Travel so far, ticks."""
        return self.high - self.low

    def rested(self, near: int) -> tuple[bool, bool]:
        """Return whether it has rested within `near` ticks of its lowest and of its highest place."""
        lower, upper = self._rests
        return (
            lower is not None and lower - self.low <= near,
            upper is not None and self.high - upper <= near,
        )

    @property
    def _still(self) -> float:
        return max(2.0, STILL * self.turn)

    def _begin(self, sample: EncoderSample) -> None:
        self.heard = True
        self.place = self.low = self.high = sample.ticks
        self._last = sample
        self._speed = 0.0
        self._anchor = sample.ticks
        self._since = sample.time
        self._rests = (None, None)

    def _rest(self, time: float) -> None:
        """Update the rests. The place before the first motion is no end of the travel."""
        if self.span <= self._still:
            self._since = time
        elif abs(self.place - self._anchor) > self._still:
            self._anchor = self.place
            self._since = time
        elif time - self._since >= DWELL:
            lower, upper = self._rests
            self._rests = (
                self.place if lower is None else min(lower, self.place),
                self.place if upper is None else max(upper, self.place),
            )


def framed(low: int, high: int, start: int, ticks_per_turn: int) -> tuple[int, int]:
    """The same travel by whole turns so that its middle lies in start .. start + one turn.

    A servo that restarts within the travel then reports counts of this frame, unless it crosses the seam.
    """
    shift = ((low + high) // 2 - start) // ticks_per_turn * ticks_per_turn
    return low - shift, high - shift


def on_turn(ticks: int, band: tuple[int, int]) -> int:
    """The one of a reading's turns that lies in a band of one turn (half-open)."""
    return band[0] + (ticks - band[0]) % (band[1] - band[0])
