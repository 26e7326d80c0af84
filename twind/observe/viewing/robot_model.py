"""Drawing model of a robot from the answer of `GetRobot`: joint angles in, body poses and distances out.

Independent of browsers. A pose is kinematics alone, one angle per joint, so joints of transmissions need no
special case. Undriven joints and a free base are not measured and stay where the model has them.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from twind.config.robot_spec import GateSettings
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats, Ints
from twind.twin.collision_model import CollisionModel
from twind.twin.model_from_text import compile_model

REACH = 0.1  # m: distances beyond are not shown


@dataclass(frozen=True, slots=True)
class ClearanceRules:
    """Part of the robot file that the distances between bodies need."""

    path: Path
    base: str
    gate: GateSettings


@dataclass(frozen=True, slots=True)
class ViewerBinding:
    """The model, and where its joints are in it."""

    robot: ClearanceRules
    model: Any  # mujoco.MjModel
    qpos: Ints


@dataclass(frozen=True, slots=True)
class NearestBodies:
    """The two bodies that are nearest to each other. Points (3,) m in the world."""

    names: str
    distance: float  # m, negative inside each other
    block: float  # m, nearer is refused
    warn: float  # m, nearer is a warning
    ends: tuple[Floats, Floats]

    @property
    def level(self) -> str:
        """`refused`, `warned` or `clear`."""
        return (
            "refused" if self.distance <= self.block else "warned" if self.distance <= self.warn else "clear"
        )


@dataclass(frozen=True, slots=True)
class BodyPoses:
    """Poses of bodies: position (nbody, 3) m, quaternion (nbody, 4) w x y z."""

    position: Floats
    rotation: Floats

    def differ(self, other: "BodyPoses", metres: float, radians: float) -> Any:
        """(nbody,) bool: further apart than that."""
        away = np.linalg.norm(self.position - other.position, axis=1) > metres
        turn = np.abs(np.einsum("bi,bi->b", self.rotation, other.rotation))
        return away | (turn < np.cos(0.5 * radians))


class RobotModel:
    """One robot. Arrays are (n,) in joint order, rad."""

    def __init__(self, description: Mapping[str, Any]) -> None:
        """`description`: the answer of `GetRobot`. Raises InvalidInput."""
        import mujoco

        robot = description["robot"]
        self.told = description
        self.name = str(robot["name"])
        self.support = str(robot["support"])
        self.base = str(robot["base"])
        self.joints = tuple(str(joint["name"]) for joint in robot["joints"])
        self.model, self.meshes_missing = compile_model(
            description["mjcf"], os.path.dirname(robot["mjcf_path"])
        )
        try:
            numbers = [self.model.joint(joint["model_joint"]).id for joint in robot["joints"]]
            gate = msgspec.convert(robot["gate"], GateSettings)
        except (KeyError, msgspec.ValidationError) as error:
            raise InvalidInput(f"{self.name}: {error}") from None
        self.qpos = self.model.jnt_qposadr[numbers].astype(np.int64)
        self.bodies_of = self.model.jnt_bodyid[numbers].astype(np.int64)  # that each joint moves
        self.rest = np.array([float(robot["poses"]["rest"][name]) for name in self.joints])
        rules = ClearanceRules(Path(robot["path"]), self.base, gate)
        try:
            self._distances: CollisionModel | None = CollisionModel(
                ViewerBinding(rules, self.model, self.qpos), REACH
            )
        except InvalidInput:  # the daemon has reported why; there is no distance to show
            self._distances = None
        self._data = mujoco.MjData(self.model)
        self._numbers = np.array(numbers, np.int64)
        self._kinematics = mujoco.mj_kinematics
        self.size = float(self.model.stat.extent)  # m, of the model

    def same_as(self, description: Mapping[str, object]) -> bool:
        """Check that `description` would give the same picture: the same MJCF and the same robot."""
        return bool(self.told["mjcf"] == description["mjcf"] and self.told["robot"] == description["robot"])

    def places(self, position: Floats) -> BodyPoses:
        """Return the poses of all bodies at the joint angles `position` (n,), rad; NaN (unknown) is taken as
        at rest."""
        self._data.qpos[self.qpos] = np.where(np.isfinite(position), position, self.rest)
        self._kinematics(self.model, self._data)
        return BodyPoses(self._data.xpos.copy(), self._data.xquat.copy())

    def axis(self, position: Floats, place: int) -> tuple[Floats, Floats]:
        """Return a point and the direction (3,) in the world of the axis of joint `place`, at `position`."""
        self.places(position)
        joint = self._numbers[place]
        return self._data.xanchor[joint].copy(), self._data.xaxis[joint].copy()

    def nearest(self, position: Floats) -> tuple[NearestBodies | None, Floats]:
        """The nearest two of the bodies that are judged (None: all further than `REACH`), and points (k, 3)
        where bodies touch."""
        import mujoco

        bodies = self._distances
        if bodies is None or not bodies.pairs or not np.isfinite(position).all():
            return None, np.zeros((0, 3))
        found = bodies.distances(position[None], bodies.boxes, bodies.reach)[0]
        contact = bodies.data.contact
        touching = np.array(contact.pos[contact.dist <= 0.0], np.float64).reshape(-1, 3)
        place = int(np.argmin(found - bodies.block))
        pair = bodies.pairs[place]
        if found[place] >= bodies.reach:
            return None, touching
        line = np.zeros(6)
        mujoco.mj_geomDistance(bodies.model, bodies.data, *pair.geoms, bodies.reach, line)
        ends = line[:3].copy(), line[3:].copy()
        return NearestBodies(
            pair.name, float(found[place]), pair.block, pair.block + bodies.band, ends
        ), touching
