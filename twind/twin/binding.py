"""A robot file bound to its compiled model: every joint mapped or passive, ranges and limits checked.

Only this module relates joint names to the model's addresses. Its results are arrays in joint order.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from twind.config.calibration_file import Calibration, JointCalibration
from twind.config.counts import rad_per_tick
from twind.config.robot_spec import JointSpec, RobotFile, TransmissionSpec
from twind.config.travel import slack
from twind.config.yaml_tree import place
from twind.exceptions import InvalidInput
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Floats, Ints, frozen
from twind.robot.attitude import Quaternion
from twind.robot.joint_limits import JointLimits
from twind.robot.joint_map import JointBusMap, JointMap
from twind.robot.measured_travel import MeasuredTravel
from twind.robot.transmission import MappedTransmission
from twind.twin.identified_model import apply_identified, with_present_stiffness
from twind.twin.imu_model import feel, mount, require_site
from twind.twin.joint_range import JointRange, reaches, turn_begin
from twind.twin.model_bounds import require_sane_model
from twind.twin.pinning import free_joints, pin
from twind.twin.transmission_range import strength

TOLERANCE = 1e-9  # rad, when ranges are compared


@dataclass(frozen=True, slots=True)
class Binding:
    """A robot ready for the loop. Arrays are (n,) in joint order. `model` is shared: never written."""

    robot: RobotFile
    model: Any  # mujoco.MjModel
    joint_map: JointMap
    limits: JointLimits
    ratings: ActuatorRatings
    qpos: Ints  # address of each joint in qpos
    dof: Ints  # address of each joint in qvel, qacc, qfrc
    actuators: Ints  # address of its goal in ctrl
    rest: Floats  # rad
    floating: bool  # the base has its free joint
    mjcf: str  # the model as compiled, base pinned or not
    mount: Quaternion | None = None  # from the IMU's axes to the base's; None: the robot has none


def bind(robot: RobotFile, calibration: Calibration | None) -> Binding:
    """Compile the model (base pinned unless `support: free`) and map every joint.

    Without calibration zero is the middle of the encoder and no joint calibrated. Raises InvalidInput.
    """
    spec, model, imu = _compile(robot)
    known: Mapping[str, JointCalibration] = {} if calibration is None else calibration.by_name
    joints = [_model_joint(model, joint, robot) for joint in robot.joints]
    _require_all_mapped(robot, model, set(joints))
    zeros, reach = reaches(robot, known, model, joints)
    return Binding(
        robot=robot,
        model=model,
        joint_map=_joint_map(robot, known, zeros, reach),
        limits=_limits(robot, reach),
        ratings=_ratings(robot),
        qpos=model.jnt_qposadr[joints].astype(np.int64),
        dof=model.jnt_dofadr[joints].astype(np.int64),
        actuators=np.array(
            [
                position_servo(model, number, f"{robot.mjcf_path}: joint {model.joint(number).name!r}")
                for number in joints
            ]
        ),
        rest=frozen([robot.poses["rest"][name] for name in robot.names]),
        floating=robot.support == "free",
        mjcf=spec.to_xml(),
        mount=imu,
    )


def rebound(binding: Binding, robot: RobotFile, calibration: Calibration | None) -> Binding:
    """Bind a robot file that differs in limits and gains only; nothing is compiled.

    `calibration`: the one of `binding`. Raises InvalidInput.
    """
    known: Mapping[str, JointCalibration] = {} if calibration is None else calibration.by_name
    joints = [_model_joint(binding.model, joint, robot) for joint in robot.joints]
    zeros, reach = reaches(robot, known, binding.model, joints)
    return replace(
        binding,
        robot=robot,
        model=with_present_stiffness(binding.model, robot, binding.actuators),
        joint_map=_joint_map(robot, known, zeros, reach),
        limits=_limits(robot, reach),
        ratings=_ratings(robot),
    )


# ------------------------------------------------------------------------------------------- the model


def _compile(robot: RobotFile) -> tuple[Any, Any, Quaternion | None]:
    """Compile the model, its base pinned unless free; return spec, model and mounting of the IMU.

    Dense Jacobian: MuJoCo 4.0.0's sparse Newton diverges.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
        base = spec.body(robot.base)
        if base is None:
            names = ", ".join(body.name for body in spec.bodies if body.name)
            raise InvalidInput(
                f"{robot.path}: model.base: no body {robot.base!r} in {robot.mjcf_path}: {names}"
            )
        spec.compiler.fusestatic = False  # bodies that `collision` may name stay bodies, whatever the support
        if robot.support != "free":
            pin(spec, base)
        elif not free_joints(base):
            raise InvalidInput(
                f"{robot.path}: support: free needs a free joint on body {robot.base!r} of {robot.mjcf_path}"
            )
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        apply_identified(spec, robot)
        if robot.imu is not None:
            require_site(spec, robot, robot.imu.site)
            feel(spec, robot.imu.site)
        model = spec.compile()
        require_sane_model(model, robot.mjcf_path)
        return spec, model, None if robot.imu is None else mount(model, robot.imu)
    except InvalidInput:
        raise
    except ValueError as error:  # errors of the parser and the compiler
        raise InvalidInput(f"{robot.mjcf_path}: {' '.join(str(error).split())}") from None


def _model_joint(model: Any, joint: JointSpec, robot: RobotFile) -> int:
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint.model_joint)
    where = f"{robot.path}: joints.{joint.name}"
    if number < 0:
        names = ", ".join(_names(model))
        at = place(robot.path, robot.text_sha256, ("joints", joint.name))
        raise InvalidInput(f"{at}: the model has no joint {joint.model_joint!r}; it has {names}")
    if model.jnt_type[number] != mujoco.mjtJoint.mjJNT_HINGE:
        raise InvalidInput(
            f"{where}: model joint {joint.model_joint!r} is no hinge: only hinges can be driven"
        )
    if model.jnt_limited[number]:
        low, high = model.jnt_range[number]
        if joint.lower < low - TOLERANCE or joint.upper > high + TOLERANCE:
            limits = f"limits {joint.lower:g}..{joint.upper:g} rad"
            at = place(robot.path, robot.text_sha256, ("joints", joint.name, "limits_rad"))
            span = f"{low:g}..{high:g}{_degrees_hint(joint, low, high)}"
            raise InvalidInput(f"{at}: {limits} are outside the model's range {span}")
    return int(number)


def _degrees_hint(joint: JointSpec, low: float, high: float) -> str:
    """Return a hint where the range would fit if the numbers of the model were radians, not degrees."""
    if joint.lower < math.degrees(low) - TOLERANCE or joint.upper > math.degrees(high) + TOLERANCE:
        return ""
    return '; is `<compiler angle="radian"/>` missing in the model? Without it ranges are degrees'


def _names(model: Any) -> list[str]:
    return [model.joint(number).name for number in range(model.njnt)]


def _require_all_mapped(robot: RobotFile, model: Any, mapped: set[int]) -> None:
    """Require that each model joint is driven, passive, or the base's free joint.

    Passive names must exist.
    """
    names = _names(model)
    for name in robot.passive:
        if name not in names:
            raise InvalidInput(
                f"{robot.path}: passive: the model has no joint {name!r}; it has {', '.join(names)}"
            )
    base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, robot.base)
    for number, name in enumerate(names):
        carried = model.jnt_type[number] == mujoco.mjtJoint.mjJNT_FREE and model.jnt_bodyid[number] == base
        if number not in mapped and name not in robot.passive and not carried:
            raise InvalidInput(
                f"{robot.path}: model joint {name or number!r} stands neither in `joints` nor in `passive`"
            )


def position_servo(model: Any, number: int, where: str) -> int:
    """Return the address in ctrl of the position servo that drives a model joint. Raises InvalidInput."""
    driving = np.flatnonzero(
        (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == number)
    )
    if len(driving) != 1:
        raise InvalidInput(f"{where} has {len(driving)} actuators, needs one: <position joint=.../>")
    actuator = int(driving[0])
    pull = model.actuator_gainprm[actuator, 0]
    back = model.actuator_biasprm[actuator, 1]
    if not (pull > 0.0 and math.isclose(pull, -back) and model.actuator_ctrlnum[actuator] == 1):
        raise InvalidInput(f"{where}: its actuator is no position servo: use <position joint=.../>")
    return int(model.actuator_ctrladr[actuator])


# ------------------------------------------------------------------------------------------- the map


def _joint_map(
    robot: RobotFile, known: Mapping[str, JointCalibration], zeros: list[int], reach: list[JointRange]
) -> JointMap:
    return JointMap(
        names=robot.names,
        buses=tuple(_bus_map(robot, bus.name, zeros, reach) for bus in robot.buses),
        calibrated=_calibrated(robot, known),
        turns=_turns(robot, known, reach),
        unwatched=tuple(place for place, joint in enumerate(robot.joints) if not joint.type.watched),
    )


def _calibrated(robot: RobotFile, known: Mapping[str, JointCalibration]) -> tuple[bool, ...]:
    """Return which joints have a measured zero: of a transmission all actuators must have one."""
    whole = {
        name: all(actuator in known for actuator in each.actuators)
        for each in robot.transmissions
        for name in each.joints
    }
    return tuple(whole.get(joint.name, joint.actuator in known) for joint in robot.joints)


def _turns(
    robot: RobotFile, known: Mapping[str, JointCalibration], reach: list[JointRange]
) -> MeasuredTravel:
    """Return the turn on which each actuator was calibrated."""
    entries = [known.get(joint.actuator) for joint in robot.joints]
    sweeps = [(0, 0) if entry is None else entry.sweep_ticks for entry in entries]
    goals = [
        joint.type.goals(
            joint.mode, None if entry is None else (entry.device.min_ticks, entry.device.max_ticks)
        )
        for joint, entry in zip(robot.joints, entries, strict=True)
    ]
    return MeasuredTravel(
        known=np.array([entry is not None for entry in entries], np.bool_),
        whole=np.array([joint.type.ticks_per_turn for joint in robot.joints], np.int64),
        band=np.array([0 if entry is None else entry.turn_band_ticks[0] for entry in entries], np.int64),
        first=np.array([sweep[0] for sweep in sweeps], np.int64),
        last=np.array([sweep[1] for sweep in sweeps], np.int64),
        slack=np.array([slack(joint) for joint in robot.joints], np.int64),
        least=np.array([least for least, _ in goals], np.int64),
        most=np.array([most for _, most in goals], np.int64),
        lower=np.array([each.first for each in reach], np.int64),
        upper=np.array([each.last for each in reach], np.int64),
        falls=np.array([joint.type.fenced(joint.mode) for joint in robot.joints], np.bool_),
        begin=np.array(
            [turn_begin(joint, entry) for joint, entry in zip(robot.joints, entries, strict=True)]
        ),
    )


def _limits(robot: RobotFile, reach: list[JointRange]) -> JointLimits:
    effort = {joint.name: joint.ratio * joint.type.effort_limit_nm for joint in robot.joints}
    by_name = {joint.name: joint for joint in robot.joints}
    for each in robot.transmissions:
        given = strength(each.law, [by_name[name] for name in each.joints])
        effort |= zip(each.joints, given.tolist(), strict=True)
    return JointLimits(
        lower=frozen([each.lower for each in reach]),
        upper=frozen([each.upper for each in reach]),
        hard_lower=frozen([each.hard_lower for each in reach]),
        hard_upper=frozen([each.hard_upper for each in reach]),
        velocity=frozen([joint.velocity_limit for joint in robot.joints]),
        acceleration=frozen([joint.acceleration_limit for joint in robot.joints]),
        effort=frozen([effort[joint.name] for joint in robot.joints]),
    )


def _ratings(robot: RobotFile) -> ActuatorRatings:
    kinds = [joint.type for joint in robot.joints]
    return ActuatorRatings(
        low_warn=frozen([kind.supply.warn for kind in kinds]),
        low_settle=frozen([kind.supply.settle for kind in kinds]),
        low_fault=frozen([kind.supply.fault for kind in kinds]),
        high_warn=frozen([kind.supply.high for kind in kinds]),
        warm=frozen([kind.heat.warn for kind in kinds]),
        hot=frozen([kind.heat.slow for kind in kinds]),
        shut=frozen([kind.heat.settle for kind in kinds]),
        cool=frozen([kind.heat.cool for kind in kinds]),
        continuous=frozen([kind.heat.continuous for kind in kinds]),
        lead=frozen([kind.lead_limit_rad for kind in kinds]),
        stiffness=_stiffness(robot),
        lag=frozen([joint.type.lag_s for joint in robot.joints]),
        follow=frozen([_known(joint.follow_rad) for joint in robot.joints]),
        follow_for=frozen([_known(joint.follow_s) for joint in robot.joints]),
        leg=np.array([joint.name in robot.legs for joint in robot.joints], np.bool_),
    )


def _known(value: float | None) -> float:
    return math.nan if value is None else value


def _stiffness(robot: RobotFile) -> Floats:
    """Return the stiffness of each joint (n,), N·m/rad: identified, else by the figures of its actuator.

    NaN: not identified where a transmission shares it among actuators, or none at all (P gain 0).
    """
    shared = {name for each in robot.transmissions for name in each.joints}
    known = {
        joint.name: math.nan if joint.name in shared else joint.ratio**2 * joint.type.stiffness_nm_per_rad
        for joint in robot.joints
    }
    known |= {name: each.value for name, each in robot.estimates("stiffness_nm_per_rad").items()}
    return frozen([value if value > 0.0 else math.nan for value in known.values()])


def _bus_map(robot: RobotFile, bus: str, zeros: list[int], reach: list[JointRange]) -> JointBusMap:
    """Return the joints of one bus, by id."""
    places = sorted(
        (place for place, joint in enumerate(robot.joints) if joint.bus == bus),
        key=lambda place: robot.joints[place].id,
    )
    joints = [robot.joints[place] for place in places]
    return JointBusMap(
        name=bus,
        joints=np.array(places, np.int64),
        ids=tuple(joint.id for joint in joints),
        zero=np.array([zeros[place] for place in places], np.int64),
        scale=frozen([rad_per_tick(joint) for joint in joints]),
        velocity_scale=frozen([j.sign / j.ratio * j.type.velocity_lsb_rad_s for j in joints]),
        effort_scale=frozen([j.sign * j.ratio * j.type.effort_lsb_nm for j in joints]),
        lower=np.array([reach[place].first for place in places], np.int64),
        upper=np.array([reach[place].last for place in places], np.int64),
        fastest=frozen([j.type.velocity_limit_rad_s * j.type.ticks_per_turn / math.tau for j in joints]),
        load_scale=frozen([1.0 / j.type.full_effort for j in joints]),
        linked=tuple(
            _link(each, [joint.name for joint in joints], dict(zip(robot.names, reach, strict=True)))
            for each in robot.transmissions
            if each.bus == bus
        ),
    )


def _link(spec: TransmissionSpec, names: list[str], reach: Mapping[str, JointRange]) -> MappedTransmission:
    """Return a transmission in terms of the joints `names` of its bus."""
    return MappedTransmission(
        rows=np.array([names.index(name) for name in spec.joints], np.int64),
        law=spec.law,
        lower=frozen([reach[name].hard_lower for name in spec.joints]),
        upper=frozen([reach[name].hard_upper for name in spec.joints]),
    )


__all__ = ["Binding", "InvalidInput", "bind", "rebound"]
