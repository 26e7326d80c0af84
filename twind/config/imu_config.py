"""The section `sensors` of a robot file: an inertial sensor (IMU) on a serial bus, register by register.

Knows the file alone; that the site exists is `twin/binding.py`'s to say.
"""

import math
from collections.abc import Sequence

from twind.config.config_section import ConfigSection
from twind.config.robot_spec import BusSpec, ImuSpec, JointSpec, RegistersSpec

TYPES = {"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "float32": 4}  # bytes, little-endian
MOST = 128  # bytes from the first register to the last: they are read in one answer
LAST_ID = 252
UNIT = 0.01  # how far the length of a rotation may be from 1


def imu_of(top: ConfigSection, wires: Sequence[BusSpec], joints: Sequence[JointSpec]) -> ImuSpec | None:
    """The IMU that the file describes; None: none. Raises ConfigError."""
    if not top.has("sensors"):
        return None
    sensors = top.section("sensors")
    if not sensors.has("imu"):
        sensors.close()
        return None
    section = sensors.section("imu")
    bus = section.text("bus", choices=[each.name for each in wires])
    _require_serial(section, next(each for each in wires if each.name == bus))
    spec = ImuSpec(
        bus=bus,
        id=_free_id(section, bus, joints),
        site=section.text("site"),
        rotation=_rotation(section),
        return_delay_us=section.number("return_delay_us", 500.0, least=0.0, most=508.0),
        gyro=_registers(section, "gyro", "lsb_rad_s", 3),
        acceleration=_registers(section, "acceleration", "lsb_m_s2", 3),
        quaternion=_registers(section, "quaternion", "lsb", 4) if section.has("quaternion") else None,
    )
    first, size = spec.span
    if size > MOST:
        reach = f"registers {first}..{first + size - 1} are {size} bytes"
        raise sensors.refuse("imu", f"{reach}, at most {MOST} are read in one answer")
    section.close()
    sensors.close()
    return spec


def _require_serial(section: ConfigSection, bus: BusSpec) -> None:
    if bus.kind != "dynamixel2":
        raise section.refuse("bus", f"{bus.name} is of kind {bus.kind}: an IMU is read on a dynamixel2 bus")


def _free_id(section: ConfigSection, bus: str, joints: Sequence[JointSpec]) -> int:
    id = section.integer("id", least=0, most=LAST_ID)
    for joint in joints:
        if (joint.bus, joint.id) == (bus, id):
            raise section.refuse("id", f"{id} on bus {bus} is that of joint {joint.name}")
    return id


def _rotation(section: ConfigSection) -> tuple[float, ...] | None:
    """Return the rotation of the sensor, a quaternion w x y z of unit length to the last digit.

    None: not given, aligned with the site. A length other than 1 is refused.
    """
    if not section.has("rotation"):
        return None
    given = section.numbers("rotation", 4)
    length = math.sqrt(sum(each * each for each in given))
    if not abs(length - 1.0) <= UNIT:
        raise section.refuse("rotation", f"a quaternion w x y z has length 1, this one {length:.4g}")
    return tuple(each / length for each in given)


def _registers(section: ConfigSection, key: str, lsb: str, count: int) -> RegistersSpec:
    if not section.has(key):
        raise section.refuse(key, "is required and missing: address, type and " + lsb)
    own = section.section(key)
    kind = own.text("type", choices=tuple(TYPES))
    found = RegistersSpec(
        address=own.integer("address", least=0, most=65535),
        type=kind,
        count=count,
        size=TYPES[kind],
        lsb=own.number(lsb, 1.0 if kind == "float32" else None, above=0.0),
        zero=own.number("zero", 0.0),
        order=own.text("order", "wxyz", ("wxyz", "xyzw")) if count == 4 else "xyz",
    )
    own.close()
    return found
