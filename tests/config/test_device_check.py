"""Are the servos on the wire those of the files? Every difference is named; nothing unknown passes."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tests.support.h24_calibration import CALIBRATION, DEVICES, KEY, KNEE, ROBOT, SETTINGS
from twind.config.device_check import check_devices, compare
from twind.config.robot_spec import RobotFile
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind_drivers.bus import IdentifiedDevice


def with_knee(change: Callable[[IdentifiedDevice], IdentifiedDevice]) -> Verdict:
    return compare(ROBOT, CALIBRATION, {**DEVICES, KEY: change(DEVICES[KEY])})


def set_to(**settings: int) -> Callable[[IdentifiedDevice], IdentifiedDevice]:
    return lambda device: replace(device, settings={**device.settings, **settings})


def without(name: str) -> Callable[[IdentifiedDevice], IdentifiedDevice]:
    return lambda device: replace(device, settings={k: v for k, v in device.settings.items() if k != name})


def test_servos_as_they_were_calibrated_pass_without_a_word() -> None:
    assert compare(ROBOT, CALIBRATION, DEVICES) == Verdict()


@pytest.mark.parametrize(
    ("register", "value"),
    [
        ("homing_offset", 5),
        ("homing_offset", -1024),
        ("drive_mode", 1),
        ("drive_mode", 4),
        ("operating_mode", 4),
        ("min_position_limit", 1),
        ("max_position_limit", 4094),
    ],
)
def test_every_recorded_register_is_compared_with_both_values_named(register: str, value: int) -> None:
    verdict = with_knee(set_to(**{register: value}))
    found = [each for each in verdict.refusals if each.code is ReasonCode.CALIB_MISMATCH]
    assert [(each.joint, each.value, each.bound) for each in found] == [
        (KNEE, float(value), float(SETTINGS[register]))
    ]
    assert f"{register} is {value}, was {SETTINGS[register]}" in found[0].message


@pytest.mark.parametrize("found", [10, 612, None])
def test_a_servo_without_the_tag_of_its_calibration_is_refused_and_one_with_it_is_not(
    found: int | None,
) -> None:
    joints = [
        replace(entry, device=replace(entry.device, tag=613)) if place == KNEE else entry
        for place, entry in enumerate(CALIBRATION.joints)
    ]
    tagged = replace(CALIBRATION, joints=tuple(joints))

    def refusals(**settings: int) -> list[Finding]:
        key = (ROBOT.joints[KNEE].bus, ROBOT.joints[KNEE].id)
        return list(compare(ROBOT, tagged, {**DEVICES, key: set_to(**settings)(DEVICES[key])}).refusals)

    assert refusals(moving_threshold=613) == []
    (one,) = refusals() if found is None else refusals(moving_threshold=found)
    assert (one.code, one.joint, one.bound) == (ReasonCode.CALIB_MISMATCH, KNEE, 613.0)
    said = "was not read" if found is None else f"is {found}"
    assert f"moving_threshold {said}, its tag was 613" in one.message


@pytest.mark.parametrize("register", ["homing_offset", "drive_mode", "operating_mode", "min_position_limit"])
def test_a_register_that_was_not_read_refuses(register: str) -> None:
    verdict = with_knee(without(register))
    assert verdict.refusals
    assert all(each.joint == KNEE for each in verdict.refusals)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (set_to(drive_mode=8), "drive_mode (10) is 8: bit 3, torque on by goal update"),
        (set_to(startup_configuration=1), "startup_configuration (60) is 1: bit 0, torque on at boot"),
        (set_to(startup_configuration=3), "startup_configuration (60) is 3"),
        (set_to(homing_offset=1025), "homing_offset (20) is 1025; beyond ±1024 position mode ignores it"),
        (set_to(homing_offset=-1025), "homing_offset (20) is -1025"),
        (set_to(secondary_shadow_id=0), "secondary_shadow_id (12) is 0: it obeys goals for id 0 too; with"),
        (set_to(secondary_shadow_id=252), "secondary_shadow_id (12) is 252"),
        (set_to(operating_mode=4), "operating_mode (11) is 4, position mode is 3: with torque off write 3"),
        (
            lambda d: replace(d, model_number=1030, model_name="XM430-W210"),
            "is XM430-W210 (model number 1030)",
        ),
        (lambda d: replace(d, model_number=4711, model_name=None), "a model that is in no table"),
    ],
)
def test_an_unusable_servo_is_refused_whatever_the_calibration(
    change: Callable[[IdentifiedDevice], IdentifiedDevice], words: str
) -> None:
    verdict = check_devices(ROBOT, {**DEVICES, KEY: change(DEVICES[KEY])})
    assert [(each.code, each.joint) for each in verdict.refusals] == [(ReasonCode.DEVICE_MISMATCH, KNEE)]
    assert words in verdict.refusals[0].message


@pytest.mark.parametrize("value", [253, 254, 255])
def test_a_second_id_that_is_off_is_nothing_to_refuse(value: int) -> None:
    """E-manual, X series, "Secondary(Shadow) ID (12)": 253 and above are off."""
    assert with_knee(set_to(secondary_shadow_id=value)) == Verdict()


def test_restoring_ram_at_boot_alone_is_no_torque_at_boot() -> None:
    assert not with_knee(set_to(startup_configuration=2)).refusals
    assert not with_knee(without("startup_configuration")).refusals  # older firmware has no such register


def test_another_firmware_and_a_slow_return_delay_are_warned_of() -> None:
    verdict = with_knee(lambda device: replace(set_to(return_delay_time=250)(device), firmware=47))
    assert not verdict.refusals
    slow, firmware = verdict.warnings
    assert (slow.code, slow.joint, slow.value, slow.bound) == (ReasonCode.DEVICE_MISMATCH, KNEE, 500.0, 10.0)
    assert (firmware.code, firmware.value, firmware.bound) == (ReasonCode.CALIB_MISMATCH, 47.0, 46.0)
    assert "`twindctl register write main 16 return_delay_time 5`" in slow.message


def test_another_model_of_the_same_size_is_refused_by_both_files() -> None:
    verdict = with_knee(lambda device: replace(device, model_number=1030, model_name="XM430-W210"))
    assert [each.code for each in verdict.refusals] == [ReasonCode.DEVICE_MISMATCH, ReasonCode.CALIB_MISMATCH]


def test_an_unread_setting_is_refused_as_unread_and_not_as_wrong() -> None:
    verdict = with_knee(lambda device: replace(device, settings={}))
    first, *others = [each.message for each in verdict.refusals]
    assert "operating_mode, homing_offset, drive_mode not read" in first
    assert others
    assert all("was not read; it was" in each for each in others)
    assert not any(word in each for each in (first, *others) for word in ("None", "write ", "must be"))


def test_a_missing_servo_is_refused_by_name() -> None:
    verdict = compare(ROBOT, CALIBRATION, {key: each for key, each in DEVICES.items() if key != KEY})
    assert [(each.code, each.joint) for each in verdict.refusals] == [(ReasonCode.DEVICE_MISSING, KNEE)]
    assert "nothing answers as id 16 on bus main" in verdict.refusals[0].message


@pytest.mark.parametrize("calibration", [None, replace(CALIBRATION, joints=())])
def test_without_calibration_every_joint_refuses(calibration: Any) -> None:
    verdict = compare(ROBOT, calibration, DEVICES)
    assert [each.code for each in verdict.refusals] == [ReasonCode.CALIB_MISSING] * 24
    assert [each.joint for each in verdict.refusals] == list(range(24))


def test_no_devices_at_all_refuse_every_joint() -> None:
    assert len(compare(ROBOT, CALIBRATION, {}).refusals) == 24


@pytest.mark.parametrize(
    ("share", "warned"), [(0.59, True), (0.61, False), (1.0, False), (1.29, False), (1.31, True)]
)
def test_implausible_travel_is_warned_of(share: float, warned: bool) -> None:
    joint = ROBOT.joints[KNEE]
    entry = CALIBRATION.joints[KNEE]
    ticks = round(share * joint.reach / (2 * 3.141592653589793) * 4096)
    joints = list(CALIBRATION.joints)
    joints[KNEE] = replace(entry, sweep_ticks=(2000, 2000 + ticks))
    verdict = compare(ROBOT, replace(CALIBRATION, joints=tuple(joints)), DEVICES)
    assert bool(verdict.warnings) is warned
    assert not verdict.refusals


def in_mode(mode: str) -> RobotFile:
    return replace(ROBOT, joints=tuple(replace(joint, mode=mode) for joint in ROBOT.joints))


@pytest.mark.parametrize(("mode", "number"), [("extended_position", 4), ("current_based_position", 5)])
def test_a_servo_has_the_mode_that_its_joint_names(mode: str, number: int) -> None:
    robot = in_mode(mode)
    assert len(check_devices(robot, DEVICES).refusals) >= 24  # all of them are in position mode
    devices = {key: set_to(operating_mode=number, current_limit=1193)(each) for key, each in DEVICES.items()}
    assert not check_devices(robot, devices).refusals
    (missing,) = check_devices(robot, {**devices, KEY: without("operating_mode")(devices[KEY])}).refusals
    assert (missing.code, missing.joint) == (ReasonCode.DEVICE_MISMATCH, KNEE)


def test_a_mode_in_which_servo_limits_have_no_effect_gives_a_warning() -> None:
    # e-manual, Min/Max Position Limit (48, 52): used in position control mode only
    devices = {key: set_to(operating_mode=4)(each) for key, each in DEVICES.items()}
    verdict = check_devices(in_mode("extended_position"), devices)
    assert [each.joint for each in verdict.warnings] == list(range(24))
    assert {(each.code, each.value, each.bound) for each in verdict.warnings} == {
        (ReasonCode.DEVICE_MISMATCH, 4.0, 3.0)
    }
    assert not check_devices(ROBOT, DEVICES).warnings


@pytest.mark.parametrize("offset", [1025, -100_000])
def test_a_wide_offset_is_refused_in_position_mode_alone(offset: int) -> None:
    # e-manual, Homing Offset (20): position control mode uses -1024..1024 only, the others all of it
    change = set_to(operating_mode=4, homing_offset=offset)
    devices = {key: change(each) for key, each in DEVICES.items()}
    assert not check_devices(in_mode("extended_position"), devices).refusals
    devices = {key: set_to(homing_offset=offset)(each) for key, each in DEVICES.items()}
    assert len(check_devices(ROBOT, devices).refusals) == 24


@pytest.mark.parametrize(("limit", "refused"), [(854, True), (855, False), (1193, False)])
def test_a_cap_beyond_the_servos_current_limit_is_refused(limit: int, refused: bool) -> None:
    robot = in_mode("current_based_position")
    kind = replace(robot.joints[0].type, current_limit_a=2.3)
    robot = replace(robot, joints=tuple(replace(joint, type=kind) for joint in robot.joints))
    devices = {key: set_to(operating_mode=5, current_limit=limit)(each) for key, each in DEVICES.items()}
    refusals = check_devices(robot, devices).refusals
    assert bool(refusals) is refused
    if refused:
        assert "current_limit (38) is 854" in refusals[0].message
    unread = {key: without("current_limit")(each) for key, each in devices.items()}
    assert len(check_devices(robot, unread).refusals) == 24


def test_registers_that_the_robot_file_expects_are_compared() -> None:
    joints = [replace(joint, registers={"shutdown": 53}) for joint in ROBOT.joints]
    robot = replace(ROBOT, joints=tuple(joints))
    assert len(check_devices(robot, DEVICES).refusals) == 24  # not read: unknown is refused
    devices = {key: set_to(shutdown=53)(device) for key, device in DEVICES.items()}
    assert not check_devices(robot, devices).refusals
    verdict = check_devices(robot, {**devices, KEY: set_to(shutdown=52)(DEVICES[KEY])})
    assert [(each.code, each.joint) for each in verdict.refusals] == [(ReasonCode.DEVICE_MISMATCH, KNEE)]


def test_a_connector_is_no_other_model() -> None:
    kind = replace(ROBOT.joints[0].type, device="XM430-W350-T")
    robot = replace(ROBOT, joints=tuple(replace(joint, type=kind) for joint in ROBOT.joints))
    assert not check_devices(robot, DEVICES).refusals
