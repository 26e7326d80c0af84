"""Joint angles for the targets of a gait, by `mink`, and how far the servos give under the weight."""

import math
from dataclasses import dataclass
from typing import Any

import mink
import mujoco
import numpy as np

from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats, Ints
from twind.twin.base_pose import stand
from twind.twin.binding import Binding
from twind.twin.servo_effects import servo_rows
from twind.twin.standing_feet import StandingFeet
from twind.walk.gait_pattern import FootPose, GaitTarget

LEG_JOINTS = 6
ITERATIONS = 2  # of the differential solution, each period: the targets move little in one
DAMPING = 1e-4
# Costs per m and rad of error: feet and mass are exact, the torso upright, the rest at its posture.
FOOT = 10.0
MASS = 10.0
TORSO = 3.0
POSTURE = 0.1
ALONG = 0.8  # least share of an ankle's axis along the left or the front


@dataclass(frozen=True, slots=True)
class Sole:
    """One foot: its body, the middle of its sole in the body's frame (3,), m, and its two ankle joints."""

    body: str
    middle: Floats
    ankle_pitch: int  # joint order
    ankle_roll: int
    pitch_sign: float  # of its axis along the left, 1 or -1
    roll_sign: float  # of its axis along the front


class LegKinematics:
    """Solves for one robot, from its stance on; angles are (n,) in joint order, rad."""

    def __init__(self, binding: Binding, stance: Floats) -> None:
        """`stance` (n,): angles in which it stands. Raises InvalidInput: no two legs of six joints."""
        self._binding = binding
        self._model: Any = binding.model
        self._rows = servo_rows(binding.model, binding.actuators)
        self.soles = soles_of(binding, stance)
        self._configuration = mink.Configuration(binding.model)
        qpos = np.array(self._configuration.q)
        qpos[binding.qpos] = stance
        data = mujoco.MjData(binding.model)
        data.qpos[:] = qpos
        stand(binding.model, data, binding.robot.base)
        self._configuration.update(np.array(data.qpos))
        self._feet = [mink.FrameTask(sole.body, "body", FOOT, FOOT) for sole in self.soles]
        self._mass = mink.ComTask(MASS)
        self._torso = mink.FrameTask(binding.robot.base, "body", 0.0, TORSO)
        posture = mink.PostureTask(binding.model, POSTURE)
        posture.set_target_from_configuration(self._configuration)
        self._tasks = [*self._feet, self._mass, self._torso, posture]
        self._weight = float(np.linalg.norm(binding.model.opt.gravity) * binding.model.body_mass.sum())

    @property
    def feet(self) -> tuple[FootPose, FootPose]:
        """Soles on the floor, left and right."""
        data = self._configuration.data
        found = []
        for sole in self.soles:
            body = data.body(sole.body)
            turn = body.xmat.reshape(3, 3)
            place = body.xpos + turn @ sole.middle
            found.append(FootPose(place[:2].copy(), float(np.arctan2(turn[1, 0], turn[0, 0]))))
        return found[0], found[1]

    @property
    def mass(self) -> Floats:
        """Centre of mass (3,), m."""
        base = self._model.body(self._binding.robot.base).id
        return np.array(self._configuration.data.subtree_com[base])

    def solve(self, target: GaitTarget, height: float, period: float) -> Floats:
        """Return the angles (n,) for a target; `height`: of the centre of mass, m; `period`: s."""
        for task, sole, foot, lift in zip(self._feet, self.soles, target.feet, target.lift, strict=True):
            turn = mink.SO3.from_z_radians(foot.heading)
            place = np.array([*foot.place, lift]) - turn.as_matrix() @ sole.middle
            task.set_target(mink.SE3.from_rotation_and_translation(turn, place))
        heading = 0.5 * (target.feet[0].heading + target.feet[1].heading)
        self._torso.set_target(mink.SE3.from_rotation(mink.SO3.from_z_radians(heading)))
        self._mass.set_target(np.array([*target.mass, height]))
        for _ in range(ITERATIONS):
            speed = mink.solve_ik(
                self._configuration, self._tasks, period, "daqp", damping=DAMPING, limits=[]
            )
            self._configuration.integrate_inplace(speed, period)
        return np.array(self._configuration.q[self._binding.qpos])

    def gravity_sag(self, target: GaitTarget) -> Floats:
        """Return by how much (n,), rad, each servo gives under the weight in the present pose.

        Weight acts at the centre of pressure, on each foot by its share.
        """
        model = self._model
        data = self._configuration.data
        data.qvel[:] = 0.0
        data.qacc[:] = 0.0
        torque = np.zeros(model.nv)
        mujoco.mj_rne(model, data, 0, torque)
        jacobian = np.zeros((3, model.nv))
        for sole, foot, share in zip(self.soles, target.feet, target.weight, strict=True):
            if share > 0.0:
                point = np.array([*foot.place, 0.0])
                mujoco.mj_jac(model, data, jacobian, None, point, model.body(sole.body).id)
                torque -= share * self._weight * jacobian[2]
        return np.array(torque[self._binding.dof] / model.actuator_gainprm[self._rows, 0])


def soles_of(binding: Binding, stance: Floats) -> tuple[Sole, Sole]:
    """Return the left and the right foot. Raises InvalidInput: not two, or a leg without its six joints."""
    model = binding.model
    data = mujoco.MjData(model)
    found = StandingFeet(binding, model, data).soles() if binding.floating else []
    if len(found) != 2:
        raise InvalidInput(
            f"{binding.robot.path}: to walk a robot needs `support: free` and two feet, as h24-standing; "
            f"{len(found)} found"
        )
    data.qpos[binding.qpos] = stance
    mujoco.mj_kinematics(model, data)
    found.sort(key=lambda sole: -float(data.xpos[sole[0], 1]))
    left, right = (_sole(binding, data, body, middle) for body, middle in found)
    return left, right


def _sole(binding: Binding, data: mujoco.MjData, body: int, middle: Floats) -> Sole:
    model = binding.model
    name = model.body(body).name
    legs = {binding.robot.names.index(joint) for joint in binding.robot.legs}
    above = _joints_above(binding, body)
    joints = [joint for joint in above if joint in legs]
    if len(joints) != LEG_JOINTS:
        raise InvalidInput(f"{binding.robot.path}: the leg above {name} has {len(joints)} joints, needs six")
    axes = [data.xaxis[model.dof_jntid[binding.dof[joint]]] for joint in joints[:2]]
    pitch = int(np.argmax([abs(float(axis[1])) for axis in axes]))  # the two next to the sole
    along = float(axes[pitch][1]), float(axes[1 - pitch][0])
    for joint, share in zip((joints[pitch], joints[1 - pitch]), along, strict=True):
        if abs(share) < ALONG:
            raise InvalidInput(
                f"{binding.robot.path}: {binding.robot.names[joint]} turns {name} neither in pitch nor in "
                "roll; the two joints next to a sole must"
            )
    return Sole(
        name,
        middle,
        joints[pitch],
        joints[1 - pitch],
        math.copysign(1.0, along[0]),
        math.copysign(1.0, along[1]),
    )


def _joints_above(binding: Binding, body: int) -> list[int]:
    """Return the driven joints from `body` up to the base, in joint order, the nearest first."""
    model = binding.model
    rows: dict[int, int] = {int(dof): row for row, dof in enumerate(binding.dof)}
    found = []
    while body > 0:
        first = int(model.body_dofadr[body])
        dofs: Ints = np.arange(first + int(model.body_dofnum[body]) - 1, first - 1, -1)
        found += [rows[int(dof)] for dof in dofs if int(dof) in rows]
        body = int(model.body_parentid[body])
    return found
