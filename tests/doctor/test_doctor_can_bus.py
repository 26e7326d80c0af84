"""Findings about CAN actuators that need no bus."""

from dataclasses import replace

from tests.support.doctor_surveys import (
    printed,
)
from twind.config.robot_file import load_robot
from twind.doctor.check import (
    DoctorFinding,
)
from twind_drivers.can.can_type import CanType
from twind_drivers.can.doctor.can_bus_checks import is_queried


def test_actuator_that_replies_to_commands_alone_is_not_queried() -> None:
    leg = next(joint for joint in load_robot("h24-mixed").joints if joint.bus == "l_leg")
    assert isinstance(leg.type, CanType)
    assert is_queried(leg)
    assert not is_queried(replace(leg, type=replace(leg.type, family="cubemars")))


def test_unverified_watchdog_warns_against_trying_it_out() -> None:
    said = printed(DoctorFinding("WATCHDOG_UNKNOWN", "bus l_leg id 1", "`watchdog: unverified`"))
    assert "kill -9" not in said
    assert "hold the joint by hand" not in said
    assert "do not try it out by killing the daemon" in said
