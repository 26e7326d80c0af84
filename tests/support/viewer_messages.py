"""Messages of a daemon to the viewer, made up: a robot, and its states."""

from pathlib import Path
from typing import Any

import msgspec

from twind.config.robot_file import load_robot

GROUP_THREE = """<mujoco><worldbody>
  <geom type="plane" size="2 2 0.1"/>
  <body name="trunk" pos="0 0 0.5">
    <geom type="box" size="0.08 0.12 0.2" group="3" mass="1" rgba="0.2 0.3 0.6 1"/>
    <body name="arm" pos="0 0.14 0.15">
      <joint name="swing" axis="1 0 0" range="-2 2"/>
      <geom type="capsule" fromto="0 0.03 0 0 0.03 -0.25" size="0.03" group="3" mass="0.2"/>
    </body>
  </body>
</worldbody></mujoco>"""


def h24() -> dict[str, Any]:
    """The answer of `GetRobot` for the built-in robot."""
    robot = load_robot("h24")
    return {"robot": msgspec.to_builtins(robot, enc_hook=str), "calibration": None, "mjcf": robot.mjcf}


def other(
    mjcf: str = GROUP_THREE, base: str = "trunk", joints: tuple[str, ...] = ("swing",)
) -> dict[str, Any]:
    """Briefing of a small robot, as much as the viewer needs."""
    robot = {
        "name": "small",
        "path": "small.yaml",
        "mjcf_path": str(Path("nowhere") / "small.xml"),
        "base": base,
        "support": "fixed",
        "joints": [
            {"name": f"the {name}", "model_joint": name, "lower": -2.0, "upper": 2.0} for name in joints
        ],
        "poses": {"rest": {f"the {name}": 0.0 for name in joints}},
        "gate": {"on_velocity": "retime", "collision": {"judge_world": False}, "on_torque": "warn"},
    }
    return {"robot": robot, "calibration": None, "mjcf": mjcf}


def state(reply: dict[str, Any], time: float = 0.0, **joints: Any) -> dict[str, Any]:
    """A message of the topic `state`: all at rest and heard, but for those named: an angle, or fields."""
    rows = []
    for joint in reply["robot"]["joints"]:
        name = joint["name"]
        asked = joints.get(name.removeprefix("the "), 0.0)
        fields = asked if isinstance(asked, dict) else {"position": asked}
        place = fields.get("position", 0.0)
        rows.append(
            {"name": name, "position": place, "goal": None, "simulated": place, "age_ms": 5.0}
            | {"heard": True, "faults": []}
            | fields
        )
    return {"topic": "state", "time": time, "sequence": 1, "dropped": 0, "joints": rows}


def status(**fields: Any) -> dict[str, Any]:
    """A message of the topic `status`."""
    told = {
        "robot": "h24",
        "mode": "live",
        "state": "armed",
        "motion": "holding",
        "armed": True,
        "inherited": False,
        "lease": None,
        "faults": [],
        "buses": [],
        "loop": {"rate_hz": 100.0, "on_time": 1.0},
    }
    return {"topic": "status", "time": 0.0, "sequence": 1, "status": told | fields}
