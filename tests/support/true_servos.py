"""Servo parameters that the body of virtual servos has, as it moves with torque on."""

from typing import Any

from twind.config.robot_spec import RobotFile
from twind.robot.arrays import Floats


def true_servos(model: Any, robot: RobotFile) -> dict[str, Floats]:
    """Return columns (n,) by name of parameter; `model`: the body's, with an actuator for each joint."""
    dofs = [model.joint(joint.model_joint).dofadr[0] for joint in robot.joints]
    return {
        "stiffness_nm_per_rad": -model.actuator_biasprm[:, 1],
        "damping_nm_s_per_rad": model.dof_damping[dofs] - model.actuator_biasprm[:, 2],
        "armature_kg_m2": model.dof_armature[dofs],
        "friction_nm": model.dof_frictionloss[dofs],
    }
