"""Steps from a stopped robot to an armed one, in words; the same for the gate and for clients. Pure."""

from collections.abc import Collection, Mapping, Sequence

from twind.robot.finding import ReasonCode
from twind.robot.modes import RESET_STATES, RobotState

DISARM = "`twindctl disarm`"
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


def reset_steps(codes: Collection[str], *, torque_on: bool) -> tuple[str, ...]:
    """Return the steps up to the reset, which needs torque off. An e-stop switches it off by itself."""
    if not torque_on:
        return (RESET,)
    return ("wait until torque is off" if ReasonCode.ESTOP in codes else DISARM, RESET)


def next_text(codes: Collection[str], *, torque_on: bool, live: bool) -> str:
    """Format `torque is on; next: …`, from latched `codes` to a robot that moves. `live`: it is armed."""
    on_feet = ("set it on its feet",) if ReasonCode.FALLING in codes else ()
    steps = (*reset_steps(codes, torque_on=torque_on), *on_feet, *((ARM,) if live else ()))
    torque = f"torque is {'on' if torque_on else 'off'}; " if live else ""
    return f"{torque}next: {THEN.join(steps)}"


def codes_text(codes: Sequence[str]) -> str:
    """Format the latched codes; a fall in words."""
    return ", ".join(f"{code} (the robot fell)" if code == ReasonCode.FALLING else code for code in codes)


def not_armed_text(state: str, codes: Sequence[str], *, torque_on: bool) -> str:
    """Format why a robot in mode live follows no goals, and the next commands. `codes`: those latched."""
    if codes or state in RESET_STATES:
        why = codes_text(codes) or f"state {state}"
        return f"the robot is stopped by {why}; {next_text(codes, torque_on=torque_on, live=True)}"
    return f"the robot is {state}, not armed: {WAYS.get(state, ELSE)}"
