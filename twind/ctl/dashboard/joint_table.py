"""The table of joints: a row each, what is wrong in colour and in words. Pure.

Columns that have no room are dropped in this order: verified, V, N·m, ms, rad/s, torque, commanded, from
outside, °C. The torque from outside has a column only where the daemon estimates it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import nan

from twind.ctl.dashboard.dashboard_blocks import DashboardBlock, DashboardRow
from twind.ctl.dashboard.dashboard_state import Answer, DashboardState, DisplayThresholds, followed
from twind.ctl.dashboard.styled_lines import Span, align_left, cut, line, right

# rad from the goal: half of where FOLLOW_ERR begins, and where it does
OFF = 0.1
FAR = 0.2
# ms without a reply: where an armed robot is warned of, and where it holds
OLD = 30.0
STALE = 100.0
# columns: of names at most, of notes at least
NAME = 16
NOTES = 10
EVERYTHING = 100  # columns from which titles are whole words
_UNKNOWN = DisplayThresholds(nan, nan, nan, nan, nan, nan)
_Cell = Callable[[Answer, DisplayThresholds], Span]
_Shown = tuple[str, int, _Cell]


@dataclass(frozen=True, slots=True)
class _TableColumn:
    title: str
    width: int
    short: str  # title and width where there is little room
    narrow: int
    cell: _Cell
    rank: int  # the highest is dropped first; 0: never


@dataclass(frozen=True, slots=True)
class _JointColumns:
    """Conditions that select the checks of a joint's row.

    Torque is checked where the robot is armed, calibration where there is a robot (mode is not sim).
    """

    armed: bool
    robot: bool
    mode: str


def joints(view: DashboardState, width: int) -> DashboardBlock:
    """All joints; those that need a look are urgent."""
    if not view.joints:
        return DashboardBlock("joints", (), (), 0)
    name = min(NAME, max(5, *(len(joint["name"]) for joint in view.joints)))
    status = view.status or {"armed": False, "mode": ""}
    looks = _JointColumns(armed=status["armed"], robot=status["mode"] != "sim", mode=status["mode"])
    estimated = any(joint.get("external_nm") is not None for joint in view.joints)
    columns = _columns(width, width - name - 2 - NOTES, estimated=estimated)
    titles = [right(title, size) for title, size, _ in columns]
    head = line((f"  {align_left('joint', name)}{''.join(titles)}  notes", "dim"))
    rows = [_row(joint, view.bounds, columns, name, width, looks) for joint in view.joints]
    return DashboardBlock("joints", (cut(head, width),), rows, min(1 + len(rows), 10), scrolls=True)


def _row(
    joint: Answer,
    bounds: Mapping[str, DisplayThresholds],
    columns: Sequence[_Shown],
    name: int,
    width: int,
    looks: _JointColumns,
) -> DashboardRow:
    known = bounds.get(joint["name"], _UNKNOWN)
    told = {**joint, "followed": followed(joint, looks.mode)}
    cells = [(size, *cell(told, known)) for _, size, cell in columns]
    notes = _notes(joint, known, looks)
    worst = _worst([*(style for _, _, style in cells), *(style for _, style in notes)])
    mark: Span = {"bad": ("! ", "bad"), "warn": ("? ", "warn")}.get(worst, ("  ", ""))
    spans: list[Span] = [mark, (align_left(joint["name"], name), worst if worst == "bad" else "")]
    spans += [(right(text, size), style) for size, text, style in cells]
    for place, (text, style) in enumerate(notes):
        spans.append((", " if place else "  ", ""))
        spans.append((text, style))
    return DashboardRow(cut(line(*spans), width), urgent=worst in ("bad", "warn"))


def _worst(styles: Sequence[str]) -> str:
    return next((style for style in ("bad", "warn") if style in styles), "")


def _columns(width: int, room: int, *, estimated: bool) -> list[_Shown]:
    """Title, width and cell of columns that have room; `estimated`: torque from outside is known."""
    roomy = width >= EVERYTHING
    kept = [each for each in _COLUMNS if estimated or each is not _OUTSIDE]
    while len(kept) > 2 and sum(each.width if roomy else each.narrow for each in kept) > room:
        kept.remove(max(kept, key=lambda each: each.rank))
    return [
        (each.title, each.width, each.cell) if roomy else (each.short, each.narrow, each.cell)
        for each in kept
    ]


def _notes(joint: Answer, known: DisplayThresholds, looks: _JointColumns) -> list[Span]:
    """Conditions of a joint in words."""
    notes: list[Span] = [] if joint["heard"] else [("SILENT", "bad")]
    if looks.armed and joint["torque"] is False:
        notes.append(("LIMP", "bad"))
    position = joint["position"]
    heat = joint["temperature"]
    volt = joint["voltage"]
    if position is not None and (position < known.lower or position > known.upper):
        notes.append(("PAST LIMIT", "bad"))
    if heat is not None and heat >= known.warm:
        notes.append(("HOT", "bad") if heat >= known.hot else ("warm", "warn"))
    if volt is not None and volt <= known.low:
        notes.append(("SUPPLY LOW", "bad") if volt <= known.flat else ("supply low", "warn"))
    notes += [(fault, "bad") for fault in joint["faults"]]
    if joint.get("contact"):
        notes.append(("contact", "warn"))
    if looks.robot and not joint["calibrated"]:
        notes.append(("uncalibrated", "warn"))
    elif joint.get("verified") is False:
        notes.append(("unverified", "warn"))
    return notes


def _number(key: str, digits: int) -> _Cell:
    def cell(joint: Answer, _known: DisplayThresholds) -> Span:
        value = joint[key]
        return ("-" if value is None else f"{round(value, digits) + 0.0:.{digits}f}", "")

    return cell


def _error(joint: Answer, _known: DisplayThresholds) -> Span:
    goal = joint["goal"]
    place = joint["followed"]
    if goal is None or place is None:
        return "-", ""
    error = goal - place
    style = "bad" if abs(error) >= FAR else "warn" if abs(error) >= OFF else ""
    return f"{round(error, 3) + 0.0:+.3f}", style


def _heat(joint: Answer, known: DisplayThresholds) -> Span:
    value = joint["temperature"]
    if value is None:
        return "-", ""
    return f"{value:.0f}", "bad" if value >= known.hot else "warn" if value >= known.warm else ""


def _supply(joint: Answer, known: DisplayThresholds) -> Span:
    value = joint["voltage"]
    if value is None:
        return "-", ""
    return f"{value:.1f}", "bad" if value <= known.flat else "warn" if value <= known.low else ""


def _age(joint: Answer, _known: DisplayThresholds) -> Span:
    value = joint["age_ms"]
    if value is None:
        return "-", ""
    text = f"{value:.0f}" if value < 10_000 else "long"
    return text, "bad" if value >= STALE else "warn" if value >= OLD else ""


def _outside(joint: Answer, _known: DisplayThresholds) -> Span:
    value = joint.get("external_nm")
    text = "-" if value is None else f"{round(value, 2) + 0.0:+.2f}"
    return text, "warn" if joint.get("contact") else ""


def _torque(joint: Answer, _known: DisplayThresholds) -> Span:
    torque: bool | None = joint["torque"]
    return ("-", "") if torque is None else ("on", "") if torque else ("off", "dim")


def _verified(joint: Answer, _known: DisplayThresholds) -> Span:
    verified = joint.get("verified")
    return ("-", "") if verified is None else ("yes", "") if verified else ("NO", "warn")


_OUTSIDE = _TableColumn("outside", 9, "ext", 7, _outside, 2)
_COLUMNS = (
    _TableColumn("commanded", 10, "goal", 8, _number("goal", 3), 3),
    _TableColumn("measured", 9, "is", 8, _number("position", 3), 0),
    _TableColumn("error", 8, "error", 7, _error, 0),
    _TableColumn("rad/s", 7, "rad/s", 6, _number("velocity", 2), 5),
    _TableColumn("N·m", 7, "N·m", 6, _number("effort", 2), 7),
    _OUTSIDE,
    _TableColumn("°C", 4, "°C", 4, _heat, 1),
    _TableColumn("V", 6, "V", 5, _supply, 8),
    _TableColumn("ms", 5, "ms", 5, _age, 6),
    _TableColumn("torque", 7, "trq", 4, _torque, 4),
    _TableColumn("verified", 9, "ver", 4, _verified, 9),
)
