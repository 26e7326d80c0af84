"""The section `sensors` of a robot file: an inertial sensor (IMU) on a serial bus, register by register.

Knows the file alone; that the site exists is `twin/binding.py`'s to say.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.config_reader import ConfigReader, ConfigStruct, Text
from twind.config.driver_family import families, family
from twind.config.robot_spec import BusSpec, ImuSpec, JointSpec, RegistersSpec

TYPES = {"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "float32": 4}  # bytes, little-endian
MOST = 128  # bytes from the first register to the last: they are read in one answer
UNIT = 0.01  # how far the length of a rotation may be from 1

Lsb = Annotated[float, Meta(gt=0.0)]  # SI per count


class RegistersKeys(ConfigStruct):
    """Registers of one quantity: value = (raw - zero) * lsb."""

    type: Literal["int8", "uint8", "int16", "uint16", "int32", "float32"]
    """little-endian"""
    address: Annotated[int, Meta(ge=0, le=65535)]
    """first of adjacent registers: x, y, z; of the optional `quaternion` four, to the world's axes"""
    zero: float = 0.0
    """number | | raw value that means 0"""


class GyroKeys(RegistersKeys):
    """Section `gyro`."""

    lsb_rad_s: Lsb | None = None
    """| 1 for `float32`, else required | rad/s or m/s² per count"""


class AccelerationKeys(RegistersKeys):
    """Section `acceleration`."""

    lsb_m_s2: Lsb | None = None
    """| 1 for `float32`, else required | rad/s or m/s² per count"""


class QuaternionKeys(RegistersKeys):
    """Section `quaternion`."""

    lsb: Lsb | None = None
    """| 1 for `float32`, else required | 1 per count"""
    order: Literal["wxyz", "xyzw"] = "wxyz"


class ImuKeys(ConfigStruct, kw_only=True):
    """Section `sensors.imu`."""

    bus: Text
    """bus | required with `sensors.imu` | servo bus of [the IMU](#an-imu-on-a-bus)"""
    id: Annotated[int, Meta(ge=0, le=252)]
    """unused by servos of that bus"""
    site: Text
    """site | | site on the model's base body"""
    rotation: tuple[float, float, float, float] | None = None
    """w, x, y, z | the site's | from the device's axes to the base's"""
    return_delay_us: Annotated[float, Meta(ge=0.0, le=508.0)] = 500.0
    """longest time from request to answer"""
    gyro: GyroKeys
    acceleration: AccelerationKeys
    quaternion: QuaternionKeys | None = None


class SensorKeys(ConfigStruct):
    """Section `sensors`."""

    imu: ImuKeys | None = None


def imu_of(top: ConfigReader, wires: Sequence[BusSpec], joints: Sequence[JointSpec]) -> ImuSpec | None:
    """The IMU that the file describes; None: none. Raises ConfigError."""
    sensors = top.section("sensors")
    given = sensors.read(SensorKeys).imu
    if given is None:
        return None
    section = sensors.section("imu")
    _require_place(section, given, wires, joints)
    spec = ImuSpec(
        bus=given.bus,
        id=given.id,
        site=given.site,
        rotation=_unit_length(section, given.rotation),
        return_delay_us=given.return_delay_us,
        gyro=_registers(section, "gyro", given.gyro, "lsb_rad_s"),
        acceleration=_registers(section, "acceleration", given.acceleration, "lsb_m_s2"),
        quaternion=_registers(section, "quaternion", given.quaternion, "lsb") if given.quaternion else None,
    )
    first, size = spec.span
    if size > MOST:
        reach = f"registers {first}..{first + size - 1} are {size} bytes"
        raise sensors.refuse("imu", f"{reach}, at most {MOST} are read in one answer")
    return spec


def _require_place(
    section: ConfigReader, given: ImuKeys, wires: Sequence[BusSpec], joints: Sequence[JointSpec]
) -> None:
    """Raises ConfigError unless it is on a bus of servos, under an id of its own."""
    name = section.choice("bus", [each.name for each in wires])
    bus = next(each for each in wires if each.name == name)
    if not family(bus.kind).takes_imu:
        takers = " or ".join(each.kind for each in families() if each.takes_imu)
        raise section.refuse("bus", f"{name} is of kind {bus.kind}: an IMU is read on a {takers} bus")
    for joint in joints:
        if (joint.bus, joint.id) == (name, given.id):
            raise section.refuse("id", f"{given.id} on bus {name} is that of joint {joint.name}")


def _unit_length(section: ConfigReader, given: tuple[float, ...] | None) -> tuple[float, ...] | None:
    """Rotation of the sensor, a quaternion w x y z of unit length to the last digit. Raises ConfigError."""
    if given is None:
        return None
    length = math.sqrt(sum(each * each for each in given))
    if not abs(length - 1.0) <= UNIT:
        raise section.refuse("rotation", f"a quaternion w x y z has length 1, this one {length:.4g}")
    return tuple(each / length for each in given)


def _registers(section: ConfigReader, key: str, given: RegistersKeys, unit: str) -> RegistersSpec:
    """Registers of one quantity, whose value of a count stands under the key `unit`."""
    lsb: float | None = getattr(given, unit)
    if lsb is None and given.type != "float32":
        raise section.section(key).refuse(unit, "is required and missing")
    return RegistersSpec(
        address=given.address,
        type=given.type,
        count=4 if isinstance(given, QuaternionKeys) else 3,
        size=TYPES[given.type],
        lsb=1.0 if lsb is None else lsb,
        zero=given.zero,
        order=given.order if isinstance(given, QuaternionKeys) else "xyz",
    )
