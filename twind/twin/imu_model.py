"""An inertial sensor in the model: its mounting and its readings. Values are in the axes of the base.

Physics computes them at a site of the base body, by added sensors: those of the model may be of any kind.
"""

from typing import Any

import mujoco
import numpy as np

from twind.config.robot_spec import ImuSpec, RobotFile
from twind.config.yaml_tree import place
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.robot.attitude import UPRIGHT, G, Quaternion, conjugate, matrix, product, tilted, unit
from twind.robot.joint_state import Imu

GYRO = "twind gyro"
ACCELERATION = "twind acceleration"
QUATERNION = "twind quaternion"


def mount(model: Any, imu: ImuSpec) -> Quaternion:
    """Return the rotation from the sensor's axes to the base's: of the robot file, else of its site."""
    if imu.rotation is not None:
        w, x, y, z = imu.rotation
        return (w, x, y, z)
    return _of_site(model, imu.site)


def mount_of(robot: RobotFile, imu: ImuSpec) -> Quaternion:
    """Return the mounting for a robot's model."""
    return mount(mujoco.MjModel.from_xml_path(str(robot.mjcf_path)), imu)


def _of_site(model: Any, name: str) -> Quaternion:
    """Return the rotation from the axes of the site to those of its body."""
    w, x, y, z = model.site_quat[model.site(name).id].tolist()
    return unit((w, x, y, z))


def require_site(spec: mujoco.MjSpec, robot: RobotFile, site: str) -> None:
    """Check that the base has such a site. Raises InvalidInput."""
    sites = [each.name for each in spec.body(robot.base).sites if each.name]
    if site not in sites:
        at = place(robot.path, robot.text_sha256, ("sensors", "imu", "site"))
        where = f"{at}: body {robot.base!r} of {robot.mjcf_path}"
        raise InvalidInput(f"{where} has no site {site!r}; it has {', '.join(sites) or 'none'}")


def feel(spec: mujoco.MjSpec, site: str) -> None:
    """Add the sensors to a model, at one of its sites."""
    for name, kind in (
        (GYRO, mujoco.mjtSensor.mjSENS_GYRO),
        (ACCELERATION, mujoco.mjtSensor.mjSENS_ACCELEROMETER),
        (QUATERNION, mujoco.mjtSensor.mjSENS_FRAMEQUAT),
    ):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)


class ImuModel:
    """Readings of the sensors of one compiled model, prepared by `feel`."""

    def __init__(self, model: Any, data: Any, site: str) -> None:
        self._stands = _of_site(model, site)
        self._turn = matrix(self._stands)
        at = [model.sensor(name).adr[0] for name in (GYRO, ACCELERATION, QUATERNION)]
        self._gyro = data.sensordata[at[0] : at[0] + 3]
        self._force = data.sensordata[at[1] : at[1] + 3]
        self._quaternion = data.sensordata[at[2] : at[2] + 4]
        self._gravity = model.opt.gravity

    def read_imu(self, time: float) -> Imu:
        """Return a reading at `time` (s); before the first step of the physics all values are 0."""
        w, x, y, z = self._quaternion.tolist()
        turned = np.array(product(self._laid(), product(unit((w, x, y, z)), conjugate(self._stands))))
        return Imu(time, _kept(self._turn @ self._gyro), _kept(self._turn @ self._force), _kept(turned))

    def _laid(self) -> Quaternion:
        """Return the rotation to a world with up upwards.

        The model of a lying robot has its gravity turned.
        """
        x, y, z = (self._gravity / -max(float(np.linalg.norm(self._gravity)), 1e-9)).tolist()
        return UPRIGHT if z > 1.0 - 1e-12 or x == y == z == 0.0 else tilted(UPRIGHT, (x, y, z))


def still(time: float) -> Imu:
    """Return the reading of a base that stands upright and does not move."""
    return Imu(time, np.zeros(3), np.array([0.0, 0.0, G]), np.array(UPRIGHT))


def _kept(values: Floats) -> Floats:
    values.setflags(write=False)
    return values
