"""One drive: a pilot at its beat, from a connection that listens to one that sends. Knows no terminal."""

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from math import inf
from typing import Any

import numpy as np

from twind.client import ClientError, Refused
from twind.learn.live.control_timing import ControlClock, RateTimer, in_step
from twind.learn.live.setpoint_session import SetpointSession
from twind.learn.live.state_subscriber import StateSubscriber
from twind.learn.policy.policy_controller import PolicyController, PolicyEnd, PolicyHold, PolicySetpoint

SHOWN = 0.5  # s between two looks at the drive
SAID = 1.0  # s between two holds that are told
KEPT = 100_000  # steps whose times are kept: 33 minutes at 50 Hz
LAST = 5  # holds of which the reason is kept
ROUNDING = 1e-6  # s
RECENT = 250  # steps that the live line is about
# Who may drive at all: no state of the robot or the policy will change these.
FINAL = frozenset(
    {"LEASE_MISSING", "LEASE_LOST", "ESTOP", "ESTOP_LATCHED", "FAULT_LATCHED", "NOT_ARMED", "MODE_DENIES"}
)


def _times() -> deque[float]:
    return deque(maxlen=KEPT)


@dataclass(slots=True)
class PolicyRunLog:
    """What a drive was like. Times in s."""

    began: float = 0.0
    ended: float = 0.0
    late: deque[float] = field(default_factory=_times)  # after the deadline, of each period
    inference: deque[float] = field(default_factory=_times)
    way: deque[float] = field(
        default_factory=_times
    )  # from the tick that was seen until its setpoint is sent
    refusals: Counter[tuple[str, str]] = field(default_factory=Counter)  # by code and joint
    holds: deque[str] = field(default_factory=lambda: deque(maxlen=LAST))  # why, of the last ones

    def plain(self, pilot: PolicyController, beat: RateTimer | None, recent: int = KEPT) -> dict[str, Any]:
        """Figures as JSON; of the last `recent` steps where they are times, in ms."""
        seen = pilot.figures
        past = self.ended - self.began
        told: dict[str, Any] = {"seconds": round(past, 3), "steps": seen.steps}
        told["rate_hz"] = round(seen.steps / past, 2) if past > 0.0 else None
        told["missed"] = 0 if beat is None else beat.missed
        for name in ("late", "inference", "way"):
            told |= _spread(name, list(islice(reversed(getattr(self, name)), recent)))
        refusals: dict[str, dict[str, int]] = {}
        for (code, joint), count in self.refusals.items():
            refusals.setdefault(code, {})[joint] = count
        tilt = None if seen.tilt != seen.tilt else round(seen.tilt, 2)
        told |= {"refused": self.refusals.total(), "refusals": refusals, "holds": seen.holds}
        told |= {"held_s": round(seen.held, 3), "too_late": seen.too_late}
        return told | {
            "why_held": list(self.holds),
            "tilt_deg": tilt,
            "most_tilt_deg": round(seen.most_tilt, 2),
        }


def _spread(name: str, times: list[float]) -> dict[str, float | None]:
    values = np.array(times) * 1e3
    keys = (("p50", 0.5), ("p99", 0.99), ("max", 1.0))
    return {f"{name}_{key}_ms": round(float(np.quantile(values, q)), 4) if times else None for key, q in keys}


class PolicyRun:
    """Begun when the robot rests in the policy's default pose, and over with `run`."""

    def __init__(
        self,
        pilot: PolicyController,
        senses: StateSubscriber,
        reins: SetpointSession,
        period: float,
        loop: float,
        clock: ControlClock,
        say: Callable[[str], None],
    ) -> None:
        """`period`: s of control; `loop`: s of the daemon's loop; `say`: is told of holds."""
        self._clock = clock
        self._say = say
        self._pilot = pilot
        self._senses = senses
        self._reins = reins
        self._period = period
        self._loop = loop
        self._mode = senses.status["mode"]
        self.log = PolicyRunLog()
        self._told = -inf
        self.beat: RateTimer | None = None

    def run(
        self, seconds: float, stop: Callable[[], bool], tell: Callable[["PolicyRun"], None]
    ) -> tuple[bool, str]:
        """Until `seconds` have passed or `stop`; whether it ended as asked, and why."""
        self.log.began = self.log.ended = self._clock.now()
        try:
            states = self._senses.next_states()
            self._reins.take()  # where that took long, a lease has lapsed; nothing moves yet
            if not states:
                return False, self._end_reason() or "no states are heard"
            beat = self.beat = in_step(states, self._clock.now(), self._period, self._loop)
            return self._beats(beat, seconds, stop, tell)
        except ClientError as error:
            return False, str(error)
        finally:
            self.log.ended = self._clock.now()
            self._settle()

    def _settle(self) -> None:
        """What the gate said of the last setpoint counts too."""
        try:
            self._reins.settle()
        except Refused as refusal:
            self.log.refusals.update(_finding_joints(refusal))
        except ClientError:
            pass  # why the drive ended is known already

    def _beats(
        self, beat: RateTimer, seconds: float, stop: Callable[[], bool], tell: Callable[["PolicyRun"], None]
    ) -> tuple[bool, str]:
        log = self.log
        shown = 0.0
        log.began = beat.deadline
        while True:
            self._clock.sleep_until(beat.deadline)
            now = log.ended = self._clock.now()
            if stop() or now - log.began >= seconds - ROUNDING:
                return True, "stopped" if stop() else f"{seconds:g} s are over"
            why = self._end_reason()
            if why:
                return False, why
            log.late.append(now - beat.deadline)
            ended = self._step(beat.deadline)
            if ended is not None:
                return False, ended
            if now - shown >= SHOWN:
                shown = now
                tell(self)
            missed = beat.advance(self._clock.now())
            if missed:
                before = self._pilot.figures.holds
                self._pilot.record_missed_periods(missed, lapsed=self._reins.lapses(missed))
                self._note(before)

    def _step(self, deadline: float) -> str | None:
        """One period; why it is the last one, None: it is not."""
        before = self._pilot.figures.holds
        asked = self._pilot.step(self._senses.newest, deadline)
        done = self._send(asked) if isinstance(asked, PolicySetpoint) else asked
        self._note(before)
        if isinstance(done, PolicyHold):
            done = self._keep(done)
        return done.reason if isinstance(done, PolicyEnd) else None

    def _note(self, before: int) -> None:
        """A hold that has begun since there were `before`."""
        if self._pilot.figures.holds > before:
            self.log.holds.append(str(self._pilot.holding))
            self._report_hold(str(self._pilot.holding))

    def _report_hold(self, reason: str) -> None:
        """Holds that follow each other closely are counted, not told."""
        now = self._clock.now()
        if now - self._told >= SAID:
            self._told = now
            self._say(reason)

    def _keep(self, hold: PolicyHold) -> PolicyHold | PolicyEnd:
        try:
            self._reins.keep()
        except Refused as refusal:
            return self._handle_refusal(refusal)
        return hold

    def _send(self, setpoint: PolicySetpoint) -> PolicyHold | PolicyEnd | None:
        log = self.log
        seen = self._pilot.figures
        log.inference.append(seen.inference)
        before = self._clock.now()
        try:
            # After a hold the gate must have taken one before the drive goes on.
            self._reins.send(setpoint.position, setpoint.velocity, wait=self._pilot.holding is not None)
        except Refused as refusal:
            return self._handle_refusal(refusal)
        log.way.append(before - seen.source)
        self._pilot.record_acceptance()
        return None

    def _handle_refusal(self, refusal: Refused) -> PolicyHold | PolicyEnd:
        found = _finding_joints(refusal)
        self.log.refusals.update(found)
        if any(code in FINAL for code, _ in found):
            return PolicyEnd(f"refused: {refusal}")
        return self._pilot.hold(f"refused: {found[0][0]} {found[0][1]}".rstrip() if found else "refused")

    def _end_reason(self) -> str:
        """Why nobody drives this robot any more; "": somebody does."""
        if self._senses.ended:
            return self._senses.ended
        status = self._senses.status
        if status["mode"] != self._mode:
            return f"the mode is now {status['mode']}, it was {self._mode}"
        if self._mode == "live" and not status["armed"]:
            return f"the robot is no longer armed: {status['state']}{_first_fault(status)}"
        return ""


def _finding_joints(refusal: Refused) -> list[tuple[str, str]]:
    """Code and joint of each finding."""
    return [(str(each.get("code")), str(each.get("joint") or "")) for each in refusal.findings]


def _first_fault(status: Mapping[str, Any]) -> str:
    return "".join(f" ({each['code']}: {each['message']})" for each in status["faults"][:1])
