"""The robot of a running daemon, as a learner simulates it: the same robot file, or none."""

from collections.abc import Mapping
from typing import Any

from twind.exceptions import InvalidInput
from twind.learn.task.plant_model import Plant, plant_of
from twind.robot_client.daemon_robot_file import robot_file_of

MODES = ("sim", "live")


def plant_from_answer(answer: Mapping[str, Any], period: float) -> Plant:
    """Build the plant of the robot in an answer of `GetRobot`. Raises InvalidInput."""
    return plant_of(robot_file_of(answer), period=period)


def require_mode(mode: str) -> None:
    """Raises InvalidInput where a policy would read one robot and move another."""
    if mode not in MODES:
        raise InvalidInput(
            f"mode {mode} shows the robot and moves the simulation: a policy would see the one and move the "
            f"other; use {' or '.join(MODES)}"
        )
