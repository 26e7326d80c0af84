"""A reading without measurement of the base: gravity from its IMU, feet and base from joints and gyro.

Leg odometry: what is lowest stands still. Where nothing stands, or a foot slips or tips, the base's velocity
is wrong by as much; its height is that above the lower sole in any case.
"""

import mujoco
import numpy as np

from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import Plant
from twind.robot.arrays import Floats
from twind.robot_client.state_message import StateMessage

BOTH = 0.01  # m: within this of the lower sole the other one stands too, the less the higher it is


class BaseEstimator:
    """Readings of one robot. Owns its MuJoCo data; not for several threads at once."""

    def __init__(self, plant: Plant) -> None:
        """`plant`: without delays."""
        # data: as it stood at the last reading
        self._plant = plant
        self.data = mujoco.MjData(plant.model)
        places = plant.places
        self._height = places.base_qpos + 2
        self._turn = slice(places.base_qpos + 3, places.base_qpos + 7)
        self._spin = slice(places.base_dof + 3, places.base_dof + 6)

    def reading(self, state: StateMessage) -> BodyReading:
        """Return a new reading as of a simulated body. The state must be fresh: it is not checked."""
        imu = state.inertial
        assert imu is not None, "the caller has checked that the state is fresh"
        plant = self._plant
        data = self.data
        data.qpos[plant.position] = state.position
        data.qvel[plant.speed] = state.velocity
        data.qpos[self._turn] = imu.quaternion
        data.qvel[self._spin] = imu.gyro
        self._follow()
        reading = BodyReading.empty(len(state.position))
        plant.read(data.qpos, data.qvel, data.sensordata, reading)
        reading.gyro[...] = imu.gyro
        reading.acceleration[...] = imu.acceleration
        reading.base_velocity[...] = odometry(reading)
        data.qpos[self._height] = reading.height  # for a picture; no sensor tells it
        return reading

    def _follow(self) -> None:
        """Places, velocities and sensors of the pose; no contacts, no forces."""
        model = self._plant.model
        data = self.data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_sensorPos(model, data)
        mujoco.mj_sensorVel(model, data)


def odometry(reading: BodyReading) -> Floats:
    """Return the velocity of the base (3,), m/s, base frame, if the lowest sole stands still."""
    x, y, z = reading.gyro
    turning = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    depth = reading.soles @ reading.gravity
    share = np.maximum(1.0 - (depth.max() - depth) / BOTH, 0.0)
    moving: Floats = share @ (reading.soles @ turning.T + reading.sole_velocities)
    still: Floats = -moving / share.sum()
    return still
