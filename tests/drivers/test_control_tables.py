"""Control tables: the vendor's addresses, our rules, and errors that help."""

import sys

import pytest

from twind.exceptions import InvalidInput
from twind_drivers.dynamixel import control_tables
from twind_drivers.dynamixel.control_tables import ControlTable, models, number_of, table


def test_every_model_of_the_index_has_a_table() -> None:
    assert len(models()) == 60
    for name, number in models().items():
        each = table(number)
        assert each.model == name
        assert each["torque_enable"].eeprom is False
        assert each["id"].eeprom is True


def test_the_known_addresses_hold() -> None:
    xm = table(1020)
    xl = table(1200)
    ph = table(2020)
    assert [
        (xm[name].address, xm[name].size) for name in ("Goal Position", "present_current", "bus_watchdog")
    ] == [
        (116, 4),
        (126, 2),
        (98, 1),
    ]
    assert (ph["Torque Enable"].address, ph["goal_position"].address) == (512, 564)
    assert xl["PWM Slope"].address == 62
    assert "present_load" in table(1060)
    assert "present_current" not in table(1060)


def test_boot_time_torque_can_be_read_though_the_vendors_files_lack_it() -> None:
    assert table(1020)["startup_configuration"].address == 60
    assert table(1200)["backup_ready"].address == 147


def test_newer_x330_firmware_has_another_indirect_layout() -> None:
    assert table(1200, 51)["Indirect Data 1"].address == 224
    assert table(1200, 52)["Indirect Data 1"].address == 208


@pytest.mark.parametrize("name", ["XM430-W350", "xm430-w350", "XM430-W350-T", "XM430-W350-R"])
def test_a_model_is_known_by_its_name_in_any_case_and_with_its_connector(name: str) -> None:
    assert number_of(name) == 1020


def test_a_misspelt_model_or_register_lists_the_near_ones() -> None:
    with pytest.raises(KeyError, match="XM430-W350"):
        number_of("XM430-W530")
    with pytest.raises(InvalidInput, match="goal_position") as caught:
        table(1020)["goal_positon"]
    assert caught.value.near[0] == "goal_position"
    with pytest.raises(KeyError, match="4711"):
        table(4711)


def test_the_sdks_code_is_not_imported() -> None:
    assert "dynamixel_easy_sdk" not in sys.modules
    assert not any("dynamixel_sdk" in str(value) for value in vars(control_tables).values())


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("present_position", 1, "read-only"),
        ("goal_pwm", 886, "-885..885"),
        ("homing_offset", -1_044_480, "-1044479"),
        ("operating_mode", 2, "not one of"),
        ("bus_watchdog", 128, "0..127"),
    ],
)
def test_an_invalid_register_write_is_refused_with_its_bound(name: str, value: int, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        table(1020)[name].check(value)


def test_signed_registers_round_trip_and_edges_pass() -> None:
    xm: ControlTable = table(1020)
    for name in ("goal_pwm", "homing_offset", "goal_position", "goal_velocity"):
        for value in xm[name].bounds:
            xm[name].check(value)
            assert xm[name].decode(xm[name].encode(value)) == value
    assert xm["present_pwm"].decode(b"\xff\xff") == -1
    assert xm["bus_watchdog"].decode(b"\xff") == 255


@pytest.mark.parametrize(
    ("model", "mode", "known"),
    [
        ("XL430-W250", 5, r"\[1, 3, 4, 16\]"),
        ("MX-28", 0, r"\[1, 3, 4, 16\]"),
        ("PH54-200-S500", 5, r"\[0, 1, 3, 4, 16\]"),
        ("RH-P12-RN", 3, r"\[0, 5\]"),
        ("XC330-M288", 2, r"\[0, 1, 3, 4, 5, 16\]"),
    ],
)
def test_an_operating_mode_that_the_model_lacks_is_refused_with_those_it_has(
    model: str, mode: int, known: str
) -> None:
    field = table(number_of(model))["operating_mode"]
    assert not field.takes(mode)
    with pytest.raises(ValueError, match=f"{mode} is not one of {known}"):
        field.check(mode)


def test_a_register_accepts_values_in_its_range_and_among_its_choices() -> None:
    protocol = table(2020)["protocol_type"]  # 2 or Modbus (PH54-200-S500-R page, "Protocol Type(13)")
    assert [value for value in range(256) if protocol.takes(value)] == [2, 10]
    assert not table(1020)["goal_pwm"].takes(886)
    assert table(1020)["goal_pwm"].takes(-885)


def test_the_facts_of_a_model_come_with_its_table_whatever_the_firmware() -> None:
    assert table(1200, 51).facts is table(1200, 52).facts
    assert table(1200).facts.ampere_per_count == 1e-3


def test_a_register_is_found_by_its_address_too_and_robot_files_still_need_names() -> None:
    xm430 = table(1020)
    assert xm430["11"] == xm430["operating_mode"] and xm430["116"] == xm430["Goal Position"]
    assert "11" not in xm430
    with pytest.raises(InvalidInput, match="no register '1000'"):
        xm430["1000"]
