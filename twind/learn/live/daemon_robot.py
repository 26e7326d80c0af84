"""The robot of a running daemon, as a learner simulates it: the same robot file, or none."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twind.config.robot_file import RobotFile, load_robot
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.learn.task.plant_model import Plant, plant_of
from twind.robot.modes import RobotState

MODES = ("sim", "live")
ANEW = "twindctl disarm, twindctl reset, twindctl arm"  # a reset wants torque to be off
WAYS: Mapping[str, str] = {
    RobotState.CONNECTED: "twindctl arm",
    RobotState.FAULT: f"mend what is latched, then {ANEW}",
    RobotState.ESTOP: f"find out why it was stopped, then {ANEW}",
    RobotState.INHIBITED: f"mend what is latched, then {ANEW}",
    RobotState.ARMING: "wait until it is",
    RobotState.SETTLING: "wait until it lies, then twindctl arm",
}
ELSE = "twindctl status says what it waits for; then twindctl arm"


def plant_from_answer(answer: Mapping[str, Any], period: float) -> Plant:
    """Build the plant of the robot in an answer of `GetRobot`. Raises InvalidInput."""
    path = Path(answer["robot"]["path"])
    try:
        robot = load_robot(str(path))
    except (ConfigError, OSError) as error:
        raise InvalidInput(f"the daemon's robot file cannot be read here: {error}") from None
    require_same(answer, robot)
    return plant_of(robot, period=period)


def require_same(answer: Mapping[str, Any], robot: RobotFile) -> None:
    """Raises InvalidInput unless the daemon runs this very robot file and model."""
    theirs = answer["robot"]
    if theirs["text_sha256"] != robot.text_sha256:
        raise InvalidInput(
            f"the daemon runs {theirs['name']} from {theirs['path']}, not as {robot.path} says now: "
            "name that robot, or restart or reload the daemon"
        )
    if theirs["mjcf"] != robot.mjcf:
        raise InvalidInput(f"the model {robot.mjcf_path} has changed since the daemon read it: restart it")


def require_armed(status: Mapping[str, Any]) -> None:
    """Raises InvalidInput where goals would move no robot, with the steps from there to an armed robot."""
    if status["mode"] == "live" and not (status["armed"] and status["state"] == RobotState.ARMED):
        found = f"the robot is {status['state']}{latched(status)}, not armed"
        raise InvalidInput(f"{found}: {WAYS.get(status['state'], ELSE)}")


def latched(status: Mapping[str, Any]) -> str:
    """The codes that are latched, in brackets; "": none."""
    codes = ", ".join(dict.fromkeys(each["code"] for each in status["faults"]))
    return f" ({codes})" if codes else ""


def require_mode(mode: str) -> None:
    """Raises InvalidInput where a policy would read one robot and move another."""
    if mode not in MODES:
        raise InvalidInput(
            f"mode {mode} shows the robot and moves the simulation: a policy would see the one and move the "
            f"other; use {' or '.join(MODES)}"
        )
