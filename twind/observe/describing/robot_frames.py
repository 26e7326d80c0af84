"""Frames of a robot: the tree of its links and the joints between them, all from the compiled model.

Links are the model's bodies, joints those of the robot file under their names there. A joint whose axis does
not pass through its body's origin, and each further joint of one body, has a link of its own.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats

BASE = "base"  # the root, as the frame of /imu
MOVING = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic"}


@dataclass(frozen=True, slots=True)
class FramePose:
    """Pose of one frame in another: position (3,) m, rotation (4,) w x y z."""

    position: Floats
    rotation: Floats

    def then(self, other: "FramePose") -> "FramePose":
        """Return the pose of a frame that has the pose `other` in this one."""
        position = np.zeros(3)
        rotation = np.zeros(4)
        mujoco.mju_mulPose(position, rotation, self.position, self.rotation, other.position, other.rotation)
        return FramePose(position, rotation)

    def inverse(self) -> "FramePose":
        """Return the pose of the other frame in this one."""
        position = np.zeros(3)
        rotation = np.zeros(4)
        mujoco.mju_negPose(position, rotation, self.position, self.rotation)
        return FramePose(position, rotation)


@dataclass(frozen=True, slots=True)
class FrameJoint:
    """One joint of the tree. `origin`: pose of the child in the parent at position 0.

    `kind`: fixed, revolute or prismatic. The joint is at `multiplier` × position of `leader` + `offset`.
    """

    name: str
    parent: str
    child: str
    origin: FramePose
    kind: str = "fixed"
    axis: tuple[float, ...] = ()
    leader: str = ""
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class RobotTree:
    """Links by name, with their body (0: none), root first, and joints, parents first."""

    model: Any  # mujoco.MjModel
    links: Mapping[str, int]
    joints: tuple[FrameJoint, ...]

    def table(self) -> list[dict[str, Any]]:
        """The joints as plain values, for a process without numpy."""
        return [
            {
                "parent": each.parent,
                "child": each.child,
                "position": each.origin.position.tolist(),
                "rotation": each.origin.rotation.tolist(),
                "kind": each.kind,
                "axis": list(each.axis),
                "leader": each.leader,
                "multiplier": each.multiplier,
                "offset": each.offset,
            }
            for each in self.joints
        ]


def robot_tree(model: Any, robot: Mapping[str, Any]) -> RobotTree:
    """The tree of a compiled model; `robot`: its file in the form of `GetRobot`. Raises InvalidInput."""
    try:
        driven = {model.joint(joint["model_joint"]).id: str(joint["name"]) for joint in robot["joints"]}
        base = model.body(robot["base"]).id
    except KeyError as error:
        raise InvalidInput(f"{robot['name']}: {error.args[0]}") from None
    return _LinkTreeBuilder(model, driven, base).build()


class _LinkTreeBuilder:
    """Builds the tree of one model. `driven`: names of the robot's joints by number in the model."""

    def __init__(self, model: Any, driven: Mapping[int, str], base: int) -> None:
        self._model = model
        self._base = base
        self._moving = {number: (name, name, 1.0, 0.0) for number, name in driven.items()}
        self._moving |= dict(_followers(model, driven))
        self._joints: list[FrameJoint] = []
        top = {int(model.body_rootid[model.jnt_bodyid[number]]) for number in driven}
        top.add(int(model.body_rootid[base]))
        self._bodies = [body for body in range(1, model.nbody) if model.body_rootid[body] in top]
        self._links: dict[str, int] = {}
        self._names: dict[int, str] = {}
        for body in self._bodies:
            self._names[body] = self._free_name(model.body(body).name or f"body_{body}")

    def build(self) -> RobotTree:
        model = self._model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        base = self._base
        is_root = self._names[base] == BASE and model.body_parentid[base] == 0
        root = BASE if is_root else self._free_name(BASE)
        self._links[root] = base if is_root else 0
        from_world = FramePose(data.xpos[base].copy(), data.xquat[base].copy()).inverse()
        for body in self._bodies:
            parent = int(model.body_parentid[body])
            place = FramePose(model.body_pos[body], model.body_quat[body])
            if is_root and body == base:
                continue
            if parent == 0:
                self._add_body(body, root, from_world.then(place))
            else:
                self._add_body(body, self._names[parent], place)
        return RobotTree(model, self._links, tuple(self._joints))

    def _add_body(self, body: int, parent: str, place: FramePose) -> None:
        """Add a body with its joints; those whose position is not known stay where the model has them."""
        model = self._model
        name = self._names[body]
        first = int(model.body_jntadr[body])
        numbers = [
            each for each in range(first, first + int(model.body_jntnum[body])) if each in self._moving
        ]
        for number in numbers:
            anchor = model.jnt_pos[number]
            joint = self._joint(number, parent, name, place.then(_at(anchor)))
            if number == numbers[-1] and not anchor.any():
                break
            parent = self._free_name(f"{joint.name}_axis")
            place = _at(-anchor)
            self._links[parent] = 0
            self._joints.append(replace(joint, child=parent))
        else:
            joint = FrameJoint(f"{name}_fixed", parent, name, place)
        self._links[name] = body
        self._joints.append(joint)

    def _joint(self, number: int, parent: str, child: str, place: FramePose) -> FrameJoint:
        """The moving joint `number`; `place`: of its axis in the model's own pose."""
        model = self._model
        axis = model.jnt_axis[number]
        zero = -float(model.qpos0[model.jnt_qposadr[number]])  # from the model's own pose to position 0
        kind = MOVING[int(model.jnt_type[number])]
        turn = np.array([1.0, 0.0, 0.0, 0.0])
        if kind == "revolute":
            mujoco.mju_axisAngle2Quat(turn, axis, zero)
        place = place.then(FramePose(np.zeros(3) if kind == "revolute" else axis * zero, turn))
        name, leader, multiplier, offset = self._moving[number]
        along = tuple(axis.tolist())
        return FrameJoint(name, parent, child, place, kind, along, leader, multiplier, offset)

    def _free_name(self, wanted: str) -> str:
        taken = {*self._names.values(), *self._links}
        while wanted in taken:
            wanted += "_"
        return wanted


def _at(position: Floats) -> FramePose:
    return FramePose(np.array(position), np.array([1.0, 0.0, 0.0, 0.0]))


def _followers(model: Any, driven: Mapping[int, str]) -> Iterator[tuple[int, tuple[str, str, float, float]]]:
    """Joints that a linear equality couples to a joint of the robot: name, leader, multiplier, offset."""
    for number in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT):
        follower = int(model.eq_obj1id[number])
        leader = int(model.eq_obj2id[number])
        offset, multiplier, *curve = model.eq_data[number, :5].tolist()
        if not model.eq_active0[number] or leader not in driven or follower in driven or any(curve):
            continue
        zero, zero_of_leader = model.qpos0[model.jnt_qposadr[[follower, leader]]].tolist()
        offset += zero - multiplier * zero_of_leader
        yield follower, (model.joint(follower).name, driven[leader], multiplier, offset)
