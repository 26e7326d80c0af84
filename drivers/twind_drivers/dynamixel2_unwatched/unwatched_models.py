"""Dynamixel models of Protocol 2.0 without a bus watchdog: numbers, units, ranges and figures. Pure.

Sources: e-manual, `dxl/x/xl320` and `dxl/pro/...-r` ("Specifications" prints `_data/dxl_pro_info.yml`). Units
of the PRO -R: "Goal Velocity (600)" and "Goal Torque (604)", which have a factor for each model; ranges:
"Min/Max Position Limit (36, 40)". Numbers of the PRO -R: one below those of the -RA in the vendor's index,
the page's 54024 of H54-200-S500-R among them; of L series: public lists of models. An L42-10-S300-R is left
out: no page states its unit of velocity.

Gain of the XL-320: e-manual, "PID Gains (27, 28, 29)": P 32 is a compliance slope of 32, at which the output
is full at 32 counts of error (assumed, as of an AX). So the output is P / 1024 of all, for each count.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from twind.exceptions import InvalidInput
from twind_drivers.virtual.dynamixel_motor_figures import FIGURES, continuous_figures
from twind_drivers.virtual.servo_strength import RAD_S, MotorFigures, OperatingPoint

A54 = 33.0 / 2048  # A per count of current
A42 = 8.25 / 2048
PRO_R = re.compile(r"[HLM](42|54)-\d+-S\d+-R")


@dataclass(frozen=True, slots=True)
class UnwatchedModel:
    """One model. `table`: `xl320` or `pro_r`; `turn`: counts per turn of the output.

    `lowest`, `highest`: largest range of its position limits. `velocity`: rad/s of one count.
    """

    name: str
    number: int
    table: str
    turn: float
    lowest: int
    highest: int
    velocity: float
    ampere: float | None  # A of one count; None: it measures no current
    hottest: float  # °C, temperature limit as delivered
    volts: float  # V, recommended
    figures: MotorFigures

    @property
    def rpm(self) -> float:
        """Revolutions per minute of one count of speed."""
        return self.velocity / RAD_S

    def strength(self, volts: float) -> tuple[float, float]:
        """Return stall torque (N·m) and speed without load (rad/s) at a supply."""
        stall, speed, _ = self.figures.at(volts)
        return stall, speed


def _pro(name: str, number: int, turn: int, rpm: float, figures: MotorFigures) -> UnwatchedModel:
    """Return a PRO -R; `rpm`: rev/min of the output per count of velocity."""
    ampere = A42 if "42-" in name else A54
    half = turn // 2
    return UnwatchedModel(name, number, "pro_r", turn, -half, half, rpm * RAD_S, ampere, 80.0, 24.0, figures)


def models() -> Mapping[str, UnwatchedModel]:
    """Return the known models by name."""
    point = OperatingPoint(7.4, 0.39, 114.0, 1.1)
    small = MotorFigures(points=(point,), gear=238.0, nominal=7.4, divisor=1024.0 / 1023.0)
    l54_50_s500 = continuous_figures(501.923, (16.0, 0.7), (13.7, 14.0, 1.9))
    l54_50_s290 = continuous_figures(288.5, (26.0, 1.05), (22.1, 4.8, 1.9))
    l54_30_s500 = continuous_figures(501.923, (23.0, 1.1), (21.0, 5.4, 1.6))
    l54_30_s400 = continuous_figures(400.5, (28.7, 1.19), (26.9, 2.5, 1.6))
    rows = (
        UnwatchedModel("XL-320", 350, "xl320", 1228.8, 0, 1023, 0.111 * RAD_S, None, 65.0, 7.4, small),
        _pro("H54-200-S500-R", 54024, 501_923, 0.00199234, FIGURES["ph54_200_s500"]),
        _pro("H54-100-S500-R", 53768, 501_923, 0.00199234, FIGURES["ph54_100_s500"]),
        _pro("H42-20-S300-R", 51200, 303_750, 0.00329218, FIGURES["ph42_020_s300"]),
        _pro("M54-60-S250-R", 46352, 251_417, 0.00397746, FIGURES["pm54_060_s250"]),
        _pro("M54-40-S250-R", 46096, 251_417, 0.00397746, FIGURES["pm54_040_s250"]),
        _pro("M42-10-S260-R", 43288, 263_187, 0.00389076, FIGURES["pm42_010_s260"]),
        _pro("L54-50-S500-R", 38152, 361_384, 0.00199234, l54_50_s500),
        _pro("L54-50-S290-R", 38176, 207_692, 0.00346667, l54_50_s290),
        _pro("L54-30-S500-R", 37896, 361_384, 0.00199234, l54_30_s500),
        _pro("L54-30-S400-R", 37928, 288_395, 0.00249657, l54_30_s400),
    )
    return {each.name: each for each in rows}


def find_model(name: str) -> UnwatchedModel | None:
    """Return a model by its name, also in the spelling XL320; None: not known."""
    return models().get("XL-320" if name == "XL320" else name)


def model(name: str) -> UnwatchedModel:
    """Return a model by its name. Raises InvalidInput that lists the names."""
    found = find_model(name)
    if found is None:
        known = ", ".join(sorted(models()))
        raise InvalidInput(f"{name!r} is no model of Protocol 2.0 without a watchdog; known: {known}")
    return found


def model_of(number: int) -> UnwatchedModel | None:
    """Return the model of a model number; None: not known."""
    return next((each for each in models().values() if each.number == number), None)
