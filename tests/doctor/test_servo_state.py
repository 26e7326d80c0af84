"""Findings about errors, torque and watchdogs, from surveys as data."""

from pathlib import Path

import pytest

from tests.support.daemon_stand_ins import answering
from tests.support.doctor_surveys import (
    KNEE,
    ROWS,
    print_only,
    servo,
    survey_findings,
)
from twind.client import Client
from twind.doctor.check import severity_of
from twind.doctor.inspectors import DaemonInspector


def test_each_hardware_error_is_a_finding_with_its_name() -> None:
    found = survey_findings(servo(KNEE, hardware_error_status=0b100101))
    assert {each.code for each in found} == {"SERVO_ERROR"}
    names = [each.measured.partition(": ")[2] for each in found]
    assert names == ["input voltage", "overheating", "overload"]


def test_a_hot_servo_is_a_warning_and_a_hardware_error_a_fault() -> None:
    found = survey_findings(servo(KNEE, hardware_error_status=4, present_temperature=75))
    assert [(each.measured, severity_of(each, ROWS).value) for each in found] == [
        ("hardware error (70) is 4: overheating", "fault"),
        ("75 degC", "warning"),
    ]


def test_torque_without_arming_and_without_a_watchdog_is_one_finding() -> None:
    (unwatched,) = survey_findings(servo(KNEE, torque_enable=1, bus_watchdog=0))
    assert (unwatched.code, unwatched.measured) == ("TORQUE_ON", "torque is on; bus watchdog (98) is 0")
    (watched,) = survey_findings(servo(KNEE, torque_enable=1, bus_watchdog=5))
    assert (watched.code, watched.measured) == ("TORQUE_ON", "torque is on")


@pytest.mark.parametrize(("mode", "codes"), [("live", set()), ("mirror", {"WATCHDOG_LEFT"})])
def test_a_watchdog_left_by_a_disarm_is_no_finding_while_the_daemon_is_live(
    tmp_path: Path, mode: str, codes: set[str]
) -> None:
    """A live daemon alone uses the bus, and arming sets the watchdog anew."""
    status = {
        "version": "1",
        "robot": "h24",
        "mode": mode,
        "state": "connected",
        "armed": False,
        "inherited": False,
    }
    with answering(tmp_path) as make:
        make("control", lambda _: {"parameters": {"status": status, "joints": []}})
        with Client(tmp_path) as client:
            found = survey_findings(servo(KNEE, bus_watchdog=255), daemon=DaemonInspector(client))
    assert {each.code for each in found} == codes


def test_servo_with_error_and_torque_gets_no_reboot_command() -> None:
    """By its mask an input voltage error switches nothing off: a reboot would let the joint fall."""
    assert "twindctl reboot main" in print_only("SERVO_ERROR", servo(KNEE, hardware_error_status=1))
    holds = print_only("SERVO_ERROR", servo(KNEE, hardware_error_status=1, torque_enable=1))
    assert f"reboot main {KNEE.id}" not in holds
    assert "support the joint" in holds


def test_torque_warns_to_support_the_robot_before_disarm() -> None:
    said = print_only("TORQUE_ON", servo(KNEE, torque_enable=1))
    assert said.index("support the robot") < said.index("twindctl disarm")
