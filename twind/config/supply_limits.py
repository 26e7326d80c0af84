"""Voltage and heat limits of a type: of the robot file, over those that its family knows of the model."""

from dataclasses import dataclass, replace
from math import inf
from sys import float_info
from typing import Annotated, TypeVar

from msgspec import Meta
from msgspec.structs import asdict

from twind.config.config_reader import ConfigReader, ConfigStruct

# °C below the servo's own limit
WARN_BELOW = 20.0
SLOW_BELOW = 15.0
SETTLE_BELOW = 10.0
COOL_BELOW = 25.0
# Of the current limit, what is borne for ever. An XM430 held 41 % of its stall current for seconds only
# (DynamixelSDK #285), one limited to 47 % reported overload in a grip (jsk_aerial_robot #281): below both.
CONTINUOUS = 0.35


@dataclass(frozen=True, slots=True)
class SupplyLimits:
    """Bounds of the supply, V. Nothing is known of the model: -inf and inf, nothing is judged by them."""

    warn: float = -inf  # told at and below
    settle: float = -inf  # settled at and below
    fault: float = -inf  # a fault at and below
    high: float = inf  # told above


@dataclass(frozen=True, slots=True)
class ThermalLimits:
    """Bounds of the temperature, °C, and what current the winding bears."""

    warn: float = inf  # told from here on
    slow: float = inf  # moves slower from here on, and begins nothing
    settle: float = inf  # settled from here on
    cool: float = inf  # once settled for heat, nobody arms before it is below this
    continuous: float = CONTINUOUS  # of the current limit, 0 to 1


Limits = TypeVar("Limits", SupplyLimits, ThermalLimits)
Volts = Annotated[float, Meta(gt=0.0, le=100.0)]
Celsius = Annotated[float, Meta(gt=0.0)]


class SupplyKeys(ConfigStruct):
    """Section `supply` of a type, V."""

    warn_v: Volts | None = None
    """| the model's: 11.1 | V; at or below: warning. Defaults: XM430; XL330: 4.4, 4, 3.8, 6.4, P series:
    19.9, 18.1, 16.5, 31.3"""
    settle_v: Volts | None = None
    """≤ `warn_v` | the model's: 10.5 | V; at or below: the robot settles"""
    fault_v: Volts | None = None
    """≤ `settle_v` | the model's: 10 | V; at or below: no pose can be held"""
    high_v: Volts | None = None
    """≥ `warn_v` | the model's: 14.8 | V; above: warning"""


class HeatKeys(ConfigStruct):
    """Section `heat` of a type, °C and a share."""

    warn_c: Celsius | None = None
    """≤ the servo's limit | the model's: 60 | °C; warning: 20 below shutdown"""
    slow_c: Celsius | None = None
    """≥ `warn_c`, ≤ the servo's limit | the model's: 65 | °C; motions slow down: 15 below shutdown"""
    settle_c: Celsius | None = None
    """≥ `slow_c`, ≤ the servo's limit | the model's: 70 | °C; the robot settles: 10 below shutdown"""
    cool_c: Celsius | None = None
    """≤ `settle_c` | the model's: 55 | °C; below: arming is possible again"""
    continuous: Annotated[float, Meta(gt=0.0, le=1.0)] | None = None
    """| 0.35 | share of the current limit that it bears permanently"""


def supply(section: ConfigReader, given: SupplyKeys, usual: SupplyLimits) -> SupplyLimits:
    """Section `supply` of a type over what is usual. Raises ConfigError: bounds that are not in order."""
    found = _override(usual, given, "_v")
    names = ("fault_v", "settle_v", "warn_v", "high_v")
    _require_order(section, names, (found.fault, found.settle, found.warn, found.high), "V")
    return found


def heat(section: ConfigReader, given: HeatKeys, usual: ThermalLimits, own: float) -> ThermalLimits:
    """Section `heat` of a type that shuts itself down at `own` °C, over what is usual.

    Raises ConfigError: bounds not in order, or never reached.
    """
    for key in ("warn_c", "slow_c", "settle_c", "cool_c"):
        section.check(key, Annotated[float, Meta(gt=0.0, le=min(own, float_info.max))])
    found = _override(usual, given, "_c")
    _require_order(section, ("warn_c", "slow_c", "settle_c"), (found.warn, found.slow, found.settle), "°C")
    _require_order(section, ("cool_c", "settle_c"), (found.cool, found.settle), "°C")
    return found


def _override(usual: Limits, given: ConfigStruct, unit: str) -> Limits:
    """`usual` with the values that are given, whose keys end in `unit`."""
    found = {key.removesuffix(unit): value for key, value in asdict(given).items() if value is not None}
    return replace(usual, **found)


def usual_heat(own: float) -> ThermalLimits:
    """Bounds of what shuts itself down at `own` °C; inf: not known, nothing is judged by them."""
    return ThermalLimits(own - WARN_BELOW, own - SLOW_BELOW, own - SETTLE_BELOW, own - COOL_BELOW)


def _require_order(
    section: ConfigReader, keys: tuple[str, ...], values: tuple[float, ...], unit: str
) -> None:
    """Raises ConfigError where one is above the next; what is not known (infinite) is in any order."""
    for key, value, after, bound in zip(keys, values, keys[1:], values[1:], strict=False):
        if not value <= bound:
            raise section.refuse(key, f"{value:g} {unit} is above {after}, which is {bound:g} {unit}")
