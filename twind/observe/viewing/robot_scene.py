"""Picture of one robot: its measured pose, goal, simulation, marks, contacts and the nearest pair of bodies.

| mode | solid | translucent |
|---|---|---|
| live | measured | the goal of every joint that has one |
| mirror | measured | the simulation, which is what takes commands |
| sim | the simulation | the goal |

A translucent figure shows only the bodies that are not where those of the solid one are.
"""

from typing import Any

import numpy as np

from twind.observe.viewing.robot_figure import Colour, RobotFigure
from twind.observe.viewing.robot_model import BodyPoses, NearestBodies, RobotModel
from twind.observe.viewing.viewer_state import ViewerSnapshot
from twind.robot.arrays import Floats

# a ghost's body nearer than this is not drawn
AWAY_M = 0.003
AWAY_RAD = 0.02
GOAL: Colour = (40, 110, 255)
SIMULATED: Colour = (20, 170, 90)
OLD: Colour = (245, 170, 0)
UNHEARD: Colour = (225, 30, 30)
FAULTY: Colour = (190, 0, 190)
CONTACT: Colour = (0, 190, 215)
LEVELS: dict[str, Colour] = {"clear": (60, 160, 60), "warned": OLD, "refused": UNHEARD}
TOUCH: Colour = (255, 220, 0)

AUTO = "as the mode needs"
BOTH = "goal and simulation"
NONE = "nothing"
GHOSTS = (AUTO, "goal", "simulation", BOTH, NONE)


def ghosts(choice: str, mode: str) -> tuple[bool, bool]:
    """Choice as two flags: draw the goal, draw the simulation."""
    if choice == AUTO:
        return mode != "mirror", mode == "mirror"
    return choice in ("goal", BOTH), choice in ("simulation", BOTH)


def marked(now: ViewerSnapshot, model: RobotModel) -> dict[int, Colour]:
    """Colours of bodies whose joints have a problem or are in contact. The joints must be known."""
    assert now.joints is not None
    faulty = np.array([bool(each) for each in now.joints.faults])
    which = ((now.joints.contact, CONTACT), (now.stale, OLD), (faulty, FAULTY), (~now.joints.heard, UNHEARD))
    return {int(body): colour for each, colour in which for body in model.bodies_of[each]}


class RobotScene:
    """One robot below a root of its own: `/robots/NAME`."""

    def __init__(self, scene: Any, robot_model: RobotModel, root: str) -> None:
        self._scene = scene
        self.likeness = robot_model
        self._root = root
        model = robot_model.model
        self._all = scene.add_frame(root, show_axes=False)
        self._solid = RobotFigure(scene, f"{root}/solid", model)
        self._goal = RobotFigure(scene, f"{root}/goal", model, (GOAL, 0.35))
        self._simulated = RobotFigure(scene, f"{root}/simulated", model, (SIMULATED, 0.35))
        self._marks = RobotFigure(scene, f"{root}/marks", model, (UNHEARD, 0.45))
        self._line: Any = None
        self._touching: Any = None
        self._drawn: tuple[object, ...] = ()
        self._pose = robot_model.rest.copy()
        self.near: NearestBodies | None = None
        self.contacts = 0
        self._solid.place(robot_model.places(self._pose))

    def draw(self, now: ViewerSnapshot, choice: str) -> None:
        """Draw the newest values. Unchanged parts are not sent."""
        joints = now.joints
        if joints is None or len(joints.measured) != len(self._pose):
            return
        known = np.isfinite(joints.measured)
        self._pose[known] = joints.measured[known]  # a silent joint stays where it was seen last
        solid = self.likeness.places(self._pose)
        self._solid.place(solid)
        goal, simulated = ghosts(choice, now.mode)
        self._ghost(self._goal, joints.goal, solid, wanted=goal)
        self._ghost(self._simulated, joints.simulated, solid, wanted=simulated)
        self._marks.mark(marked(now, self.likeness), solid)
        self._distances()

    def _ghost(self, figure: RobotFigure, position: Floats, solid: BodyPoses, *, wanted: bool) -> None:
        """A joint without a goal is where the robot is."""
        there = self.likeness.places(np.where(np.isfinite(position), position, self._pose))
        away = there.differ(solid, AWAY_M, AWAY_RAD)
        figure.show(away & wanted, there)
        figure.place(there)

    def _distances(self) -> None:
        """The nearest pair as a line of its colour, contacts as points."""
        self.near, touching = self.likeness.nearest(self._pose)
        self.contacts = len(touching)
        near = self.near
        ends = np.zeros((0, 2, 3)) if near is None else np.array([near.ends])
        drawn = (ends.round(4).tobytes(), touching.round(4).tobytes(), None if near is None else near.level)
        if drawn == self._drawn:
            return
        self._drawn = drawn
        self._show_line(near)
        self._show_touching(touching.astype(np.float32))

    def _show_line(self, near: NearestBodies | None) -> None:
        if near is None:
            if self._line is not None:
                self._line.visible = False
            return
        points = np.array([near.ends], np.float32)
        colours = np.tile(LEVELS[near.level], (1, 2, 1))
        if self._line is None:
            self._line = self._scene.add_line_segments(
                f"{self._root}/near",
                points,
                colors=colours.astype(np.uint8),
                thickness=4.0,
                thickness_units="screen",
            )
        else:
            self._line.points = points
            self._line.colors = colours.astype(np.uint8)
            self._line.visible = True

    def _show_touching(self, points: Any) -> None:
        if self._touching is not None:
            self._touching.remove()
            self._touching = None
        if len(points):
            self._touching = self._scene.add_point_cloud(
                f"{self._root}/touching",
                points,
                colors=TOUCH,
                point_size=0.012,
                point_shape="circle",
                precision="float32",
            )

    def remove(self) -> None:
        """Remove the robot from the scene; another one takes its place."""
        self._all.remove()


def camera(model: RobotModel) -> tuple[Floats, Floats]:
    """Return the camera's position and target: from the front, a little to the robot's left, all of it in
    sight."""
    low, high = extent(model)
    middle = 0.5 * (low + high)
    size = max(0.3, float(np.linalg.norm(high - low)))
    return middle + size * np.array([1.45, 0.6, 0.3]), middle


def extent(model: RobotModel) -> tuple[Floats, Floats]:
    """The least and the greatest place (3,) m of the robot's bodies at rest, in its own world."""
    places = model.places(model.rest)
    own = model.model.body_rootid == model.model.body_rootid[model.model.body(model.base).id]
    seen = places.position[own]
    return seen.min(axis=0), seen.max(axis=0)
