"""MJCF of a robot whose bodies nobody has described: its joints alone, each with a light link of its own.

Positions, limits and the gate's checks of time and speed work; no geometry can touch, and no weight pulls.
"""

from collections.abc import Mapping
from xml.sax.saxutils import quoteattr

# A link of 10 g that no gravity pulls: the simulation follows goals without a load.
_LINK = """\
    <body name={body}>
      <inertial pos="0 0 0" mass="0.01" diaginertia="1e-5 1e-5 1e-5"/>
      <joint name={joint} axis="0 0 1" range="{lower:.6f} {upper:.6f}"/>
    </body>
"""
_MODEL = """\
<!-- Joints without bodies: a model of the robot in place of this file has collisions and torques checked. -->
<mujoco model={name}>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.005" integrator="implicitfast" gravity="0 0 0"/>
  <default>
    <joint type="hinge" damping="0.1" armature="0.01"/>
    <position kp="5" kv="0.3" inheritrange="1"/>
  </default>
  <worldbody>
    <body name="base">
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <freejoint/>
{links}    </body>
  </worldbody>
  <actuator>
{actuators}  </actuator>
</mujoco>
"""


def bodiless_model(name: str, ranges: Mapping[str, tuple[float, float]]) -> str:
    """Return the MJCF of a base with one link a joint. `ranges`: rad, by joint."""
    links = [
        _LINK.format(body=quoteattr(f"{joint}_link"), joint=quoteattr(joint), lower=low, upper=high)
        for joint, (low, high) in ranges.items()
    ]
    actuators = [f"    <position name={quoteattr(joint)} joint={quoteattr(joint)}/>\n" for joint in ranges]
    body = "".join(f"  {line}\n" for link in links for line in link.splitlines())
    return _MODEL.format(name=quoteattr(name), links=body, actuators="".join(actuators))
