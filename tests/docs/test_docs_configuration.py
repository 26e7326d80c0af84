"""docs/configuration.md names every key of settings and robot file, and no other; with the right defaults."""

import re
from dataclasses import is_dataclass
from pathlib import Path
from typing import get_args

from tests.support.doc_pages_text import ROOT, table
from twind.config.actuator_types import CanType, ServoType
from twind.config.bus_config import CanBusKeys, SerialBusKeys
from twind.config.can_type import CanSlotKeys, CanTypeKeys
from twind.config.collision_config import CollisionKeys
from twind.config.config_reader import ConfigStruct, keys_of
from twind.config.daemon_settings import SettingsKeys, load_settings
from twind.config.imu_config import SensorKeys
from twind.config.joint_config import OF_DEFAULTS, JointKeys
from twind.config.robot_file import RobotKeys, read_robot
from twind.config.servo_type import ServoSlotKeys, ServoTypeKeys
from twind.config.transmission_config import DifferentialKeys, LinkageKeys

TEXT = (ROOT / "docs" / "configuration.md").read_text()
HEADING = ("key", "value", "default", "what")
SETTINGS, ROBOT = (
    table(part, *HEADING) for part in TEXT.split("\n## CAN buses\n")[0].split("\n## Robot file\n")
)

FILE = """\
format: twind-robot/1
name: one
model: {mjcf: one.xml, base: torso}
buses: {main: {kind: dynamixel2}, leg: {kind: can}}
types:
  small: {device: XM430-W350, gains: {p: 1, i: 0, d: 0}, registers: {shutdown: 52}}
  large: {device: DM4340, gains: {kp: 100.0, kd: 2.0}}
defaults: {type: small, bus: main}
joints:
  yaw: {id: 1, limits_rad: [-1.0, 1.0], registers: {shutdown: 52}}
  knee: {type: large, bus: leg, id: 1, limits_rad: [-1.0, 1.0]}
  elbow: {id: 2, limits_rad: [-1.0, 1.0], stop_rad: {upper: 1.1}, homing: {side: upper}}
  roll: {limits_rad: [-0.1, 0.1]}
  toe: {limits_rad: [-0.1, 0.1]}
actuators: {a: {id: 3, registers: {shutdown: 52}}, b: {type: large, bus: leg, id: 2}}
transmissions:
  one: {kind: differential, actuators: [a], joints: {roll: [0.5]}}
  two: {kind: linkage_table, actuators: [b], joints: [toe], table: toe.csv}
poses: {rest: {yaw: 0.0}}
collision: {}
sensors:
  imu: {bus: main, id: 9, site: imu, gyro: {address: 0, type: int16, lsb_rad_s: 0.1},
        acceleration: {address: 6, type: int16, lsb_m_s2: 0.1}, quaternion: {address: 12, type: float32}}
"""


def described(folder: Path) -> None:
    """A robot in which every key may stand."""
    (folder / "one.xml").write_text("<mujoco/>")
    (folder / "one.yaml").write_text(FILE)
    (folder / "toe.csv").write_text("b_rad,toe_rad\n-1.0,-0.5\n1.0,0.5\n")


def keys_in(cell: str) -> list[str]:
    """Keys of a first cell; one that begins with a dot has the section of the first."""
    keys = re.findall(r"`([^`]+)`", cell)
    section_of_first = keys[0].rpartition(".")[0]
    return [section_of_first + key if key.startswith(".") else key for key in keys]


def documented(rows: list[list[str]]) -> set[str]:
    return {key for cell, *_ in rows for key in keys_in(cell)}


def defaults(rows: list[list[str]]) -> dict[str, str]:
    """Default by key."""
    return {key: usual for cell, _, usual, _ in rows for key in keys_in(cell)}


def keys_below(prefix: str, *shapes: type) -> set[str]:
    """Keys of the shapes as the page spells them; of a section its own keys."""
    found: set[str] = set()
    for shape in shapes:
        for key, field in keys_of(shape).items():
            section = next((each for each in (field.kind, *get_args(field.kind)) if is_shape(each)), None)
            found |= keys_below(f"{prefix}{key}.", section) if section else {prefix + key}
    return found


def is_shape(kind: object) -> bool:
    return isinstance(kind, type) and (issubclass(kind, ConfigStruct) or is_dataclass(kind))


def test_every_key_of_the_settings_is_on_the_page() -> None:
    assert keys_below("", SettingsKeys) == documented(SETTINGS)


def test_every_key_of_the_robot_file_is_on_the_page() -> None:
    slot = keys_below("", ServoSlotKeys, CanSlotKeys)
    joint = keys_below("", JointKeys)
    linked = keys_below("transmissions.TRANSMISSION.", DifferentialKeys, LinkageKeys)
    read_elsewhere = {"buses", "types", "defaults", "joints", "actuators", "transmissions", "poses"}
    keys = keys_below("", RobotKeys) - read_elsewhere - {"collision", "sensors"}
    keys |= keys_below("buses.BUS.", SerialBusKeys, CanBusKeys)
    keys |= keys_below("types.TYPE.", ServoTypeKeys, CanTypeKeys) - {"types.TYPE.registers"}
    keys |= {f"defaults.{key}" for key in OF_DEFAULTS}
    keys |= {
        f"{entry}.{key}" for entry in ("joints.JOINT", "actuators.ACTUATOR") for key in slot - {"registers"}
    }
    keys |= {f"joints.JOINT.{key}" for key in joint}
    keys |= {f"{entry}.registers.REGISTER" for entry in ("types.TYPE", "joints.JOINT", "actuators.ACTUATOR")}
    keys |= linked - {"transmissions.TRANSMISSION.joints"} | {"transmissions.TRANSMISSION.joints.JOINT"}
    keys |= (
        keys_below("collision.", CollisionKeys) | keys_below("sensors.", SensorKeys) | {"poses.POSE.JOINT"}
    )
    assert keys == documented(ROBOT)


def test_the_defaults_of_the_page_are_those_of_the_code(tmp_path: Path) -> None:
    described(tmp_path)
    robot = read_robot(tmp_path / "one.yaml")
    page = defaults(ROBOT)
    bus = robot.buses[0]
    kind = robot.joints[0].type
    joint = robot.joints[0]
    assert page["support"] == f"`{robot.support}`"
    assert page["loop.rate_hz"] == f"{robot.rate_hz:g}"
    assert page["loop.command_timeout_ms"] == f"{robot.command_timeout_ms:g}"
    assert page["buses.BUS.baud"] == f"{bus.baud}"
    assert page["buses.BUS.bitrate"] == f"{robot.buses[1].baud}"
    knee = robot.joints[1]
    assert isinstance(knee.type, CanType)
    assert page["types.TYPE.watchdog"] == f"`{knee.type.watchdog}`"
    assert page["types.TYPE.torque_limit_nm"] == "`ranges.torque_nm`"
    assert knee.type.torque_limit_nm == knee.type.ranges.torque_nm
    assert page["joints.JOINT.feedback_id"] == f"`id` + {(knee.feedback_id or 0) - knee.id}"
    assert page["buses.BUS.latency_timer_ms"] == f"{bus.latency_timer_ms}"
    assert page["buses.BUS.one_write"] == f"`{str(bus.one_write).lower()}`"
    assert page["types.TYPE.mode"] == f"`{kind.mode}`; CAN: `{knee.type.mode}`"
    assert isinstance(kind, ServoType)
    assert page["types.TYPE.return_delay_us"] == f"{kind.return_delay_us}"
    assert page["types.TYPE.velocity_limit_rad_s"] == f"{kind.velocity_limit_rad_s:g}"
    assert page["types.TYPE.acceleration_limit_rad_s2"] == f"{kind.acceleration_limit_rad_s2:g}"
    assert (page["defaults.sign"], page["defaults.ratio"]) == (f"{joint.sign}", f"{joint.ratio:g}")
    assert page["gate.on_velocity"] == f"`{robot.gate.on_velocity}`"
    assert page["gate.on_torque"] == f"`{robot.gate.on_torque}`"
    assert robot.imu is not None
    assert page["sensors.imu.return_delay_us"] == f"{robot.imu.return_delay_us:g}"
    assert page["sensors.imu.quaternion.zero"] == f"{robot.imu.gyro.zero:g}"
    assert robot.imu.quaternion is not None
    assert page["sensors.imu.quaternion.order"] == f"`{robot.imu.quaternion.order}`"
    clearance = robot.gate.collision
    for key, value in (("block", clearance.block), ("warn", clearance.warn), ("world", clearance.world)):
        assert page[f"collision.{key}_m"] == f"{value:g}"
    usual = defaults(SETTINGS)
    settings = load_settings(None, {"HOME": str(tmp_path)}, 1000)
    for key in ("mode", "robot", "log_level"):
        assert usual[key] == f"`{getattr(settings, key)}`"
    for key in ("latency_warn_ms", "latency_block_ms"):
        assert usual[f"thresholds.{key}"] == f"{getattr(settings, key):g}"
