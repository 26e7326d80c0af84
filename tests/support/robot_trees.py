"""Robots as trees of links, and MuJoCo's kinematics of them."""

from collections.abc import Mapping
from typing import Any

import msgspec
import mujoco

from twind.config.robot_file import load_robot
from twind.observe.describing.robot_frames import RobotTree, robot_tree
from twind.twin.binding import bind

# Two joints in one body, one off its origin and with a zero elsewhere; a slide and a hinge that follow.
ODD = """
<mujoco><compiler angle="radian"/><worldbody>
  <geom type="plane" size="1 1 1"/>
  <body name="table" pos="1 0 0"><geom size="0.1"/></body>
  <body name="base" pos="0.1 0.2 0.3" quat="0.5 0.5 -0.5 0.5"><geom type="ellipsoid" size="1 2 3"/>
    <body name="arm" pos="0.1 0 0" euler="0.3 0.2 1.1">
      <joint name="m_yaw" axis="0 0 1"/>
      <joint name="m_pitch" axis="0 1 1" pos="0.02 0.03 0.01" ref="0.4"/>
      <geom type="capsule" size="0.01 0.1"/>
      <body name="tip" pos="0 0 0.1"><joint name="grip" type="slide" axis="1 0 0"/><geom size="0.01"/></body>
      <body pos="0 0.1 0"><joint name="curl" axis="1 0 0" ref="0.1"/><geom size="0.01"/></body>
      <body name="loose"><joint name="swing" axis="1 0 0"/><geom size="0.01"/></body>
    </body>
  </body></worldbody>
  <equality><joint joint1="grip" joint2="m_yaw" polycoef="0.01 0.05 0 0 0"/>
    <joint joint1="curl" joint2="m_pitch" polycoef="0 -0.5 0 0 0"/></equality>
  <actuator><position joint="m_yaw" forcerange="-3 3"/></actuator>
</mujoco>"""


def joint(name: str, lower: float = -1.0, upper: float = 2.0) -> dict[str, Any]:
    return {
        "name": name,
        "model_joint": f"m_{name}",
        "lower": lower,
        "upper": upper,
        "velocity_limit": 4.0,
    }


def odd_robot() -> tuple[RobotTree, dict[str, Any]]:
    robot = {"name": "odd", "base": "base", "mjcf_path": "odd.xml", "joints": [joint("yaw"), joint("pitch")]}
    return robot_tree(mujoco.MjModel.from_xml_string(ODD), robot), robot


def built_in(name: str) -> tuple[RobotTree, dict[str, Any]]:
    file = load_robot(name)
    robot = msgspec.to_builtins(file, enc_hook=str)
    return robot_tree(bind(file, None).model, robot), robot


def placed(tree: RobotTree, robot: Mapping[str, Any], angles: Mapping[str, float]) -> mujoco.MjData:
    data = mujoco.MjData(tree.model)
    for each in robot["joints"]:
        data.joint(each["model_joint"]).qpos = angles[each["name"]]
    for each in tree.joints:
        if each.leader != each.name and each.kind != "fixed":
            data.joint(each.name).qpos = each.multiplier * angles[each.leader] + each.offset
    mujoco.mj_kinematics(tree.model, data)
    return data
