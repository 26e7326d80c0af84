"""Ranges and factory values of every model's registers, and some of them against their manual page."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind_drivers.dynamixel.control_tables import TableRegister, models, number_of, table
from twind_drivers.dynamixel.factory_defaults import FACTORY, P_SERIES
from twind_drivers.dynamixel.register_rules import FEEDS, GAINS, rule

EVERY = [table(number) for number in models().values()]
RULED = [each for each in EVERY if not each.facts.undriven]


def test_every_default_is_in_its_range_and_every_range_fits_its_register() -> None:
    for each in EVERY:
        for field in each.fields.values():
            lower, upper = field.bounds
            for edge in (lower, upper):
                back = field.decode(field.encode(edge))
                assert back == edge or field.rule.codes is not None, (each.stem, field.key)
            default = field.rule.default
            assert default is None or field.takes(default), (each.stem, field.key, default)


FIELDS = [field for each in EVERY for field in each.fields.values() if field.rule.writable]


@given(
    st.sampled_from(FIELDS),
    st.integers(-(2**33), 2**33) | st.integers(-70_000, 70_000) | st.integers(-2, 300),
)
def test_a_value_that_passes_the_check_fits_the_register_and_others_are_refused(
    field: TableRegister, value: int
) -> None:
    passed = False
    with suppress(ValueError):
        field.check(value)
        passed = True
    assert passed == field.takes(value)
    if passed:
        assert field.decode(field.encode(value)) == value


def test_every_limit_register_exists_in_that_models_table() -> None:
    for each in EVERY:
        limits = {field.rule.limit for field in each.fields.values() if field.rule.limit is not None}
        assert [limit for limit in limits if limit not in each] == [], each.stem


def test_every_model_that_we_drive_has_its_factory_values() -> None:
    assert set(FACTORY) == {each.stem for each in RULED}


def test_every_setting_that_a_model_has_is_known() -> None:
    """The pages leave open: goals and profiles of the P layout, the gains of -R(A) and gripper."""
    for each in RULED:
        may_be_open = {
            "goal_pwm",
            "goal_current",
            "goal_velocity",
            "profile_acceleration",
            "profile_velocity",
        }
        allowed = may_be_open if each.stem in P_SERIES else set()
        if None in FACTORY[each.stem].gains:
            allowed = allowed | {*GAINS, *FEEDS}
        blank = {
            field.key
            for field in each.fields.values()
            if field.rule.writable
            and field.rule.default is None
            and not field.key.startswith(("indirect", "external"))
        }
        assert blank <= allowed, each.stem


def test_a_register_that_only_reports_is_not_writable() -> None:
    for each in EVERY:
        reports = (
            "present_",
            "realtime_tick",
            "moving_status",
            "error_code",
            "hardware_error",
            "controller_state",
        )
        assert [
            key
            for key, field in each.fields.items()
            if key.startswith(reports) and not key.endswith("_lpf_frequency") and field.rule.writable
        ] == []


def test_the_two_models_that_were_checked_first_are_what_they_were() -> None:
    """Golden: e-manual pages of XM430-W350 and XL330-M288, firmware 45 and 46."""
    keys = ("temperature_limit", "max_voltage_limit", "min_voltage_limit", "current_limit", "velocity_limit")
    more = ("shutdown", *GAINS, "goal_current", "goal_pwm", "return_delay_time", "moving_threshold")
    xm, xl = ([rule(stem, key).default for key in (*keys, *more)] for stem in ("xm430_w350", "xl330_m288"))
    assert xm == [80, 160, 95, 1193, 200, 52, 1920, 100, 0, 0, 800, 1193, 885, 250, 10]
    assert xl == [70, 70, 35, 1750, 445, 53, 1600, 180, 0, 0, 400, 1750, 885, 250, 10]


@pytest.mark.parametrize(
    ("name", "values"),
    [  # the pages: emanual.robotis.com/docs/en/ + models.page(stem)
        ("XM430-W210", {"velocity_limit": 330, "current_limit": 1193, "position_p_gain": 800}),
        ("XH430-W350", {"velocity_limit": 130, "current_limit": 648, "position_p_gain": 900}),
        ("XH430-V210", {"velocity_limit": 230, "max_voltage_limit": 300, "min_voltage_limit": 110}),
        ("XL430-W250", {"velocity_limit": 265, "position_d_gain": 4000, "velocity_i_gain": 1000}),
        ("2XL430-W250", {"velocity_limit": 250, "position_d_gain": 2000, "temperature_limit": 72}),
        ("XC430-W150", {"velocity_limit": 460, "position_p_gain": 460, "moving_threshold": 20}),
        ("2XC430-W250", {"velocity_limit": 275, "position_p_gain": 700, "min_voltage_limit": 60}),
        ("XM540-W270", {"velocity_limit": 128, "current_limit": 2047, "external_port_mode_1": 3}),
        ("XW540-H260", {"velocity_limit": 145, "current_limit": 1188, "max_voltage_limit": 300}),
        ("XL330-M077", {"velocity_limit": 1620, "velocity_p_gain": 40, "position_i_gain": 400}),
        ("XC330-T181", {"velocity_limit": 510, "current_limit": 910, "pwm_slope": 255}),
        ("XC330-M288", {"velocity_limit": 350, "current_limit": 2352, "position_d_gain": 500}),
        ("MX-64", {"velocity_limit": 285, "current_limit": 1941, "acceleration_limit": 32767}),
        ("MX-28", {"velocity_limit": 230, "position_p_gain": 850, "min_voltage_limit": 95}),
        ("PH54-200-S500", {"velocity_limit": 2900, "current_limit": 22740, "position_p_gain": 314}),
        ("PM42-010-S260", {"max_position_limit": 262931, "pwm_limit": 2009, "position_p_gain": 1061}),
        ("M54-40-S250-RA", {"acceleration_limit": 11037, "shutdown": 52, "position_p_gain": None}),
        ("RH-P12-RN", {"operating_mode": 5, "max_position_limit": 1150, "current_limit": 1984}),
    ],
)
def test_some_models_against_their_pages(name: str, values: dict[str, int | None]) -> None:
    found = table(number_of(name))
    assert {key: found[key].rule.default for key in values} == values


def test_ranges_are_the_models_own() -> None:
    """Pages of XH430-W350, XL330-M288, PH54-200-S500-R, RH-P12-RN(A): column "Range"."""
    assert table(1000)["goal_current"].bounds == (-648, 648)
    assert table(1200)["baud_rate"].bounds == (0, 6)
    assert table(2020)["min_position_limit"].bounds == (-501_923, 501_923)
    assert table(2020)["profile_velocity"].rule.limit == "velocity_limit"
    assert table(35074)["goal_position"].bounds == (0, 1150)
    assert not table(350)["present_position"].rule.signed  # XL320: a direction bit
