"""Check by its status that a robot follows goals, before a client begins to move it."""

from collections.abc import Mapping
from typing import Any

from twind.exceptions import InvalidInput
from twind.robot.modes import RESET_STATES, Mode, RobotState
from twind.robot.recovery_steps import not_armed_text, reported_torque, stopped_by_text


def require_armed(status: Mapping[str, Any]) -> None:
    """Raises InvalidInput where goals would move no robot, with the steps from there to an armed robot."""
    if status["mode"] != Mode.LIVE or (status["armed"] and status["state"] == RobotState.ARMED):
        return
    stopped = bool(_latched(status)) or status["state"] in RESET_STATES
    raise InvalidInput(_stopped_by(status) if stopped else not_armed_text(status["state"]))


def stopped_text(status: Mapping[str, Any]) -> str:
    """Return what stopped the robot, and the next commands; "": nothing."""
    return _stopped_by(status) if status["state"] in RESET_STATES else ""


def _stopped_by(status: Mapping[str, Any]) -> str:
    torque_on = reported_torque(status)
    return stopped_by_text(status["state"], _latched(status), torque_on=torque_on, mode=status["mode"])


def _latched(status: Mapping[str, Any]) -> list[str]:
    """Return the codes that only a reset clears. An older daemon reports none; in a fault all count."""
    codes = list(dict.fromkeys(fault["code"] for fault in status["faults"]))
    latched = status.get("latched")
    if latched is None:
        return codes if status["state"] in RESET_STATES else []
    return [code for code in codes if code in latched] or list(latched)
