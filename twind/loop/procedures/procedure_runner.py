"""Procedures: work over several ticks, as generators that are stepped once per tick.

One procedure at a time may own the torque; a more urgent one takes it over. Others (checks, register reads)
run beside it.
"""

from collections.abc import Callable, Generator, Iterable
from enum import IntEnum
from typing import Any

from twind.exceptions import TwindError
from twind.loop.bus.bus_port import ScriptRun
from twind.robot.finding import Finding, ReasonCode

Procedure = Generator[None, float, None]  # yields at the end of a tick, is sent the next tick's time


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


class ProcedureRunner:
    """Running procedures: at most one that owns the torque, and any number beside it."""

    def __init__(self) -> None:
        self._torque: Procedure | None = None
        self._rank: Priority | None = None
        self._others: list[Procedure] = []

    @property
    def rank(self) -> Priority | None:
        """Urgency of the procedure that owns the torque; None: no procedure owns it."""
        return self._rank

    def own(self, rank: Priority, start: Callable[[], Procedure]) -> bool:
        """Begin a procedure that owns the torque, ending a less urgent one; False if one as urgent runs."""
        if self._rank is not None and self._rank >= rank:
            return False
        self.abandon()
        body = start()
        self._torque = body
        self._rank = rank
        if not _first(body):
            self._torque = self._rank = None
        return True

    def beside(self, body: Procedure) -> None:
        """Begin a procedure that does not touch the torque."""
        if _first(body):
            self._others.append(body)

    def abandon(self) -> None:
        """End the procedure that owns the torque, at the step it has reached; it answers its caller."""
        body = self._torque
        self._torque = None
        self._rank = None
        if body is not None:
            body.close()

    def step(self, now: float) -> None:
        """Run one step of each procedure; `now` in s."""
        body = self._torque
        if body is not None and not _next(body, now) and self._torque is body:
            self._torque = self._rank = None
        if self._others:
            self._others = [other for other in self._others if _next(other, now)]


def _first(body: Procedure) -> bool:
    """Run to the first wait; False when it ended already."""
    try:
        next(body)
    except StopIteration:
        return False
    return True


def _next(body: Procedure, now: float) -> bool:
    try:
        body.send(now)
    except StopIteration:
        return False
    return True


def all_of(tasks: Iterable[ScriptRun[Any]]) -> Generator[None, float, None]:
    """Wait until every task is done; then raise the first error."""
    waiting = list(tasks)
    while not all(task.done for task in waiting):
        yield
    for task in waiting:
        if task.error is not None:
            raise task.error


def ticks(count: int) -> Generator[None, float, float]:
    """Wait `count` ticks; return the time of the last, s."""
    now = 0.0
    for _ in range(count):
        now = yield
    return now
