"""Registers of a serial servo that rule it out for a joint, or give a warning, by the table of its model."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.derived_arm import serial_arm_of
from twind.config.actuator_types import DeviceWarning
from twind.config.robot_file import load_robot
from twind.config.robot_spec import JointSpec
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.servo_type import ServoType

GAINS = "gains: {p: 800, i: 0, d: 0}"
FINE = {"operating_mode": 3, "homing_offset": 0, "drive_mode": 0}
Y, P, X, DUAL = "YM070-210-R099", "PH42-020-S300", "XM430-W350", "XM540-W270"
DIRECT = "YM070-210-M001"
RATIO = ("electronic_gearratio_numerator", "electronic_gearratio_denominator")


@pytest.fixture(scope="module")
def joints(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, JointSpec]:
    folder = tmp_path_factory.mktemp("arms")

    def joint(model: str, folder: Path) -> JointSpec:
        folder.mkdir()
        return load_robot(serial_arm_of(folder, "dynamixel2", model, GAINS)).joints[0]

    return {model: joint(model, folder / model) for model in (Y, P, X, DUAL, DIRECT)}


def found(model: str, settings: Mapping[str, int]) -> IdentifiedDevice:
    gear = table(number_of(model)).facts.gear
    own = dict(zip(RATIO, (gear, 1), strict=True)) if gear else {}
    return IdentifiedDevice(1, number_of(model), table(number_of(model)).model, 46, FINE | own | settings)


def reasons(joint: JointSpec, settings: Mapping[str, int]) -> list[str]:
    return list(joint.type.unfit(joint, found(joint.type.device, settings)))


@pytest.mark.parametrize("model", [Y, P, X, DUAL, DIRECT])
def test_a_servo_as_delivered_is_fit(joints: Mapping[str, JointSpec], model: str) -> None:
    joint = joints[model]
    assert reasons(joint, {}) == []
    assert list(joint.type.doubts(joint, found(model, {}))) == []


def test_a_slave_of_another_servo_is_refused(joints: Mapping[str, JointSpec]) -> None:
    """E-manual, "Drive Mode": bit 1, of the sizes with a connector for a cable to another servo."""
    assert reasons(joints[DUAL], {"drive_mode": 2}) == [
        "drive_mode (10) is 2: bit 1, slave, must be 0: it follows the cable of another servo, not its goals"
    ]


@pytest.mark.parametrize("drive_mode", [0, 1])
def test_the_direction_bit_of_the_drive_mode_is_left_to_the_calibration(
    joints: Mapping[str, JointSpec], drive_mode: int
) -> None:
    assert reasons(joints[DUAL], {"drive_mode": drive_mode}) == []


@pytest.mark.parametrize(
    ("model", "register", "reason"),
    [
        (X, "pwm_limit", "pwm_limit (36) is 0: with torque on it would take goals, and not move"),
        (Y, "pwm_limit", "pwm_limit (64) is 0: with torque on it would take goals, and not move"),
        (Y, "current_limit", "current_limit (66) is 0: with torque on it would take goals, and not move"),
        (X, "current_limit", None),  # it limits the current in the modes with a goal current alone
    ],
)
def test_a_servo_that_would_hold_nothing_is_refused(
    joints: Mapping[str, JointSpec], model: str, register: str, reason: str | None
) -> None:
    assert reasons(joints[model], {register: 0}) == ([] if reason is None else [reason])
    assert reasons(joints[model], {register: 1}) == []


@pytest.mark.parametrize(
    ("model", "settings", "reason"),
    [
        (
            Y,
            {"operating_mode": 1},
            "operating_mode (33) is 1, position mode is 3: with torque off write 3 to",
        ),
        (Y, {"operating_mode": 1}, "write 3 to register 33, then calibrate anew"),
        (Y, {"secondary_shadow_id": 7}, "with torque off write 255, off, to register 10"),
        (P, {"secondary_id": 3}, "secondary_id (12) is 3: it obeys goals for id 3 too; with torque off"),
        (Y, {"drive_mode": 8}, "drive_mode (32) is 8: bit 3"),
        (Y, {"drive_mode": 4}, "drive_mode (32) is 4: bit 2"),
        (Y, {"startup_configuration": 1}, "startup_configuration (34) is 1: bit 0"),
    ],
)
def test_a_register_is_named_with_its_address_in_that_model(
    joints: Mapping[str, JointSpec], model: str, settings: Mapping[str, int], reason: str
) -> None:
    [text] = reasons(joints[model], settings)
    assert reason in text


@pytest.mark.parametrize(("model", "address"), [(X, 68), (P, 516), (Y, 15)])
def test_a_servo_whose_registers_were_not_read_is_refused_as_unread(
    joints: Mapping[str, JointSpec], model: str, address: int
) -> None:
    joint = joints[model]
    [text] = joint.type.unfit(joint, replace(found(model, {}), settings={}))
    assert text.startswith("operating_mode, homing_offset, drive_mode not read")
    assert f"status_return_level ({address}) is 0" in text


@pytest.mark.parametrize("missing", list(FINE))
def test_one_needed_register_that_was_not_read_is_named_alone(
    joints: Mapping[str, JointSpec], missing: str
) -> None:
    joint = joints[X]
    device = found(X, {})
    settings = {name: value for name, value in device.settings.items() if name != missing}
    [text] = joint.type.unfit(joint, replace(device, settings=settings))
    assert text.startswith(f"{missing} not read")


def test_the_registers_of_another_model_are_not_judged(joints: Mapping[str, JointSpec]) -> None:
    joint = joints[X]
    other = {"secondary_id": 3, "operating_mode": 1, "pwm_limit": 0}
    assert list(joint.type.unfit(joint, found(P, other))) == [
        f"is {P} (model number {number_of(P)}), the robot file says {X}"
    ]


@pytest.mark.parametrize(
    ("ratio", "fit"), [((99, 1), True), ((198, 2), True), ((1, 1), False), ((99, 2), False), ((0, 0), False)]
)
def test_a_gear_ratio_is_that_of_the_gear(
    joints: Mapping[str, JointSpec], ratio: tuple[int, int], fit: bool
) -> None:
    given = reasons(joints[Y], dict(zip(RATIO, ratio, strict=True)))
    refusal = f"electronic gear ratio (96, 100) is {ratio[0]}/{ratio[1]}: write 99 and 1"
    assert given == ([] if fit else [refusal])


@pytest.mark.parametrize(("offset", "fit"), [(1024, True), (1025, False), (-1024, True), (-1025, False)])
def test_position_mode_heeds_a_homing_offset_of_1024_counts(
    joints: Mapping[str, JointSpec], offset: int, fit: bool
) -> None:
    given = reasons(joints[X], {"homing_offset": offset})
    refusal = f"homing_offset (20) is {offset}; beyond ±1024 position mode ignores it: write 0"
    assert given == ([] if fit else [refusal])


def test_a_servo_with_a_battery_has_no_bound_of_its_homing_offset(joints: Mapping[str, JointSpec]) -> None:
    assert reasons(joints[Y], {"homing_offset": 100_000}) == []


def test_an_expected_register_is_compared_where_it_is_known(joints: Mapping[str, JointSpec]) -> None:
    joint = replace(joints[X], registers={"shutdown": 53})
    device = found(X, {})
    assert reasons(joint, {"shutdown": 53}) == []
    assert reasons(joint, {"shutdown": 52}) == ["shutdown is 52, the robot file says 53"]
    assert reasons(joint, {}) == [
        "shutdown must be 53, but is not read from servos: remove it from the robot file"
    ]
    [text] = joint.type.unfit(joint, replace(device, settings={}))
    assert "not read, so nothing is known" in text


@pytest.mark.parametrize(("units", "warned"), [(5, False), (6, True)])
def test_a_return_delay_above_the_described_one_gives_a_warning(
    joints: Mapping[str, JointSpec], units: int, warned: bool
) -> None:
    """E-manual, "Return Delay Time": in units of 2 us."""
    kind = joints[X].type
    assert isinstance(kind, ServoType)
    joint = replace(joints[X], type=replace(kind, return_delay_us=10))
    warnings = list(joint.type.doubts(joint, found(X, {"return_delay_time": units})))
    assert [(each.value, each.bound) for each in warnings] == ([(12.0, 10.0)] if warned else [])


@pytest.mark.parametrize(("model", "address"), [(X, 60), (Y, 34)])
def test_ram_that_a_servo_restores_at_boot_gives_a_warning(
    joints: Mapping[str, JointSpec], model: str, address: int
) -> None:
    joint = joints[model]
    text = f"startup_configuration ({address}) is 2: bit 1, RAM from its backup at boot; write 0"
    warnings = list(joint.type.doubts(joint, found(model, {"startup_configuration": 2})))
    assert warnings == [DeviceWarning(text, 2.0, 0.0)]
    assert list(joint.type.doubts(joint, found(model, {"startup_configuration": 1}))) == []


def test_a_servo_of_any_model_in_place_of_another_is_refused_for_its_model_alone(
    joints: Mapping[str, JointSpec], tmp_path: Path
) -> None:
    """Registers of another model have other addresses, or are not there."""
    expected = [*joints.values(), load_robot(serial_arm_of(tmp_path, "dynamixel2", "MX-64", GAINS)).joints[0]]
    for joint in expected:
        for model in {*joints, "MX-64"} - {joint.type.device}:
            device = found(model, {"startup_configuration": 2})
            (reason,) = joint.type.unfit(joint, device)
            assert f"the robot file says {joint.type.device}" in reason
            assert not [each for each in joint.type.doubts(joint, device) if "startup" in each.message]
