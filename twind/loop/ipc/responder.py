"""Replies to calls, and events for subscribers and the log. All leave by the link."""

from collections.abc import Mapping, Sequence
from math import isnan
from typing import Any

from twind import link
from twind.loop.ipc.call_outcome import CallFailure, CallOutcome, CallRefusal
from twind.loop.ipc.front_link import ControlLink
from twind.robot.event_codes import AnyEventCode, EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.safety.latency_alarm import CALM, CALM_FOR, LatencyAlert
from twind_drivers.clock import Clock


class Responder:
    """Sender of replies and events. `urgent`: the state changed, and its report cannot wait for 10 Hz."""

    def __init__(self, out: ControlLink, clock: Clock) -> None:
        self._link = out
        self._clock = clock
        self.urgent = True
        self._episode_open = False  # by the marks of clients

    def answer(self, command: link.Command, outcome: CallOutcome) -> None:
        """Send the outcome of a call."""
        if isinstance(outcome, CallRefusal):
            self.refuse(command, outcome.findings)
        elif isinstance(outcome, CallFailure):
            self.error(command, outcome.error, **outcome.parameters)
        else:
            self.reply(command, continues=outcome.continues, **outcome.parameters)

    def reply(self, command: link.Command, *, continues: bool = False, **parameters: Any) -> None:
        """Send a reply to a call."""
        self._link.reply(link.Reply(ticket=command.ticket, parameters=parameters, continues=continues))

    def error(self, command: link.Command, error: str, /, **parameters: Any) -> None:
        """Send the interface's `error` for a call that failed."""
        self._link.reply(link.Reply(ticket=command.ticket, parameters=parameters, error=error))

    def refuse(self, command: link.Command, findings: Sequence[Finding]) -> None:
        """Send the refusal of the gate for a call."""
        self.error(command, "Refused", findings=list(findings))

    def event(
        self,
        level: str,
        code: AnyEventCode,
        message: str,
        findings: Sequence[Finding] = (),
        *,
        id: str = "",
        phase: str = "",
        before: str = "",
        cause: str = "",
        stop: str = "",
        annotation: link.Annotation | None = None,
        holder: str = "",
    ) -> int:
        """Report an event; return its sequence number.

        `message` is for people alone; programs read the other fields (`link.Event`).
        """
        sequence = self._link.sequence()
        self._link.event(
            link.Event(
                time=self._clock.now(),
                sequence=sequence,
                level=level,
                code=str(code),
                message=message,
                findings=list(findings),
                id=id,
                phase=phase,
                before=before,
                cause=cause,
                stop=stop,
                annotation=annotation,
                holder=holder,
            )
        )
        return sequence

    def verdict(self, id: str, verdict: Mapping[str, Any], now: float, lead: float) -> None:
        """Report the verdict on a motion; `lead`: s of its lead-in."""
        sequence = self._link.sequence()
        self._link.event(
            link.VerdictReport(time=now, sequence=sequence, id=id, verdict=dict(verdict), lead=lead)
        )

    def slow(self, alert: LatencyAlert) -> None:
        """Report that a hop became too slow, or has recovered."""
        if alert.calm:
            message = (
                f"{alert.hop} is below {CALM * alert.bound * 1e3:g} ms again, for more than {CALM_FOR:g} s"
            )
            if isnan(alert.value):
                message = f"{alert.hop} is not measured any longer: no robot is read"
            self.event("info", EventCode.LATENCY_CALM, message)
            return
        finding = Finding(
            ReasonCode.LATENCY_WARN, value=alert.value, bound=alert.bound, message=f"s, {alert.hop}"
        )
        self.event("warning", finding.code, f"{alert.hop} is above its threshold", (finding,))

    def mark(self, command: link.Mark, code: AnyEventCode, message: str) -> None:
        """Send a client's annotation as an event; the reply gives its sequence number.

        That of an end also says whether an episode was open.
        """
        sequence = self.event("info", code, message, annotation=command.annotation, holder=command.holder)
        kind = command.annotation.kind
        was_open = {"was_open": self._episode_open} if kind == "end" else {}
        self.reply(command, sequence=sequence, **was_open)
        if kind != "note":
            self._episode_open = kind == "begin"
