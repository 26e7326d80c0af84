"""docs/configuration.md names every key of settings and robot file, and no other; with the right defaults."""

import re
from pathlib import Path

import pytest

from tests.support.doc_pages_text import ROOT, table
from twind.config import config_section
from twind.config.actuator_types import CanType, ServoType
from twind.config.daemon_settings import load_settings
from twind.config.robot_file import read_robot

TEXT = (ROOT / "docs" / "configuration.md").read_text()
HEADING = ("key", "value", "default", "what")
SETTINGS, ROBOT = (
    table(part, *HEADING) for part in TEXT.split("\n## CAN buses\n")[0].split("\n## Robot file\n")
)
NAMES = {"buses": "BUS", "types": "TYPE", "joints": "JOINT", "poses": "POSE", "actuators": "ACTUATOR"}
NAMES |= {"transmissions": "TRANSMISSION"}

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


def keys_of(cell: str) -> list[str]:
    """Keys of a first cell; one that begins with a dot has the section of the first."""
    keys = re.findall(r"`([^`]+)`", cell)
    section_of_first = keys[0].rpartition(".")[0]
    return [section_of_first + key if key.startswith(".") else key for key in keys]


def documented(rows: list[list[str]]) -> set[str]:
    return {key for cell, *_ in rows for key in keys_of(cell)}


def defaults(rows: list[list[str]]) -> dict[str, str]:
    """Default by key."""
    return {key: usual for cell, _, usual, _ in rows for key in keys_of(cell)}


def asked(monkeypatch: pytest.MonkeyPatch, read: object) -> set[str]:
    """Every key that is asked for, as the page spells it, while `read` reads a file."""
    found: set[str] = set()
    given = config_section.ConfigSection._given

    def spy(self: config_section.ConfigSection, key: str) -> str | None:
        found.add(f"{self.path}.{key}".strip("."))
        return given(self, key)

    monkeypatch.setattr(config_section.ConfigSection, "_given", spy)
    read()  # type: ignore[operator]
    return {_spelled(path) for path in found if not path.endswith(".")}


def _spelled(path: str) -> str:
    parts = path.split(".")
    if parts[0] in NAMES and len(parts) > 1:
        parts[1] = NAMES[parts[0]]
    if parts[0] == "poses" and len(parts) == 3:
        parts[2] = "JOINT"
    if parts[0] == "transmissions" and parts[2:3] == ["joints"]:
        parts[3:] = ["JOINT"] * len(parts[3:])
    if "registers" in parts[:-1]:
        parts[-1] = "REGISTER"
    return ".".join(parts)


def _leaves(keys: set[str]) -> set[str]:
    """Without the sections that hold others."""
    return {key for key in keys if not any(other.startswith(f"{key}.") for other in keys)}


def test_every_key_of_the_settings_is_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "twind.yaml"
    file.write_text("mode: sim\n")
    keys = asked(monkeypatch, lambda: load_settings(file, {}, 1000))
    assert _leaves(keys) == documented(SETTINGS)


def test_every_key_of_the_robot_file_is_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    described(tmp_path)
    keys = asked(monkeypatch, lambda: read_robot(tmp_path / "one.yaml"))
    assert _leaves(keys) == documented(ROBOT)


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
