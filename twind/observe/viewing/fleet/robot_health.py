"""Health of a robot as one word with a colour, and as a line of text. Pure."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from twind.observe.viewing import status_html
from twind.observe.viewing.viewer_state import Message, ViewerSnapshot


class HealthLevel(StrEnum):
    """The most urgent first."""

    STOPPED = "e-stop"
    FAULT = "fault"
    LOST = "lost"  # nothing comes from it
    ODD = "odd"  # its messages are unreadable
    OLD = "old"  # it is there, but sent no joints lately
    WARNED = "warned"
    MOVING = "moving"
    WELL = "well"


COLOURS = {
    HealthLevel.STOPPED: status_html.RED,
    HealthLevel.FAULT: status_html.RED,
    HealthLevel.LOST: status_html.GREY,
    HealthLevel.ODD: status_html.GREY,
    HealthLevel.OLD: status_html.GREY,
    HealthLevel.WARNED: status_html.AMBER,
    HealthLevel.MOVING: "#2563eb",
    HealthLevel.WELL: status_html.GREEN,
}
PUNCTUAL = 0.99  # of the ticks: a loop with fewer on time is reported
GREY = (HealthLevel.LOST, HealthLevel.ODD, HealthLevel.OLD)  # its drawing is not current


@dataclass(frozen=True, slots=True)
class RobotHealth:
    """Health of one robot: its level, and a line of text."""

    kind: HealthLevel
    said: str

    @property
    def colour(self) -> str:
        """Colour of the level, in HTML notation."""
        return COLOURS[self.kind]


def standing(now: ViewerSnapshot) -> RobotHealth:
    """Return the health of a robot from the snapshot known so far."""
    status = now.status
    if now.lost is not None:
        return RobotHealth(HealthLevel.LOST, "lost" if status is not None else "not reached")
    if status is None or now.age is None:
        return RobotHealth(HealthLevel.LOST, "no message yet")
    if now.age >= status_html.OLD:
        return RobotHealth(HealthLevel.OLD, f"no message for {now.age:.0f} s")
    said = _format_status(status)
    if status["state"] == "estop":
        return RobotHealth(HealthLevel.STOPPED, said)
    if status["state"] in ("fault", "inhibited") or status["faults"]:
        return RobotHealth(HealthLevel.FAULT, said)
    if not _is_healthy(now, status):
        return RobotHealth(HealthLevel.WARNED, said)
    return RobotHealth(
        HealthLevel.MOVING if status["motion"] in ("active", "streaming") else HealthLevel.WELL, said
    )


def described(now: ViewerSnapshot, problem: str) -> tuple[RobotHealth, str]:
    """Return the health and `page` of a robot, whatever it sends: a robot of another version must not disturb
    the others."""
    try:
        how = standing(now)
        return how, page(now, how, problem)
    except Exception as error:  # noqa: BLE001
        how = RobotHealth(HealthLevel.ODD, f"a message is unreadable: {type(error).__name__}: {error}")
        return how, status_html.block([status_html.row("state", how.said, how.colour)])


def _format_status(status: Message) -> str:
    """Return mode, state and motion as text. In sim the robot is always disconnected, so that state is left
    out."""
    mode = str(status["mode"])
    state = str(status["state"])
    states = [] if (mode, state) == ("sim", "disconnected") else [state]
    return ", ".join([mode, *states, str(status["motion"])])


def _is_healthy(now: ViewerSnapshot, status: Message) -> bool:
    """Check that all buses are connected, and every joint answers with a new value and without a fault."""
    told = now.joints
    assert told is not None
    if status["mode"] != "sim" and not all(bus["connected"] for bus in status["buses"]):
        return False
    return bool(told.heard.all()) and not now.stale.any() and not any(told.faults)


def summary(standings: Iterable[RobotHealth]) -> str:
    """Return the number of robots at each health level, as HTML."""
    found = Counter(each.kind for each in standings)
    told = [
        f'<span style="color:{COLOURS[kind]};font-weight:600">{found[kind]} {kind}</span>'
        for kind in HealthLevel
        if found[kind]
    ]
    return status_html.block(
        [", ".join(told) or status_html.row("robots", "none was found yet", status_html.AMBER)]
    )


def page(now: ViewerSnapshot, how: RobotHealth, problem: str) -> str:
    """One robot in words, as HTML. `problem`: why it is not drawn."""
    rows = [status_html.row("state", how.said, how.colour)]
    if now.lost is not None:
        rows.append(status_html.row("now", now.lost, status_html.RED))
    if problem:
        rows.append(status_html.row("picture", problem, status_html.RED))
    if now.status is not None and how.kind in GREY:
        rows.append(status_html.row("last state", _format_status(now.status), status_html.GREY))
    rows += _status(now.status) if now.status is not None else []
    if now.joints is not None and now.told is not None and how.kind not in GREY:
        names = [str(joint["name"]) for joint in now.told["robot"]["joints"]]
        if len(names) == len(now.joints.heard):
            rows.append(status_html.row("joints", f"{int(now.joints.heard.sum())} of {len(names)} heard"))
            rows += status_html.joints(now, names)
        rows += status_html.events(now)[:1]
    return status_html.block(rows)


def _status(status: Message) -> list[str]:
    """Build the HTML rows worth a line where many robots are shown: faults, the lease holder, a late loop."""
    lease = status["lease"]
    loop = status["loop"]
    rows = [
        status_html.row("fault", f"{each['code']}: {each['message']}", status_html.RED)
        for each in status["faults"]
    ]
    if lease is not None:
        rows.append(status_html.row("lease", str(lease["holder"])))
    if not loop["on_time"] >= PUNCTUAL:
        late = f"{loop['rate_hz']:g} Hz, {loop['on_time']:.1%} of the ticks on time"
        rows.append(status_html.row("loop", late, status_html.AMBER))
    return rows
