"""Completion of a spec: base, actuators, exclusions. What no file says is worked out and remarked.

The figures of an actuator follow from mass and inertia alone, since no model says which servo moves a joint.
"""

import math
from typing import Any

import mujoco
import numpy as np

from twind.twin.pinning import exclude_children, free_joints, pin
from twind_calibration.model_import.imported_model import RemarkList, import_refused
from twind_calibration.model_import.mjcf_reader import fix_inertia

HELD = 50.0  # kp in units of the largest gravity torque: a joint sags by at most 1 / 50 rad
SLOWEST = 20.0  # rad/s: natural frequency of a joint that gravity does not turn
FASTEST = 100.0  # rad/s: natural frequency of kp and armature alone; a time step of 5 ms stays stable
GRAVITY = 9.81  # m/s²
HINGE = mujoco.mjtJoint.mjJNT_HINGE
SLIDE = mujoco.mjtJoint.mjJNT_SLIDE


def finish(spec: mujoco.MjSpec, file: str, floating: bool | None, remarks: RemarkList) -> str:
    """Complete a spec; return the name of the base. Raises InvalidInput; ValueError: it does not compile."""
    spec.compiler.fusestatic = False
    fix_inertia(spec, spec.compile())
    base = _base(spec, file)
    _name_parts(spec, remarks, file)
    _support(spec, base, floating, remarks, file)
    model = spec.compile()
    _complete_actuators(spec, model, remarks, file)
    return str(base.name)


def _base(spec: mujoco.MjSpec, file: str) -> Any:
    """Return the one body of the world that carries hinges."""
    carrying = [body for body in spec.worldbody.bodies if any(_hinges(body))]
    if len(carrying) == 1:
        return carrying[0]
    names = ", ".join(body.name or "unnamed" for body in carrying[:8])
    if carrying:
        reason = f"{len(carrying)} root bodies carry joints: {names}; put them into one body"
        raise import_refused(reason, where=file)
    raise import_refused(
        "no joint that turns: 0 hinges, at least 1 is needed; is this the robot?", where=file
    )


def _hinges(body: Any) -> list[Any]:
    return [joint for joint in body.find_all("joint") if joint.type == HINGE]


def _name_parts(spec: mujoco.MjSpec, remarks: RemarkList, file: str) -> None:
    """Give each body and joint a name, which exclusions and the robot file need."""
    for kind, parts in (("body", spec.bodies[1:]), ("joint", _hinges(spec.worldbody))):
        taken = {part.name for part in parts}
        for number, part in enumerate(parts):
            if part.name:
                continue
            names = (f"{kind}_{number}{'_' * extra}" for extra in range(len(taken) + 1))
            part.name = next(name for name in names if name not in taken)
            taken.add(part.name)
            remarks.add(file, f"a {kind} without a name is now called {part.name!r}")


def _support(spec: mujoco.MjSpec, base: Any, floating: bool | None, remarks: RemarkList, file: str) -> None:
    """Add or remove the free joint of the base. A fixed base and its neighbours never collide."""
    has_free = bool(free_joints(base))
    if floating is None:
        does = "floats" if has_free else "is fixed to the world"
        remarks.add(file, f"the base {base.name!r} {does}, as in the file")
    elif floating and not has_free:
        if base.joints:
            names = ", ".join(joint.name for joint in base.joints)
            raise import_refused(
                f"base {base.name!r} cannot float: joints {names} hold it; remove them", where=file
            )
        base.add_freejoint(name=_unused(spec, "floating_base"))
        for key in list(spec.keys):
            spec.delete(key)  # their poses lack the place of the base
    if has_free and floating is False:
        pin(spec, base)
    elif not has_free and not floating:
        exclude_children(spec, base)


def _unused(spec: mujoco.MjSpec, name: str) -> str:
    taken = {joint.name for joint in spec.joints}
    while name in taken:
        name += "_"
    return name


def _complete_actuators(spec: mujoco.MjSpec, model: mujoco.MjModel, remarks: RemarkList, file: str) -> None:
    """Give each hinge that follows no other one position servo."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    followers = _followers(model)
    servos = _driving(model)
    assumed = []
    for joint in spec.joints:
        if joint.type != HINGE or joint.name in followers:
            continue
        present = servos.get(joint.id, [])
        if len(present) == 1 and _is_position_servo(model, present[0]):
            continue
        for number in present:
            name = model.actuator(number).name
            remarks.add(file, f"actuator {name or number!r} of {joint.name!r} became a position servo")
        _remove(spec, present)
        _add_servo(
            spec, joint, model, data, float(inertia[joint_dof(model, joint.id), joint_dof(model, joint.id)])
        )
        assumed.append(joint.name)
    if assumed:
        rule = f"kp {HELD:g} times the gravity torque per rad, damping critical, armature kp / {FASTEST:g}²"
        remarks.add(file, f"position servos assumed for {len(assumed)} joints ({', '.join(assumed)}): {rule}")


def joint_dof(model: mujoco.MjModel, joint: int) -> int:
    """Number of the degree of freedom of a joint with one axis."""
    return int(model.jnt_dofadr[joint])


def _followers(model: mujoco.MjModel) -> set[str]:
    rows = np.flatnonzero((model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_obj2id >= 0))
    return {model.joint(int(model.eq_obj1id[row])).name for row in rows}


def _driving(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Actuators of each joint."""
    found: dict[int, list[int]] = {}
    for actuator in np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT):
        found.setdefault(int(model.actuator_trnid[actuator, 0]), []).append(int(actuator))
    return found


def _is_position_servo(model: mujoco.MjModel, actuator: int) -> bool:
    pull = model.actuator_gainprm[actuator, 0]
    return bool(pull > 0.0 and math.isclose(pull, -model.actuator_biasprm[actuator, 1]))


def _remove(spec: mujoco.MjSpec, actuators: list[int]) -> None:
    """Remove actuators by the number that they were compiled with, and what refers to them."""
    removed = [each for each in spec.actuators if each.id in actuators]
    names = {each.name for each in removed if each.name}
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname in names:
            spec.delete(sensor)
    for element in [*removed, *(spec.keys if removed else ())]:  # a key pose has a place for each actuator
        spec.delete(element)


def _add_servo(spec: mujoco.MjSpec, joint: Any, model: mujoco.MjModel, data: Any, inertia: float) -> None:
    body = int(model.jnt_bodyid[joint.id])
    arm = data.subtree_com[body] - data.xanchor[joint.id]
    arm = arm - data.xaxis[joint.id] * float(arm @ data.xaxis[joint.id])
    torque = float(model.body_subtreemass[body]) * GRAVITY * float(np.linalg.norm(arm))
    kp = max(HELD * torque, inertia * SLOWEST**2)
    armature = float(model.dof_armature[joint_dof(model, joint.id)])
    if armature == 0.0:
        armature = kp / FASTEST**2
        joint.armature = armature
        inertia += armature
    servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=_rounded(kp), kv=_rounded(2.0 * math.sqrt(kp * inertia)))
    if model.jnt_limited[joint.id]:
        servo.inheritrange = 1.0
    if model.jnt_actfrclimited[joint.id]:
        servo.forcerange = model.jnt_actfrcrange[joint.id]


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
