"""The learner's model: free, on a floor, with the sensors of a reading; a refusal names what is missing."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from twind.config.robot_file import RobotFile, load_robot
from twind.exceptions import InvalidInput
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import SOLE_SITES, Plant, plant_of

PERIOD = 0.02


def h24() -> RobotFile:
    return load_robot("h24")


def changed(folder: Path, was: str, now: str) -> RobotFile:
    """h24 whose model differs in one text."""
    robot = h24()
    assert was in robot.mjcf
    path = folder / "changed.xml"
    path.write_text(robot.mjcf.replace(was, now))
    return replace(robot, mjcf_path=path)


def moving(plant: Plant, steps: int = 30) -> Any:
    """Its data while it topples, after the position and velocity stages."""
    data = mujoco.MjData(plant.model)
    data.qpos[:] = plant.stance
    data.ctrl[:] = plant.control
    data.qvel[:2] = 0.6, 0.3
    mujoco.mj_step(plant.model, data, steps)
    mujoco.mj_step1(plant.model, data)
    return data


def read(plant: Plant, data: Any) -> BodyReading:
    reading = BodyReading.empty(len(plant.default))
    plant.read(data.qpos, data.qvel, data.sensordata, reading)
    return reading


@pytest.fixture(scope="module")
def plant() -> Plant:
    return plant_of(h24(), period=PERIOD)


@pytest.mark.parametrize("name", ["h24", "h24-standing", "h24-mixed", "h24-split"])
def test_every_built_in_robot_stands_on_its_feet_in_its_pose(name: str) -> None:
    plant = plant_of(load_robot(name), period=PERIOD)
    data = mujoco.MjData(plant.model)
    data.qpos[:] = plant.stance
    data.ctrl[:] = plant.control
    mujoco.mj_step(plant.model, data, 100)
    mujoco.mj_step1(plant.model, data)
    reading = read(plant, data)
    assert float(reading.height) == pytest.approx(plant.height, abs=0.005)
    assert reading.gravity[2] < -0.99
    np.testing.assert_allclose(reading.position, plant.default, atol=0.05)
    assert plant.mass == pytest.approx(4.51, abs=0.01)


def test_looks_are_left_out_unless_wanted_and_change_no_bit_of_the_motion(plant: Plant) -> None:
    seen = plant_of(h24(), period=PERIOD, looks=True)
    assert seen.model.ngeom > plant.model.ngeom == 28
    assert (seen.model.geom_group == 2).any()
    assert not (plant.model.geom_group == 2).any()
    one, other = moving(plant), moving(seen)
    assert np.array_equal(one.qpos, other.qpos)


def test_a_reading_equals_the_ground_truth_of_the_base(plant: Plant) -> None:
    data = moving(plant)
    reading = read(plant, data)
    base = plant.places.base
    turned = data.xmat[base].reshape(3, 3)
    np.testing.assert_allclose(reading.position, data.qpos[7:], atol=0)
    np.testing.assert_allclose(reading.velocity, data.qvel[6:], atol=0)
    np.testing.assert_allclose(reading.gyro, data.qvel[3:6], atol=1e-12)
    np.testing.assert_allclose(reading.gravity, -turned[2], atol=1e-12)
    np.testing.assert_allclose(reading.base_velocity, turned.T @ data.qvel[:3], atol=1e-12)
    soles = np.array([data.site(name).xpos for name in SOLE_SITES])
    np.testing.assert_allclose(reading.soles, (soles - data.xpos[base]) @ turned, atol=1e-12)
    assert reading.soles[0, 1] > 0.0 > reading.soles[1, 1], "the left one comes first, and left is +y"
    assert float(reading.height) == pytest.approx(float(data.xpos[base][2] - soles[:, 2].min()))


def test_only_the_accelerometer_is_where_the_robot_file_has_its_imu(tmp_path: Path) -> None:
    """All other readings are of the base, wherever the IMU is mounted."""
    was = '<site name="imu" pos="0 0 0"/>'
    robot = changed(tmp_path, was, was + '<site name="chest" pos="0.05 0 0.1"/>')
    standing = load_robot("h24-standing")
    assert standing.imu is not None
    chest = replace(standing, mjcf_path=robot.mjcf_path, imu=replace(standing.imu, site="chest"))
    one = plant_of(robot, period=PERIOD)
    other = plant_of(chest, period=PERIOD)
    data = moving(one)
    there = mujoco.MjData(other.model)
    there.qpos[:] = data.qpos
    there.qvel[:] = data.qvel
    there.ctrl[:] = data.ctrl
    for model, state in ((one.model, data), (other.model, there)):
        mujoco.mj_forward(model, state)
    here = read(one, data).base.copy()
    there_told = read(other, there).base.copy()
    turn = data.qvel[3:6]
    turning = data.qacc[3:6]
    arm = np.array([0.05, 0.0, 0.1])
    expected = here[3:6] + np.cross(turning, arm) + np.cross(turn, np.cross(turn, arm))
    np.testing.assert_allclose(there_told[3:6], expected, atol=1e-6)
    assert np.abs(expected - here[3:6]).max() > 0.1
    here[3:6] = there_told[3:6]
    np.testing.assert_allclose(there_told, here, atol=1e-9)


def test_sole_velocities_are_those_of_the_joints_alone(plant: Plant) -> None:
    """Seen from the base: how it turns and moves itself is not in them."""
    data = moving(plant)
    before = read(plant, data)
    dt = 1e-6
    still = mujoco.MjData(plant.model)
    still.qpos[:] = data.qpos
    still.qvel[:] = data.qvel
    still.qpos[7:] += dt * data.qvel[6:]
    mujoco.mj_step1(plant.model, still)
    moved = (read(plant, still).soles - before.soles) / dt
    np.testing.assert_allclose(before.sole_velocities, moved, atol=1e-4)
    assert np.abs(moved).max() > 0.01


def test_many_states_are_read_as_each_alone(plant: Plant) -> None:
    states = [moving(plant, steps) for steps in (5, 40)]
    many = BodyReading.empty(len(plant.default), (2,))
    stacked = [np.stack([getattr(s, name) for s in states]) for name in ("qpos", "qvel", "sensordata")]
    plant.read(*stacked, many)
    for row, state in enumerate(states):
        np.testing.assert_array_equal(many.values[row], read(plant, state).values)


def test_servo_gains_are_given_as_shares_of_their_torque(plant: Plant) -> None:
    np.testing.assert_allclose(plant.stiffness, 38.0 / 4.1)
    np.testing.assert_allclose(plant.braking, 0.85 / 4.1)


def test_control_takes_whole_steps_of_the_physics() -> None:
    plant = plant_of(h24(), period=0.012)
    assert (plant.substeps, plant.model.opt.timestep) == (3, pytest.approx(0.004))


def test_room_for_delays_is_kept_and_nothing_is_delayed_yet() -> None:
    plant = plant_of(h24(), period=PERIOD, action_delay=0.04, imu_delay=0.02)
    assert set(plant.model.actuator_history[plant.places.actuators, 0]) == {8}
    assert set(plant.model.sensor_history[plant.places.imu, 0]) == {4}
    assert not plant.model.actuator_delay.any() and not plant.model.sensor_delay.any()
    assert plant_of(h24(), period=PERIOD).model.nhistory == 0


def test_a_model_without_a_floor_gets_one(tmp_path: Path) -> None:
    floor = '<geom name="floor" type="plane" size="2 2 0.1" rgba="0.4 0.45 0.5 1"/>'
    plant = plant_of(changed(tmp_path, floor, ""), period=PERIOD)
    data = mujoco.MjData(plant.model)
    data.qpos[:] = plant.stance
    data.ctrl[:] = plant.control
    mujoco.mj_step(plant.model, data, 100)
    assert data.qpos[2] == pytest.approx(plant.stance[2], abs=0.005)


def test_a_base_without_a_free_joint_is_refused_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"body 'torso' has no free joint.*add <freejoint/>"):
        plant_of(changed(tmp_path, '<freejoint name="base"/>', ""), period=PERIOD)


def test_a_robot_with_one_foot_is_refused(tmp_path: Path) -> None:
    robot = changed(
        tmp_path,
        '<geom name="l_foot" type="box"',
        '<geom name="l_foot" contype="0" conaffinity="0" type="box"',
    )
    with pytest.raises(InvalidInput, match=r"two feet are needed.*r_foot found lowest"):
        plant_of(robot, period=PERIOD)
