"""Places of robots on the page, and one robot on its plate, with its name, in the colour of its health.

| you see | it is |
|---|---|
| the robot | measured; in mode sim the simulation |
| a body in red, amber, purple | its joint is missing, is old, reports a fault |
| all of it grey and translucent | lost or old: it stands where it was seen last |
"""

from math import ceil, sqrt
from typing import Any

import numpy as np

from twind.exceptions import InvalidInput
from twind.observe.viewing.fleet.robot_health import GREY, RobotHealth
from twind.observe.viewing.robot_figure import Colour, RobotFigure
from twind.observe.viewing.robot_model import RobotModel
from twind.observe.viewing.robot_scene import extent, marked
from twind.observe.viewing.status_html import rgb_of
from twind.observe.viewing.viewer_state import Message, ViewerSnapshot
from twind.robot.arrays import Floats

ROW = 4  # robots beside each other where there are no more than these
USUAL = 0.6  # m: size of a robot whose model is not known yet
APART = 1.6  # sizes of the largest, between two
PLATE = 0.45  # sizes: its radius
THICK = 0.004  # m
ABOVE = 0.25  # sizes: the name, above the highest body
FADED: Colour = (130, 136, 145)


def spots(count: int, apart: float) -> Floats:
    """(count, 2) m, x towards who looks: rows from the left, the first in front, the next in its gaps."""
    wide = count if count <= ROW else ceil(sqrt(2.0 * count))
    row, column = np.divmod(np.arange(count), max(1, wide))
    return apart * np.stack([-1.0 * row, column - 0.5 * (wide - 1) + 0.5 * (row % 2)], axis=1)


def camera(spots: Floats, size: float) -> tuple[Floats, Floats]:
    """Position and target of a camera that sees all robots. `size`: of the largest, m."""
    low = spots.min(axis=0)
    high = spots.max(axis=0)
    middle = np.array([*(0.5 * (low + high)), 0.5 * size])
    wide = float(high[1] - low[1]) + 2.0 * size + 0.5 * float(high[0] - low[0])
    return middle + wide * np.array([0.62, 0.05, 0.24]), middle


class FleetRobotPlace:
    """One robot's place. Until its model is known there are plate and name."""

    def __init__(self, scene: Any, number: int, name: str) -> None:
        self._scene = scene
        self._at = f"/robots/{number}"
        self._name = name
        self._root = scene.add_frame(self._at, show_axes=False)
        self._plate = scene.add_cylinder(
            f"{self._at}/plate", radius=PLATE * USUAL, height=THICK, cast_shadow=False
        )
        self._label = scene.add_label(f"{self._at}/name", name, anchor="bottom-center")
        self._label.position = (0.0, 0.0, (1.0 + ABOVE) * USUAL)
        self._robot: _PlacedFigure | None = None
        self._told: Message | None = None
        self.size = USUAL  # m
        self.problem = ""  # why the robot is not drawn

    def to(self, spot: Floats) -> None:
        """Stand there, (2,) m."""
        self._root.position = (float(spot[0]), float(spot[1]), 0.0)

    def draw(self, now: ViewerSnapshot, how: RobotHealth) -> None:
        """As it is now."""
        if now.told is not None and now.told is not self._told:
            self._describe(now.told)
        colour = rgb_of(how.colour)
        if tuple(self._plate.color) != colour:
            self._plate.color = colour
        said = f"{self._name}: {how.kind}"
        if self._label.text != said:
            self._label.text = said
        if self._robot is not None:
            self._robot.draw(now, faded=how.kind in GREY)

    def failed(self, error: Exception) -> None:
        """It is drawn no more until it is described anew."""
        self._clear(f"it cannot be drawn: {type(error).__name__}: {error}")

    def _clear(self, problem: str) -> None:
        robot = self._robot
        self._robot = None
        self.problem = problem
        if robot is not None:
            robot.remove()

    def _describe(self, description: Message) -> None:
        """Another robot, or the same one again."""
        self._told = description
        if self._robot is not None and self._robot.likeness.same_as(description):
            return
        self._clear("")
        try:
            likeness = RobotModel(description)
        except InvalidInput as error:
            self.problem = str(error)
            return
        low, high = extent(likeness)
        self.size = max(0.3, float(np.linalg.norm(high - low)))
        self._robot = _PlacedFigure(self._scene, f"{self._at}/robot", likeness)
        self._plate.radius = PLATE * self.size
        self._label.position = (0.0, 0.0, self._robot.lifted(high[2]) + ABOVE * self.size)


class _PlacedFigure:
    """The figure over the middle of the plate; one whose model hangs below its floor is lifted onto it."""

    def __init__(self, scene: Any, root: str, model: RobotModel) -> None:
        self.likeness = model
        low, high = extent(model)
        x, y = (-0.5 * (low + high))[:2]
        self._lift = max(0.0, -float(low[2]))
        self._root = scene.add_frame(root, show_axes=False, position=(x, y, self._lift))
        self._solid = RobotFigure(scene, f"{root}/solid", model.model, alone=True)
        self._marks = RobotFigure(scene, f"{root}/marks", model.model, (FADED, 0.45), alone=True)
        self._pose = model.rest.copy()
        self._solid.place(model.places(self._pose))

    def lifted(self, height: float) -> float:
        """m above the page's floor, of a height in the model."""
        return height + self._lift

    def draw(self, now: ViewerSnapshot, *, faded: bool) -> None:
        joints = now.joints
        told = joints is not None and len(joints.measured) == len(self._pose)
        if joints is not None and told:
            known = np.isfinite(joints.measured)
            self._pose[known] = joints.measured[known]  # a silent joint stays where it was seen last
        places = self.likeness.places(self._pose)
        self._solid.seen(wanted=not faded)
        self._solid.place(places)
        everybody = dict.fromkeys(range(self.likeness.model.nbody), FADED)
        self._marks.mark(everybody if faded else marked(now, self.likeness) if told else {}, places)

    def remove(self) -> None:
        self._root.remove()
