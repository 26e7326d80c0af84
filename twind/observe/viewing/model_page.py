"""Page of a robot file: a slider for each joint, and what the file says of the joint that was moved last.

The blue limb stands a little further in the positive direction; the arrow is the axis, by the right hand.
"""

import math
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from twind.observe.viewing.robot_model import RobotModel
from twind.observe.viewing.status_html import AMBER, block, row
from twind.observe.viewing.viewer_state import Message, ViewerState
from twind.robot.arrays import Floats

AHEAD = 0.3  # rad that the blue limb is ahead in the positive direction
ARROW = 0.2  # of the robot's size
COLOUR = (230, 90, 0)


class ModelPage:
    """Page of one robot file, for `RobotViewer`. `live`: angles come from a daemon; there are no sliders."""

    def __init__(self, server: Any, known: ViewerState, model: RobotModel, *, live: bool) -> None:
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        self.ghost = "goal"
        self._known = known
        self._model = model
        self._live = live
        self._scene = server.scene
        self._arrow: Any = None
        self._drawn: tuple[object, ...] = ()
        self._joints: list[Mapping[str, Any]] = list(model.told["robot"]["joints"])
        self._todo = tuple(model.told["robot"].get("todo") or ())
        self._words = gui.add_html("")
        self._which = gui.add_dropdown("joint", options=model.joints, initial_value=model.joints[0])
        self._facts = gui.add_html("")
        self._sliders: list[Any] = []
        if not live:
            with gui.add_folder("angles, rad"):
                self._sliders = [self._slider(gui, joint) for joint in self._joints]
        gui.main_panel.dock_right()

    def _slider(self, gui: Any, joint: Mapping[str, Any]) -> Any:
        name = str(joint["name"])
        lower = float(joint["lower"])
        upper = float(joint["upper"])
        at = float(self._model.rest[self._model.joints.index(name)])
        slider = gui.add_slider(name, lower, upper, (upper - lower) / 400.0, min(max(at, lower), upper))
        slider.on_update(partial(self._choose, name))
        return slider

    async def _choose(self, name: str, _: Any) -> None:
        if self._which.value != name:
            self._which.value = name

    def message(self) -> Message:
        """Message of the topic `state` with the angles of the sliders, in the form of `Monitor`."""
        return state_message([float(slider.value) for slider in self._sliders], self._chosen, self._joints)

    def live_message(self, message: Message) -> Message:
        """Message of a daemon with the joints of this file, by name; one that it lacks is not known."""
        rows = {str(row["name"]): row for row in message["joints"]}
        angles = [rows.get(name, {}).get("position") for name in self._model.joints]
        return state_message(
            angles, self._chosen, self._joints, [name in rows for name in self._model.joints]
        )

    @property
    def _chosen(self) -> int:
        return self._model.joints.index(str(self._which.value))

    def set_html(self, words: str, alerts: str = "") -> None:
        """Show the state of the daemon, where one is mirrored; a robot file has no alerts."""
        if self._live and self._words.content != words:
            self._words.content = words

    def set_robot(self, robot: Message, *, jogs: bool) -> None:
        """Keep the joints: this page is of one robot file."""

    def draw(self) -> None:
        """Draw the axis and the facts of the chosen joint, where they changed."""
        joints = self._known.now().joints
        if joints is None:
            return
        place = self._chosen
        anchor, axis = self._model.axis(joints.measured, place)
        drawn = (place, anchor.round(4).tobytes(), axis.round(4).tobytes(), float(joints.measured[place]))
        if drawn == self._drawn:
            return
        self._drawn = drawn
        self._facts.content = facts(self._joints[place], float(joints.measured[place]), axis, self._todo)
        if self._arrow is not None:
            self._arrow.remove()
        length = ARROW * self._model.size
        ends = np.array([[anchor - 0.5 * length * axis, anchor + length * axis]], np.float32)
        self._arrow = self._scene.add_arrows(
            "/axis",
            ends,
            COLOUR,
            shaft_radius=0.02 * length,
            head_radius=0.06 * length,
            head_length=0.15 * length,
        )


def state_message(
    angles: list[float | None],
    chosen: int,
    joints: list[Mapping[str, Any]],
    fresh: list[bool] | None = None,
) -> Message:
    """Build a message of the topic `state`: the goal of the chosen joint is `AHEAD` of its angle."""
    rows = []
    for place, (angle, joint) in enumerate(zip(angles, joints, strict=True)):
        goal = angle + AHEAD if place == chosen and angle is not None else None
        is_fresh = fresh is None or fresh[place]
        rows.append(
            {"name": joint["name"], "position": angle, "goal": goal, "age_ms": 0.0, "heard": is_fresh}
        )
    return {"topic": "state", "time": time.monotonic(), "joints": rows}


def facts(joint: Mapping[str, Any], angle: float, axis: Floats, todo: tuple[str, ...]) -> str:
    """Build the rows of one joint: id, limits, axis, sign, angle."""
    lower = float(joint["lower"])
    upper = float(joint["upper"])
    name = str(joint["name"])
    sign = "+1: its counts grow" if int(joint["sign"]) > 0 else "-1: its counts shrink"
    rows = [
        row("device", f"bus {joint['bus']}, id {joint['id']}, {joint['type']['device']}"),
        row("limits", f"{lower:g} to {upper:g} rad ({_degrees(lower)} to {_degrees(upper)})"),
        row("axis", "{:.2f} {:.2f} {:.2f} in the world".format(*(axis + 0.0))),
        row("sign", f"{sign} with the angle"),
        row("angle", f"{angle:.3f} rad ({_degrees(angle)})" if math.isfinite(angle) else "not known"),
        row("positive", "about the arrow by the right hand: towards the blue limb"),
    ]
    rows += [row("todo", each, AMBER) for each in todo if name in each.split(".")]
    return block(rows)


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.0f}°"
