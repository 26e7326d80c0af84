"""Slow motion under a held button: joints up or down, one to a value, or all to a pose. Pure arithmetic."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any

import numpy as np

from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats

SPEED = 0.2  # rad/s at most
SHARE = 0.25  # of the joint's velocity limit at most
STOPPING = 0.05  # s that braking from this speed may take, by the joint's acceleration limit
BEYOND = 0.02  # rad behind its limit that a joint is sent to: the gate refuses, and says which limit it is
LONGEST_STEP = 0.04  # s of motion that one setpoint adds, however late it is
HOLD = 0.15  # s from the newest proof that a control is held to the end of the motion that it permits
NEAR = 1e-4  # rad: a joint so near is there
DIRECTIONS = {"up": 1, "down": -1}
SLIDER = "to"


@dataclass(slots=True)
class JogRequest:
    """Request of a control: `up`, `down` or `to` and a joint, or `pose` and one of the robot file's poses."""

    kind: str
    name: str
    value: float = nan  # rad, of `to`; it may change while the control is held


def jog_speed(joint: Mapping[str, Any]) -> float:
    """Return the speed (rad/s) of a joint of the robot file under a held button."""
    velocity = float(joint["velocity_limit"])
    acceleration = float(joint["acceleration_limit"])
    return min(SPEED, SHARE * velocity, STOPPING * acceleration)


class JogMotion:
    """Way of some joints from where they are commanded; each setpoint goes a short step on.

    `target` (rad) and `speed` (rad/s), both (m,) in the order of `names`, may change between two steps.
    """

    def __init__(self, names: Sequence[str], start: Floats, target: Floats, speed: Floats) -> None:
        """All arrays are (m,), rad and rad/s, in the order of `names`."""
        self.names = list(names)
        self.position = start.copy()  # rad, (m,), of the setpoint before
        self.target = target.copy()
        self.speed = speed.copy()

    @property
    def is_done(self) -> bool:
        """The last setpoint was the target."""
        return bool((self.position == self.target).all())

    def advance(self, seconds: float) -> tuple[list[float], list[float]]:
        """Return the next positions (rad) and velocities (rad/s), `seconds` after those before."""
        step = self.speed * min(max(seconds, 0.0), LONGEST_STEP)
        way = self.target - self.position
        arrives = np.abs(way) <= step
        self.position = np.where(arrives, self.target, self.position + np.clip(way, -step, step))
        return self.position.tolist(), np.where(arrives, 0.0, np.sign(way) * self.speed).tolist()

    def steer(self, velocities: Mapping[str, float], joints: Mapping[str, Mapping[str, Any]]) -> None:
        """Move towards the limits at `velocities` (rad/s by joint), at most `jog_speed`; others stand still.

        `joints`: each joint of the robot file, by name.
        """
        for place, name in enumerate(self.names):
            joint = joints[name]
            velocity = velocities.get(name, 0.0)
            limit = float(joint["upper"] if velocity > 0.0 else joint["lower"])
            self.speed[place] = min(abs(velocity), jog_speed(joint))
            self.target[place] = limit if velocity else self.position[place]


def joints_of(robot: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the joints of `robot` (as in the answer of `GetRobot`) by name."""
    return {str(joint["name"]): joint for joint in robot["joints"]}


def known_positions(names: Sequence[str], now: Mapping[str, float | None]) -> Floats:
    """Return the positions (m,), rad, of joints. Raises InvalidInput: one is not known."""
    here = np.array([nan if (place := now.get(name)) is None else place for name in names], np.float64)
    unknown = [name for name, place in zip(names, here.tolist(), strict=True) if not isfinite(place)]
    if unknown:
        raise InvalidInput(
            f"the position of {', '.join(unknown)} is not known: it cannot be jogged from there"
        )
    return here


def plan_jog(request: JogRequest, robot: Mapping[str, Any], now: Mapping[str, float | None]) -> JogMotion:
    """Plan the motion of `robot` (as in the answer of `GetRobot`) from the goals or positions `now`, rad.

    The joints of a pose arrive together. Raises InvalidInput: no such joint or pose, an unknown position, or
    nothing to move.
    """
    joints = joints_of(robot)
    if request.kind == "pose":
        target = dict(robot["poses"].get(request.name) or {})
        if not target:
            raise InvalidInput(f"no pose {request.name!r}; known: {', '.join(robot['poses'])}")
    elif request.kind in DIRECTIONS and request.name in joints:
        target = {request.name: _beyond(joints[request.name], DIRECTIONS[request.kind])}
    elif request.kind == SLIDER and request.name in joints and isfinite(request.value):
        target = {request.name: request.value}
    else:
        raise InvalidInput(f"no button {request.kind!r} of a joint {request.name!r}")
    start = known_positions(list(target), now)
    goal = np.array(list(target.values()), np.float64)
    way = np.abs(goal - start)
    if request.kind != SLIDER and way.max(initial=0.0) < NEAR:
        raise InvalidInput(f"{request.name}: it is there")
    fastest = np.array([jog_speed(joints[name]) for name in target])
    together = way / max(float((way / fastest).max(initial=0.0)), 1e-9)
    return JogMotion(list(target), start, goal, together if request.kind == "pose" else fastest)


def _beyond(joint: Mapping[str, Any], direction: int) -> float:
    return float(joint["upper"]) + BEYOND if direction > 0 else float(joint["lower"]) - BEYOND
