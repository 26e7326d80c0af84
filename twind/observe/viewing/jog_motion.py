"""Slow motion of a held button: one joint up or down, or all joints to a pose. Pure arithmetic."""

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
NEAR = 1e-4  # rad: a joint so near is there
DIRECTIONS = {"up": 1, "down": -1}


@dataclass(frozen=True, slots=True)
class JogRequest:
    """Request of a button: `up` or `down` and a joint, or `pose` and one of the robot file's poses."""

    kind: str
    name: str


def jog_speed(joint: Mapping[str, Any]) -> float:
    """Return the speed (rad/s) of a joint of the robot file under a held button."""
    velocity = float(joint["velocity_limit"])
    acceleration = float(joint["acceleration_limit"])
    return min(SPEED, SHARE * velocity, STOPPING * acceleration)


class JogMotion:
    """Straight way of some joints from where they are commanded; each setpoint goes a short step on."""

    def __init__(self, names: Sequence[str], start: Floats, target: Floats, speed: Floats) -> None:
        """All arrays are (m,), rad and rad/s, in the order of `names`."""
        self.names = list(names)
        self._start = start
        self._target = target
        self.duration = float((np.abs(target - start) / speed).max(initial=0.0))  # s
        self._velocity = (target - start) / max(self.duration, 1e-9)
        self._elapsed = 0.0

    @property
    def is_done(self) -> bool:
        """The last setpoint was the target."""
        return self._elapsed >= self.duration

    def advance(self, seconds: float) -> tuple[list[float], list[float]]:
        """Return the next positions (rad) and velocities (rad/s), `seconds` after those before."""
        self._elapsed = min(self.duration, self._elapsed + min(max(seconds, 0.0), LONGEST_STEP))
        if self.is_done:
            return self._target.tolist(), [0.0] * len(self.names)
        return (self._start + self._velocity * self._elapsed).tolist(), self._velocity.tolist()


def plan_jog(request: JogRequest, robot: Mapping[str, Any], now: Mapping[str, float | None]) -> JogMotion:
    """Plan the motion of `robot` (as in the answer of `GetRobot`) from the goals or positions `now`, rad.

    Raises InvalidInput: no such joint or pose, an unknown position, or nothing to move.
    """
    joints = {str(joint["name"]): joint for joint in robot["joints"]}
    if request.kind == "pose":
        target = dict(robot["poses"].get(request.name) or {})
        if not target:
            raise InvalidInput(f"no pose {request.name!r}; known: {', '.join(robot['poses'])}")
    elif request.kind in DIRECTIONS and request.name in joints:
        target = {request.name: _beyond(joints[request.name], DIRECTIONS[request.kind])}
    else:
        raise InvalidInput(f"no button {request.kind!r} of a joint {request.name!r}")
    known = {name: nan if place is None else place for name, place in now.items()}
    here = {name: known.get(name, nan) for name in target}
    unknown = [name for name, place in here.items() if not isfinite(place)]
    if unknown:
        raise InvalidInput(
            f"the position of {', '.join(unknown)} is not known: it cannot be jogged from there"
        )
    start = np.array(list(here.values()), np.float64)
    goal = np.array(list(target.values()), np.float64)
    speed = np.array([jog_speed(joints[name]) for name in target])
    if np.abs(goal - start).max(initial=0.0) < NEAR:
        raise InvalidInput(f"{request.name}: it is there")
    return JogMotion(list(target), start, goal, speed)


def _beyond(joint: Mapping[str, Any], direction: int) -> float:
    return float(joint["upper"]) + BEYOND if direction > 0 else float(joint["lower"]) - BEYOND
