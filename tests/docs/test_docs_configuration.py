"""Tables of keys in docs/configuration.md are those of the code; defaults without a type are right."""

import re
from pathlib import Path

import pytest

from tests.support.doc_pages_text import ROOT, table
from twind.config.collision_config import Clearance
from twind.config.robot_file import read_robot
from twind.config.write_keys_page import renew_page
from twind_drivers.can.can_type import CanType

TEXT = (ROOT / "docs" / "configuration.md").read_text()
ROBOT = table(TEXT.partition("\n## Robot file\n")[2].partition("\n## ")[0], "key", "value", "default", "what")

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
    """A robot with an actuator of each kind."""
    (folder / "one.xml").write_text("<mujoco/>")
    (folder / "one.yaml").write_text(FILE)
    (folder / "toe.csv").write_text("b_rad,toe_rad\n-1.0,-0.5\n1.0,0.5\n")


def test_the_tables_of_the_page_are_made_of_the_structs() -> None:
    assert renew_page(TEXT) == TEXT, "run: python -m twind.config.write_keys_page docs/configuration.md"


def test_a_page_without_its_markers_is_refused() -> None:
    with pytest.raises(ValueError, match="keys of settings"):
        renew_page("# Settings\n")


def test_every_table_names_a_key_once() -> None:
    keys = re.findall(r"`([^`]+)`", " ".join(row[0] for row in ROBOT))
    whole = [key for key in keys if not key.startswith(".")]
    assert len(whole) == len(set(whole))


def test_defaults_that_no_type_tells_are_those_of_the_code(tmp_path: Path) -> None:
    described(tmp_path)
    robot = read_robot(tmp_path / "one.yaml")
    page = {re.findall(r"`([^`]+)`", cell)[0]: usual for cell, _, usual, _ in ROBOT}
    knee = robot.joints[1]
    assert isinstance(knee.type, CanType)
    assert page["types.TYPE.mode"] == f"`{robot.joints[0].type.mode}`; CAN: `{knee.type.mode}`"
    assert page["types.TYPE.torque_limit_nm"] == "`ranges.torque_nm`"
    assert knee.type.torque_limit_nm == knee.type.ranges.torque_nm
    assert page["joints.JOINT.feedback_id"] == f"`id` + {(knee.feedback_id or 0) - knee.id}"
    assert page["poses.POSE.JOINT"] == f"{robot.poses['rest']['elbow']:g}"
    assert page["collision.warn_m"] == f"{Clearance().warn:g}"
    supply = robot.joints[0].type.supply
    heat = robot.joints[0].type.heat
    for key, bound in (("warn", supply.warn), ("settle", supply.settle), ("fault", supply.fault)):
        assert page[f"types.TYPE.supply.{key}_v"] == f"the model's: {bound:g}"
    for key, bound in (
        ("warn", heat.warn),
        ("slow", heat.slow),
        ("settle", heat.settle),
        ("cool", heat.cool),
    ):
        assert page[f"types.TYPE.heat.{key}_c"] == f"the model's: {bound:g}"
    assert page["types.TYPE.heat.continuous"] == f"{heat.continuous:g}"
