"""A daemon under a fake clock on a robot with a body in MuJoCo: soft joints sag, and steps overshoot."""

from pathlib import Path
from typing import Any

import numpy as np

from tests.support.built_in_copy import change, copy_built_in
from tests.support.daemon_rig import Rig
from twind.robot.arrays import Floats
from twind.robot.trajectory import Trajectory
from twind.virtual.virtual_robot_spec import body_for, buses


def written_robot(folder: Path, name: str, *changes: tuple[str, str]) -> str:
    """Write a built-in robot with these replacements in its file; return its path."""
    path = copy_built_in(name, folder)
    for old, new in changes:
        change(path, old, new)
    return str(path)


class BodyRig(Rig):
    """One body moves the servos of all buses."""

    def _virtual(self, bus: str, start: Any) -> Any:
        made = self.__dict__.setdefault("_made_buses", {})
        if not made:
            body = body_for(self.made, now=self.clock.now())
            made.update(buses(self.made, physics=False, body=body, now=self.clock.now()))
        return made[bus]

    def sag(self) -> Floats:
        """Return how far each joint is from its commanded goal (n,), rad."""
        off: Floats = self.loop.executor.reference.position - self.loop.robot.measured.position
        return off

    def move_to(self, pose: dict[str, float], seconds: float) -> None:
        """Move joints to `pose`, rad, and let `seconds` more pass."""
        self.lease()
        goal = self.loop.executor.reference.position.copy()
        for name, value in pose.items():
            goal[self.names.index(name)] = value
        path = self.straight(goal, seconds)
        self.submit(path, more=True)
        self.seconds(seconds)

    def straight(self, goal: Floats, seconds: float) -> Any:
        """Return a path to `goal` (n,), rad, that begins and ends at rest."""
        return Trajectory(
            np.array([seconds]), goal[None], np.ones(len(goal), np.bool_), np.zeros((1, len(goal)))
        )
