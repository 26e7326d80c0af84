"""Virtual servos are as strong as their model: against hand calculation, and against a real XL330."""

import csv
from itertools import groupby
from math import pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest

from tests.support.pendulum_rig import GRAVITY, TICK, FeetechPendulum, Pendulum
from twind.virtual.bench_servos import BusTiming, bench, servo
from twind.virtual.virtual_main import prepare_motors
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.dynamixel_models import FACTS
from twind_drivers.virtual.dynamixel_motor_figures import FIGURES, NEAREST, motor_figures, stand_in
from twind_drivers.virtual.servo_strength import RAD_S, MotorFigures, OperatingPoint

OVERLOAD = 32  # bit of register 70
RUNS = Path(__file__).parents[1] / "data" / "xl330_pendulum.csv"
# model, V, P gain, kg, m; at 12 V, at 5 V and above it
LOADS = [
    ("XL330-M288", 5.0, 400, 0.20, 0.10),
    ("XL330-M288", 7.4, 400, 0.30, 0.10),
    ("XL430-W250", 12.0, 640, 0.50, 0.10),
    ("XM430-W350", 12.0, 800, 1.00, 0.15),
    ("XM430-W350", 14.8, 800, 1.00, 0.15),
    ("XM540-W270", 12.0, 800, 2.00, 0.20),
]


def balance(stall: float, slope: float, weight: float, dry: float, loaded: float = 0.0) -> float:
    """Angle (rad) at which a lifted mass ends whose goal is level: motor = weight sin(angle) + friction.

    `slope`: share of the output per tick of error. `loaded`: friction per (N·m)² that the gear carries.
    """
    low, high = 0.0, pi / 2
    while high - low > 1e-5:
        angle = (low + high) / 2
        motor = stall * min((pi / 2 - angle) / TICK * slope, 1.0)
        load = weight * sin(angle)
        rubbing = dry + loaded * (motor + load) ** 2
        low, high = (angle, high) if motor > load + rubbing else (low, angle)
    return low


def lift(arm: Pendulum) -> float:
    """Raise the mass slowly to level, so that nothing carries it on; return what is missing, rad."""
    arm.torque(True)
    for left in np.linspace(1.0, 0.0, 100):
        arm.goal((1.0 - left**2) * pi / 2)
        arm.wait(0.03)
    arm.wait(0.2)
    return pi / 2 - arm.angle


@pytest.mark.parametrize(("model", "volts", "p", "mass", "length"), LOADS)
def test_a_load_sinks_as_the_figures_of_the_model_and_its_gain_law_say(
    model: str, volts: float, p: int, mass: float, length: float
) -> None:
    arm = Pendulum(model, mass, length, volts=volts)
    arm.register("position_p_gain", p)
    arm.register("position_d_gain", 0)
    missing = lift(arm)
    sag = arm.servos.protection.supply_share[0] * arm.servos.protection.nominal[0]
    figures = motor_figures(table(number_of(model)))
    stall = figures.at(sag)[0]
    dry = 0.0122 * stall if figures.friction is None else figures.friction
    weight = mass * GRAVITY * length
    expected = balance(stall, p / figures.divisor / 885.0, weight, dry, figures.load_friction)
    assert missing == pytest.approx(pi / 2 - expected, rel=0.04)


@pytest.mark.parametrize(
    ("volts", "p", "mass", "stall"),
    [(6.0, 32, 0.8, 16.5), (7.4, 32, 0.8, 19.5), (7.4, 16, 0.8, 19.5), (12.0, 32, 1.2, 30.0)],
)
def test_a_load_on_an_sts3215_sinks_as_its_page_and_the_assumed_gain_law_say(
    volts: float, p: int, mass: float, stall: float
) -> None:
    arm = FeetechPendulum("STS3215", mass, 0.1, volts=volts)
    arm.register("position_p_gain", p)
    strength = stall * 0.0980665  # kg cm
    expected = balance(strength, 25.0 * p / 128.0 / 1000.0, mass * GRAVITY * 0.1, 0.0122 * strength)
    assert lift(arm) == pytest.approx(pi / 2 - expected, rel=0.04)


@pytest.mark.parametrize(
    ("model", "volts", "rpm"),
    [("XL330-M288", 5.0, 103), ("XL330-M288", 6.0, 123), ("XL430-W250", 11.1, 57),
     ("XM430-W350", 12.0, 46), ("XM430-W350", 14.8, 57), ("XM540-W270", 12.0, 30)],
)  # fmt: skip
def test_without_load_it_turns_at_the_speed_of_the_page(model: str, volts: float, rpm: float) -> None:
    arm = Pendulum(model, 0.001, 0.01, volts=volts)
    arm.register("operating_mode", 16)
    arm.torque(True)
    arm.register("goal_pwm", 885)
    arm.wait(1.0)
    assert arm.speed == pytest.approx(rpm * RAD_S, rel=0.06)  # the page's speed is without gear friction


@pytest.mark.parametrize(
    ("model", "mass", "length"),
    [
        ("XL330-M288", 0.49, 0.1),
        ("XL430-W250", 0.5, 0.2),
        ("XM430-W350", 1.0, 0.25),
        ("XM540-W270", 2.0, 0.3),
        ("STS3215", 0.6, 0.2),
    ],
)
def test_limp_it_swings_with_its_own_inertia_and_loses_what_friction_takes(
    model: str, mass: float, length: float
) -> None:
    """Period 2 pi sqrt(I / mgl) (1 + a² / 16); each half swing loses 2 F / mgl, and damping its share."""
    if model == "STS3215":
        arm: Pendulum = FeetechPendulum(model, mass, length, volts=7.4)
        figures = MotorFigures(points=(OperatingPoint(7.4, 1.912, 52.0, 3.0),), gear=345.0, nominal=7.4)
    else:
        arm = Pendulum(model, mass, length)
        figures = motor_figures(table(number_of(model)))
    weight = mass * GRAVITY * length
    inertia = mass * length**2 + figures.armature
    arm.body.data.qpos[0] = begin = 0.5
    arm.until(0.02)
    turns = []
    while len(turns) < 2:  # where it turns back
        before = arm.speed
        arm.wait(0.002)
        if before * arm.speed < 0.0:
            turns.append((arm.now, abs(arm.angle)))
    (first, lower), (second, lowest) = turns
    period = 2.0 * pi * sqrt(inertia / weight) * (1.0 + begin**2 / 16.0)
    assert 2.0 * (second - first) == pytest.approx(period, rel=0.03)
    volts = figures.nominal
    stall, speed, _ = figures.at(volts)
    dry = 0.0122 * stall if figures.friction is None else figures.friction
    wet = 0.0117 * stall / speed if figures.damping is None else figures.damping
    lost = 2.0 * dry / weight + lower * pi / 2.0 * wet / sqrt(inertia * weight)
    assert lower - lowest == pytest.approx(lost, rel=0.25)


# ------------------------------------------------------------------------------------- a real servo


def recorded() -> dict[str, np.ndarray]:
    """Samples by P gain and trajectory: time (s), goal (rad), torque, position (rad)."""
    with RUNS.open() as file:
        rows = list(csv.reader(file))[1:]
    runs = groupby(rows, key=lambda row: row[0])
    return {run: np.array([row[1:] for row in samples], np.float64) for run, samples in runs}


RECORDED = recorded()


@pytest.mark.parametrize("run", RECORDED)
def test_it_moves_as_a_real_xl330_did(run: str) -> None:
    """Mean error over 6 s from the first sample; an XM430 in its place is far off."""
    samples = RECORDED[run]
    errors = []
    for model in ("XL330-M288", "XM430-W350"):
        arm = Pendulum(model, 0.49, 0.1, volts=7.4 if model == "XL330-M288" else None)
        arm.body.data.qpos[0] = samples[0, 3]
        arm.register("position_p_gain", int(run.split()[0]))
        on = False
        found = []
        for time, goal, torque, _ in samples.tolist():
            arm.until(time)
            found.append(arm.angle)
            if (torque == 1.0) is not on:
                on = torque == 1.0
                arm.torque(on)
            arm.goal(goal)
        errors.append(np.degrees(np.abs(np.array(found) - samples[:, 3]).mean()))
        assert not arm.servos["hardware_error_status"][0] & OVERLOAD
    real, strong = errors
    assert real < 2.5
    assert strong > 8.0


# ------------------------------------------------------------------------------------- figures


@pytest.mark.parametrize(
    ("slow", "fast"),
    [("xm430_w350", "xm430_w210"), ("xh430_w350", "xh430_w210"), ("xh430_v350", "xh430_v210"),
     ("xl330_m288", "xl330_m077"), ("xc330_m288", "xc330_m181"), ("xc330_t288", "xc330_t181"),
     ("xc430_w240", "xc430_w150"), ("xm540_w270", "xm540_w150"), ("xh540_w270", "xh540_w150"),
     ("xh540_v270", "xh540_v150"), ("xw540_t260", "xw540_t140")],
)  # fmt: skip
def test_one_motor_behind_two_gears_turns_at_one_speed(slow: str, fast: str) -> None:
    one, other = (each.at(each.nominal)[1] * each.gear for each in (FIGURES[slow], FIGURES[fast]))
    assert one == pytest.approx(other, rel=0.03)


def test_no_motor_gives_more_power_than_it_takes() -> None:
    """N·m per A is V·s per rad, less what the gear takes; two pages round 17 % and 6 % above."""
    for figures in FIGURES.values():
        stall, speed, amperes = figures.at(figures.nominal)
        assert 0.3 < stall / amperes / (figures.nominal / speed) < 1.2


def test_at_a_voltage_of_the_page_the_figures_are_those_of_the_page() -> None:
    for figures in FIGURES.values():
        for row in figures.points:
            assert figures.at(row.volts) == pytest.approx((row.stall, row.rpm * RAD_S, row.amperes))


def test_between_and_beyond_the_rows_strength_and_speed_grow_with_the_voltage() -> None:
    xl330 = FIGURES["xl330_m288"]
    for low, high in ((3.0, 3.7), (5.0, 5.5), (6.0, 7.4)):
        assert all(less < more for less, more in zip(xl330.at(low), xl330.at(high), strict=True))
    assert xl330.at(7.4)[0] == pytest.approx(0.60 * 7.4 / 6.0)


def test_every_model_that_is_driven_has_figures_or_says_whose_it_takes(capfd) -> None:
    for stem, facts in FACTS.items():
        assert facts.undriven or stem in FIGURES or NEAREST[stem] in FIGURES
    assert stand_in(table(number_of("XL330-M288"))) is None
    buses = bench([servo("a:1:XL330-M288"), servo("a:2:RH-P12-RN")], BusTiming())
    prepare_motors(buses, None)
    warned = capfd.readouterr().err
    assert "no motor figures are published for RH-P12-RN: it is as strong as PM42-010-S260" in warned
    assert "XL330" not in warned


def test_a_servo_behind_a_bad_connector_is_weaker() -> None:
    arm = Pendulum("XM430-W350", 1.0, 0.15)
    arm.torque(True)
    arm.goal(1.0)
    arm.wait(1.0)
    before = arm.angle
    arm.servos.protection.drop(0, 3.0)
    arm.goal(0.0)
    arm.wait(1.0)
    arm.goal(1.0)
    arm.wait(1.0)
    assert before - arm.angle > 0.01
