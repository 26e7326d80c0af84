"""The learner's model of a robot file: free on a floor, with an observation's sensors and room for delays.

A robot that hangs on a gantry is lowered to the floor; a model without a floor gets one. Names, limits,
addresses and feet come from the twin's binding.
"""

from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from twind.config.robot_file import RobotFile
from twind.exceptions import InvalidInput
from twind.learn.randomise.physics_randomiser import ModelAddresses
from twind.learn.task.observation import BodyReading, height_of
from twind.learn.task.observation_layout import ObservationLayout
from twind.robot.arrays import Floats, Ints, frozen
from twind.twin.base_pose import stand
from twind.twin.binding import Binding, bind
from twind.twin.identified_model import apply_identified
from twind.twin.mirror import index
from twind.twin.pinning import free_joints
from twind.twin.standing_feet import StandingFeet

BASE_SITE = "twind_base"
IMU_SITE = "twind_imu"
DOWN_SITE = "twind_down"
SOLE_SITES = ("twind_left_sole", "twind_right_sole")
IMU = 9  # first numbers of sensordata: gyro, accelerometer, which way is down; the IMU's delay is theirs
FORCE = slice(3, 6)
DOWN = slice(6, 9)
EVERYTHING = 0x7FFFFFFF  # collision bits of a floor that we lay


@dataclass(frozen=True, slots=True)
class Plant:
    """A robot as a learner simulates it. Arrays in joint order."""

    binding: Binding  # names and limits; its own model lacks what is added here
    model: Any  # mujoco.MjModel, as compiled: who changes it changes a copy
    places: ModelAddresses
    layout: ObservationLayout
    default: Floats  # rad, (n,): the pose `stand` of the robot file, else `rest`
    stance: Floats  # (nq,): standing in it
    control: Floats  # (nu,): holding it
    height: float  # m, of the base above the soles in it
    weight: float  # m/s², gravity
    position: slice | Ints  # of the joints in qpos
    speed: slice | Ints  # in qvel
    goals: slice | Ints  # in ctrl
    stiffness: Floats  # 1/rad, (n,): share of its torque that a servo uses per rad of lag
    braking: Floats  # s/rad, (n,): and per rad/s of its own speed
    substeps: int  # of the physics per control period

    @property
    def mass(self) -> float:
        """Mass of the whole robot, kg."""
        return float(self.model.body_subtreemass[self.places.base])

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the robot's bodies, in the order of a draw."""
        return tuple(self.model.body(body).name for body in self.places.links)

    def parts(self, qpos: Floats, qvel: Floats, sensordata: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the parts of a reading from a state as in `read`: positions, velocities, IMU, rest.

        They are views where the joints are one run in the model (`steady`), and may then be kept.
        """
        position = qpos[..., self.position]
        velocity = qvel[..., self.speed]
        return position, velocity, sensordata[..., :IMU], sensordata[..., IMU:]

    @property
    def steady(self) -> bool:
        """`parts` are views."""
        return isinstance(self.position, slice) and isinstance(self.speed, slice)

    def rest(self, sensordata: Floats) -> None:
        """Set the accelerometer to its reading on a robot at rest, which is still held.

        A robot that is put on the floor does not weigh on it: it would begin in free fall. `sensordata` is of
        one robot.
        """
        x, y, z = sensordata[DOWN].tolist()
        sensordata[FORCE] = -self.weight * x, -self.weight * y, -self.weight * z

    def read(self, qpos: Floats, qvel: Floats, sensordata: Floats, reading: BodyReading) -> None:
        """Fill `reading` from a state (…, nq), (…, nv), (…, nsensordata): of one robot or of many."""
        fill(reading, *self.parts(qpos, qvel, sensordata))


def fill(reading: BodyReading, position: Floats, velocity: Floats, imu: Floats, rest: Floats) -> None:
    """Put the parts of a state into `reading`."""
    reading.position[...] = position
    reading.velocity[...] = velocity
    base = reading.base
    base[..., :IMU], base[..., IMU + 1 :] = imu, rest
    reading.height[...] = height_of(base)


def plant_of(
    robot: RobotFile,
    *,
    period: float,
    action_delay: float = 0.0,
    imu_delay: float = 0.0,
    looks: bool = False,
) -> Plant:
    """`period`: s, of control; the model's timestep is shortened to divide it.

    Delays: s, the most that is ever wanted; the plant has none until they are set. `looks`: with the geoms
    that are only seen. Raises InvalidInput: no free base, not two feet, or what `bind` finds.
    """
    binding = bind(_freed(robot), None)
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    substeps = max(1, int(np.ceil(period / spec.option.timestep - 1e-9)))
    spec.option.timestep = period / substeps
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # as in `bind`
    # One robot is one island: to look for more cost 6 % of a step (h24 standing, measured).
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    for element in [*spec.sensors, *spec.keys]:  # its own would stand between ours, or lack a joint
        spec.delete(element)
    if not looks:  # those of h24 cost 11 % of a step (standing, measured)
        for geom in [geom for geom in spec.geoms if _is_only_seen(geom)]:
            spec.delete(geom)
    _floor(spec)
    _sensors(spec, binding, round(imu_delay / spec.option.timestep))
    apply_identified(spec, robot, delays=False)  # they are drawn, see `action_delay`
    for actuator in spec.actuators:
        actuator.nsample = round(action_delay / spec.option.timestep)
    model = spec.compile()
    places = _places(model, binding)
    default = frozen([robot.poses.get("stand", robot.poses["rest"])[name] for name in robot.names])
    stance, control, height = _standing(model, binding, default)
    gain = model.actuator_gainprm[places.actuators, 0]
    bias = model.actuator_biasprm[places.actuators, 2]
    torque = _torque(model, binding, places)
    return Plant(
        binding=binding,
        model=model,
        places=places,
        layout=ObservationLayout(robot.names),
        default=default,
        stance=stance,
        control=control,
        height=height,
        weight=float(np.linalg.norm(model.opt.gravity)),
        position=index(binding.qpos),
        speed=index(binding.dof),
        goals=index(binding.actuators),
        stiffness=frozen(gain / torque),
        braking=frozen(-bias / torque),
        substeps=substeps,
    )


def _freed(robot: RobotFile) -> RobotFile:
    """Return the robot without what holds it. Raises InvalidInput if nothing could let it move."""
    base = mujoco.MjSpec.from_file(str(robot.mjcf_path)).body(robot.base)
    if base is not None and not free_joints(base):
        raise InvalidInput(
            f"{robot.mjcf_path}: body {robot.base!r} has no free joint, so the robot cannot stand or fall by "
            "itself: add <freejoint/> (a robot with support gantry or fixed has it removed by the daemon)"
        )
    return replace(robot, support="free")


def _is_only_seen(geom: Any) -> bool:
    """True for a geom without mass that collides with nothing."""
    return not (geom.contype or geom.conaffinity) and geom.mass == 0.0


def _floor(spec: Any) -> None:
    """Add a floor, unless the world has a body that can be stood on."""
    if not any(geom.contype or geom.conaffinity for geom in spec.worldbody.geoms):
        floor = spec.worldbody.add_geom(name="twind_floor", type=mujoco.mjtGeom.mjGEOM_PLANE)
        floor.size = [0.0, 0.0, 0.1]
        floor.contype = EVERYTHING
        floor.conaffinity = EVERYTHING


def _sensors(spec: Any, binding: Binding, imu_samples: int) -> None:
    """Add the sensors of a reading, in its order; height follows from them (`height_of`)."""
    base = spec.body(binding.robot.base)
    kind = mujoco.mjtSensor
    base.add_site(name=BASE_SITE)
    base.add_site(name=IMU_SITE, pos=_imu(spec, binding.robot))  # in the axes of the base, as on a robot
    spec.worldbody.add_site(name=DOWN_SITE, quat=[0.0, 1.0, 0.0, 0.0])  # its z axis points down
    for name, (body, place) in zip(SOLE_SITES, _soles(binding), strict=True):
        spec.body(binding.model.body(body).name).add_site(name=name, pos=place)
    sites = [
        (kind.mjSENS_GYRO, BASE_SITE, False),
        (kind.mjSENS_ACCELEROMETER, IMU_SITE, False),
        (kind.mjSENS_FRAMEZAXIS, DOWN_SITE, True),
        (kind.mjSENS_VELOCIMETER, BASE_SITE, False),
        *((kind.mjSENS_FRAMEPOS, sole, True) for sole in SOLE_SITES),
        *((kind.mjSENS_FRAMELINVEL, sole, True) for sole in SOLE_SITES),
    ]
    for number, (sensor, site, seen_from_base) in enumerate(sites):
        added = spec.add_sensor(name=f"twind_{number}", type=sensor, objname=site)
        added.objtype = mujoco.mjtObj.mjOBJ_SITE
        if seen_from_base:
            added.reftype = mujoco.mjtObj.mjOBJ_SITE
            added.refname = BASE_SITE
        if 3 * number < IMU:
            added.nsample = imu_samples


def _imu(spec: Any, robot: RobotFile) -> Any:
    """Return the place of the IMU on the base: the site of the robot file, else `imu`, else its origin."""
    wanted = "imu" if robot.imu is None else robot.imu.site
    return next((site.pos for site in spec.body(robot.base).sites if site.name == wanted), [0.0, 0.0, 0.0])


def _soles(binding: Binding) -> list[tuple[int, Floats]]:
    """Body and place of the left and the right sole. Raises InvalidInput: the robot has not two feet."""
    data = mujoco.MjData(binding.model)
    found = StandingFeet(binding, binding.model, data).soles()
    if len(found) != 2:
        names = ", ".join(binding.model.body(body).name for body, _ in found) or "nothing"
        raise InvalidInput(
            f"{binding.robot.mjcf_path}: two feet are needed, lowest in the rest pose: {names} found lowest; "
            "give each foot one body with a box, capsule, cylinder, sphere or mesh that collides"
        )
    found.sort(key=lambda sole: -float(data.xpos[sole[0], 1]))  # the left one first: y points left
    return found


def _places(model: Any, binding: Binding) -> ModelAddresses:
    base = int(model.body(binding.robot.base).id)
    free = int(model.body_jntadr[base])
    joints = [int(model.joint(joint.model_joint).id) for joint in binding.robot.joints]
    return ModelAddresses(
        links=np.flatnonzero(model.body_rootid == model.body_rootid[base]).astype(np.int64),
        base=base,
        joints=np.array(joints, np.int64),
        qpos=binding.qpos,
        dof=binding.dof,
        base_qpos=int(model.jnt_qposadr[free]),
        base_dof=int(model.jnt_dofadr[free]),
        actuators=np.array(
            [np.flatnonzero(model.actuator_ctrladr == goal)[0] for goal in binding.actuators], np.int64
        ),
        imu=np.arange(IMU // 3, dtype=np.int64),
    )


def _standing(model: Any, binding: Binding, pose: Floats) -> tuple[Floats, Floats, float]:
    """qpos, ctrl and height of the base: on the floor in `pose`, upright."""
    data = mujoco.MjData(model)
    data.qpos[binding.qpos] = pose
    data.ctrl[binding.actuators] = pose
    stand(model, data, binding.robot.base)
    mujoco.mj_forward(model, data)
    base = data.site(BASE_SITE).xpos[2]
    lower = min(data.site(name).xpos[2] for name in SOLE_SITES)
    return frozen(data.qpos), frozen(data.ctrl), float(base - lower)


def _torque(model: Any, binding: Binding, places: ModelAddresses) -> Floats:
    """The most that each servo gives, N·m: of the model, else of the robot file."""
    limited = model.actuator_forcelimited[places.actuators] != 0
    given = model.actuator_forcerange[places.actuators, 1]
    return np.where(limited, given, binding.limits.effort)
