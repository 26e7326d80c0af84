"""Findings about settings of servos, from surveys as data."""

from dataclasses import replace

import pytest

from tests.support.doctor_surveys import (
    KNEE,
    LINE,
    ROBOT,
    print_only,
    servo,
    survey_codes,
    survey_findings,
)
from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import Calibration, JointCalibration
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector
from twind_drivers.servo_tools.doctor import register_fix


@pytest.mark.parametrize(
    ("calibrated", "now", "message"),
    [
        ((0, 4095), (1900, 2100), "register write main {0} min_position_limit 0"),
        ((1900, 2100), (1900, 2100), "calibrate l_knee anew, or tighten its `limits_rad`"),
        ((1900, 2100), (1900, 2101), "calibrate l_knee anew, or tighten its `limits_rad`"),
    ],
    ids=["written since", "as calibrated", "written since, and calibrated tight"],
)
def test_remedy_of_tight_position_limits_causes_no_next_finding(
    calibrated: tuple[int, int], now: tuple[int, int], message: str
) -> None:
    record = DeviceRecord(1020, 47, None, 0, 0, 3, *calibrated)
    entry = JointCalibration(
        "l_knee", "main", KNEE.id, record, 2048, 0.0, 1, 1, (0, 4095), 0, (0, 4096), "jig"
    )
    before = Calibration("h24", "", "", "", "jig", (entry,))
    one = servo(KNEE, min_position_limit=now[0], max_position_limit=now[1])
    [tight] = [each for each in survey_findings(one, calibration=before) if each.code == "FENCE_TIGHT"]
    assert message.format(KNEE.id) in tight.command + tight.advice
    assert not (tight.command and tight.advice)
    written = dict(line.split()[-2:] for line in tight.command.splitlines())
    after = servo(KNEE, **{name: int(value) for name, value in written.items()})
    if written:
        assert not survey_findings(after, calibration=before)


def test_shutdown_mask_of_the_robot_file_is_no_finding_and_no_mask_is_fixed() -> None:
    wanted = replace(KNEE, registers={"shutdown": 20})
    assert not survey_codes(servo(wanted, shutdown=20))
    [other] = survey_findings(servo(wanted, shutdown=52))
    assert (other.code, other.expected, other.fix) == ("REGISTER_DIFFERS", "20", None)
    [unsaid] = survey_findings(servo(KNEE, shutdown=20))
    assert (unsaid.code, unsaid.fix) == ("SHUTDOWN_MASK", None)
    assert "register write main" in unsaid.command


def test_fix_is_not_offered_against_the_robot_file() -> None:
    seen = CheckContext(HostInspector(), "twind.service", robot=ROBOT, lines={"main": LINE})
    assert register_fix.offer_fix(seen, servo(KNEE), "return_delay_time", 5) is not None
    demanded = replace(KNEE, registers={"return_delay_time": 9})
    assert register_fix.offer_fix(seen, servo(demanded), "return_delay_time", 5) is None
    assert register_fix.offer_fix(seen, servo(demanded), "return_delay_time", 9) is not None


def test_without_a_calibration_position_limits_are_judged_by_their_width() -> None:
    assert "FENCE_TIGHT" not in survey_codes(servo(KNEE, min_position_limit=1000, max_position_limit=2500))
    [tight] = survey_findings(servo(KNEE, min_position_limit=1000, max_position_limit=2400))
    assert tight.code == "FENCE_TIGHT"
    assert "a width of 14" in tight.expected
    assert not tight.command, "which counts are right, nobody knows"


def test_servo_that_answers_pings_alone_is_one_finding() -> None:
    assert survey_codes(replace(servo(KNEE), values={})) == {"STATUS_LEVEL"}


def test_zero_limit_is_not_raised_to_the_model_maximum() -> None:
    for name in ("velocity_limit", "pwm_limit", "current_limit"):
        said = print_only("FENCE_TIGHT", servo(KNEE, **{name: 0}))
        assert "register write main" not in said
        assert "and no further" in said


def test_low_current_limit_advises_to_lower_the_robot_file() -> None:
    joint = replace(KNEE, mode="current_based_position")
    said = print_only("FENCE_TIGHT", servo(joint, current_limit=500, operating_mode=5))
    assert "register write main" not in said
    assert "lower `current_limit_a` of type xm430 to 1.34 A" in said


def test_calibration_restore_warns_about_exchanged_servos_first() -> None:
    record = DeviceRecord(1020, 47, None, 300, 0, 3, 0, 4095)
    entry = JointCalibration(
        KNEE.name, "main", KNEE.id, record, 2048, 0.0, 1, 1, (0, 4095), 0, (0, 4096), "jig"
    )
    said = print_only(
        "CALIBRATION_CHANGED", servo(KNEE), calibration=Calibration("h24", "", "", "", "jig", (entry,))
    )
    assert said.index("only to the servo that was calibrated") < said.index("homing_offset 300")
