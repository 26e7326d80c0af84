"""Remedies of the doctor where its diagnosis is wrong: what must be printed before they are followed."""

import re
from dataclasses import replace

import pytest

from tests.support.surveyed_servos import KNEE, found, servo
from twind.config.calibration_file import Calibration, JointCalibration
from twind.config.device_record import DeviceRecord
from twind_calibration import doctor
from twind_calibration.command_hint import CommandHint
from twind_calibration.doctor import check_table, report
from twind_calibration.doctor.check import DoctorFinding, Fix
from twind_calibration.doctor.finding_commands import add_commands
from twind_calibration.doctor.runner import DoctorReport

ROWS = check_table.complaints()
# What moves, drops, wipes, burns or stops something where the diagnosis is wrong.
HARMFUL = re.compile(
    r"`twindctl (arm|disarm|reboot|adopt|register write)|`sudo systemctl (re)?start|`sudo systemctl mask|"
    r"`sudo (chown|chmod|chgrp|usermod|ip link set \S+ (up|down))|switch (it|its power) off|supply|unplug|"
    r"disconnect|cable|connector|end (it|the (other )?program)|chrt|vendor's tool|firmware|exchange|wires"
)
# Rows whose remedy has such a word and no such effect.
HARMLESS = {
    "VOLTAGE_BOUNDS": "the supply stays as it is",
    "PORT_DENIED": "the group lets the daemon open a port, which moves nothing",
    "NO_DAEMON": "a daemon that begins changes no torque",
}


def printed(finding: DoctorFinding) -> str:
    """The finding as the doctor prints it to a call beside a daemon."""
    ready, fix = add_commands([finding], ROWS, CommandHint(), daemon=True)
    return report.text(DoctorReport(found=ready, fix=fix), ROWS, None)


def only(code: str, *servos: object, **more: object) -> str:
    """The printed finding of this code, about a bus where the rest is well."""
    (finding,) = [each for each in found(*servos, **more) if each.code == code]  # type: ignore[arg-type]
    return printed(finding)


@pytest.mark.parametrize("code", [code for code in ROWS if HARMFUL.search(ROWS[code].remedy)])
def test_a_remedy_that_can_harm_has_a_caution(code: str) -> None:
    assert ROWS[code].caution or code in HARMLESS


@pytest.mark.parametrize("code", [code for code, row in ROWS.items() if row.caution])
def test_the_caution_is_printed_before_the_remedy_and_before_the_command(code: str) -> None:
    said = printed(DoctorFinding(code, "thing", "measured", command="COMMAND", advice="ADVICE"))
    assert said.index(ROWS[code].caution) < said.index("ADVICE") < said.index("COMMAND")
    said = printed(DoctorFinding(code, "thing", "measured"))
    assert said.index(ROWS[code].caution) < said.index("do: ")
    (data,) = report.data(DoctorReport(found=[DoctorFinding(code, "thing", "measured")]), ROWS, None)["found"]
    assert data["caution"] == ROWS[code].caution


def test_what_fix_would_do_is_asked_with_the_cautions(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin.readline", lambda: "n\n")
    mends = [
        DoctorFinding("RETURN_DELAY", f"id {id}", "500 us", fix=Fix("delay := 5", lambda: None))
        for id in (1, 2)
    ]
    assert not doctor._agreed(DoctorReport(found=mends), ROWS, asks=True)
    assert capsys.readouterr().out.count(ROWS["RETURN_DELAY"].caution) == 1


def test_a_servo_with_an_error_that_still_holds_is_not_to_be_rebooted() -> None:
    """By its mask an input voltage error switches nothing off: a reboot would let the joint fall."""
    assert "twindctl reboot main" in only("ERROR_VOLTAGE", servo(KNEE, hardware_error_status=1))
    holds = only("ERROR_VOLTAGE", servo(KNEE, hardware_error_status=1, torque_enable=1))
    assert f"reboot main {KNEE.id}" not in holds
    assert "support the joint" in holds


def test_a_limit_that_locks_a_joint_is_not_raised_to_the_model_s_most() -> None:
    for name in ("velocity_limit", "pwm_limit", "current_limit"):
        said = only("LIMIT_ZERO", servo(KNEE, **{name: 0}))
        assert "register write main" not in said
        assert "and no further" in said


def test_a_current_limit_that_protects_a_joint_is_kept_and_the_robot_file_lowered() -> None:
    joint = replace(KNEE, mode="current_based_position")
    said = only("CURRENT_CAP", servo(joint, current_limit=500, operating_mode=5))
    assert "register write main" not in said
    assert "lower `current_limit_a` of type xm430 to 1.34 A" in said


def test_a_second_id_that_couples_two_servos_of_one_joint_is_to_be_left() -> None:
    said = only("SECOND_ID", servo(KNEE, secondary_shadow_id=17))
    assert said.index("where two servos turn one joint") < said.index("secondary_shadow_id 255")


def test_an_exchanged_servo_is_not_to_get_the_zero_of_the_old_one() -> None:
    record = DeviceRecord(1020, 47, None, 300, 0, 3, 0, 4095)
    entry = JointCalibration(
        KNEE.name, "main", KNEE.id, record, 2048, 0.0, 1, 1, (0, 4095), 0, (0, 4096), "jig"
    )
    said = only(
        "CALIBRATION_CHANGED", servo(KNEE), calibration=Calibration("h24", "", "", "", "jig", (entry,))
    )
    assert said.index("only to the servo that was calibrated") < said.index("homing_offset 300")


def test_torque_of_another_program_is_not_taken_off_before_the_robot_is_supported() -> None:
    said = only("TORQUE_ON", servo(KNEE, torque_enable=1))
    assert said.index("support the robot") < said.index("twindctl disarm")


def test_the_watchdog_of_an_actuator_is_not_to_be_tried_out_with_hands_on_the_robot() -> None:
    said = printed(DoctorFinding("CAN_WATCHDOG_UNVERIFIED", "bus l_leg id 1", "`watchdog: unverified`"))
    assert "kill -9" not in said
    assert "hold the joint by hand" not in said
    assert "do not try it out by killing the daemon" in said


def test_a_silent_bus_is_not_to_be_switched_on_with_a_person_at_the_robot() -> None:
    for code in ("BUS_SILENT", "CAN_SILENT"):
        assert "make sure that no person works at the robot" in printed(
            DoctorFinding(code, "bus main", "no answer")
        )
