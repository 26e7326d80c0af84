"""Estimate of the base from joints and an IMU: it is the truth as far as a foot stands."""

import mujoco
import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.learn.environment.sim_body import SimBody
from twind.learn.live.base_estimator import BaseEstimator
from twind.learn.randomise.randomisation_ranges import load_ranges
from twind.learn.task.action_shaping import ActionShaper, ActionShaping
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import plant_of
from twind.robot_client.state_message import ImuReading, StateMessage

PLANT = plant_of(load_robot("h24-standing"), period=0.02)


def sensed(body: SimBody, reading: BodyReading) -> StateMessage:
    """Return a daemon's state of the same moment: joints, and the IMU's own orientation."""
    n = len(PLANT.default)
    at = PLANT.places.base_qpos + 3
    imu = ImuReading(
        reading.gyro.copy(), reading.acceleration.copy(), body.data.qpos[at : at + 4].copy(), 0.0
    )
    row = np.zeros(n)
    return StateMessage(0.0, 0.0, 0, reading.position.copy(), reading.velocity.copy(), row, row, imu)


def swaying(seconds: float, size: float) -> list[tuple[BodyReading, BodyReading]]:
    """Truth and estimate of a robot that bends its knees and stretches them."""
    body = SimBody(PLANT, load_ranges("none"), 0.02)
    estimate = BaseEstimator(PLANT)
    shaper = ActionShaper(PLANT.binding.limits, PLANT.default, ActionShaping())
    body.reset(np.random.default_rng(0))
    names = PLANT.layout.joints
    found = []
    for step in range(round(seconds / 0.02)):
        action = np.zeros(len(names))
        bend = size * np.sin(2.0 * np.pi * 0.5 * 0.02 * step)
        for side in "lr":
            for joint, share in (("hip_pitch", -1.0), ("knee", 2.0), ("ankle_pitch", -1.0)):
                action[names.index(f"{side}_{joint}")] = share * bend
        truth = body.advance(*shaper.step(action))
        kept = BodyReading(truth.values.copy())
        found.append((kept, estimate.reading(sensed(body, kept))))
    return found


@pytest.fixture(scope="module")
def swayed() -> list[tuple[BodyReading, BodyReading]]:
    return swaying(4.0, 0.4)


def test_feet_and_gravity_and_height_are_exact(swayed: list[tuple[BodyReading, BodyReading]]) -> None:
    for truth, told in swayed:
        for name in ("position", "velocity", "gyro", "acceleration", "gravity", "height", "soles"):
            assert np.abs(getattr(truth, name) - getattr(told, name)).max() < 1e-6, name
        assert np.abs(truth.sole_velocities - told.sole_velocities).max() < 1e-6


def test_the_estimated_base_velocity_follows_the_standing_feet(
    swayed: list[tuple[BodyReading, BodyReading]],
) -> None:
    true = np.array([truth.base_velocity for truth, _ in swayed])
    told = np.array([told.base_velocity for _, told in swayed])
    assert np.abs(true[25:]).max() > 0.04  # it moves
    error = np.abs(told - true)[25:]
    assert np.sqrt((error**2).mean()) < 0.002
    assert error.max() < 0.005  # m/s


def test_the_heading_changes_nothing(swayed: list[tuple[BodyReading, BodyReading]]) -> None:
    truth, told = swayed[60]
    estimate = BaseEstimator(PLANT)
    turned = np.zeros(4)
    body = SimBody(PLANT, load_ranges("none"), 0.02)
    body.reset(np.random.default_rng(0))
    heard = sensed(body, truth)
    assert heard.inertial is not None
    straight = estimate.reading(heard).values.copy()
    mujoco.mju_mulQuat(turned, np.array([np.cos(0.6), 0.0, 0.0, np.sin(0.6)]), heard.inertial.quaternion)
    heard.inertial.quaternion[:] = turned
    assert np.abs(estimate.reading(heard).values - straight).max() < 1e-9
    assert told.values.shape == straight.shape
