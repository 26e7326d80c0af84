"""Table of the fleet for display, and as JSON for programs. Pure: no terminal, `now` is given."""

from collections.abc import Sequence
from typing import Any

from twind.bridge.fleet.fleet_roster import UPLINK, RobotRecord
from twind.ctl.dashboard.dashboard_blocks import STATES
from twind.ctl.dashboard.styled_lines import Line, Span, cut, line, wide

OLD = 3.0  # s after which a report counts as stale
COLUMNS = ("robot", "where", "mode", "state", "motion", "joints", "faults", "latency", "age")
_RIGHT = ("joints", "latency", "age")


def rows(robots: Sequence[RobotRecord], now: float, width: int) -> list[Line]:
    """Return a head and a line per robot, at most `width` wide; below them the faults by robot."""
    cells = [[(name, "title") for name in COLUMNS], *(_cells(each, now) for each in robots)]
    widths = [max(wide(row[place][0]) for row in cells) for place in range(len(COLUMNS))]
    table = [cut(_row(row, widths), width) for row in cells]
    wrong = [cut(line((f"{each.name}: ", "bad"), why), width) for each in robots if (why := _wrong(each))]
    return [*table, *([()] if wrong else []), *wrong]


def _wrong(robot: RobotRecord) -> str:
    return robot.lost or (f"its report cannot be decoded: {robot.odd}" if robot.odd else "")


def to_json(robot: RobotRecord, now: float) -> dict[str, Any]:
    """Return the same as JSON.

    `age_s`: s since the status was received; null: never yet. `odd`: why the robot's answer is invalid.
    """
    status = robot.status or {}
    age = robot.age(now)
    return {
        "name": robot.name,
        "where": robot.where or None,
        "lost": robot.lost or None,
        "odd": robot.odd or None,
        "age_s": None if age is None else round(age, 3),
        "mode": status.get("mode"),
        "state": status.get("state"),
        "motion": status.get("motion"),
        "armed": status.get("armed"),
        "heard": robot.answering,
        "joints": robot.joints,
        "faults": [fault["code"] for fault in status.get("faults") or ()],
        "latency_ms": status.get("latency_ms"),
        "way_ms": None if robot.way is None else round(robot.way * 1e3, 2),
    }


def _cells(robot: RobotRecord, now: float) -> list[Span]:
    age = robot.age(now)
    where = robot.where if robot.where in ("", UPLINK) else "here"
    silent = ("lost", "alarm") if robot.lost else ("odd", "warn") if robot.odd else ("no answer", "warn")
    if robot.status is None:
        unknown = [("-", "dim")] * 4
        return [(robot.name, ""), (where or "-", ""), ("-", ""), silent, *unknown, _age(age, robot)]
    status = robot.status
    old = bool(robot.lost or robot.odd) or age is None or age > OLD
    cells: list[Span] = [
        (str(status["mode"]), "title" if status["mode"] == "live" else ""),
        _state(str(status["state"]), status["mode"]),
        (str(status["motion"]), ""),
        _joints(robot),
        _faults(robot),
        ("-" if status["latency_ms"] is None else f"{status['latency_ms']:.1f} ms", ""),
    ]
    if old:  # a stale report must not look like the present state
        cells = [(text, "dim") for text, _ in cells]
        cells[1] = silent
    return [(robot.name, "dim" if old else ""), (where, "dim" if old else ""), *cells, _age(age, robot)]


def _state(state: str, mode: str) -> Span:
    """Return the state and its style; a simulated robot needs no device, so it is not disconnected."""
    if mode != "sim":
        return state, STATES.get(state, "")
    return ("simulated" if state == "disconnected" else state), ""


def _joints(robot: RobotRecord) -> Span:
    """Return answering joints of all ("11/12") and its style; "-" in sim, where no device answers."""
    if robot.answering is None or (robot.status or {}).get("mode") == "sim":
        return "-", ""
    return f"{robot.answering}/{robot.joints}", "" if robot.answering == robot.joints else "warn"


def _faults(robot: RobotRecord) -> Span:
    """Return the first fault, and the number of further ones."""
    codes = list(dict.fromkeys(fault["code"] for fault in (robot.status or {}).get("faults") or ()))
    if not codes:
        return "-", ""
    return codes[0] + (f" +{len(codes) - 1}" if len(codes) > 1 else ""), "bad"


def _age(age: float | None, robot: RobotRecord) -> Span:
    if age is None:
        return "-", "dim"
    text = f"{age:.1f} s" if age < 60.0 else f"{age / 60.0:.0f} min"
    return text, "bad" if robot.lost else "warn" if age > OLD else ""


def _row(cells: Sequence[Span], widths: Sequence[int]) -> Line:
    spans: list[Span] = []
    for name, (text, style), width in zip(COLUMNS, cells, widths, strict=True):
        room = " " * (width - wide(text))
        spans += [(room, ""), (text, style)] if name in _RIGHT else [(text, style), (room, "")]
        spans.append(("  ", ""))
    return line(*spans[:-1])
