"""Table of joints as HTML: a bar of the angle between its limits, to drag, and buttons to hold. Pure.

It is sent once for a robot: the page's script fills in the values, so that a held button is never replaced.
"""

import json
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind.robot.arrays import Floats
from twind.robot_client.jog_motion import SLIDER, SPEED

ARROWS = (("down", "−", "less"), ("up", "+", "more"))


def joint_rows(robot: Mapping[str, Any], *, jogs: bool) -> str:
    """Build one row a joint; `jogs`: with buttons, and a row of poses above."""
    rows = [_joint_row(place, joint, jogs=jogs) for place, joint in enumerate(robot["joints"])]
    return f'<div class="tw-joints">{_poses(robot["poses"]) if jogs else ""}{"".join(rows)}</div>'


def joint_values(position: Floats, goal: Floats, external: Floats, contact: NDArray[np.bool_]) -> str:
    """Values (n,), rad and N·m, as JSON for the page; unknown ones are null."""

    def column(values: Floats) -> Sequence[float | None]:
        return [round(float(value), 4) if np.isfinite(value) else None for value in values]

    known = {"position": column(position), "goal": column(goal), "external": column(external)}
    return json.dumps(known | {"contact": contact.tolist()})


def _poses(poses: Mapping[str, Any]) -> str:
    buttons = "".join(_button("pose", name, name, f"hold: towards the pose {name}") for name in poses)
    return (
        '<div data-twind-row class="tw-poses"><span>hold to move, '
        f"at most {SPEED:g} rad/s:</span>{buttons}{_ANSWER}</div>"
    )


def _joint_row(place: int, joint: Mapping[str, Any], *, jogs: bool) -> str:
    name = str(joint["name"])
    lower = float(joint["lower"])
    upper = float(joint["upper"])
    data = f'data-twind-row data-place="{place}" data-lower="{lower}" data-upper="{upper}"'
    hold = f"hold and drag: {name} follows"
    slides = f'class="tw-bar tw-slider" {_control(SLIDER, name, hold)}' if jogs else 'class="tw-bar"'
    marks = "".join(f'<i class="tw-{mark}" hidden></i>' for mark in ("to", "goal", "is"))
    buttons = "".join(_button(kind, name, sign, f"hold: {name} {word}") for kind, sign, word in ARROWS)
    title = escape(f"{name}: {lower:g} to {upper:g} rad")
    return (
        f'<div {data} class="tw-row" title="{title}"><span class="tw-name">{escape(name)}</span>'
        f'<span {slides}>{marks}</span><span class="tw-number">–</span>'
        '<span class="tw-outside" title="N·m from outside"></span>'
        f"<span>{buttons if jogs else ''}</span>{_ANSWER}</div>"
    )


_ANSWER = '<div data-twind-answer class="tw-answer" role="status"></div>'


def _button(kind: str, name: str, text: str, title: str) -> str:
    return f'<button type="button" class="tw-hold" {_control(kind, name, title)}>{escape(text)}</button>'


def _control(kind: str, name: str, title: str) -> str:
    words = escape(title)
    return f'data-twind-kind="{kind}" data-twind-name="{escape(name)}" title="{words}" aria-label="{words}"'
