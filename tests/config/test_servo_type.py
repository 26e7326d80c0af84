"""The units of a type come from the model it names, and no robot file talks a servo's counts wrong."""

from math import isnan, nan, pi

import pytest

from twind.config.config_reader import ConfigReader
from twind.config.yaml_tree import ConfigError, parse
from twind_drivers.dynamixel.control_tables import models, number_of, table
from twind_drivers.dynamixel.servo_keys import servo_type
from twind_drivers.dynamixel.servo_type import ServoType


def of(device: str, *lines: str) -> ServoType:
    text = "\n".join((f"device: {device}", "gains: {p: 1, i: 0, d: 0}", *lines))
    return servo_type("small", ConfigReader("robot.yaml", parse(text, "robot.yaml")))


@pytest.mark.parametrize(
    ("device", "turn", "ampere", "rpm"),
    [
        ("XM430-W350", 4096, 0.00269, 0.229),
        ("XL330-M288", 4096, 0.001, 0.229),
        ("XH430-V350-R", 4096, 0.00134, 0.229),
        ("PH54-200-S500", 1_003_846, 0.001, 0.01),
    ],
)
def test_a_type_has_the_units_of_its_model(device: str, turn: int, ampere: float, rpm: float) -> None:
    found = of(device)
    assert found.ticks_per_turn == turn
    assert found.current_lsb_a == pytest.approx(ampere)
    assert found.velocity_lsb_rad_s == pytest.approx(rpm * 2.0 * pi / 60.0)


@pytest.mark.parametrize(
    "device",
    [
        name
        for name, number in models().items()
        if table(number).facts.counts_per_turn and not table(number).facts.undriven
    ],
)
def test_counts_that_contradict_the_model_are_refused_with_both(device: str) -> None:
    known = table(number_of(device)).facts.counts_per_turn
    assert known is not None
    assert of(device, f"ticks_per_turn: {known}").ticks_per_turn == known
    for wrong in (known // 2, known * 2, known - known // 500):
        with pytest.raises(ConfigError, match=f"{wrong}, but a {device} has {known}"):
            of(device, f"ticks_per_turn: {wrong}")


@pytest.mark.parametrize(
    ("device", "reason"),
    [
        ("XL320", "no bus watchdog: use a bus of kind dynamixel2_unwatched"),
        ("H54-200-S500-R", "no bus watchdog: use a bus of kind dynamixel2_unwatched"),
    ],
)
def test_a_model_that_is_not_driven_is_refused_at_its_name_with_the_reason(device: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=rf"device: {device} is not driven here: .*{reason}"):
        of(device, "ticks_per_turn: 4096")


def test_the_vendors_two_figures_of_one_model_are_one_model() -> None:
    """PM42-010: 526,374 by the .model file, 526,375 by the M42-10-S260-R(A) page."""
    assert of("PM42-010-S260", "ticks_per_turn: 526375").ticks_per_turn == 526_375


@pytest.mark.parametrize(
    ("text", "missing"),
    [("mode: position", "velocity_lsb_rad_s"), ("velocity_lsb_rad_s: 0.001", "ticks_per_turn")],
)
def test_a_unit_on_which_the_sources_disagree_is_required_in_the_file(text: str, missing: str) -> None:
    """RH-P12-RN(A): 4096 counts and 0.01 rpm by its page, 4231 and 0.114 rpm by the .model file."""
    with pytest.raises(ConfigError, match=f"{missing}.*disagrees"):
        of("RH-P12-RN", text)


def test_the_units_in_the_file_apply_to_a_disputed_model() -> None:
    found = of("RH-P12-RN", "ticks_per_turn: 4096", "velocity_lsb_rad_s: 0.001")
    assert (found.ticks_per_turn, found.velocity_lsb_rad_s) == (4096, 0.001)


def test_a_current_unit_that_was_measured_goes_before_the_manuals() -> None:
    assert of("XM430-W350", "current_lsb_a: 0.0027").current_lsb_a == 0.0027


@pytest.mark.parametrize("text", ["current_lsb_a: 0", "velocity_lsb_rad_s: -1", f"current_lsb_a: .{nan}"])
def test_a_unit_that_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        of("XM430-W350", text)


def test_no_watchdog_is_refused_for_a_model_that_has_one() -> None:
    with pytest.raises(
        ConfigError, match=r"watchdog: a XM430-W350 has a bus watchdog.*remove this key"
    ) as told:
        of("XM430-W350", "watchdog: none")
    assert told.value.line > 1


def test_gain_and_stall_torque_give_stiffness_and_lag() -> None:
    found = of("XM430-W350")  # 4.1 N·m and 4.82 rad/s at 12 V; 885 counts of output
    output = 4096 / (2.0 * pi) / 128.0 / 885.0  # share for each rad of error, P gain 1
    assert found.stiffness_nm_per_rad == pytest.approx(4.1 * output)
    assert found.lag_s == pytest.approx(1.0 / (4.817 * output), rel=1e-3)
    stiff = found.with_gains({"p": 800, "i": 0, "d": 0})
    assert stiff.stiffness_nm_per_rad == pytest.approx(800.0 * found.stiffness_nm_per_rad)
    assert stiff.lag_s == pytest.approx(found.lag_s / 800.0)


def test_a_servo_without_gain_or_figures_has_no_known_lag() -> None:
    assert isnan(of("XM430-W350").with_gains({"p": 0, "i": 0, "d": 0}).lag_s)
    unknown = of("XW540-H260")
    assert isnan(unknown.stiffness_nm_per_rad) and isnan(unknown.lag_s)
