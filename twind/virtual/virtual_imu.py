"""IMU of a virtual robot: a device on its bus with the measurements of the body."""

import numpy as np

from twind.config.robot_spec import ImuSpec, RobotFile
from twind.robot.arrays import Floats
from twind.robot.attitude import Quaternion, matrix, product
from twind.robot.joint_state import Imu
from twind.twin.imu_model import mount_of, still
from twind.twin.mujoco_physics import MujocoPhysics
from twind_drivers.dynamixel.register_sensor import SensorField
from twind_drivers.virtual.virtual_sensor import SensorRegisters, VirtualSensor


def sensor_of(robot: RobotFile, bus: str, body: MujocoPhysics | None) -> VirtualSensor | None:
    """The IMU of that bus, at the `body`, or (None) at a base that stands still; None: there is none."""
    imu = robot.imu
    if imu is None or imu.bus != bus:
        return None
    spec = imu
    turned = mount_of(robot, imu)

    def tell() -> list[Floats]:
        """Return the measurements of the body in the axes of the device."""
        return in_device(still(0.0) if body is None else body.imu(), spec, turned)

    cells = [
        SensorRegisters(SensorField(each.address, each.kind, each.count), each.lsb, each.zero)
        for each in imu.registers
    ]
    return VirtualSensor(imu.id, cells, tell, return_delay=imu.return_delay_us * 1e-6)


def in_device(measured: Imu, imu: ImuSpec, turned: Quaternion) -> list[Floats]:
    """Field by field, in the device's own axes and order. `turned`: from these axes to the base's."""
    back = matrix(turned).T
    values = [back @ measured.gyro, back @ measured.acceleration]
    if imu.quaternion is not None:
        w, x, y, z = measured.quaternion.tolist()
        w, x, y, z = product((w, x, y, z), turned)
        values.append(np.array((w, x, y, z) if imu.quaternion.order == "wxyz" else (x, y, z, w)))
    return values
