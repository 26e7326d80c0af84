"""What the loop says: answers to calls, and events for whoever watches. Everything leaves by the link."""

from collections.abc import Sequence
from math import isnan
from typing import Any

from twind import link
from twind.loop.front_link import ControlLink
from twind.robot.event_codes import AnyEventCode, EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.safety.latency_alarm import CALM, CALM_FOR, LatencyAlert
from twind_drivers.clock import Clock


class Responder:
    """Answers and events."""

    def __init__(self, out: ControlLink, clock: Clock) -> None:
        self._link = out
        self._clock = clock

    def reply(self, command: link.Command, *, continues: bool = False, **parameters: Any) -> None:
        """An answer to a call."""
        self._link.reply(link.Reply(ticket=command.ticket, parameters=parameters, continues=continues))

    def error(self, command: link.Command, error: str, /, **parameters: Any) -> None:
        """A call that failed: the interface's `error`."""
        self._link.reply(link.Reply(ticket=command.ticket, parameters=parameters, error=error))

    def refuse(self, command: link.Command, findings: Sequence[Finding]) -> None:
        """A call that the gate refused."""
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
    ) -> None:
        """Report an event. `message` is for people alone; programs read the other fields (`link.Event`)."""
        self._link.event(
            link.Event(
                time=self._clock.now(),
                sequence=self._link.sequence(),
                level=level,
                code=str(code),
                message=message,
                findings=list(findings),
                id=id,
                phase=phase,
                before=before,
                cause=cause,
                stop=stop,
            )
        )

    def slow(self, alert: LatencyAlert) -> None:
        """A hop became too slow, or has recovered."""
        if alert.calm:
            said = f"{alert.hop} is below {CALM * alert.bound * 1e3:g} ms again, for more than {CALM_FOR:g} s"
            if isnan(alert.value):
                said = f"{alert.hop} is not measured any longer: no robot is read"
            self.event("info", EventCode.LATENCY_CALM, said)
            return
        finding = Finding(
            ReasonCode.LATENCY_WARN, value=alert.value, bound=alert.bound, message=f"s, {alert.hop}"
        )
        self.event("warning", finding.code, f"{alert.hop} is above its threshold", (finding,))

    def mark(self, command: link.Mark, code: EventCode, message: str) -> None:
        """What a client says of what the robot is doing, as an event; the reply names it."""
        sequence = self._link.sequence()
        self._link.event(
            link.Event(
                time=self._clock.now(),
                sequence=sequence,
                level="info",
                code=str(code),
                message=message,
                annotation=command.annotation,
                holder=command.holder,
            )
        )
        self.reply(command, sequence=sequence)
