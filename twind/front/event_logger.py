"""Log lines of the loop's news: every event, and a report each five seconds. Front process."""

from collections.abc import Sequence
from typing import Any

from twind.front.daemon_log import DaemonLog
from twind.front.joint_naming import JointNames
from twind.link import Event, Overview, Tick
from twind.robot.event_codes import EventCode

EVERY = 5.0  # s between two latency reports (design 6.4)


class EventLogger:
    """Turns news into lines."""

    def __init__(self, log: DaemonLog) -> None:
        self._log = log
        self._last: Overview | None = None  # of the last report

    def event(
        self, event: Event, names: JointNames, buses: Sequence[str] = (), state: str | None = None
    ) -> None:
        """Write one line per event, with the first finding as text: joint, value, bound, reason.

        `buses`: the bus of each joint; `state`: of the robot.
        """
        found = names.findings(event.findings)
        spoken = found[0]["message"] if found and event.findings[0].message == event.message else None
        first = found[0]["message"] if found and spoken is None else None
        more = len(found) - 1 if len(found) > 1 else None
        fields = {"message": spoken or event.message, "finding": first, "more": more}
        kept = {key: value for key, value in fields.items() if value is not None}
        kept |= {"holder": event.holder} if event.holder else {}
        self._log.write(event.level, event.code, event.time, _details(event, names, buses, state), **kept)

    def overview(self, news: Overview, tick: Tick | None) -> None:
        """Write every five seconds: mode, state, rate, lateness, latency per hop."""
        last = self._last
        if tick is None or (last is not None and news.time < last.time + EVERY):
            return
        if last is not None:
            self._log.write("info", EventCode.LATENCY, news.time, **self._summary(news, last, tick))
        self._last = news

    @staticmethod
    def _summary(news: Overview, last: Overview, tick: Tick) -> dict[str, Any]:
        summary = {
            "mode": tick.mode,
            "state": tick.state,
            "motion": tick.motion,
            "hz": round((news.loop.ticks - last.loop.ticks) / (news.time - last.time), 1),
            "missed": news.loop.missed,
            "late_p99_us": news.loop.late_p99_us,
            "violations": news.violations,
        }
        for hop in news.latencies:
            if hop.now_ms is None:  # no recent value: hops of commands while none comes
                continue
            summary[f"{hop.hop}_ms"] = round(hop.now_ms, 3)
            summary[f"{hop.hop}_p99_ms"] = None if hop.p99_ms is None else round(hop.p99_ms, 3)
            if hop.violations and hop.hop != "total":
                summary[f"{hop.hop}_violations"] = hop.violations
        return {key: value for key, value in summary.items() if value is not None}


def _details(event: Event, names: JointNames, buses: Sequence[str], state: str | None) -> dict[str, object]:
    """Return the fields for programs: state, and code, joint, bus, value and bound of the first finding."""
    if not event.findings:
        return {"state": state}
    first = event.findings[0]
    joint = first.joint
    return {
        "state": state,
        "finding_code": first.code.value if first.code.value != event.code else None,
        "joint": names.name(joint),
        "bus": buses[joint] if joint is not None and 0 <= joint < len(buses) else None,
        "value": first.value,
        "bound": first.bound,
    }
