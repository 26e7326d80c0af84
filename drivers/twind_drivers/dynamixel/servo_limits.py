"""Voltage, heat and current limits of a servo model, scaled from the vendor's limits.

The vendor prints, per model, how far the voltage limits (registers 32, 34) may be set, and at which
temperature (31) the servo shuts itself down. The default bounds stand, within that, where those of a 12 V
XM430 stand: told at 11.1 V, settled at 10.5 V, a fault at 10.0 V, too much above 14.8 V, of 9.5 to 16 V.
"""

from math import inf, isfinite, nan

from twind.config.supply_limits import SupplyLimits
from twind_drivers.dynamixel.control_tables import ControlTable, number_of, table
from twind_drivers.dynamixel.dynamixel_models import base
from twind_drivers.dynamixel.factory_defaults import FACTORY, FactoryDefaults

XM430 = (9.5, 16.0)  # V, what its voltage limits may be
# V, of an XM430 at 12 V (facts of its page: 10.0-14.8)
TOLD = 11.1
SETTLED = 10.5
FAULT = 10.0
HIGH = 14.8


def full_counts(device: str, current_limit_a: float, current_lsb_a: float) -> float:
    """Counts of a servo's current (or load) register at its limit: the whole load. NaN: not known.

    `current_limit_a` is the robot file's, NaN where it gives none: then the servo's own limit as delivered
    (register 38). Load is in 0.1 % (e-manual, "Present Load").
    """
    made = _made(device)
    known = _table(device)
    if made is None or known is None:
        return nan
    if known.facts.effort == "present_load":
        return 1000.0
    if isfinite(current_limit_a):
        return current_limit_a / current_lsb_a
    return nan if made.current is None else float(made.current)


def usual_supply(device: str) -> SupplyLimits:
    """Bounds of a model from the range that its vendor prints; infinite where that is not known."""
    made = _made(device)
    if made is None:
        return SupplyLimits()
    least = made.volts_least or made.volts[0]
    most = made.volts_most or made.volts[1]
    own = (0.1 * least, 0.1 * most)
    return SupplyLimits(*(_scaled(bound, own) for bound in (TOLD, SETTLED, FAULT, HIGH)))


def _scaled(bound: float, own: tuple[float, float]) -> float:
    """`bound` (V) of an XM430, at the same share of what this model bears; in steps of the register."""
    share = (bound - XM430[0]) / (XM430[1] - XM430[0])
    return round(own[0] + share * (own[1] - own[0]), 1)


def heat_limit(device: str) -> float:
    """At which temperature (°C) the servo shuts itself down as delivered; inf: not known."""
    made = _made(device)
    return inf if made is None else float(made.temperature)


def _made(device: str) -> FactoryDefaults | None:
    known = _table(device)
    return None if known is None else FACTORY.get(base(known.stem))


def _table(device: str) -> ControlTable | None:
    try:
        return table(number_of(device))
    except KeyError:
        return None
