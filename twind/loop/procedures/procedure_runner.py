"""Procedures: work over several ticks, as generators that are stepped once per tick.

One procedure at a time may own the torque; a more urgent one takes it over. Others (checks, register reads)
run beside it. A procedure returns the outcome of its call, and the caller that began it replies. One that is
ended by force has the outcome `Busy`, with the cause.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from enum import IntEnum

from twind.exceptions import TwindError
from twind.loop.ipc.call_outcome import CallFailure, CallOutcome
from twind.robot.finding import Finding, ReasonCode

# yields at the end of a tick, is sent the next tick's time, returns the outcome of its call, if it has one
Procedure = Generator[None, float, CallOutcome | None]
Steps = Generator[None, float, None]  # part of a procedure
Ending = Callable[[CallOutcome | None], None]  # receives the outcome, once, however the procedure ends


class ProcedureFailed(TwindError):
    """Early end of arming or homing: torque goes off, and the finding gives the reason."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.message)
        self.finding = finding

    @classmethod
    def measured(
        cls, code: ReasonCode, value: float, bound: float, message: str, joint: int | None = None
    ) -> "ProcedureFailed":
        """Return the failure for a measured value and its bound."""
        return cls(Finding(code, joint, value=float(value), bound=float(bound), message=message))


class Priority(IntEnum):
    """Urgency of a procedure that owns the torque."""

    ARM = 1
    HOME = 2
    DISARM = 3
    FAULT = 4
    SHUTDOWN = 5
    ESTOP = 6
    CUT = 7


DOING = {Priority.ARM: "arming", Priority.HOME: "the end-stop search", Priority.DISARM: "disarming"}


def unanswered(_outcome: CallOutcome | None) -> None:
    """Ignore an outcome: no client waits for it."""


@dataclass(eq=False)
class RunningProcedure:
    """One procedure and the receiver of its outcome."""

    body: Procedure
    ended: Ending
    outcome: CallOutcome | None = None  # once it has ended by itself
    broken: bool = False  # a later step than the first raised an exception

    def begin(self) -> bool:
        """Run to the first wait; False when it ended already."""
        try:
            next(self.body)
        except StopIteration as stop:
            self.outcome = stop.value
            return False
        return True

    def step(self, now: float) -> bool:
        """Run to the next wait; False when it has ended."""
        try:
            self.body.send(now)
        except StopIteration as stop:
            self.outcome = CallFailure("Busy", {"what": "failed inside"}) if self.broken else stop.value
            return False
        except Exception:
            self.broken = True
            raise
        return True

    def finish(self, outcome: CallOutcome | None) -> None:
        """Pass the outcome to its receiver; later calls do nothing."""
        ended = self.ended
        self.ended = unanswered
        ended(outcome)


@dataclass(eq=False)
class TorqueOwner(RunningProcedure):
    """The procedure that owns the torque."""

    rank: Priority = field(kw_only=True)


class ProcedureRunner:
    """Running procedures: at most one that owns the torque, and any number beside it."""

    def __init__(self, cause: Callable[[], str] = str) -> None:
        """`cause`: returns the text of what is latched, which ends procedures; empty: nothing is."""
        self._cause = cause
        self._torque: TorqueOwner | None = None
        self._others: list[RunningProcedure] = []

    @property
    def rank(self) -> Priority | None:
        """Urgency of the procedure that owns the torque; None: no procedure owns it."""
        return None if self._torque is None else self._torque.rank

    def own(self, rank: Priority, start: Callable[[], Procedure], ended: Ending = unanswered) -> bool:
        """Begin a procedure that owns the torque, ending a less urgent one; False if one as urgent runs.

        `ended` receives its outcome, also when it is ended by force. A procedure whose first step raises an
        exception owns nothing: the caller receives the exception, and `ended` no outcome.
        """
        if self._torque is not None and self._torque.rank >= rank:
            return False
        self.abandon()
        owner = TorqueOwner(start(), ended, rank=rank)
        self._torque = owner
        try:
            goes_on = owner.begin()
        except Exception:
            self._torque = None
            raise
        if not goes_on:
            self._end(owner)
        return True

    def beside(self, body: Procedure, ended: Ending = unanswered) -> None:
        """Begin a procedure that does not touch the torque."""
        other = RunningProcedure(body, ended)
        if other.begin():
            self._others.append(other)
        else:
            other.finish(other.outcome)

    def abandon(self) -> None:
        """End the procedure that owns the torque by force, at the step it has reached.

        The only place that does so. Its outcome is `Busy`, with what is latched or "something more urgent".
        """
        owner = self._torque
        if owner is None:
            return
        doing = DOING.get(owner.rank, owner.rank.name.lower())
        self._torque = None
        owner.body.close()
        what = f"{doing} was ended by {self._cause() or 'something more urgent'}"
        owner.finish(CallFailure("Busy", {"what": what}))

    def step(self, now: float) -> None:
        """Run one step of each procedure; `now` in s."""
        owner = self._torque
        if owner is not None and not owner.step(now):
            self._end(owner)
        running = []
        for other in self._others:  # grows when one of them begins another
            if other.step(now):
                running.append(other)
            else:
                other.finish(other.outcome)
        self._others = running

    def _end(self, owner: TorqueOwner) -> None:
        """Process the end of `owner`. A running body cannot be ended, so it has begun no other owner."""
        self._torque = None
        owner.finish(owner.outcome)


def ticks(count: int) -> Generator[None, float, float]:
    """Wait `count` ticks, at least one; return the time of the last, s."""
    for _ in range(count - 1):
        yield
    return (yield)
