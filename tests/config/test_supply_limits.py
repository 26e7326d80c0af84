"""Voltage and heat limits of servos: defaults of every model, keys of the robot file, wrong order."""

from math import inf, isfinite, isnan, nan
from pathlib import Path

import pytest

from tests.support.doc_pages_text import ROOT
from twind.config.config_reader import ConfigReader
from twind.config.robot_file import load_robot, read_robot
from twind.config.supply_limits import (
    HeatKeys,
    SupplyKeys,
    SupplyLimits,
    ThermalLimits,
    heat,
    supply,
    usual_heat,
)
from twind.config.yaml_tree import ConfigError, parse
from twind.twin.binding import bind
from twind_drivers.dynamixel.control_tables import models, number_of, table
from twind_drivers.dynamixel.factory_defaults import FACTORY
from twind_drivers.dynamixel.servo_limits import full_counts, heat_limit, usual_supply


def of(text: str, device: str = "XM430-W350") -> SupplyLimits:
    section = ConfigReader("robot.yaml", parse(f"supply: {text}", "robot.yaml")).section("supply")
    return supply(section, section.read(SupplyKeys), usual_supply(device))


def warmth(text: str, device: str = "XM430-W350") -> ThermalLimits:
    section = ConfigReader("robot.yaml", parse(f"heat: {text}", "robot.yaml")).section("heat")
    limit = heat_limit(device)
    return heat(section, section.read(HeatKeys), usual_heat(limit), limit)


def test_a_12_v_servo_has_the_bounds_of_12_v_and_80_degrees() -> None:
    assert of("{}") == SupplyLimits(11.1, 10.5, 10.0, 14.8)
    assert warmth("{}") == ThermalLimits(60.0, 65.0, 70.0, 55.0, 0.35)


@pytest.mark.parametrize(
    ("device", "bounds", "settle"),
    [
        ("XL330-M288", SupplyLimits(4.4, 4.0, 3.8, 6.4), 60.0),
        ("XL430-W250", SupplyLimits(8.0, 7.2, 6.6, 12.5), 62.0),
        ("XH540-V150", SupplyLimits(15.7, 13.9, 12.5, 26.5), 70.0),
        ("PH54-200-S500", SupplyLimits(19.9, 18.1, 16.5, 31.3), 70.0),
    ],
)
def test_other_models_have_them_at_the_same_share_of_what_they_bear(
    device: str, bounds: SupplyLimits, settle: float
) -> None:
    assert of("{}", device) == bounds
    assert warmth("{}", device).settle == settle


def test_the_bounds_of_every_model_are_in_order_and_inside_what_it_can_be_set_to() -> None:
    for device in models():
        volts = of("{}", device)
        degrees = warmth("{}", device)
        made = FACTORY.get(table(number_of(device)).stem.removesuffix("_fw52"))
        if made is None:  # nothing is printed about it: never reached
            assert (volts, degrees) == (
                SupplyLimits(-inf, -inf, -inf, inf),
                ThermalLimits(inf, inf, inf, inf),
            ), device
            assert isnan(full_counts(device, 1.0, 0.01)), device
            continue
        low = 0.1 * made.volts[0]
        high = 0.1 * made.volts[1]
        assert low < volts.fault < volts.settle < volts.warn < volts.high < high, device
        assert degrees.cool < degrees.warn < degrees.slow < degrees.settle < made.temperature, device
        assert isfinite(full_counts(device, nan, 0.001)), device


def test_a_device_that_is_in_no_table_has_no_bounds() -> None:
    assert of("{}", "XYZ") == SupplyLimits()
    assert warmth("{}", "XYZ") == ThermalLimits()
    assert isnan(full_counts("XYZ", nan, 0.001))


def test_the_keys_of_the_robot_file_win() -> None:
    text = "{warn_v: 13.2, settle_v: 12.8, fault_v: 12.4, high_v: 16.8}"
    assert of(text) == SupplyLimits(13.2, 12.8, 12.4, 16.8)
    text = "{warn_c: 40, slow_c: 45, settle_c: 50, cool_c: 30, continuous: 0.25}"
    assert warmth(text) == ThermalLimits(40.0, 45.0, 50.0, 30.0, 0.25)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("{fault_v: 10.6}", "fault_v"),
        ("{settle_v: 11.2}", "settle_v"),
        ("{warn_v: 15}", "warn_v"),
        ("{settle_v: 0}", "settle_v"),
        ("{high_v: 101}", "high_v"),
        ("{warn: 11}", "warn"),
    ],
)
def test_a_supply_out_of_order_or_out_of_reach_is_refused(text: str, key: str) -> None:
    with pytest.raises(ConfigError, match=f"supply.{key}"):
        of(text)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("{warn_c: 66}", "warn_c"),
        ("{slow_c: 71}", "slow_c"),
        ("{settle_c: 81}", "settle_c"),  # the servo is off by then
        ("{cool_c: 71}", "cool_c"),
        ("{continuous: 0}", "continuous"),
        ("{continuous: 1.1}", "continuous"),
        ("{hot: 60}", "hot"),
    ],
)
def test_heat_out_of_order_or_out_of_reach_is_refused(text: str, key: str) -> None:
    with pytest.raises(ConfigError, match=f"heat.{key}"):
        warmth(text)


def test_the_whole_load_is_the_current_limit_or_the_servos_own_or_a_thousand_of_load() -> None:
    assert full_counts("XM430-W350", 2.69, 0.00269) == pytest.approx(1000.0)
    assert full_counts("XM430-W350", nan, 0.00269) == 1193.0
    assert full_counts("XL430-W250", 1.0, 0.00269) == 1000.0
    assert full_counts("XL430-W250", nan, 0.00269) == 1000.0


def test_ratings_stand_in_joint_order() -> None:
    ratings = bind(load_robot("h24"), None).ratings
    for bound, value in (
        (ratings.low_warn, 11.1),
        (ratings.low_settle, 10.5),
        (ratings.low_fault, 10.0),
        (ratings.high_warn, 14.8),
        (ratings.warm, 60.0),
        (ratings.hot, 65.0),
        (ratings.shut, 70.0),
        (ratings.cool, 55.0),
        (ratings.continuous, 0.35),
    ):
        assert bound.tolist() == [value] * 24
    assert ratings.leg.tolist() == [False] * 12 + [True] * 12  # head, arms, waist; two legs


def one(tmp_path: Path, more: str) -> Path:
    (tmp_path / "one.xml").write_text("<mujoco/>")
    path = tmp_path / "one.yaml"
    path.write_text(
        "format: twind-robot/1\nname: one\nmodel: {mjcf: one.xml, base: torso}\n"
        "buses: {main: {kind: dynamixel2}}\n"
        "types: {small: {device: XM430-W350, gains: {p: 1, i: 0, d: 0}}}\n"
        "defaults: {type: small, bus: main}\n"
        "joints: {yaw: {id: 1, limits_rad: [-1, 1]}, knee: {id: 2, limits_rad: [-1, 1]}}\n"
        f"poses: {{rest: {{}}}}\n{more}\n"
    )
    return path


@pytest.mark.parametrize(
    ("more", "legs"), [("", ("yaw", "knee")), ("legs: [knee]", ("knee",)), ("legs: []", ())]
)
def test_without_a_legs_key_every_joint_supports_the_robot(
    tmp_path: Path, more: str, legs: tuple[str, ...]
) -> None:
    assert read_robot(one(tmp_path, more)).legs == legs


@pytest.mark.parametrize("more", ["legs: [nee]", "legs: [knee, knee]", "legs: [x_y_z]"])
def test_a_leg_that_is_no_joint_or_named_twice_is_refused(tmp_path: Path, more: str) -> None:
    with pytest.raises(ConfigError, match="legs"):
        read_robot(one(tmp_path, more))


def test_the_configuration_page_lists_the_same_defaults() -> None:
    text = (ROOT / "docs" / "configuration.md").read_text()
    volts = of("{}")
    degrees = warmth("{}")
    for name in ("warn", "settle", "fault", "high"):
        row = next(line for line in text.splitlines() if f"TYPE.supply.{name}_v`" in line)
        assert f"the model's: {getattr(volts, name):g} |" in row
    for name in ("warn", "slow", "settle", "cool"):
        row = next(line for line in text.splitlines() if f"TYPE.heat.{name}_c`" in line)
        assert f"the model's: {getattr(degrees, name):g} |" in row
    small = of("{}", "XL330-M288")
    big = of("{}", "PH42-020-S300")
    for kind in (small, big):
        assert f"{kind.warn:g}, {kind.settle:g}, {kind.fault:g}, {kind.high:g}" in text
