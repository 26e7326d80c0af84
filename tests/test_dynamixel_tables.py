"""Control tables: the vendor's addresses, our rules, and errors that help."""

import sys

import pytest

from twind_drivers.dynamixel import tables
from twind_drivers.dynamixel.registers import rule
from twind_drivers.dynamixel.tables import Table, models, number_of, table


def test_every_model_of_the_index_has_a_table() -> None:
    assert len(models()) == 60
    for name, number in models().items():
        each = table(number)
        assert each.model == name
        assert each["torque_enable"].eeprom is False
        assert each["id"].eeprom is True


def test_the_known_addresses_hold() -> None:
    xm, xl, ph = table(1020), table(1200), table(2020)
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
    with pytest.raises(KeyError, match="goal_position"):
        table(1020)["goal_positon"]
    with pytest.raises(KeyError, match="4711"):
        table(4711)


def test_the_sdks_code_is_not_imported() -> None:
    assert "dynamixel_easy_sdk" not in sys.modules
    assert not any("dynamixel_sdk" in str(value) for value in vars(tables).values())


@pytest.mark.parametrize("number", [1020, 1200])
def test_every_register_of_the_two_models_we_know_best_has_a_rule(number: int) -> None:
    for field in table(number).fields.values():
        if "indirect" not in field.key:
            lower, upper = field.bounds
            assert lower <= upper
            assert field.rule.default is None or lower <= field.rule.default <= upper
            assert field.rule.default is not None or not field.rule.writable, field.key


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
def test_what_may_not_be_written_is_refused_with_its_bound(name: str, value: int, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        table(1020)[name].check(value)


def test_signed_registers_round_trip_and_edges_pass() -> None:
    xm: Table = table(1020)
    for name in ("goal_pwm", "homing_offset", "goal_position", "goal_velocity"):
        for value in xm[name].bounds:
            xm[name].check(value)
            assert xm[name].decode(xm[name].encode(value)) == value
    assert xm["present_pwm"].decode(b"\xff\xff") == -1
    assert xm["bus_watchdog"].decode(b"\xff") == 255


def test_models_whose_page_we_have_not_checked_have_no_invented_defaults() -> None:
    assert rule("xm540_w270", "position_p_gain").default is None
    assert rule("ph54_200_s500", "homing_offset").signed
    assert rule("ph54_200_s500", "homing_offset").upper is None
    assert not rule("xl320", "present_position").signed
