"""Blocks of a picture: each makes rows of one subject, and knows which of them must catch the eye. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import acos, asin, atan2, degrees, hypot

from twind.ctl.dashboard.dashboard_state import Answer, DashboardNotice, DashboardState
from twind.ctl.dashboard.styled_lines import Line, Span, cut, fitting, length, line, wrapped
from twind.ctl.reasons import remedy
from twind.ctl.status_table import LOST, gap_text, state_text
from twind.robot.fall_settings import FallState

STALE = 100.0  # ms, of an IMU's reading
LABEL = 9  # columns of `loop     `
NEWEST = 5  # refusals beside everything else
STATES = {  # style of a robot's state; others are plain
    "armed": "good",
    "fault": "alarm",
    "estop": "alarm",
    "inhibited": "alarm",
    "disconnected": "warn",
    "settling": "warn",
    "arming": "warn",
    "calibrating": "warn",
}
_OUTCOMES = {True: ("success", "good"), False: ("FAILED", "warn"), None: ("ended", "")}
LEVELS = {"error": "bad", "warning": "warn", "refused": "warn", "debug": "dim"}


@dataclass(frozen=True, slots=True)
class DashboardRow:
    """One row. `urgent` rows are shown before the others where there is no room for all."""

    line: Line
    urgent: bool = False


@dataclass(frozen=True, slots=True)
class DashboardBlock:
    """One subject. `least`: lines, heads included, below which it is not shown at all."""

    name: str
    heads: Sequence[Line]
    rows: Sequence[DashboardRow]
    least: int
    scrolls: bool = False

    @property
    def full_height(self) -> int:
        """Number of lines that the block takes where there is room for all."""
        return len(self.heads) + len(self.rows)

    def shown(self, room: int, offset: int = 0) -> list[Line]:
        """As many lines as there is room for: urgent rows first, then the others from `offset` on."""
        if self.full_height <= room:
            return [*self.heads, *(row.line for row in self.rows)]
        places = max(0, room - len(self.heads) - 1)
        urgent = [row for row in self.rows if row.urgent][:places]
        others = [row for row in self.rows if not row.urgent]
        start = max(0, min(offset, len(others) - (places - len(urgent)))) if self.scrolls else 0
        rows = [*urgent, *others[start : start + places - len(urgent)]]
        hidden = len(self.rows) - len(rows)
        keys = ", up and down keys move" if self.scrolls else ""
        more = line((f"  … {hidden} more {self.name}{keys}", "dim"))
        return [*self.heads, *(row.line for row in rows), more][:room]


def header(view: DashboardState, width: int) -> Line:
    """Build the header line: robot name, mode, state and motion; the daemon's version at the right."""
    status = view.status
    if status is None:
        return line((" twind ", "head"), " waiting for messages of the daemon")
    state = status["state"]
    word = state_text(status["mode"], state).removeprefix("state ")
    style = STATES.get(state, "")
    style = "" if status["mode"] == "sim" and style == "warn" else style
    said: list[Span] = [
        (f" {status['robot']} ", "head"),
        (f" {status['mode'].upper()} ", "title"),
        (f" !! {state.upper()} !! " if style == "alarm" else f" {word} ", style),
        (f" {status['motion']}", ""),
    ]
    if status["inherited"]:
        said.append(("  ! torque was found on", "warn"))
    if status.get("fall") in (FallState.FALLING, FallState.FALLEN):
        said.append((f"  !! {status['fall']}", "alarm"))
    if view.lost:
        said.append((f"  ! {view.lost} news lost", "warn"))
    shown = cut(line(*said), width)
    version = f"twind {status['version']}"
    room = width - length(shown) - len(version)
    return (*shown, (" " * room + version, "dim")) if room > 1 else shown


def trouble(view: DashboardState, width: int) -> DashboardBlock:
    """No daemon, no news, latched faults with what to do, and warnings of ports."""
    rows: list[Line] = []
    if view.gone:
        said = f"no daemon since {ago(view.now - view.gone_since)}; its last state is below ({view.gone})"
        rows += wrapped(("!! ", "alarm"), said, "bad", width)
    elif view.news_at is not None and view.now - view.news_at > view.patience:
        rows += wrapped(("!! ", "alarm"), f"no news for {ago(view.now - view.news_at)}", "bad", width)
    status = view.status or {"faults": (), "buses": ()}
    for fault in status["faults"]:
        rows += wrapped((" FAULT ", "alarm"), f" {fault['code']}: {fault['message']}", "bad", width)
        rows += wrapped(("   do: ", "bad"), remedy(fault["code"]), "", width)
    for bus in status["buses"]:
        if bus.get("warning"):
            rows += wrapped(("  WARN ", "warn"), f" {bus['name']}: {bus['warning']}", "warn", width)
    return DashboardBlock("troubles", (), [DashboardRow(each) for each in rows], min(len(rows), 4))


def summary(view: DashboardState, width: int) -> DashboardBlock:
    """Lease, loop, latency: a line each."""
    status = view.status
    if status is None:
        return DashboardBlock("summary", (), (), 0)
    rows = [_labelled("lease", _lease(status, view), width), _labelled("loop", _loop(status), width)]
    rows.append(_labelled("latency", _latency(status), width))
    if view.imu is not None:
        rows.append(_labelled("imu", _imu(view.imu), width))
    gap = gap_text(status.get("gap"))
    if gap is not None:
        rows.append(_labelled("gap", [(gap, "")], width))
    return DashboardBlock("summary", (), [DashboardRow(each) for each in rows], len(rows))


def recorder(view: DashboardState, width: int) -> DashboardBlock:
    """Content of the flight recorder, the streamers, and the episode that runs or ran last."""
    rows = [_stream(told, width) for told in (view.status or {}).get("streams") or ()]
    flight = (view.status or {}).get("flight")
    if flight:
        last = flight.get("last")
        parts = [
            (f"holds {flight['span_s']:.0f} s, {flight['bytes'] / 1e6:.1f} MB", ""),
            (f"last file {last}" if last else "no file written yet", ""),
        ]
        rows.append(_labelled("flight", parts, width))
    for episode in view.episodes[:3]:
        until = view.now if episode.end is None else episode.end
        spent = ago(until - episode.begin)
        if episode.end is None:
            parts = [(f"{episode.task} runs for {spent}", "good")]
        else:
            label = _OUTCOMES[episode.success]
            parts = [(f"{episode.task}, {spent} long", ""), label, (f"{ago(view.now - episode.end)} ago", "")]
        rows.append(_labelled("episode", parts, width))
    return DashboardBlock("recorder", (), [DashboardRow(each) for each in rows], min(len(rows), 1))


def _stream(report: Answer, width: int) -> Line:
    """Build the line of one streamer, with problems first because a small terminal cuts the end of a line."""
    wrong = [(f"! {report['error']}", "warn")] if report["error"] else []
    lost = [(f"! {report[key]} {said}", "warn") for key, said in LOST[:2] if report[key]]
    counts = [
        (f"{report['rate_hz']:.0f} Hz", ""),
        (f"{report['sent']} sent, {report['waiting']} waiting", ""),
    ]
    return _labelled("stream", [*wrong, *lost, *counts, (report["endpoint"], "dim")], width)


def refusals(view: DashboardState, width: int) -> DashboardBlock:
    """The newest refusals of the gate and their reasons."""
    return _make_notice_block("refusals", "refused last", view.refusals, view.now, width)


def last_refusals(view: DashboardState, width: int) -> DashboardBlock:
    """The newest refusals."""
    return _make_notice_block("refusals", "refused last", view.refusals[:NEWEST], view.now, width)


def events(view: DashboardState, width: int) -> DashboardBlock:
    """The newest events."""
    return _make_notice_block("events", "events", view.events, view.now, width)


def titled(text: str, width: int) -> Line:
    """A rule with a title in it."""
    return cut(
        line(("── ", "dim"), (text, "title"), (" " + "─" * max(0, width - len(text) - 4), "dim")), width
    )


def ago(seconds: float) -> str:
    """3 s, 2 min, 5 h."""
    whole = max(0, int(seconds))
    return f"{whole} s" if whole < 120 else f"{whole // 60} min" if whole < 7200 else f"{whole // 3600} h"


def _make_notice_block(
    name: str, title: str, notices: Sequence[DashboardNotice], now: float, width: int
) -> DashboardBlock:
    rows = []
    for each in notices:
        when = f"{ago(now - each.at):>7} ago  "
        rows.append(DashboardRow(cut(line((when, "dim"), (each.text, LEVELS.get(each.level, ""))), width)))
    return DashboardBlock(name, (titled(title, width),) if rows else (), rows, 2 if rows else 0)


def _labelled(label: str, parts: Sequence[Span], width: int) -> Line:
    return fitting(parts, width, line((f"{label:<{LABEL}}", "dim")))


def _lease(status: Answer, view: DashboardState) -> list[Span]:
    lease = status["lease"]
    if lease is None:
        return [("free", "")]
    left = max(0.0, lease["expires_in"] - (view.now - (view.news_at or view.now)))
    return [(lease["holder"], "title"), (f"{left:.2f} s left", "")]


def _loop(status: Answer) -> list[Span]:
    loop = status["loop"]
    on_time = loop["on_time"]
    missed = loop["missed"]
    ticks = loop["ticks"]
    style = "good" if on_time >= 0.99 else "warn" if on_time >= 0.9 else "bad"
    sign = "" if on_time >= 0.99 else "! "
    late = [micro(loop[key]) for key in ("late_p50_us", "late_p99_us", "late_max_us")]
    policy = (loop.get("realtime") or {}).get("scheduler", "")
    denied = "scheduler" in (loop.get("realtime_denied") or ())
    share = f" ({missed / (missed + ticks):.2%})" if missed else ""
    return [
        (f"{loop['rate_hz']:g} Hz", ""),
        (f"{sign}on time {on_time:.0%} of the last 100", style),
        (f"missed {missed}{share}", "warn" if missed else ""),
        (f"late p50/p99/max {'/'.join(late)} µs", ""),
        (f"! {policy}" if denied else policy, "warn" if denied else ""),
    ]


def _latency(status: Answer) -> list[Span]:
    violations = status["violations"]
    skew = status.get("skew_ms")
    return [
        (f"now {milli(status['latency_ms'])} ms", ""),
        (f"mean {milli(status['latency_avg_ms'])}, max {milli(status['latency_max_ms'])} ms", ""),
        (f"{'! ' if violations else ''}violations {violations}", "warn" if violations else ""),
        ("" if skew is None else f"between buses {skew:.1f} ms", "dim"),
    ]


def _imu(imu: Answer) -> list[Span]:
    """Tilt of the base and its direction, what the IMU measures, and the age of the reading.

    Readings from before an interruption are not shown.
    """
    if imu["age_ms"] > STALE:
        return [(f"! silent for {ago(imu['age_ms'] / 1e3)}: how it leans is not known", "warn")]
    w, x, y, z = imu["quaternion"]
    lean = degrees(acos(min(1.0, max(-1.0, 1.0 - 2.0 * (x * x + y * y)))))
    pitch = degrees(asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x)))))
    roll = degrees(atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
    return [
        (f"leans {lean:.1f}°", ""),
        (f"roll {roll:+.1f}°, pitch {pitch:+.1f}°", ""),
        (f"{hypot(*imu['acceleration']):.2f} m/s², {hypot(*imu['gyro']):.2f} rad/s", "dim"),
        (f"{imu['age_ms']:.0f} ms old", "dim"),
    ]


def milli(value: float | None, digits: int = 1) -> str:
    """A number, or a dash."""
    return "-" if value is None else f"{value:.{digits}f}"


def micro(value: float | None) -> str:
    """A whole number, or a dash."""
    return "-" if value is None else f"{value:.0f}"
