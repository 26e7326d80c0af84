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
    """Give each body and hinge a name, which exclusions and the robot file need."""
    given: list[str] = []
    for kind, parts in (("body", spec.bodies[1:]), ("joint", _hinges(spec.worldbody))):
        taken = {part.name for part in parts}
        for number, part in enumerate(parts):
            if part.name:
                continue
            names = (f"{kind}_{number}{'_' * extra}" for extra in range(len(taken) + 1))
            part.name = next(name for name in names if name not in taken)
            taken.add(part.name)
            given.append(part.name)
    if given:
        remarks.add(file, f"parts without a name are now called {', '.join(given)}")


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
    present = _driving(spec)
    assumed: list[str] = []
    replaced: list[str] = []
    for joint in spec.joints:
        servos = present.get(joint.name, [])
        if joint.type != HINGE or joint.name in followers or _is_position_servo(servos):
            continue
        for extra in servos[1:]:
            spec.delete(extra)
        dof = int(model.jnt_dofadr[joint.id])
        kp, kv = _gains(joint, model, data, float(inertia[dof, dof]))
        _make_servo(servos[0] if servos else _new_servo(spec, joint.name), joint, kp, kv)
        (replaced if servos else assumed).append(joint.name)
    rule = f"kp {HELD:g} times the gravity torque per rad, damping critical, armature kp / {FASTEST:g}²"
    if assumed:
        remarks.add(file, f"position servos assumed for {len(assumed)} joints ({', '.join(assumed)}): {rule}")
    if replaced:
        remarks.add(file, f"actuators of {', '.join(replaced)} became position servos: {rule}")


def _followers(model: mujoco.MjModel) -> set[str]:
    rows = np.flatnonzero((model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_obj2id >= 0))
    return {model.joint(int(model.eq_obj1id[row])).name for row in rows}


def _driving(spec: mujoco.MjSpec) -> dict[str, list[Any]]:
    """Actuators of each joint."""
    found: dict[str, list[Any]] = {}
    for actuator in spec.actuators:
        if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT:
            found.setdefault(actuator.target, []).append(actuator)
    return found


def _is_position_servo(servos: list[Any]) -> bool:
    pull = servos[0].gainprm[0] if len(servos) == 1 else 0.0
    return bool(pull > 0.0 and math.isclose(pull, -servos[0].biasprm[1]))


def _gains(joint: Any, model: mujoco.MjModel, data: Any, inertia: float) -> tuple[float, float]:
    """Return kp and kv of a servo; a joint without armature gets one. `inertia`: kg·m² about its axis."""
    body = int(model.jnt_bodyid[joint.id])
    axis = data.xaxis[joint.id]
    arm = data.subtree_com[body] - data.xanchor[joint.id]
    arm = arm - axis * float(arm @ axis)
    torque = float(model.body_subtreemass[body]) * GRAVITY * float(np.linalg.norm(arm))
    kp = max(HELD * torque, inertia * SLOWEST**2)
    if model.dof_armature[model.jnt_dofadr[joint.id]] == 0.0:
        joint.armature = _rounded(kp / FASTEST**2)
        inertia += kp / FASTEST**2
    return _rounded(kp), _rounded(2.0 * math.sqrt(kp * inertia))


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _new_servo(spec: mujoco.MjSpec, joint: str) -> Any:
    taken = {actuator.name for actuator in spec.actuators}
    name = joint if joint not in taken else f"{joint}_servo"
    return spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)


def _make_servo(servo: Any, joint: Any, kp: float, kv: float) -> None:
    """Turn an actuator of any kind into a position servo within the limits of its joint."""
    servo.gear = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    servo.ctrlrange = np.zeros(2)
    servo.ctrllimited = mujoco.mjtLimited.mjLIMITED_AUTO
    is_limited = joint.range[0] < joint.range[1]
    servo.set_to_position(kp=kp, kv=kv, inheritrange=is_limited)
    if joint.actfrcrange[0] < joint.actfrcrange[1]:
        servo.forcerange = joint.actfrcrange
