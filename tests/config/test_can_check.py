"""Are the CAN actuators on the wire those of the files? What they tell is compared, and both values named."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from twind.config.calibration_file import dump_calibration, fitting, read_calibration
from twind.config.device_check import compare
from twind.config.robot_file import load_robot
from twind.robot.finding import ReasonCode, Verdict
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.can.can_models import number_of as can_number
from twind_drivers.can.can_type import CanType

ROBOT = load_robot("h24-mixed")
SERVO = {
    "homing_offset": 0,
    "drive_mode": 0,
    "operating_mode": 3,
    "min_position_limit": 0,
    "max_position_limit": 4095,
    "startup_configuration": 0,
    "return_delay_time": 5,
}
TOLD = {"pmax_milli": 12_500, "vmax_milli": 30_000, "tmax_milli": 10_000}
NODE = {
    "homing_offset": 0,
    "drive_mode": 0,
    "operating_mode": 1,
    "min_position_limit": -32595,
    "max_position_limit": 32595,
    **TOLD,
}
DEVICES = {
    (j.bus, j.id): IdentifiedDevice(j.id, 1020, "XM430-W350", 46, SERVO)
    if j.bus == "upper"
    else IdentifiedDevice(j.id, can_number("DM4310"), None, 1, NODE)
    for j in ROBOT.joints
}
ZEROS = {j.name: 2048 if j.bus == "upper" else 100 for j in ROBOT.joints}
CALIBRATION = fitting(ROBOT, ZEROS, DEVICES, created="2026-11-21T09:14:03Z", tool="twind")
KNEE = ROBOT.names.index("l_knee")
KEY = ("l_leg", 4)


def with_knee(change: Callable[[IdentifiedDevice], IdentifiedDevice]) -> Verdict:
    return compare(ROBOT, CALIBRATION, {**DEVICES, KEY: change(DEVICES[KEY])})


def set_to(**settings: int) -> Callable[[IdentifiedDevice], IdentifiedDevice]:
    return lambda device: replace(device, settings={**device.settings, **settings})


def test_actuators_as_they_were_calibrated_pass_without_a_word() -> None:
    assert compare(ROBOT, CALIBRATION, DEVICES) == Verdict()


def test_a_calibration_of_both_kinds_is_written_and_read_back() -> None:
    found = read_calibration(dump_calibration(CALIBRATION), "here", ROBOT)
    assert found == replace(CALIBRATION, sha256=found.sha256)
    assert found.by_name["l_knee"].device.model_number == can_number("DM4310") > 65535


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"pmax_milli": 12_566}, "its frames span 12.566 rad, the robot file says 12.5: a wrong range"),
        ({"pmax_milli": 12_498}, "its frames span 12.498 rad, the robot file says 12.5"),
        ({"vmax_milli": 45_000}, "its frames span 45 rad/s, the robot file says 30"),
        ({"tmax_milli": 20_000}, "its frames span 20 N·m, the robot file says 10"),
        (
            {"operating_mode": 2},
            "its operating mode is 2: it does not take the commands of the damiao family",
        ),
    ],
)
def test_a_device_setting_that_differs_from_the_file_is_refused_with_both_values(
    settings: dict[str, int], words: str
) -> None:
    verdict = with_knee(set_to(**settings))
    found = [each for each in verdict.refusals if each.code is ReasonCode.DEVICE_MISMATCH]
    assert [each.joint for each in found] == [KNEE]
    assert words in found[0].message


def test_a_range_within_a_thousandth_is_equal() -> None:
    assert with_knee(set_to(pmax_milli=12_501)) == Verdict()


@pytest.mark.parametrize("lost", TOLD)
def test_a_range_that_was_not_read_refuses(lost: str) -> None:
    """The described one would stand for it: an actuator of another range reads as another position."""
    settings = {key: value for key, value in NODE.items() if key != lost}
    verdict = with_knee(lambda device: replace(device, settings=settings))
    [found] = verdict.refusals
    assert (found.code, found.joint) == (ReasonCode.DEVICE_MISMATCH, KNEE)
    assert "was not read, so the scale of its readings is not known" in found.message


def test_a_device_of_a_family_that_reports_no_ranges_is_compared_by_its_other_values() -> None:
    joint = ROBOT.joints[KNEE]
    assert isinstance(joint.type, CanType)
    device = IdentifiedDevice(4, can_number("RS01"), "RS01", 1, {"operating_mode": 1})
    assert not list(replace(joint.type, family="robstride", device="RS01").unfit(joint, device))


def test_a_reported_device_model_is_compared() -> None:
    verdict = with_knee(
        lambda device: replace(device, model_name="DM4340", model_number=can_number("DM4340"))
    )
    assert "is DM4340 (model number 71004), the robot file says DM4310" in verdict.refusals[0].message
    assert any(each.code is ReasonCode.CALIB_MISMATCH for each in verdict.refusals)


def test_an_unread_operating_mode_refuses() -> None:
    unread = {key: value for key, value in NODE.items() if key != "operating_mode"}
    assert with_knee(lambda device: replace(device, settings=unread)).refusals


def test_ranges_that_changed_since_the_calibration_refuse() -> None:
    verdict = with_knee(set_to(max_position_limit=32767))
    assert [each.code for each in verdict.refusals] == [ReasonCode.CALIB_MISMATCH]
    assert "max_position_limit is 32767, was 32595 when calibrated" in verdict.refusals[0].message


def test_other_firmware_warns() -> None:
    verdict = with_knee(lambda device: replace(device, firmware=2))
    assert verdict.accepted
    assert "firmware is 2, was 1 when calibrated" in verdict.warnings[0].message


def test_a_device_that_does_not_answer_is_missing() -> None:
    devices = {key: device for key, device in DEVICES.items() if key != KEY}
    found = [each for each in compare(ROBOT, CALIBRATION, devices).refusals if each.joint == KNEE]
    assert [each.code for each in found] == [ReasonCode.DEVICE_MISSING]
