"""The units of a type's servos: counts a turn, ampere and rad/s of a count. Pure.

They come from the facts of the model that the type names; the keys are for models of which the sources
disagree, and for a unit of current that was measured. Counts a turn that contradict the model are refused:
each angle would be wrong by that factor.
"""

import math
from dataclasses import dataclass

from twind.config.config_section import ConfigSection
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.dynamixel_models import ModelCapabilities

X_SERIES = ModelCapabilities()  # of a device that is in no table: the robot file refuses it
ROUNDING = 1e-5  # the vendor's own figures of one model differ by 2e-6


@dataclass(frozen=True, slots=True)
class ServoUnits:
    """Units of the servos of one type."""

    ticks_per_turn: int
    current_lsb_a: float  # A per count; of a model that measures no current nothing is multiplied by it
    velocity_lsb_rad_s: float  # rad/s per count


def units(section: ConfigSection, device: str) -> ServoUnits:
    """The units that a type has. Raises ConfigError: against the model, or missing where nobody knows."""
    known = _facts(device)
    current = known.ampere_per_count or X_SERIES.ampere_per_count or math.nan
    velocity = known.radians_per_velocity_count
    if velocity is None and not section.has("velocity_lsb_rad_s"):
        raise section.refuse("velocity_lsb_rad_s", _unclear(device, "rad/s a count"))
    return ServoUnits(
        ticks_per_turn=_turn(section, device, known.counts_per_turn),
        current_lsb_a=section.number("current_lsb_a", current, above=0.0, most=1.0),
        velocity_lsb_rad_s=section.number("velocity_lsb_rad_s", velocity, above=0.0, most=1.0),
    )


def _turn(section: ConfigSection, device: str, known: int | None) -> int:
    if known is None and not section.has("ticks_per_turn"):
        raise section.refuse("ticks_per_turn", _unclear(device, "counts a turn"))
    given = section.integer("ticks_per_turn", known, least=256, most=2**24)
    if known is not None and abs(given - known) > ROUNDING * known:
        raise section.refuse(
            "ticks_per_turn",
            f"{given}, but a {device} has {known}: leave the key out; a gear behind it goes into ratio",
        )
    return given


def _facts(device: str) -> ModelCapabilities:
    try:
        return table(number_of(device)).facts
    except KeyError:
        return X_SERIES


def _unclear(device: str, what: str) -> str:
    return f"missing: what is printed about the {device} disagrees; give the {what} that you measured"
