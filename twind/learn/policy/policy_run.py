"""One drive of a policy: states from one connection, setpoints to another, in time. Knows no terminal."""

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from math import inf
from typing import Any

import numpy as np

from twind.client import ClientError, Refused
from twind.learn.live.setpoint_session import SetpointSession
from twind.learn.policy.policy_controller import NoSetpoint, PolicyController, PolicyEnd, PolicySetpoint
from twind.robot_client.control_timing import RateTimer, in_step
from twind.robot_client.state_subscriber import StateSubscriber
from twind_drivers.clock import Clock

SHOWN = 0.5  # s between two reports of the figures
HOLD_PERIOD = 1.0  # s between two reports of a hold
KEPT = 100_000  # steps whose times are kept: 33 minutes at 50 Hz
LAST = 5  # holds of which the reason is kept
ROUNDING = 1e-6  # s
RECENT = 250  # steps that the live line is about
# Refusals that no later state of the robot or the policy changes.
FINAL = frozenset(
    {"LEASE_MISSING", "LEASE_LOST", "ESTOP", "ESTOP_LATCHED", "FAULT_LATCHED", "NOT_ARMED", "MODE_DENIES"}
)


def _times() -> deque[float]:
    return deque(maxlen=KEPT)


@dataclass(slots=True)
class PolicyRunLog:
    """Figures of a drive. Times in s."""

    began: float = 0.0
    ended: float = 0.0
    late: deque[float] = field(default_factory=_times)  # after the deadline, of each period
    inference: deque[float] = field(default_factory=_times)
    way: deque[float] = field(
        default_factory=_times
    )  # from the tick that was seen until its setpoint is sent
    refusals: Counter[tuple[str, str]] = field(default_factory=Counter)  # by code and joint
    holds: deque[str] = field(default_factory=lambda: deque(maxlen=LAST))  # why, of the last ones

    def plain(
        self, controller: PolicyController, timer: RateTimer | None, recent: int = KEPT
    ) -> dict[str, object]:
        """Return the figures as JSON; of the last `recent` steps where they are times, in ms."""
        seen = controller.figures
        past = self.ended - self.began
        figures: dict[str, object] = {"seconds": round(past, 3), "steps": seen.steps}
        figures["rate_hz"] = round(seen.steps / past, 2) if past > 0.0 else None
        figures["return_per_step"] = round(seen.returned / seen.judged, 4) if seen.judged else None
        figures["missed"] = 0 if timer is None else timer.missed
        for name in ("late", "inference", "way"):
            figures |= _spread(name, list(islice(reversed(getattr(self, name)), recent)))
        refusals: dict[str, dict[str, int]] = {}
        for (code, joint), count in self.refusals.items():
            refusals.setdefault(code, {})[joint] = count
        tilt = None if seen.tilt != seen.tilt else round(seen.tilt, 2)
        figures |= {"refused": self.refusals.total(), "refusals": refusals, "holds": seen.holds}
        figures |= {"held_s": round(seen.held, 3), "too_late": seen.too_late}
        return figures | {
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
        controller: PolicyController,
        subscriber: StateSubscriber,
        session: SetpointSession,
        period: float,
        loop: float,
        clock: Clock,
        print_reason: Callable[[str], None],
    ) -> None:
        """`period`: s of control; `loop`: s of the daemon's; `print_reason`: gets the reason of a hold."""
        self._clock = clock
        self._print_reason = print_reason
        self._controller = controller
        self._subscriber = subscriber
        self._session = session
        self._period = period
        self._loop = loop
        self._mode = subscriber.status["mode"]
        self.log = PolicyRunLog()
        self._hold_reported = -inf
        self.timer: RateTimer | None = None

    def run(
        self, seconds: float, stop: Callable[[], bool], tell: Callable[["PolicyRun"], None]
    ) -> tuple[bool, str]:
        """Drive until `seconds` have passed or `stop`. Return whether it ended as asked, and why."""
        self.log.began = self.log.ended = self._clock.now()
        try:
            states = self._subscriber.next_states()
            self._session.take()  # where that took long, a lease has lapsed; nothing moves yet
            if not states:
                return False, self._end_reason() or "no states are received"
            timer = self.timer = in_step(states, self._clock.now(), self._period, self._loop)
            return self._run_periods(timer, seconds, stop, tell)
        except ClientError as error:
            return False, str(error)
        finally:
            self.log.ended = self._clock.now()
            self._settle()

    def _settle(self) -> None:
        """Count the gate's answer to the last setpoint too."""
        try:
            self._session.settle()
        except Refused as refusal:
            self.log.refusals.update(_finding_joints(refusal))
        except ClientError:
            pass  # why the drive ended is known already

    def _run_periods(
        self, timer: RateTimer, seconds: float, stop: Callable[[], bool], tell: Callable[["PolicyRun"], None]
    ) -> tuple[bool, str]:
        log = self.log
        shown = 0.0
        log.began = timer.deadline
        while True:
            self._clock.sleep_until(timer.deadline)
            now = log.ended = self._clock.now()
            if stop() or now - log.began >= seconds - ROUNDING:
                return True, "stopped" if stop() else f"{seconds:g} s are over"
            why = self._end_reason()
            if why:
                return False, why
            log.late.append(now - timer.deadline)
            ended = self._step(timer.deadline)
            if ended is not None:
                return False, ended
            if now - shown >= SHOWN:
                shown = now
                tell(self)
            missed = timer.advance(self._clock.now())
            if missed:
                before = self._controller.figures.holds
                self._controller.record_missed_periods(missed, lapsed=self._session.lapses(missed))
                self._note(before)

    def _step(self, deadline: float) -> str | None:
        """One period; why it is the last one, None: it is not."""
        before = self._controller.figures.holds
        asked = self._controller.step(self._subscriber.newest, deadline)
        done = self._send(asked) if isinstance(asked, PolicySetpoint) else asked
        self._note(before)
        if isinstance(done, NoSetpoint):
            done = self._keep(done)
        return done.reason if isinstance(done, PolicyEnd) else None

    def _note(self, before: int) -> None:
        """Report a hold that has begun since there were `before`."""
        if self._controller.figures.holds > before:
            self.log.holds.append(str(self._controller.holding))
            self._report_hold(str(self._controller.holding))

    def _report_hold(self, reason: str) -> None:
        """Report a hold, unless one was reported within the last second."""
        now = self._clock.now()
        if now - self._hold_reported >= HOLD_PERIOD:
            self._hold_reported = now
            self._print_reason(reason)

    def _keep(self, hold: NoSetpoint) -> NoSetpoint | PolicyEnd:
        try:
            self._session.keep()
        except Refused as refusal:
            return self._handle_refusal(refusal)
        return hold

    def _send(self, setpoint: PolicySetpoint) -> NoSetpoint | PolicyEnd | None:
        log = self.log
        seen = self._controller.figures
        log.inference.append(seen.inference)
        before = self._clock.now()
        try:
            # After a hold the gate must have taken one before the drive goes on.
            self._session.send(
                setpoint.position, setpoint.velocity, wait=self._controller.holding is not None
            )
        except Refused as refusal:
            return self._handle_refusal(refusal)
        log.way.append(before - seen.source)
        self._controller.record_acceptance()
        return None

    def _handle_refusal(self, refusal: Refused) -> NoSetpoint | PolicyEnd:
        found = _finding_joints(refusal)
        self.log.refusals.update(found)
        if any(code in FINAL for code, _ in found):
            return PolicyEnd(f"refused: {refusal}")
        return self._controller.hold(f"refused: {found[0][0]} {found[0][1]}".rstrip() if found else "refused")

    def _end_reason(self) -> str:
        """Return why the drive cannot go on; "": it can."""
        if self._subscriber.ended:
            return self._subscriber.ended
        status = self._subscriber.status
        if status["mode"] != self._mode:
            return f"the mode is now {status['mode']}, it was {self._mode}"
        if self._mode == "live" and not status["armed"]:
            return f"the robot is no longer armed: {status['state']}{_first_fault(status)}"
        return ""


def _finding_joints(refusal: Refused) -> list[tuple[str, str]]:
    """Return code and joint of each finding."""
    return [(str(each.get("code")), str(each.get("joint") or "")) for each in refusal.findings]


def _first_fault(status: Mapping[str, Any]) -> str:
    return "".join(f" ({each['code']}: {each['message']})" for each in status["faults"][:1])
