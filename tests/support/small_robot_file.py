"""A robot file of two joints."""

import shutil
from pathlib import Path

from twind.config.robot_file import load_robot, read_robot
from twind.config.robot_spec import RobotFile

SMALL = """\
format: twind-robot/1
name: arm-2
model: {mjcf: arm.xml, base: base}
support: fixed
loop: {rate_hz: 50}
buses:
  main: {kind: dynamixel2, port: /dev/ttyUSB0, baud: 1000000}
types:
  xm: {device: XM430-W350, gains: {p: 800, i: 0, d: 0}, torque_constant_nm_per_a: 1.78, current_limit_a: 2.3,
       velocity_limit_rad_s: 4.0, acceleration_limit_rad_s2: 20.0, registers: {shutdown: 52}}
defaults: {type: xm, bus: main}
joints:
  shoulder: {id: 1, limits_rad: [-1.0, 1.0]}
  elbow: {id: 2, sign: -1, ratio: 2.0, limits_deg: [0, 90],
          velocity_limit_rad_s: 1.5, registers: {shutdown: 53}}
poses:
  rest: {}
  up: {shoulder: 0.5}
"""


def write(folder: Path, text: str) -> Path:
    shutil.copy(load_robot("h24").mjcf_path, folder / "arm.xml")
    path = folder / "arm-2.yaml"
    path.write_text(text)
    return path


def read(folder: Path, text: str = SMALL) -> RobotFile:
    return read_robot(write(folder, text))
