"""Mode, state and latches of the robot. Only `change`, `latch` and `acknowledge` change the last two."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from twind.loop.ipc.responder import Responder
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, RobotState
from twind.safety.state_machine import TABLE, RobotEvent, StateLatch


class RobotCondition:
    """State of the robot and its bus, and why it may not move. Each change is reported."""

    def __init__(self, mode: Mode, reports: Responder) -> None:
        self.mode = mode
        self.unreachable: Finding | None = None  # why no new client can connect; None: clients can
        self.stop_wanted = False  # SIGTERM: lower the robot, then end
        self.finished = False  # the loop ends after this tick
        self._reports = reports
        self._latch = StateLatch()
        self._latches: dict[ReasonCode, Finding] = {}
        self.latches: Mapping[ReasonCode, Finding] = MappingProxyType(self._latches)  # oldest first

    @property
    def state(self) -> RobotState:
        """State of the robot and its bus."""
        return self._latch.state

    @property
    def latched(self) -> bool:
        """True from a fault or e-stop until a reset, also while its port is away."""
        return self._latch.latched

    @property
    def identified(self) -> bool:
        """The buses are open and all their devices identified."""
        return self._latch.identified

    @property
    def cause(self) -> str:
        """Text of the first latched finding; empty: none is latched."""
        return next((f"{each.code}: {each.message}" for each in self.latches.values()), "")

    def change(self, event: RobotEvent, *, stop: str = "") -> None:
        """Apply an event to the state and report a change. `stop`: as in `link.Event`.

        Raises RuntimeError where the state does not allow it.
        """
        before = self.state
        self._latch = self._latch.after(event)
        if self.state is not before:
            self._reports.urgent = True
            message = f"{before.value} → {self.state.value} ({event.value})"
            cause = event.name.lower()
            self._reports.event("info", self.state, message, before=before.value, cause=cause, stop=stop)

    def change_if(self, event: RobotEvent) -> None:
        """Apply an event where the state allows it; torque off must not depend on the state."""
        if self.state in TABLE[event]:
            self.change(event)

    def latch(self, finding: Finding) -> None:
        """Keep a fault until an operator acknowledges it: the first of its code, or the same with a value."""
        first = self._latches.get(finding.code)
        if first is None or (first.joint == finding.joint and first.value is None):
            self._latches[finding.code] = finding
            self._reports.urgent = True

    def acknowledge(self, codes: Iterable[str]) -> None:
        """Drop the latched findings of these codes."""
        for code in set(codes):
            self._latches.pop(ReasonCode(code), None)
