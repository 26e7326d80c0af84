"""Search for a joint's endstop: slowly and weakly against it, back off, repeat. Pure: no clock.

Counts are calibrated and continue over turns; efforts are raw. Where the turn is unknown, the stop may lie
whole turns nearer than expected. Then the joint must finally move further away from its stop than it could
from any other place that looks the same. Goals begin at the servo's hold goal and go on
from the last one commanded. A goal from the measured position would take away the error that carries the
load, and the limb would dip.
"""

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from math import inf
from statistics import median

from twind.robot.finding import Finding, ReasonCode

# share of the current limit, rad/s, and captures, where the request has none
USUAL_SHARE = 0.12
USUAL_SPEED = 0.2
USUAL_TIMES = 3
MARGIN = 0.2  # rad either side of where the stop should be
PRESSED = 0.15  # s at the cap without movement that count as a stop
LEAST = 5  # readings in that time
AT_CAP = 0.85  # of the cap, which a current regulated to it flickers around
OVER_CAP = 1.5  # share of the cap ...
OVER_CAP_SLACK = 5.0  # raw, and so much more ...
OVER_CAP_ROW = 3  # ... readings in a row: the servo exceeds its cap
STALE = 0.03  # s: with an older reading no goal advances ...
LOST = 0.1  # s ... and an even older one ends the search; the servo's own watchdog is set to that
GAP = 0.1  # s between two steps; after a longer gap the joint's movement is unknown
SPREAD = 5.0  # counts between the captures; more means a loose joint or a soft stop
SETTLE = 0.3  # s that a joint is given to follow its last goal
NO_STOP = 1.0  # s at the end of the way without a stop
READS = 10  # readings that must agree before anything begins ...
AGREE = 3  # counts ... of difference
WAIT = 3.0  # s to wait for them
SPARE = 5.0  # s beyond the planned time, twice of it


class HomingPhase(StrEnum):
    """Phase of an end-stop search."""

    APPROACHING = "approaching"
    BACKING = "backing off"
    FOUND = "found"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class HomingParameters:
    """Direction, expected place, speed and effort limits of one end-stop search. Counts and raw efforts."""

    way: int  # +1 or -1: towards the stop, in counts
    expected: float  # count of the stop from the coarse zero
    margin: float  # counts that the stop may be on either side of that
    speed: float  # counts/s of the goals
    cap: float  # raw effort, the most that the servo may use
    back: float  # counts that it backs off
    lead: float  # counts that a goal may be ahead of the joint
    astray: float  # counts that the joint may go against the search direction
    still: float  # counts that a standing joint may flicker within `PRESSED`
    times: int  # captures
    turn: float = 0.0  # counts of a turn where the turn is unknown, and the stop may lie turns nearer; else 0
    away: float = 0.0  # counts that it backs off after the last capture; at least `back`


@dataclass(frozen=True, slots=True)
class HomingSample:
    """One reading of the joint."""

    at: float  # s, when it was read
    count: int
    effort: float  # raw; NaN: not reported


class StandstillCheck:
    """Check before the first write: the joint hangs still and its readings agree."""

    def __init__(self, now: float) -> None:
        self._until = now + WAIT
        self._samples: deque[HomingSample] = deque(maxlen=READS)

    def step(self, sample: HomingSample, now: float) -> bool | Finding:
        """Process a reading; True: enough readings agree. A finding: they did not in time."""
        if not self._samples or sample.at > self._samples[-1].at:
            self._samples.append(sample)
        counts = [each.count for each in self._samples]
        if len(counts) == READS and now - sample.at <= STALE and max(counts) - min(counts) <= AGREE:
            return True
        if now < self._until:
            return False
        spread = float(max(counts) - min(counts)) if len(counts) == READS else inf
        message = f"counts between {READS} readings, or too few of them: let it hang still, check its cable"
        return Finding(ReasonCode.STOP_NOT_FOUND, value=spread, bound=float(AGREE), message=message)


class EndstopSearch:
    """State machine of a search: approach, stop, back off, several times.

    `failed` is the reason of a failure.

    After a failure nothing may be written.
    """

    def __init__(self, search: HomingParameters, start: float, now: float) -> None:
        """`start`: count of the servo's hold goal, read back."""
        self.search = search
        self.goal = start
        self.phase = HomingPhase.APPROACHING
        self.captures: list[float] = []
        self.failed: Finding | None = None
        self._began = self._now = now
        self._samples: deque[HomingSample] = deque()  # readings of the last PRESSED s
        self._over = 0  # readings in a row over the cap
        self._farthest = -inf  # count in search direction, of this approach
        self._ended: float | None = None  # s, since when the goals of this phase are at their end
        self.turns_off = 0.0  # counts, whole turns by which the stop lies off `expected`
        self._home = abs(self._end - start)
        self._patience = self._planned() * 2.0 + SPARE

    @property
    def progress(self) -> float:
        """Progress, 0 to 1: the captures, and the share of the way to the first."""
        first = 1.0 - min(1.0, abs(self._end - self.goal) / max(self._home, 1.0))
        done = len(self.captures) if self.captures else first
        return min(1.0, done / self.search.times)

    @property
    def done(self) -> bool:
        """True when the stop was found or the search failed: no more goals are to be written."""
        return self.phase in (HomingPhase.FOUND, HomingPhase.FAILED)

    def step(self, sample: HomingSample, now: float) -> float:
        """Return the goal (counts) of this tick; the last one where nothing may advance."""
        passed = now - self._now
        self._now = now
        if not self.done:
            self.failed = self._check_lost_reading(sample, now, passed)
        if not self.done and self.failed is None:
            self._keep(sample)
            self.failed = self._astray(sample) or self._overdue(now)
        if self.failed is not None:
            self.phase = HomingPhase.FAILED
        elif not self.done and now - sample.at <= STALE:
            (self._approach if self.phase is HomingPhase.APPROACHING else self._back)(sample, now, passed)
        return self.goal

    # ------------------------------------------------------------------------------- the two ways

    def _approach(self, sample: HomingSample, now: float, passed: float) -> None:
        search = self.search
        if self._pressed(now):
            self._capture(float(median(each.count for each in self._samples)))
            return
        ahead = (self.goal - sample.count) * search.way
        left = (self._end - self.goal) * search.way
        self.goal += search.way * max(0.0, min(search.speed * passed, search.lead - ahead, left))
        if left > 0.0 and ahead < search.lead:
            self._ended = None
        elif self._ended is None:
            self._ended = now
        elif now - self._ended > NO_STOP:
            self._fail(self._held_back(sample) if ahead >= search.lead else self._no_stop(sample))

    def _back(self, sample: HomingSample, now: float, passed: float) -> None:
        """Move to the place beside the last capture, at the same speed.

        The joint must follow there; otherwise it is held.
        """
        search = self.search
        place = self.captures[-1] - search.way * (
            max(search.back, search.away) if self._last else search.back
        )
        left = (self.goal - place) * search.way
        self.goal -= search.way * min(search.speed * passed, max(0.0, left))
        if left > 0.0:
            return
        self._ended = now if self._ended is None else self._ended
        if now - self._ended < SETTLE:
            return
        if abs(sample.count - self.goal) > search.back / 2.0:
            message = "counts from where it was sent, away from its stop: it does not come back"
            off = abs(sample.count - self.goal)
            self._fail(
                Finding(ReasonCode.STOP_NOT_FOUND, value=off, bound=search.back / 2.0, message=message)
            )
        else:
            self._begin(HomingPhase.FOUND if self._last else HomingPhase.APPROACHING)

    @property
    def _last(self) -> bool:
        """True from the last capture on."""
        return len(self.captures) >= self.search.times

    def _begin(self, phase: HomingPhase) -> None:
        self.phase = phase
        self._ended = None
        self._farthest = -inf
        self._samples.clear()

    def _capture(self, count: float) -> None:
        search = self.search
        self.captures.append(count)
        off = count - search.expected
        self.turns_off = search.turn * round(off / search.turn) if search.turn else 0.0
        off = abs(off - self.turns_off)
        spread = max(self.captures) - min(self.captures)
        if off > search.margin:
            message = (
                f"counts from where the stop should be, held at {count:.0f}: is something in its way, or its "
                "load more than the cap lifts? Lay the robot so that the joint carries less"
            )
            self._fail(Finding(ReasonCode.STOP_NOT_FOUND, value=off, bound=search.margin, message=message))
        elif spread > SPREAD:
            message = "counts between the captures: is it loose, or is the stop soft?"
            self._fail(Finding(ReasonCode.STOP_NOT_FOUND, value=spread, bound=SPREAD, message=message))
        else:
            self._begin(HomingPhase.BACKING)

    def _pressed(self, now: float) -> bool:
        """Check that the joint is at the cap and stands for long enough."""
        samples = self._samples
        search = self.search
        if len(samples) < LEAST or samples[-1].at - samples[0].at < PRESSED - 1e-9:
            return False
        counts = [each.count for each in samples]
        loaded = all(abs(each.effort) >= AT_CAP * search.cap for each in samples)
        return loaded and max(counts) - min(counts) <= search.still

    # ------------------------------------------------------------------------------- what ends it

    @property
    def _end(self) -> float:
        """Farthest count that a goal may have."""
        return self.search.expected + self.search.way * self.search.margin

    def _planned(self) -> float:
        """Return the time (s) of the search at its speed over the longest way."""
        search = self.search
        again = search.times * (2.0 * (search.back + search.margin) / search.speed + PRESSED + SETTLE)
        return (self._home + search.away) / search.speed + again

    def _keep(self, sample: HomingSample) -> None:
        if self._samples and sample.at <= self._samples[-1].at:
            return
        self._samples.append(sample)
        while len(self._samples) > 1 and self._samples[1].at <= sample.at - PRESSED:
            self._samples.popleft()
        over = abs(sample.effort) > OVER_CAP * self.search.cap + OVER_CAP_SLACK
        self._over = self._over + 1 if over else 0
        self._farthest = max(self._farthest, sample.count * self.search.way)

    def _check_lost_reading(self, sample: HomingSample, now: float, passed: float) -> Finding | None:
        if not 0.0 <= passed <= GAP:
            message = "s since the last step: the joint's movement meanwhile is unknown"
            return Finding(ReasonCode.TIME_GAP, value=passed, bound=GAP, message=message)
        if not now - sample.at <= LOST:
            message = "s since its last reading: check cable and power"
            return Finding(ReasonCode.STATE_STALE, value=now - sample.at, bound=LOST, message=message)
        return None

    def _astray(self, sample: HomingSample) -> Finding | None:
        search = self.search
        if self._over >= OVER_CAP_ROW:
            message = "raw effort, over the cap that it was given: the servo exceeds it"
            return Finding(
                ReasonCode.OVERCURRENT, value=abs(sample.effort), bound=search.cap, message=message
            )
        along = sample.count * search.way
        ahead = along - self.goal * search.way
        if ahead > search.astray and self._last and search.turn:
            message = (
                "counts behind its goal on the way from its stop: something is in its way, or was in place "
                "of its stop; its turn stays unknown"
            )
            return Finding(ReasonCode.STOP_NOT_FOUND, value=ahead, bound=search.astray, message=message)
        if ahead > search.astray:
            message = "counts ahead of its goal: it runs away, its load is more than the cap holds"
            return Finding(ReasonCode.STOP_NOT_FOUND, value=ahead, bound=search.astray, message=message)
        behind = self._farthest - along
        if self.phase is HomingPhase.APPROACHING and behind > search.astray:
            message = "counts against the way to its stop: wrong sign, or more load than the cap lifts?"
            return Finding(ReasonCode.STOP_NOT_FOUND, value=behind, bound=search.astray, message=message)
        return None

    def _overdue(self, now: float) -> Finding | None:
        if now - self._began <= self._patience:
            return None
        message = "s have passed and the stop was not found so often: is it held back on its way?"
        return Finding(
            ReasonCode.STOP_NOT_FOUND, value=now - self._began, bound=self._patience, message=message
        )

    def _held_back(self, sample: HomingSample) -> Finding:
        message = (
            f"raw effort, held back at count {sample.count} and not standing at its cap: gains too soft, no "
            "current reported, or too slow for its goals?"
        )
        return Finding(
            ReasonCode.STOP_NOT_FOUND,
            value=abs(sample.effort),
            bound=AT_CAP * self.search.cap,
            message=message,
        )

    def _no_stop(self, sample: HomingSample) -> Finding:
        beyond = (sample.count - self.search.expected) * self.search.way
        message = "counts beyond where the stop should be, and no stop: wrong stop_rad, side or coarse zero?"
        return Finding(ReasonCode.STOP_NOT_FOUND, value=beyond, bound=self.search.margin, message=message)

    def _fail(self, finding: Finding) -> None:
        self.failed = finding
        self.phase = HomingPhase.FAILED
