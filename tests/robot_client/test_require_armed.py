"""A client that is about to move a stopped robot says what stopped it, and the commands that arm it again."""

from typing import Any

import pytest

from twind.exceptions import InvalidInput
from twind.robot.recovery_steps import UNKNOWN
from twind.robot_client.require_armed import require_armed, stopped_text


def status(state: str, *codes: str, mode: str = "live", **over: Any) -> dict[str, Any]:
    """A status, as far as it is looked at."""
    faults = [{"code": each} for each in codes]
    return {"mode": mode, "armed": False, "state": state, "faults": faults, "latched": list(codes)} | over


MENDED = "find and mend the cause, then `twindctl reset`"
RESET = f"next: {MENDED}, then `twindctl arm`"
LOWER = f"`twindctl disarm`, then {MENDED}, then `twindctl arm`"
OFF = {"torque_on": False}


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (status("connected"), "the robot is connected, not armed: `twindctl arm`"),
        (status("settling"), "the robot is settling, not armed: wait until it lies, then `twindctl arm`"),
        (status("fault", "LEASE_LOST", **OFF), f"the robot is stopped by LEASE_LOST; torque is off; {RESET}"),
        (
            status("fault", "LEASE_LOST", latched=None, **OFF),
            f"the robot is stopped by LEASE_LOST; torque is off; {RESET}",
        ),
        (status("estop", "ESTOP", **OFF), f"the robot is stopped by ESTOP; torque is off; {RESET}"),
        (status("inhibited", **OFF), f"the robot is stopped by state inhibited; torque is off; {RESET}"),
        (
            status("disconnected", "PORT_LOST", torque_on=None),
            f"the robot is stopped by PORT_LOST; {UNKNOWN}; next: {LOWER}",
        ),
        (  # an older daemon, whose status has no such field
            status("inhibited"),
            f"the robot is stopped by state inhibited; {UNKNOWN}; next: support the robot, then {LOWER}",
        ),
        (
            status("fault", "LEASE_LOST", torque_on=True),
            f"the robot is stopped by LEASE_LOST; torque is on; next: {LOWER}",
        ),
        (
            status("fault", "LEASE_LOST", inherited=True, **OFF),
            f"the robot is stopped by LEASE_LOST; torque is on; next: {LOWER}",
        ),
        (
            status("fault", "FALLING", "STATE_STALE", latched=["FALLING"], armed=True),
            "the robot is stopped by FALLING (the robot fell); torque is on; next: `twindctl disarm`, "
            f"then {MENDED}, then set it on its feet, then `twindctl arm`",
        ),
    ],
)
def test_a_robot_that_is_not_armed_is_refused_with_its_state_and_the_next_commands(
    given: dict[str, Any], text: str
) -> None:
    with pytest.raises(InvalidInput) as refused:
        require_armed(given)
    assert str(refused.value) == text
    assert stopped_text(given) in ("", text)


def test_an_armed_or_simulated_robot_is_not_refused() -> None:
    for given in (status("armed", armed=True), status("connected", mode="sim")):
        require_armed(given)
        assert stopped_text(given) == ""


def test_the_text_of_a_stopped_simulation_has_no_torque() -> None:
    assert stopped_text(status("estop", "ESTOP", mode="sim")) == (
        f"the robot is stopped by ESTOP; next: {MENDED}"
    )


def test_a_command_names_no_code_that_clears_by_itself() -> None:
    with pytest.raises(InvalidInput, match="not armed"):
        require_armed(status("identifying", "STATE_STALE", latched=[]))
