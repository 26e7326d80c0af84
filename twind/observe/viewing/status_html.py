"""Texts of the viewer, as HTML. All data from outside is escaped: a client chooses its own name.

Pure: no browser, no clock.
"""

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from twind.observe.viewing.robot_model import NearestBodies, RobotModel
from twind.observe.viewing.viewer_state import Message, ViewerSnapshot

# the page's style has the lighter ones of its dark scheme
RED, AMBER, GREEN, GREY, PURPLE, CYAN = (
    f"var(--tw-{name}, {colour})"
    for name, colour in (
        ("red", "#c81e1e"),
        ("amber", "#b86e00"),
        ("green", "#1a7f37"),
        ("grey", "#6b7280"),
        ("purple", "#be00be"),
        ("cyan", "#0e7490"),
    )
)


def rgb_of(colour: str) -> tuple[int, int, int]:
    """Return a colour of the page, `#rrggbb` or a variable with that as its default, for the 3D scene."""
    red, green, blue = bytes.fromhex(colour.rpartition("#")[2][:6])
    return red, green, blue


LEVELS = {"error": RED, "warning": AMBER}
OLD = 1.0  # s without news of joints after which the picture is called old
NAMED = 6  # joints that are named before the rest are counted
BASES = {
    "fixed": "fixed where the model has it",
    "gantry": "hung up, drawn where the model has it",
    "free": "free; nothing measures it, so it is drawn where the model has it",
}


def page(now: ViewerSnapshot, model: RobotModel | None, near: NearestBodies | None, contacts: int) -> str:
    """Build all rows, the most urgent first."""
    rows = [*connection(now), *format_age(now), *_state(now)]
    if model is not None:
        rows += [*joints(now, model.joints), *_distance(near, contacts), *_base(model)]
    return block(rows)


def alerts(now: ViewerSnapshot) -> str:
    """Build the list of refusals, warnings and errors with their ages, the newest first."""
    lines = [
        (verdict["time"], "refused", "; ".join(_found(verdict["verdict"]["refusals"])), AMBER)
        for verdict in now.refusals
    ]
    lines += [
        (each["time"], each["event"]["code"], str(each["event"]["message"]), LEVELS[each["event"]["level"]])
        for each in now.events
    ]
    lines.sort(key=lambda line: float(line[0]), reverse=True)
    ages = [_ago(now, time).removesuffix(" ago: ") for time, *_ in lines]
    return block([_alert(age, *line[1:]) for age, line in zip(ages, lines, strict=True)] or [row("none", "")])


def _alert(age: str, code: str, text: str, colour: str) -> str:
    return (
        f'<div style="display:grid;grid-template-columns:3.6em 1fr;gap:0.4em"><span style="color:{GREY};'
        f'text-align:right">{escape(age)}</span><span><b style="color:{colour}">{escape(code)}</b> '
        f"{escape(text)}</span></div>"
    )


def block(rows: Sequence[str]) -> str:
    """Lines below each other."""
    return f'<div style="font-size:0.8em;line-height:1.45;padding:0 0.7em 0.5em">{"".join(rows)}</div>'


def row(name: str, text: str, colour: str = "") -> str:
    """One line; name and text are escaped here."""
    style = f' style="color:{colour};font-weight:600"' if colour else ""
    return f'<div><span style="color:{GREY}">{escape(name)}</span> <span{style}>{escape(text)}</span></div>'


def connection(now: ViewerSnapshot) -> list[str]:
    """Build the row with the reason why no messages arrive; empty: they arrive."""
    if now.lost is not None:
        return [row("now", now.lost, RED)]
    return [row("now", "no message yet", AMBER)] if now.status is None else []


def format_age(now: ViewerSnapshot) -> list[str]:
    """Build the row with the age of the picture: an old one looks like that of a robot that stands still."""
    if now.age is None:
        return []
    if now.age < OLD:
        return [row("heard", f"less than {OLD:g} s ago")]
    return [row("heard", f"{now.age:.0f} s ago: the picture is old", RED)]


def _state(now: ViewerSnapshot) -> list[str]:
    status = now.status
    if status is None:
        return []
    flags = "".join(f", {name}" for name in ("armed", "inherited") if status[name])
    colour = RED if status["state"] in ("fault", "estop", "inhibited") else ""
    lease = status["lease"]
    loop = status["loop"]
    holder = "nobody" if lease is None else f"{lease['holder']}, {lease['expires_in']:.1f} s"
    rows = [
        row("robot", f"{status['robot']}, mode {status['mode']}"),
        row("state", f"{status['state']}{flags}; motion {status['motion']}", colour),
        row("lease", holder),
    ]
    rows += [row("fault", f"{each['code']}: {each['message']}", RED) for each in status["faults"]]
    rows.append(row("loop", f"{loop['rate_hz']:g} Hz, {loop['on_time']:.1%} of the ticks on time"))
    for bus in status["buses"]:
        if not bus["connected"]:
            rows.append(row(f"bus {bus['name']}", f"not connected ({bus['port'] or 'no port'})", AMBER))
        else:
            rows.append(row(f"bus {bus['name']}", f"{_ms(bus['latency_ms'])}, {bus['errors']} errors"))
    return rows


def joints(now: ViewerSnapshot, names: Sequence[str]) -> list[str]:
    """Build one HTML row per condition (missing, old, faults, contact) with the joints that have it.

    `names`: those of all joints, in their order.
    """
    told = now.joints
    if told is None:
        return []
    rows = []
    for what, which, colour in (
        ("not heard", ~told.heard, RED),
        ("old", now.stale, AMBER),
        ("faults", np.array([bool(each) for each in told.faults]), PURPLE),
        ("contact", told.contact, CYAN),
    ):
        these = [name for name, marked in zip(names, which, strict=True) if marked]
        if these:
            rows.append(row(what, _some(these), colour))
    return rows


def _some(names: Sequence[str]) -> str:
    rest = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + rest


def _distance(near: NearestBodies | None, contacts: int) -> list[str]:
    touch = [row("contacts", f"{contacts} points")] if contacts else []
    if near is None:
        return [row("nearest", "no two bodies that are judged are nearer than 100 mm"), *touch]
    colour = {"clear": GREEN, "warned": AMBER, "refused": RED}[near.level]
    said = f"{near.names}: {near.distance * 1e3:.1f} mm"
    bounds = f" (warned below {near.warn * 1e3:g}, refused below {near.block * 1e3:g})"
    return [row("nearest", said + bounds, colour), *touch]


def _base(model: RobotModel) -> list[str]:
    rows = [row("base", f"{model.base}, {BASES.get(model.support, model.support)}")]
    if model.meshes_missing:
        rows.append(row("model", "mesh files cannot be read here: balls stand for them", AMBER))
    return rows


def _found(findings: Sequence[Message]) -> list[str]:
    said = [f"{each['code']}: {each['message']}" for each in findings[:2]]
    return [*said, *([f"{len(findings) - 2} more"] if len(findings) > 2 else [])]


def events(now: ViewerSnapshot) -> list[str]:
    """The newest first."""
    return [
        row(
            each["event"]["code"],
            _ago(now, each["time"]) + str(each["event"]["message"]),
            LEVELS[each["event"]["level"]],
        )
        for each in now.events
    ]


def _ago(now: ViewerSnapshot, time: float) -> str:
    if now.joints is None:
        return ""
    return f"{max(0.0, now.joints.time - time):.0f} s ago: "


def _ms(value: Any) -> str:
    return "–" if value is None else f"{value:.2f} ms"
