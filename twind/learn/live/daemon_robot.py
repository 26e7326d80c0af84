"""The robot of a running daemon, as a learner simulates it: the same robot file, or none."""

from collections.abc import Mapping
from typing import Any

from twind.exceptions import InvalidInput
from twind.learn.task.plant_model import Plant, plant_of
from twind.robot.modes import RobotState
from twind.robot_client.daemon_robot_file import robot_file_of

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
    return plant_of(robot_file_of(answer), period=period)


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
