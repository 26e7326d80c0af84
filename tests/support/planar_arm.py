"""A planar arm of three serial servos, in each mode of positions: 3, 4 and 5; one geared, one reversed."""

from pathlib import Path

WAIST = "extended"  # the joint that is one in `waist_in`
BODY = """\
<mujoco model="arm">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" jacobian="dense"><flag contact="disable"/></option>
  <worldbody>
    <body name="base">
      <geom type="box" size=".05 .05 .05" mass="1"/>
      <body name="upper" pos="0 0 .1">
        <joint name="single" axis="0 0 1" range="-1 1.2" damping=".1"/>
        <geom type="capsule" fromto="0 0 0 .15 0 0" size=".02" mass=".1"/>
        <body name="fore" pos=".2 0 0">
          <joint name="extended" axis="0 0 1" range="-1.1 1" damping=".1"/>
          <geom type="capsule" fromto="0 0 0 .15 0 0" size=".02" mass=".1"/>
          <body name="hand" pos=".2 0 0">
            <joint name="capped" axis="0 0 1" range="-1 1.1" damping=".1"/>
            <geom type="capsule" fromto="0 0 0 .1 0 0" size=".02" mass=".1"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="single" kp="20"/> <position joint="extended" kp="20"/> <position joint="capped" kp="20"/>
  </actuator>
</mujoco>
"""

ROBOT = """\
format: twind-robot/1
name: arm
model: {mjcf: arm.xml, base: base}
support: fixed
buses:
  main: {kind: dynamixel2, baud: 1000000}
types:
  servo: {device: XM430-W350, gains: {p: 800, i: 0, d: 0}, torque_constant_nm_per_a: 1.78,
          velocity_limit_rad_s: 3.0, current_limit_a: 1.0}
defaults: {type: servo, bus: main}
joints:
  single: {id: 1, mode: position, limits_rad: [-0.8, 1.0]}
  extended: {id: 2, mode: extended_position, sign: -1, ratio: 1.5, limits_rad: [-0.9, 0.8]}
  capped: {id: 3, mode: current_based_position, limits_rad: [-0.8, 0.9]}
poses: {rest: {}}
"""


def arm_in(folder: Path) -> str:
    """The path of its robot file."""
    (folder / "arm.xml").write_text(BODY)
    (folder / "arm.yaml").write_text(ROBOT)
    return str(folder / "arm.yaml")


def waist_in(folder: Path, ratio: float = 2.5, more: str = "") -> str:
    """The robot file of the planar arm, its second joint a waist; `more`: keys of that joint."""
    path = Path(arm_in(folder))
    body = folder / "arm.xml"
    body.write_text(body.read_text().replace('range="-1.1 1"', 'range="-1.7 1.7"'))
    path.write_text(
        path.read_text().replace(
            "ratio: 1.5, limits_rad: [-0.9, 0.8]", f"ratio: {ratio:g}, limits_rad: [-1.57, 1.57]{more}"
        )
    )
    return str(path)
