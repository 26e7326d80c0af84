"""Situations in which the gate and the front's share of it give each code: real parts, a robot in a pose.

Each function makes one situation and returns the codes that it led to.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.free_standing_h24 import free_h24
from twind.config.robot_file import load_robot
from twind.ctl.offline_check import pose, verdict
from twind.robot.finding import ReasonCode
from twind.twin.binding import Binding, bind

Told = Iterable[str]
Scene = Callable[[Path], Told]
SCENES: dict[ReasonCode, Scene] = {}


def leads_to(code: ReasonCode) -> Callable[[Scene], Scene]:
    def keep(scene: Scene) -> Scene:
        assert code not in SCENES, code
        SCENES[code] = scene
        return scene

    return keep


def checked(message: dict[str, Any], binding: Binding | None = None) -> Told:
    """Result of `Check` for it, with a robot at rest."""
    binding = bind(load_robot("h24"), None) if binding is None else binding
    found = verdict(binding, pose(binding.robot, "rest"), message)
    return [finding["code"] for findings in found.values() for finding in findings]


def path(joint: str, *rows: tuple[float, float], speed: float | None = None, **more: Any) -> dict[str, Any]:
    extra = {} if speed is None else {"velocities": [speed]}
    points = [{"time_from_start": t, "positions": [place], **extra} for t, place in rows]
    return {"joint_names": [joint], "points": points, **more}


PATHS = {
    ReasonCode.BAD_SCHEMA: path("head_yaw", (1.0, 0.1), goal_time=-1.0),
    ReasonCode.CMD_EXPIRED: path("head_yaw", (1.0, 0.1), start_in=-1.0),
    ReasonCode.TOO_DISTANT: path("head_yaw", (1.0, 0.1), start_in=61.0),
    ReasonCode.EMPTY: path("head_yaw"),
    ReasonCode.NO_JOINTS: {"joint_names": [], "points": [{"time_from_start": 1.0, "positions": []}]},
    ReasonCode.UNKNOWN_JOINT: path("tail", (1.0, 0.1)),
    ReasonCode.DUP_JOINT: {
        "joint_names": ["head_yaw", "head_yaw"],
        "points": [{"time_from_start": 1.0, "positions": [0.1, 0.1]}],
    },
    ReasonCode.BAD_SHAPE: {
        "joint_names": ["head_yaw"],
        "points": [{"time_from_start": 1.0, "positions": []}],
    },
    ReasonCode.TOO_MANY_POINTS: path("head_yaw", *[(0.01 * (i + 1), 0.0) for i in range(2001)]),
    ReasonCode.NONFINITE: path("head_yaw", (1.0, float("nan"))),
    ReasonCode.TIME_ORDER: path("head_yaw", (1.0, 0.1), (0.9, 0.2)),
    ReasonCode.POS_LIMIT: path("head_yaw", (4.0, 1.6)),
    ReasonCode.START_JUMP: path("head_yaw", (0.0, 0.4), (4.0, 0.0)),
    ReasonCode.VEL_LIMIT: path("head_yaw", (0.1, 1.0), policy="reject"),
    ReasonCode.ACC_LIMIT: path("head_yaw", (0.1, 0.3), (4.0, 0.0), policy="reject"),
    ReasonCode.JERK_LIMIT: path("head_yaw", (0.002, 0.0), (0.004, 0.00006), (0.006, 0.00006)),
    ReasonCode.BRAKE_DISTANCE: path("head_yaw", (1.0, 0.0), (1.45, 1.5), policy="reject"),
    ReasonCode.END_NOT_AT_REST: path("head_yaw", (1.0, 0.1), (2.0, 0.6), speed=0.5),
    ReasonCode.RETIMED: path("head_yaw", (0.1, 1.0), policy="retime"),
    ReasonCode.STOP_APPENDED: path("head_yaw", (1.0, 0.1), (2.0, 0.6), speed=0.5, append_stop=True),
}
for each, message in PATHS.items():
    leads_to(each)(lambda _, message=message: checked(message))


@leads_to(ReasonCode.SELF_COLLISION)
def the_legs_cross(folder: Path) -> Told:
    points = [{"time_from_start": 2.0, "positions": [-0.4, 0.4]}]
    return checked({"joint_names": ["l_hip_roll", "r_hip_roll"], "points": points})


def standing_still(folder: Path, change: tuple[str, str]) -> Binding:
    """The h24 bolted to the world, in a model that was changed."""
    source = free_h24(folder)
    source.write_text(source.read_text().replace("support: free", "support: fixed"))
    model = folder / "h24.xml"
    assert change[0] in model.read_text()
    model.write_text(model.read_text().replace(*change))
    return bind(load_robot(str(source)), None)


@leads_to(ReasonCode.FLOOR)
def a_toe_goes_through_the_floor(folder: Path) -> Told:
    low = standing_still(folder, ('pos="0 0 0.555"', 'pos="0 0 0.48"'))
    return checked(path("l_ankle_pitch", (2.0, 0.85)), low)


@leads_to(ReasonCode.KEEP_OUT)
def an_arm_reaches_into_a_post(folder: Path) -> Told:
    post = '<geom name="post" type="box" size="0.05 0.05 0.6" pos="0 0.36 0.6"/>\n    <body name="torso"'
    world = standing_still(folder, ('<body name="torso"', post))
    return checked(path("l_shoulder_roll", (3.0, 1.6)), world)


@leads_to(ReasonCode.TORQUE_INFEASIBLE)
def an_arm_is_lifted_by_a_motor_too_weak(folder: Path) -> Told:
    strong = bind(load_robot("h24"), None)
    weak = replace(strong, limits=replace(strong.limits, effort=np.full(24, 0.1)))
    return checked(path("l_shoulder_roll", (3.0, 1.4)), weak)


@leads_to(ReasonCode.UNSTABLE_POSE)
def it_leans_over_its_toes(folder: Path) -> Told:
    standing = bind(load_robot(str(free_h24(folder))), None)
    points = [{"time_from_start": 3.0, "positions": [0.35, 0.35]}]
    return checked({"joint_names": ["l_ankle_pitch", "r_ankle_pitch"], "points": points}, standing)
