"""The built-in robot: a body that its servos can carry, and motions that nothing refuses."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.ctl.offline_check import motions_of, standing
from twind.robot import splines
from twind.robot.arrays import Floats
from twind.robot.trajectory import Reference
from twind.safety.gate import GateThresholds, TrajectoryRequest, check
from twind.twin.binding import bind
from twind.twin.mirror import TwinMirror
from twind.twin.simulation import Simulation, hush

H24 = load_robot("h24")
BINDING = bind(H24, None)
PERIOD = 1.0 / BINDING.robot.rate_hz  # s
COUNT = len(H24.joints)
STALL = 4.1  # N·m, XM430-W350 at 12 V
MOTIONS, _ = motions_of(H24)
# What is simulated: policies, captures and figures of the documents rest on it. Right is as left.
BODIES = {  # g, and moments of inertia, g mm²
    "torso": (950, 2921250, 2422500, 1781250),
    "neck": (90, 17340, 14550, 14550),
    "head": (220, 178200, 178200, 178200),
    "l_shoulder": (90, 17340, 14550, 14550),
    "l_upper_arm_top": (100, 19267, 16167, 16167),
    "l_upper_arm": (120, 80519, 80519, 22433),
    "l_forearm": (120, 136357, 136357, 20659),
    "waist": (100, 19267, 16167, 16167),
    "pelvis": (450, 547500, 333750, 693750),
    "l_hip": (60, 11560, 9700, 9700),
    "l_hip_cross": (150, 28900, 24250, 24250),
    "l_thigh": (260, 287939, 287939, 82059),
    "l_shank": (220, 176966, 176966, 49744),
    "l_ankle": (110, 21193, 17783, 17783),
    "l_foot": (120, 44960, 148000, 184960),
}
COLLIDING = {  # of the body with the same name but l_hand: size, and place in it, mm
    "floor": (2000, 2000, 100, 0, 0, 0),
    "torso": (45, 60, 75, 0, 0, 0),
    "head": (45, 0, 0, 0, 0, 25),
    "l_upper_arm": (20, 27.5, 0, 0, 0, -47.5),
    "l_forearm": (18, 30, 0, 0, 0, -50),
    "l_hand": (24, 0, 0, 0, 0, -105),
    "pelvis": (40, 55, 25, 0, 0, -35),
    "l_thigh": (26, 35, 0, 0, 0, -55),
    "l_shank": (22, 30, 0, 0, 0, -60),
    "l_foot": (60, 32, 10, 12, 0, -25),
}


def at(position: Floats) -> Reference:
    return Reference(position, np.zeros(COUNT), np.zeros(COUNT))


def test_h24_has_the_24_joints_of_a_humanoid_in_one_order() -> None:
    assert COUNT == 24
    counts = {part: sum(part in name for name in H24.names) for part in ("head_", "waist_")}
    assert counts == {"head_": 2, "waist_": 2}
    arms = [name for name in H24.names if "shoulder" in name or "elbow" in name]
    legs = [name for name in H24.names if any(part in name for part in ("hip", "knee", "ankle"))]
    assert (len(arms), len(legs)) == (8, 12)
    assert [joint.id for joint in H24.joints] == list(range(1, 25))
    assert {joint.type.device for joint in H24.joints} == {"XM430-W350"}


def test_h24_split_is_the_same_body_on_two_buses() -> None:
    split = load_robot("h24-split")
    assert [bus.baud for bus in split.buses] == [1_000_000, 1_000_000]
    assert [bus.baud for bus in H24.buses] == [2_000_000]
    assert split.mjcf == H24.mjcf
    assert split.poses == H24.poses
    same = [(j.name, j.sign, j.ratio, j.lower, j.upper) for j in split.joints]
    assert same == [(j.name, j.sign, j.ratio, j.lower, j.upper) for j in H24.joints]


def test_both_hang_on_a_gantry_and_settle_at_zero() -> None:
    for name in ("h24", "h24-split"):
        robot = load_robot(name)
        assert robot.support == "gantry"
        assert set(robot.poses["rest"].values()) == {0.0}


def test_the_body_is_one_that_xm430_can_carry() -> None:
    model = BINDING.model
    assert 4.0 < model.body_mass.sum() < 5.0
    assert np.allclose(model.actuator_forcerange, [-STALL, STALL])
    assert model.opt.timestep <= 0.005
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def test_bodies_weigh_and_collide_as_ever_whatever_they_look_like() -> None:
    model = BINDING.model
    left = [number for number in range(1, model.nbody) if not model.body(number).name.startswith("r_")]
    assert [model.body(number).name for number in left] == list(BODIES)
    units = np.array([1e3, 1e9, 1e9, 1e9])
    measured = np.column_stack([model.body_mass, model.body_inertia])[left] * units
    assert np.abs(measured - list(BODIES.values())).max() < 0.5
    collides = model.geom_contype | model.geom_conaffinity
    solid = [number for number in np.flatnonzero(collides) if not model.geom(number).name.startswith("r_")]
    assert [model.geom(number).name for number in solid] == list(COLLIDING)
    shapes = np.hstack([model.geom_size, model.geom_pos])[solid] * 1e3
    assert np.allclose(shapes, list(COLLIDING.values()), atol=1e-6)
    looks = model.geom_group == 2
    assert looks.any()
    assert not collides[looks].any()


def test_left_and_right_are_mirror_images() -> None:
    model = BINDING.model
    data = mujoco.MjData(BINDING.model)
    mujoco.mj_kinematics(model, data)
    for number in range(model.nbody):
        name = model.body(number).name
        if name.startswith("l_"):
            other = model.body("r_" + name[2:]).id
            assert np.allclose(data.xpos[number] * [1, -1, 1], data.xpos[other])
            assert model.body_mass[number] == model.body_mass[other]
            assert np.allclose(model.body_inertia[number], model.body_inertia[other])
            shapes = [
                model.geom_size[(model.geom_bodyid == each) & (model.geom_contype > 0)]
                for each in (number, other)
            ]
            assert np.array_equal(*shapes)
    for joint in H24.joints:
        if joint.name.startswith("l_"):
            other_joint = H24.joints[H24.names.index("r_" + joint.name[2:])]
            mirrored = "roll" in joint.name or "yaw" in joint.name
            bounds = (-joint.upper, -joint.lower) if mirrored else (joint.lower, joint.upper)
            assert (other_joint.lower, other_joint.upper) == bounds


def test_the_model_has_an_imu_a_floor_and_colliding_pairs() -> None:
    model = BINDING.model
    assert model.site("imu").bodyid[0] == model.body("torso").id
    assert {model.sensor(i).name for i in range(model.nsensor)} >= {
        "imu_gyro",
        "imu_acceleration",
        "imu_quaternion",
    }
    assert model.geom("floor").type[0] == mujoco.mjtGeom.mjGEOM_PLANE
    data = mujoco.MjData(model)
    pose = np.zeros(COUNT)
    pose[[H24.names.index(f"{side}_hip_roll") for side in "lr"]] = -0.4, 0.4
    data.qpos[BINDING.qpos] = pose
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    assert data.ncon > 0  # the legs meet


@pytest.mark.parametrize("name", list(H24.poses))
def test_poses_are_light_to_hold(name: str) -> None:
    pose = np.array([H24.poses[name][joint] for joint in H24.names])
    data = mujoco.MjData(BINDING.model)
    data.qpos[BINDING.qpos] = pose
    mujoco.mj_inverse(BINDING.model, data)
    assert np.abs(data.qfrc_inverse).max() < 0.5 * STALL


def test_torque_off_at_rest_moves_less_than_two_counts() -> None:
    hush()
    simulation = Simulation(BINDING, 0.01)
    simulation.model.actuator_gainprm[:] = 0.0
    simulation.model.actuator_biasprm[:] = 0.0  # limp: friction alone
    for _ in range(300):
        simulation.step(None)
    assert np.abs(simulation.state(0.0).position).max() < 2 * 2 * np.pi / 4096


def test_a_standing_h24_stands_on_its_own_servos() -> None:
    hush()
    binding = bind(replace(H24, support="free"), None)
    simulation = Simulation(binding, 0.01)
    pose = np.array([H24.poses["stand"][name] for name in H24.names])
    simulation.place(pose)
    for _ in range(200):
        simulation.step(pose)
    assert simulation.data.qpos[2] > 0.40  # torso height
    assert np.abs(simulation.state(0.0).effort).max() < 0.5 * STALL


def test_there_are_three_motions_of_every_kind_of_curve() -> None:
    assert sorted(MOTIONS) == ["reach", "squat", "wave"]
    kinds = {(m.velocity is not None) + (m.acceleration is not None) for m in MOTIONS.values()}
    assert kinds == {0, 1, 2}


@pytest.mark.parametrize("name", MOTIONS)
def test_a_motion_starts_and_ends_at_rest_and_the_gate_refuses_nothing(name: str) -> None:
    trajectory = MOTIONS[name]
    rest = BINDING.rest
    ends = trajectory.position[[0, -1]] - rest
    assert np.abs(ends[:, trajectory.commanded]).max() < 1e-9
    verdict = check(
        trajectory, standing(rest, PERIOD), BINDING.limits, TrajectoryRequest(), GateThresholds()
    ).verdict
    assert (verdict.refusals, verdict.warnings, verdict.changes) == ((), (), ())
    sagged = np.linspace(-0.03, 0.03, COUNT)  # rad: limp joints hang beside the rest pose
    found = check(trajectory, standing(sagged, PERIOD), BINDING.limits, TrajectoryRequest(), GateThresholds())
    assert found.verdict.accepted


@pytest.mark.parametrize("name", MOTIONS)
def test_a_motion_stays_within_the_strength_of_the_servos(name: str) -> None:
    curve = splines.interpolate(MOTIONS[name], at(np.array(BINDING.rest)))
    mirror = TwinMirror(BINDING)
    data = mujoco.MjData(mirror.model)
    for t in np.arange(0.0, curve.duration, 0.1):
        reference = curve.sample(float(t))
        assert reference is not None
        data.qpos[:] = reference.position
        data.qvel[:] = reference.velocity
        data.qacc[:] = reference.acceleration
        mujoco.mj_inverse(mirror.model, data)
        assert np.abs(data.qfrc_inverse).max() < 0.5 * STALL


@pytest.mark.parametrize("name", MOTIONS)
def test_the_simulation_tracks_a_motion_and_comes_to_rest(name: str) -> None:
    hush()
    curve = splines.interpolate(MOTIONS[name], at(np.array(BINDING.rest)))
    simulation = Simulation(BINDING, 0.01)
    worst = 0.0
    for t in np.arange(0.0, curve.duration + 1.0, 0.01):
        reference = curve.sample(float(t))
        assert reference is not None
        simulation.step(reference.position)
        state = simulation.state(float(t))
        worst = max(worst, float(np.abs(state.position - reference.position).max()))
    assert worst < 0.05
    assert np.abs(state.velocity).max() < 0.01
    assert simulation.warnings == 0
