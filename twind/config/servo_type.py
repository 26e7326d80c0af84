"""Section `types.TYPE` of serial servos, and what their joints may say of them. Read once, checked."""

import math
import re
from collections.abc import Callable
from difflib import get_close_matches

from twind.config.actuator_types import GainSettings, ServoType
from twind.config.config_section import ConfigSection
from twind.config.drive_mode import joint_mode, type_mode
from twind.config.servo_units import units
from twind.config.supply_limits import heat, supply
from twind_drivers.dynamixel.control_tables import ControlTable, number_of, table

MAX_ID = 252  # e-manual, "ID (7)"
_REGISTER = re.compile(r"[a-z][a-z0-9_]{1,40}")


def servo_type(name: str, section: ConfigSection) -> ServoType:
    """One kind of servo. Raises ConfigError."""
    delay = section.integer("return_delay_us", 500, least=0, most=508)  # factory setting: 250 units of 2 µs
    if delay % 2:
        raise section.refuse("return_delay_us", f"{delay} is odd: the register counts in steps of 2 µs")
    device = section.text("device")
    known = _find_table(section, device)
    of = units(section, device)
    spec = ServoType(
        name=name,
        device=device,
        mode=type_mode(section),
        return_delay_us=delay,
        ticks_per_turn=of.ticks_per_turn,
        gains=_gains(section.section("gains")),
        torque_constant_nm_per_a=section.number("torque_constant_nm_per_a", math.nan, above=0.0, most=1e3),
        current_lsb_a=of.current_lsb_a,
        velocity_lsb_rad_s=of.velocity_lsb_rad_s,
        velocity_limit_rad_s=section.number("velocity_limit_rad_s", 2.0, above=0.0, most=100.0),
        acceleration_limit_rad_s2=section.number("acceleration_limit_rad_s2", 10.0, above=0.0, most=1e4),
        current_limit_a=section.number("current_limit_a", math.nan, above=0.0, most=1e3),
        registers=_registers(section.section("registers"), known),
        supply=supply(section, device),
        heat=heat(section, device),
    )
    section.close()
    return spec


def servo_joint(
    source: Callable[[str], ConfigSection], entry: ConfigSection, kind: ServoType, described: ConfigSection
) -> tuple[int, str, dict[str, int]]:
    """Id, mode and registers of a joint that a servo of `kind` drives. Raises ConfigError."""
    return (
        entry.integer("id", least=0, most=MAX_ID),
        joint_mode(source, entry, kind, described),
        {**kind.registers, **_registers(entry.section("registers"), table(number_of(kind.device)))},
    )


def _find_table(section: ConfigSection, device: str) -> ControlTable:
    """The vendor's table of a type's device. Raises ConfigError with the nearest names."""
    try:
        return table(number_of(device))
    except KeyError as error:
        raise section.refuse("device", str(error.args[0])) from None


def _gains(section: ConfigSection) -> GainSettings:
    gains = GainSettings(*(section.integer(key, least=0, most=16383) for key in ("p", "i", "d")))
    section.close()
    return gains


def _registers(section: ConfigSection, known: ControlTable) -> dict[str, int]:
    for key in section:
        if not _REGISTER.fullmatch(key):
            raise section.refuse(key, "a register is named in snake case, as homing_offset")
        if key not in known:
            near = get_close_matches(key, known.fields, 1)
            hint = f"; nearest: {near[0]}" if near else ""
            raise section.refuse(key, f"{known.model} has no {key}{hint}")
    return {key: section.integer(key, least=-(2**31), most=2**32 - 1) for key in section}
