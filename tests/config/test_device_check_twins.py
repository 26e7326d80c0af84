"""Recorded data that distinguish a device from its twins: a difference, or silence, refuses."""

from dataclasses import replace

import pytest

from tests.support.h24_calibration import CALIBRATION, DEVICES, KEY, KNEE, ROBOT
from twind.config.calibration_file import Calibration
from twind.config.device_check import check_devices, compare
from twind.robot.finding import Finding, ReasonCode
from twind_drivers.bus import IdentifiedDevice

ID = "0011223344556677"
OTHER = "8899aabbccddeeff"


def recorded(**record: object) -> Calibration:
    """The calibration whose knee has that in its device record."""
    knee = CALIBRATION.by_name["l_knee"]
    knee = replace(knee, device=replace(knee.device, **record))  # type: ignore[arg-type]
    joints = tuple(knee if each.name == "l_knee" else each for each in CALIBRATION.joints)
    return replace(CALIBRATION, joints=joints)


def refusals(calibration: Calibration, device: IdentifiedDevice) -> tuple[Finding, ...]:
    return compare(ROBOT, calibration, {**DEVICES, KEY: device}).refusals


@pytest.mark.parametrize("other_id", [OTHER, None, ""])
def test_another_unique_id_or_none_is_another_device(other_id: str | None) -> None:
    [finding] = refusals(recorded(unique_id=ID), replace(DEVICES[KEY], unique_id=other_id))
    assert (finding.code, finding.joint) == (ReasonCode.CALIB_MISMATCH, KNEE)
    assert f"its unique id is {other_id}, was {ID} when calibrated" in finding.message


def test_the_same_unique_id_passes_and_so_does_one_that_was_never_recorded() -> None:
    assert not refusals(recorded(unique_id=ID), replace(DEVICES[KEY], unique_id=ID))
    assert not refusals(CALIBRATION, replace(DEVICES[KEY], unique_id=ID))


@pytest.mark.parametrize("stamp", [10, None])
def test_another_stamp_or_none_is_another_servo(stamp: int | None) -> None:
    settings = {k: v for k, v in DEVICES[KEY].settings.items() if k != "moving_threshold"}
    settings |= {} if stamp is None else {"moving_threshold": stamp}
    [finding] = refusals(recorded(tag=613), replace(DEVICES[KEY], settings=settings))
    assert (finding.code, finding.joint, finding.bound) == (ReasonCode.CALIB_MISMATCH, KNEE, 613.0)
    assert "moving_threshold" in finding.message
    assert not refusals(
        recorded(tag=613), replace(DEVICES[KEY], settings={**settings, "moving_threshold": 613})
    )


def with_bits(**settings: int) -> IdentifiedDevice:
    return replace(DEVICES[KEY], settings={**DEVICES[KEY].settings, **settings})


def test_a_time_based_profile_is_refused_and_ram_from_a_backup_gives_a_warning() -> None:
    found = check_devices(ROBOT, {**DEVICES, KEY: with_bits(drive_mode=4)})
    assert "drive_mode (10) is 4: bit 2, time-based profile, must be 0" in found.refusals[0].message
    found = check_devices(ROBOT, {**DEVICES, KEY: with_bits(startup_configuration=2)})
    assert not found.refusals
    assert "startup_configuration (60) is 2: bit 1" in found.warnings[0].message


def test_everything_that_is_wrong_is_named_at_once() -> None:
    device = replace(
        with_bits(homing_offset=2900, drive_mode=12, startup_configuration=1, max_position_limit=4000),
        unique_id=OTHER,
    )
    found = [each.message for each in refusals(recorded(unique_id=ID, tag=613), device)]
    for words in (
        "homing_offset (20) is 2900; beyond ±1024 position mode ignores it",
        "bit 3, torque on by goal update",
        "bit 2, time-based profile",
        "startup_configuration (60) is 1: bit 0, torque on at boot",
        "homing_offset is 2900, was 0 when calibrated",
        "drive_mode is 12, was 0",
        "max_position_limit is 4000, was 4095",
        "moving_threshold",
        "its unique id is",
    ):
        assert [message for message in found if words in message], words
