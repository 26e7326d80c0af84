"""A pinned h24 with an identified model, whose joints hands may press, under a fake clock."""

from dataclasses import replace

import numpy as np

from tests.support.mujoco_servo_rig import WholeBodyRig
from twind.config.identified_spec import IdentifiedJoint, IdentifiedModel, ParameterEstimate
from twind.config.robot_spec import RobotFile
from twind.loop.tick.bound_robot import BoundRobot
from twind.robot.arrays import Floats
from twind.robot.trajectory import Trajectory
from twind.twin.binding import bind
from twind.twin.mujoco_physics import MujocoPhysics


def estimated(value: float) -> ParameterEstimate:
    """An estimate with five percent of uncertainty."""
    return ParameterEstimate(value, 0.05 * value, value, value)


def identified(
    robot: RobotFile,
    friction: dict[str, float],
    hold_nm: float = np.inf,
    stiffness: dict[str, float] | None = None,
) -> RobotFile:
    """Return the robot with friction (N·m) and `stiffness` (N·m/rad) by joint identified.

    `hold_nm`: of all joints; `stiffness` None: not identified.
    """
    known = stiffness or {}
    joints = {
        name: IdentifiedJoint(
            friction_nm=estimated(value),
            stiffness_nm_per_rad=estimated(known[name]) if name in known else None,
        )
        for name, value in friction.items()
    }
    model = IdentifiedModel(robot.name, "2026-11-28T10:00:00Z", "test", "true", 60.0, 0.25, joints)
    hold = {} if np.isinf(hold_nm) else dict.fromkeys(robot.names, hold_nm)
    return replace(robot, identified=model, gate=replace(robot.gate, contact_hold_nm=hold))


class ContactRig(WholeBodyRig):
    """`press` turns a joint of the body from outside."""

    hold_nm = 1.0  # of all joints
    knows_stiffness = False  # the daemon: of the servos

    def born(self, mode):  # type: ignore[no-untyped-def]
        """A daemon that knows the friction and the armature of the gears."""
        body = self.body
        rub = {
            joint.name: float(body.model.dof_frictionloss[body.model.joint(joint.model_joint).dofadr[0]])
            for joint in self.robot.joints
        }
        stiff = dict(zip(rub, self.one.binding.ratings.stiffness.tolist(), strict=True))
        self.robot = identified(self.robot, rub, self.hold_nm, stiff if self.knows_stiffness else None)
        self.one = BoundRobot(self.robot, self.one.calibration, bind(self.robot, self.one.calibration))
        return super().born(mode)

    @property
    def body(self) -> MujocoPhysics:
        """The body of all buses."""
        return next(iter(self.virtual.values())).servos.muscles.whole

    def press(self, joint: str, torque: float) -> None:
        """Press with N·m until the next call; 0 releases."""
        model = self.body.model
        dof = int(model.joint(self.robot.joints[self.names.index(joint)].model_joint).dofadr[0])
        body = self.body.data
        # A torque about the axis of the joint on its link; the parent takes none.
        body.xfrc_applied[:] = 0.0
        body.xfrc_applied[model.dof_bodyid[dof], 3:] = torque * body.xaxis[model.dof_jntid[dof]]

    def dance(self, seconds: float, seed: int, around: Floats | None = None) -> int:
        """Submit a motion of all joints around a pose (n,), rad, of None the rest pose; return its ticket."""
        rng = np.random.default_rng(seed)
        limits = self.loop.robot.limits
        start = self.loop.robot.rest if around is None else around
        time = np.arange(1.0, seconds + 0.5)
        sideways = np.array([name.endswith(("_roll", "hip_yaw")) for name in self.names])
        room = 0.4 * np.minimum(start - limits.lower, limits.upper - start)
        reach = np.minimum(np.where(sideways, 0.03, 0.3), np.maximum(room, 0.0))
        rows = start + reach * rng.uniform(-1.0, 1.0, (len(time), len(start)))
        rows[-1] = start
        return self.submit(
            Trajectory(time, rows, np.ones(len(start), np.bool_), np.zeros_like(rows)), more=True
        )
