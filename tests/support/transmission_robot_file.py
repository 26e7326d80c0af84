"""A small robot with a differential waist and a linkage in its ankle: primitives, two serial buses."""

import math
from pathlib import Path

from twind.config.robot_file import read_robot
from twind.config.robot_spec import RobotFile

BODY = """\
<mujoco model="linked">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" jacobian="dense"/>
  <worldbody>
    <body name="pelvis" pos="0 0 1">
      <freejoint/>
      <geom type="box" size=".08 .08 .05" mass="1"/>
      <body name="chest_mount" pos="0 0 .1">
        <joint name="waist_roll" axis="1 0 0" range="-.6 .6" damping=".1"/>
        <geom type="sphere" size=".03" mass=".2"/>
        <body name="chest" pos="0 0 .05">
          <joint name="waist_yaw" axis="0 0 1" range="-1 1" damping=".1"/>
          <geom type="capsule" fromto="0 0 .02 0 0 .15" size=".05" mass=".5"/>
        </body>
      </body>
      <body name="shin" pos="0 0 -.12">
        <joint name="knee" axis="0 1 0" range="-.1 2.2" damping=".1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".03" mass=".3"/>
        <body name="cross" pos="0 0 -.25">
          <joint name="ankle_pitch" axis="0 1 0" range="-.9 .9" damping=".05"/>
          <geom type="sphere" size=".02" mass=".1"/>
          <body name="foot" pos="0 0 -.03">
            <joint name="ankle_roll" axis="1 0 0" range="-.5 .5" damping=".05"/>
            <geom type="box" size=".08 .04 .01" pos=".03 0 -.01" mass=".1"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <contact>
    <exclude body1="pelvis" body2="chest_mount"/> <exclude body1="pelvis" body2="chest"/>
    <exclude body1="chest_mount" body2="chest"/> <exclude body1="pelvis" body2="shin"/>
    <exclude body1="shin" body2="cross"/> <exclude body1="shin" body2="foot"/>
    <exclude body1="cross" body2="foot"/>
  </contact>
  <actuator>
    <position joint="waist_roll" kp="40"/> <position joint="waist_yaw" kp="40"/>
    <position joint="knee" kp="40"/>
    <position joint="ankle_pitch" kp="20"/> <position joint="ankle_roll" kp="20"/>
  </actuator>
</mujoco>
"""

ROBOT = """\
format: twind-robot/1
name: linked
model: {mjcf: linked.xml, base: pelvis}
support: gantry
buses:
  main: {kind: dynamixel2, baud: 1000000}
  leg: {kind: dynamixel2, baud: 1000000}
types:
  xm: {device: XM430-W350, gains: {p: 800, i: 0, d: 0}, torque_constant_nm_per_a: 1.78, current_limit_a: 2.3,
       velocity_limit_rad_s: 4.0, acceleration_limit_rad_s2: 40.0}
defaults: {type: xm, bus: main}
joints:
  waist_roll: {limits_rad: [-0.4, 0.4]}
  knee: {id: 2, limits_rad: [0.0, 2.0]}
  ankle_roll: {limits_rad: [-0.2, 0.2]}
  waist_yaw: {limits_rad: [-0.5, 0.5]}
  ankle_pitch: {limits_rad: [-0.4, 0.4]}
actuators:
  waist_a: {id: 3, sign: -1}
  waist_b: {id: 1, ratio: 1.2}
  ank_in: {bus: leg, id: 5}
  ank_out: {bus: leg, id: 6, sign: -1}
transmissions:
  waist:
    kind: differential
    actuators: [waist_a, waist_b]
    joints: {waist_roll: [-0.25, 0.25], waist_yaw: [0.3, 0.3]}
  ankle: {kind: linkage_table, actuators: [ank_in, ank_out], joints: [ankle_pitch, ankle_roll],
          table: ankle.csv}
poses:
  rest: {}
  bent: {knee: 1.0, ankle_pitch: -0.3, ankle_roll: 0.1, waist_roll: 0.2, waist_yaw: -0.3}
"""

HEAD = "ank_in_rad,ank_out_rad,ankle_pitch_rad,ankle_roll_rad"


def ankle(a: float, b: float) -> tuple[float, float]:
    """Pitch and roll of an ankle with two rods, of the angles of its cranks; smooth, and bent."""
    push = math.sin(a) + math.sin(b)
    twist = math.sin(a) - math.sin(b)
    return 0.45 * push + 0.03 * twist**2, 0.3 * twist + 0.02 * push**2


def table(places: int = 15, reach: float = 1.15) -> str:
    """That ankle as a linkage table."""
    axis = [reach * (2.0 * at / (places - 1) - 1.0) for at in range(places)]
    rows = [(a, b, *ankle(a, b)) for a in axis for b in axis]
    return "\n".join([HEAD, *(",".join(f"{number:.9f}" for number in row) for row in rows)]) + "\n"


def write(folder: Path, text: str = ROBOT, rods: str | None = None, body: str = BODY) -> Path:
    """The robot's files in a folder; the path of the robot file."""
    (folder / "linked.xml").write_text(body)
    (folder / "ankle.csv").write_text(table() if rods is None else rods)
    path = folder / "linked.yaml"
    path.write_text(text)
    return path


def linked(folder: Path, text: str = ROBOT, rods: str | None = None) -> RobotFile:
    """The robot, read."""
    return read_robot(write(folder, text, rods))


CAN_ROBOT = (
    ROBOT.replace("leg: {kind: dynamixel2, baud: 1000000}", "leg: {kind: can}")
    .replace(
        "defaults:",
        "  dm: {device: DM4340, gains: {kp: 60.0, kd: 2.0}, velocity_limit_rad_s: 4.0}\ndefaults:",
    )
    .replace("ank_in: {bus: leg, id: 5}", "ank_in: {type: dm, bus: leg, id: 5}")
    .replace(
        "ank_out: {bus: leg, id: 6, sign: -1}", "ank_out: {type: dm, bus: leg, id: 6, sign: -1, ratio: 1.5}"
    )
)
