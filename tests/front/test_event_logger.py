"""Every event is a line; latency is reported every five seconds and not more often."""

import json
import os

from msgspec.structs import replace

from tests.support.loop_stand_in import NAMES, overview, tick
from twind.front.daemon_log import DaemonLog, LogWriter
from twind.front.event_logger import EventLogger
from twind.front.joint_naming import JointNames
from twind.link import Event, LatencyInfo
from twind.robot.finding import Finding, ReasonCode


class Lines:
    """A log whose lines can be read back."""

    def __init__(self) -> None:
        self._reader, self._writer = os.pipe()
        self.log = DaemonLog(LogWriter(self._writer), "info", journal=True)

    def read(self) -> list[dict[str, object]]:
        self.log.close()
        os.close(self._writer)
        with os.fdopen(self._reader) as text:
            return [json.loads(line[3:]) for line in text]


def test_an_event_is_a_line_with_its_first_finding_named() -> None:
    lines = Lines()
    findings = [Finding(ReasonCode.POS_LIMIT, 2, 1, value=2.0, bound=1.0)] * 3
    event = Event(
        time=1.0, sequence=1, level="warning", code="POS_LIMIT", message="refused x", findings=findings
    )
    EventLogger(lines.log).event(event, JointNames(NAMES))
    (line,) = lines.read()
    assert (line["event"], line["level"], line["message"]) == ("POS_LIMIT", "warning", "refused x")
    assert (line["finding"], line["more"]) == ("joint_2, point 1: position 2 rad, bound 1 rad", 2)


def test_latency_is_reported_every_five_seconds() -> None:
    lines = Lines()
    report = EventLogger(lines.log)
    for step in range(155):  # 15.4 s at 10 Hz, 99 Hz of ticks
        report.overview(overview(100.0 + step / 10.0, ticks=int(step * 9.9)), tick(0.0, 1))
    said = lines.read()
    assert [line["event"] for line in said] == ["latency"] * 3
    assert {line["hz"] for line in said} <= {98.8, 99.0, 99.2}
    assert (said[0]["bus_ms"], said[0]["state"], said[0]["late_p99_us"]) == (1.5, "armed", 80.0)


def test_command_hops_are_in_the_report_where_there_were_commands_and_violations_where_there_were_any() -> (
    None
):
    def hops(step: int) -> list[LatencyInfo]:
        at = 3.0 if step < 60 else None  # nobody commands any more
        return [
            LatencyInfo("total", 3.0, 3.0, 0.1, 2.9, 3.1, 3.0, 3.1, 4),
            LatencyInfo("command", at, 3.0, 0.1, 2.9, 3.1, 3.0, 3.1, 7),
        ]

    lines = Lines()
    report = EventLogger(lines.log)
    for step in range(105):
        news = replace(overview(100.0 + step / 10.0, ticks=step * 10), latencies=hops(step))
        report.overview(news, tick(0.0, 1))
    busy, idle = lines.read()
    assert (busy["command_ms"], busy["command_p99_ms"], busy["command_violations"]) == (3.0, 3.1, 7)
    assert not [key for key in idle if key.startswith("command")]
    assert idle["total_ms"] == 3.0
    assert "total_violations" not in busy  # they are the line's own


def test_client_annotations_are_logged_with_their_holder_and_rate_limited() -> None:
    lines = Lines()
    event = Event(time=1.0, sequence=1, level="info", code="NOTE", message="slips", holder="uid 1, pid 2")
    for _ in range(100):
        EventLogger(lines.log).event(event, JointNames(NAMES))
    EventLogger(lines.log).event(replace(event, code="MOTION", message="done", holder=""), JointNames(NAMES))
    said = lines.read()
    assert said[0]["holder"] == "uid 1, pid 2"
    assert [line["event"] for line in said] == ["NOTE"] * 20 + ["MOTION"]
