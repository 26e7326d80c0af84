"""A small robot whose torso hull overlaps its limbs, from primitives: in its rest pose no two bodies collide.

The torso carries a backpack without a joint, and the head a face without one. The hand can hit the torso.
"""

from pathlib import Path

from twind.config.robot_file import read_robot
from twind.config.robot_spec import RobotFile

MODEL = """\
<mujoco model="hull">
  <compiler angle="radian" autolimits="true" {compiler}/>
  <option timestep="0.002" integrator="implicitfast" jacobian="dense">{option}</option>
  <default>
    <joint type="hinge" range="-2 2" damping="0.1" armature="0.01"/>
    <position kp="20" kv="0.5" forcerange="-4 4"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1"/>
    <body name="torso" pos="0 0 0.6">
      <freejoint/>
      <geom name="torso" type="box" size="0.08 0.08 0.1" mass="1"/>
      <body name="backpack">
        <geom name="backpack" type="sphere" pos="-0.09 0 0" size="0.06" mass="0.2"/>
        <body name="tail" pos="-0.1 0 0">
          <joint name="tail" axis="0 1 0"/>
          <geom name="tail" type="capsule" fromto="0 0 0 -0.1 0 0" size="0.03" mass="0.05"/>
        </body>
      </body>
      <body name="head" pos="0 0 0.12">
        <joint name="head" axis="0 0 1"/>
        <geom name="head" type="box" size="0.06 0.06 0.06" mass="0.2"/>
        <body name="face">
          <geom name="face" type="sphere" pos="0.05 0 -0.03" size="0.04" mass="0.02"/>
          <body>
            <geom name="nose" type="sphere" pos="0.07 0 -0.03" size="0.02" mass="0.01"/>
          </body>
        </body>
      </body>
      <body name="arm" pos="0 0.09 -0.02">
        <joint name="arm" axis="0 1 0"/>
        <geom name="arm" type="capsule" fromto="0 0 0 0 0.06 -0.05" size="0.03" mass="0.1"/>
        <body name="hand" pos="0 0.06 -0.05">
          <joint name="hand" axis="1 0 0"/>
          <geom name="hand" type="sphere" pos="0 0 -0.1" size="0.03" mass="0.05"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="head"/> <position joint="tail"/> <position joint="arm"/> <position joint="hand"/>
  </actuator>
  {more}
</mujoco>
"""
ROBOT = """\
format: twind-robot/1
name: hull
model: {{mjcf: hull.xml, base: torso}}
support: {support}
buses: {{main: {{kind: dynamixel2}}}}
types: {{small: {{device: XM430-W350, gains: {{p: 800, i: 0, d: 0}}}}}}
defaults: {{type: small, bus: main}}
joints:
  head: {{id: 1, limits_rad: [-1.9, 1.9]}}
  tail: {{id: 2, limits_rad: [-1.9, 1.9]}}
  arm: {{id: 3, limits_rad: [-1.9, 1.9]}}
  hand: {{id: 4, limits_rad: [-1.9, 1.9]}}
poses: {{rest: {{}}}}
collision: {{allow: [[torso, hand]]}}
"""


def hull(
    folder: Path, *, support: str = "gantry", compiler: str = "", option: str = "", more: str = ""
) -> RobotFile:
    """The robot file, written to `folder`. `compiler`, `option`, `more`: MJCF to put in."""
    folder.mkdir(exist_ok=True)
    (folder / "hull.xml").write_text(MODEL.format(compiler=compiler, option=option, more=more))
    (folder / "hull.yaml").write_text(ROBOT.format(support=support))
    return read_robot(folder / "hull.yaml")
