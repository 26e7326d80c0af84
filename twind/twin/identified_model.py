"""An identified model laid over the robot's own before it is compiled, alike for all that use the model.

The static part: servo, delay, friction and inertia of joints, mass of bodies. `servo_effects.py` has what no
element of MuJoCo describes.
"""

import copy
import math
from typing import Any

import mujoco
import numpy as np

from twind.config.identified_spec import IdentifiedBody, IdentifiedJoint
from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput
from twind.robot.arrays import Ints

STIFF = 0.9999  # impedance of friction
SHORTEST_STEP = 0.5  # share of the model's timestep that a simulation keeps, to divide its period


def apply_identified(spec: Any, robot: RobotFile, *, delays: bool = True) -> None:
    """Write what `robot.identified` says into `spec`, an MjSpec. `delays` False: servos act at once.

    Raises InvalidInput: a body that the model lacks.
    """
    identified = robot.identified
    if identified is None:
        return
    present = robot.identified_joints
    for joint in robot.joints:
        found = identified.joints.get(joint.name)
        hinge = spec.joint(joint.model_joint)
        if found is None or hinge is None:
            continue
        _set_hinge(hinge, found, spec.option.timestep)
        for servo in spec.actuators:
            if servo.trntype == mujoco.mjtTrn.mjTRN_JOINT and servo.target == joint.model_joint:
                _set_servo(servo, hinge, found, present[joint.name])
                if delays:
                    _set_delay(servo, found, spec.option.timestep)
    if identified.bodies:
        compiled = spec.copy().compile()
        for name, body in identified.bodies.items():
            _set_body(spec, compiled, name, body)


def with_present_stiffness(model: Any, robot: RobotFile, addresses: Ints) -> Any:
    """Return a compiled model with the identified stiffness at the robot's present gains.

    `addresses` (n,): of the joints' goals in ctrl. The model itself is returned where nothing differs.
    """
    found = robot.estimates("stiffness_nm_per_rad")
    places = [place for place, name in enumerate(robot.names) if name in found]
    rows = np.searchsorted(model.actuator_ctrladr, addresses[places])
    stiffness = np.array([found[robot.names[place]].value for place in places])
    if np.array_equal(model.actuator_gainprm[rows, 0], stiffness):
        return model
    changed = copy.copy(model)
    changed.actuator_gainprm[rows, 0] = stiffness
    changed.actuator_biasprm[rows, 1] = -stiffness
    return changed


def _set_hinge(hinge: Any, found: IdentifiedJoint, timestep: float) -> None:
    """Set friction and inertia. MuJoCo's default friction is soft: a joint that should stick creeps."""
    hinge.solimp_friction[:2] = STIFF
    hinge.solref_friction[0] = 2.0 * timestep
    friction = found.value("friction_nm")
    armature = found.value("armature_kg_m2")
    if friction is not None:
        hinge.frictionloss = friction
    if armature is not None:
        hinge.armature = armature


def _set_servo(servo: Any, hinge: Any, found: IdentifiedJoint, present: IdentifiedJoint) -> None:
    """Set stiffness and damping; `present`: at the present gains.

    The joint keeps its own damping, which acts without torque too.
    """
    identified = found.value("stiffness_nm_per_rad")
    stiffness = present.value("stiffness_nm_per_rad")
    damping = found.value("damping_nm_s_per_rad")
    if identified is not None and stiffness is not None:
        # As identified, a servo saturates at the error of the model; a gain changes no torque limit.
        servo.forcerange *= identified / servo.gainprm[0]
        servo.gainprm[0] = stiffness
        servo.biasprm[1] = -stiffness
    if damping is not None:
        own = min(float(hinge.damping[0]), damping)
        hinge.damping[0] = own
        servo.biasprm[2] = own - damping


def _set_delay(servo: Any, found: IdentifiedJoint, timestep: float) -> None:
    """Set the delay of the goal, with room for it in the history at the shortest timestep."""
    delay = found.value("delay_s") or 0.0
    if delay > 0.0:
        servo.delay = delay
        servo.interp = 1  # linear: held samples round a delay up to whole steps
        servo.nsample = math.ceil(delay / (SHORTEST_STEP * timestep)) + 1


def _set_body(spec: Any, compiled: Any, name: str, found: IdentifiedBody) -> None:
    """Set mass and centre of mass; the inertia about the centre grows as the mass does."""
    number = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_BODY, name)
    if number < 0:
        names = ", ".join(compiled.body(at).name for at in range(1, compiled.nbody))
        raise InvalidInput(f"identified model: bodies.{name}: the model has no body {name!r}; it has {names}")
    before = float(compiled.body_mass[number])
    mass = before if found.mass_kg is None else found.mass_kg.value
    body = spec.body(name)
    body.explicitinertial = True
    body.mass = mass
    body.inertia = compiled.body_inertia[number] * (mass / before if before > 0.0 else 1.0)
    body.ipos = compiled.body_ipos[number] if found.com_m is None else found.com_m.value
    body.iquat = compiled.body_iquat[number]
