"""A client that is about to move a stopped robot says what stopped it, and the commands that arm it again."""

from typing import Any

import pytest

from twind.exceptions import InvalidInput
from twind.robot_client.require_armed import require_armed, stopped_text


def status(state: str, *codes: str, mode: str = "live", **over: Any) -> dict[str, Any]:
    """A status, as far as it is looked at."""
    faults = [{"code": each} for each in codes]
    return {"mode": mode, "armed": False, "state": state, "faults": faults, "latched": list(codes)} | over


RESET = "next: `twindctl reset`, then `twindctl arm`"


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (status("connected"), "the robot is connected, not armed: `twindctl arm`"),
        (status("settling"), "the robot is settling, not armed: wait until it lies, then `twindctl arm`"),
        (status("fault", "LEASE_LOST"), f"the robot is stopped by LEASE_LOST; torque is off; {RESET}"),
        (
            status("fault", "LEASE_LOST", latched=None),
            f"the robot is stopped by LEASE_LOST; torque is off; {RESET}",
        ),
        (status("estop", "ESTOP"), f"the robot is stopped by ESTOP; torque is off; {RESET}"),
        (status("inhibited"), f"the robot is stopped by state inhibited; torque is off; {RESET}"),
        (
            status("fault", "FALLING", "STATE_STALE", latched=["FALLING"], armed=True),
            "the robot is stopped by FALLING (the robot fell); torque is on; next: `twindctl disarm`, "
            "then `twindctl reset`, then set it on its feet, then `twindctl arm`",
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


def test_a_command_names_no_code_that_clears_by_itself() -> None:
    with pytest.raises(InvalidInput, match="not armed"):
        require_armed(status("identifying", "STATE_STALE", latched=[]))
