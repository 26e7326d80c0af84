"""Reports of streamers on themselves, for topic `stream` and the status. Front process only, not the loop.

A report belongs to the connection that it came on, so there are never more reports than connections.
"""

from collections.abc import Mapping
from typing import Any

from twind.front.daemon_log import printable
from twind.front.monitor_subscribers import SubscriberRegistry
from twind.front.state_cache import StateCache

TEXT = 200  # characters of each text that are kept
MOST_HZ = 1e6  # samples a second, upper bound of a report
MOST = 2**53  # of messages; beyond it JSON's readers round
COUNTS = ("sent", "waiting", "dropped", "dead", "failures")
SILENCE = 10.0  # s without another report after which a streamer counts as gone
GONE = "the streamer is gone"
HANGS = f"the streamer has sent no report for {SILENCE:g} s"


class StreamerReportCache:
    """The last report of each streamer."""

    def __init__(self, world: StateCache, telemetry: SubscriberRegistry) -> None:
        self._world = world
        self._telemetry = telemetry
        self._reports: dict[
            int, tuple[float, dict[str, object]]
        ] = {}  # connection -> time received (s), report

    def take(self, client: int, report: Mapping[str, Any], now: float) -> None:
        """A report, as the interface has it. Its texts reach terminals: short, no control characters."""
        kept = {key: _shorten(value) if isinstance(value, str) else value for key, value in report.items()}
        self._reports[client] = now, kept
        self._publish_report(kept, now)

    def forget(self, client: int, now: float, why: str = GONE) -> None:
        """Remove the report of a connection that ended."""
        last = self._reports.pop(client, None)
        if last is not None:
            self._publish_report({**last[1], "error": why}, now)

    def drop_silent(self, now: float) -> None:
        """Drop the streamers whose last report is older than `SILENCE` s: they hang."""
        for client in [client for client, (at, _) in self._reports.items() if now - at > SILENCE]:
            self.forget(client, now, HANGS)

    def _publish_report(self, report: dict[str, object], now: float) -> None:
        self._world.stream([kept for _, kept in self._reports.values()])
        self._telemetry.stream(report, now)


def find_invalid_number(report: Mapping[str, Any]) -> tuple[str, str] | None:
    """Return the first invalid number of a report, with the reason; None: all are valid."""
    if not 0.0 <= report["rate_hz"] <= MOST_HZ:
        return "rate_hz", f"0 to {MOST_HZ:.0f} samples a second"
    return next(((key, f"0 to {MOST} messages") for key in COUNTS if not 0 <= report[key] <= MOST), None)


def _shorten(text: str) -> str:
    return printable(text[:TEXT])[:TEXT]
