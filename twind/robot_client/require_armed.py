"""Check by its status that a robot follows goals, before a client begins to move it."""

from collections.abc import Mapping
from typing import Any

from twind.exceptions import InvalidInput
from twind.robot.modes import RESET_STATES, RobotState
from twind.robot.recovery_steps import not_armed_text


def require_armed(status: Mapping[str, Any]) -> None:
    """Raises InvalidInput where goals would move no robot, with the steps from there to an armed robot."""
    if status["mode"] != "live" or (status["armed"] and status["state"] == RobotState.ARMED):
        return
    raise InvalidInput(_text(status))


def stopped_text(status: Mapping[str, Any]) -> str:
    """Return what stopped the robot, and the next commands; "": nothing."""
    return _text(status) if status["state"] in RESET_STATES else ""


def _text(status: Mapping[str, Any]) -> str:
    torque_on = bool(status["armed"] or status.get("inherited"))
    return not_armed_text(status["state"], _latched(status), torque_on=torque_on)


def _latched(status: Mapping[str, Any]) -> list[str]:
    """Return the codes that only a reset clears. An older daemon reports none; in a fault all count."""
    codes = list(dict.fromkeys(fault["code"] for fault in status["faults"]))
    latched = status.get("latched")
    if latched is None:
        return codes if status["state"] in RESET_STATES else []
    return [code for code in codes if code in latched] or list(latched)
