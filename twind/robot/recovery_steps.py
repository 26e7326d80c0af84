"""Steps from a stopped robot to an armed one, in words; the same for the gate and for clients. Pure.

`torque_on` is True: on; False: read off at every joint; None: not known, which counts as on.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, RobotState

SUPPORT = "support the robot"  # an inhibited one loses its torque where it stands
LIVE = "`twindctl mode live`"
WAIT = "wait until torque is off"
DISARM = "`twindctl disarm`"
CAUSE = "find and mend the cause"
RESET = "`twindctl reset`"
ARM = "`twindctl arm`"
THEN = ", then "
WAYS: Mapping[str, str] = {
    RobotState.CONNECTED: ARM,
    RobotState.ARMING: "wait until it is",
    RobotState.SETTLING: f"wait until it lies{THEN}{ARM}",
    RobotState.CALIBRATING: f"wait until it is calibrated{THEN}{ARM}",
}
ELSE = f"`twindctl status` says what it waits for{THEN}{ARM}"
UNKNOWN = "whether torque is on is not known: keep clear, reconnect the bus or switch the power off"


def torque_text(torque_on: bool | None) -> str:
    """Format whether torque is on; not known with what to do."""
    return UNKNOWN if torque_on is None else f"torque is {'on' if torque_on else 'off'}"


def reported_torque(status: Mapping[str, Any]) -> bool | None:
    """Return whether torque is on, as far as a status says it. An older daemon never says off."""
    if status["armed"] or status.get("inherited"):
        return True
    torque_on: bool | None = status.get("torque_on")
    return torque_on


def reset_steps(
    state: str, codes: Collection[str], *, torque_on: bool | None, live: bool = True
) -> tuple[str, ...]:
    """Return the steps up to the reset, which needs torque off. An e-stop switches it off by itself.

    Outside `live` only torque that is on keeps from a reset, and only `live` switches it off.
    """
    release: tuple[str, ...] = ()
    if torque_on or (torque_on is None and live):
        support = (SUPPORT,) if state == RobotState.INHIBITED else ()
        writes = () if live else (LIVE,)
        release = (*support, *writes, WAIT if ReasonCode.ESTOP in codes else DISARM)
    return (*release, CAUSE, RESET)


def steps_text(state: str, codes: Collection[str], *, torque_on: bool | None, live: bool) -> str:
    """Format `next: …`, from latched `codes` to a robot that moves; in `live` it is armed."""
    on_feet = ("set it on its feet",) if ReasonCode.FALLING in codes else ()
    steps = reset_steps(state, codes, torque_on=torque_on, live=live)
    return f"next: {THEN.join((*steps, *on_feet, *((ARM,) if live else ())))}"


def next_text(state: str, codes: Collection[str], *, torque_on: bool | None, live: bool) -> str:
    """Format `torque is on; next: …`. Outside `live` nothing is said of torque."""
    torque = f"{torque_text(torque_on)}; " if live else ""
    return torque + steps_text(state, codes, torque_on=torque_on, live=live)


def codes_text(codes: Sequence[str]) -> str:
    """Format the latched codes; a fall in words."""
    return ", ".join(f"{code} (the robot fell)" if code == ReasonCode.FALLING else code for code in codes)


def stopped_by_text(state: str, codes: Sequence[str], *, torque_on: bool | None, mode: str) -> str:
    """Format what stopped a robot, and the next commands. `codes`: those latched."""
    why = codes_text(codes) or f"state {state}"
    after = next_text(state, codes, torque_on=torque_on, live=mode == Mode.LIVE)
    return f"the robot is stopped by {why}; {after}"


def not_armed_text(state: str) -> str:
    """Format that a robot that nothing stopped is not armed, and the next commands."""
    return f"the robot is {state}, not armed: {WAYS.get(state, ELSE)}"
