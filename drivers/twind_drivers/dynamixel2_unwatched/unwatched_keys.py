"""Keys of XL-320 and PRO -R in a robot file: types, and slots of joints. Read once, checked."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

from msgspec import Meta

from twind.config.actuator_types import TypeSpec
from twind.config.config_reader import ConfigReader
from twind.config.driver_family import SlotEntry, unknown_model
from twind.config.family_keys import Speed
from twind.config.robot_spec import ActuatorSlot, BusSpec
from twind.config.supply_limits import SupplyLimits, ThermalLimits, heat, supply
from twind.config.unwatched_type import UnwatchedTypeKeys
from twind_drivers.dynamixel.servo_keys import ServoSlotKeys, servo_bus
from twind_drivers.dynamixel2_unwatched.unwatched_models import PRO_R, find_model
from twind_drivers.dynamixel2_unwatched.unwatched_registers import layout_of
from twind_drivers.dynamixel2_unwatched.unwatched_servo_type import (
    FULL,
    KIND,
    UnwatchedGains,
    UnwatchedServoType,
)
from twind_drivers.half_duplex.register_table import RegisterTable
from twind_drivers.half_duplex.servo_type_keys import (
    make_slot,
    read_choice,
    read_required,
    require_even_delay,
)

POSITION = "position"
# °C below the temperature limit of an XL-320, 65, and of a PRO -R, 80
HEAT = {"xl320": ThermalLimits(48.0, 52.0, 57.0, 45.0), "pro_r": ThermalLimits(60.0, 65.0, 72.0, 55.0)}


class UnwatchedServoTypeKeys(UnwatchedTypeKeys, kw_only=True):
    """Entry of `types` for XL-320 and PRO -R."""

    gains: UnwatchedGains
    velocity_limit_rad_s: Speed = 2.0
    """of the motor shaft"""
    torque_limit: Annotated[int, Meta(ge=1, le=FULL)] = FULL
    """1–1000; Dynamixel 1.0: 1–1023 | all | 0.1 %; Feetech: register 48, at most register 16;
    Dynamixel 1.0: register 34, at most register 14"""
    torque_constant_nm_per_a: Annotated[float, Meta(gt=0.0, le=1e3)] = math.nan
    """>0 | unknown | without it effort is unknown"""
    volts: Annotated[float, Meta(ge=4.0, le=36.0)] = math.nan
    """4–25 | Feetech: 7.4; Dynamixel 1.0: of its page | V of the supply, of which the strength depends"""
    return_delay_us: Annotated[int, Meta(ge=0, le=510)] = 500
    """0–508, even | 500 | twice register 9; Dynamixel 1.0: twice register 5, or more"""
    registers: ConfigReader
    """number | none | required content; compared, never written"""


def unwatched_bus(name: str, section: ConfigReader) -> BusSpec:
    """One bus. Raises ConfigError."""
    return replace(servo_bus(name, section), kind=KIND)


def is_unwatched(device: str) -> bool:
    """Return whether that is a model of the family; also for a PRO -R that is not driven."""
    return find_model(device) is not None or PRO_R.fullmatch(device) is not None


def unwatched_servo_type(name: str, section: ConfigReader) -> UnwatchedServoType:
    """One kind of servo. Raises ConfigError."""
    given = section.read(UnwatchedServoTypeKeys)
    known = find_model(given.device)
    if known is None:
        raise section.refuse("device", unknown_model(given.device))
    require_even_delay(section, given.return_delay_us)
    layout = layout_of(known.table)
    for register, value in given.gains.registers().items():
        if register not in layout.gains:
            raise section.refuse(
                "gains", f"a {known.name} has no {register}; it has {', '.join(layout.gains)}"
            )
        if value > layout.table[register].most:
            most = layout.table[register].most
            raise section.refuse("gains", f"{register} {value} is above {most}, the most of a {known.name}")
    return UnwatchedServoType(
        name=name,
        device=known.name,
        mode=read_choice(section, (POSITION,), POSITION),
        ticks_per_turn=round(known.turn),
        velocity_lsb_rad_s=known.velocity,
        velocity_limit_rad_s=given.velocity_limit_rad_s,
        acceleration_limit_rad_s2=given.acceleration_limit_rad_s2,
        registers=_registers(given.registers, layout.table),
        supply=supply(section.section("supply"), given.supply, SupplyLimits()),
        heat=heat(section.section("heat"), given.heat, HEAT[known.table], known.hottest),
        gains=given.gains,
        torque_limit=given.torque_limit,
        torque_constant_nm_per_a=given.torque_constant_nm_per_a,
        volts=known.volts if math.isnan(given.volts) else given.volts,
        watchdog=given.watchdog,
        return_delay_us=given.return_delay_us,
        lead_limit=given.lead_limit_rad,
    )


def unwatched_slot(entry: SlotEntry, kind: TypeSpec) -> ActuatorSlot:
    """The servo of a joint, or of an actuator beside the joints. Raises ConfigError."""
    assert isinstance(kind, UnwatchedServoType)
    given = entry.section.read(ServoSlotKeys, *entry.beside)
    mode = read_choice(entry.section, (POSITION,), kind.mode)
    return make_slot(entry, given, given.id, kind, mode, _registers(given.registers, kind.layout.table))


def refuse_other_table(slot: ActuatorSlot, others: Sequence[ActuatorSlot], section: ConfigReader) -> None:
    """Refuse a PRO -R beside an XL-320: one request reads all devices of a bus. Raises ConfigError."""
    for other in others:
        pair = (slot.type, other.type)
        tables = {each.model.table for each in pair if isinstance(each, UnwatchedServoType)}
        if len(tables) > 1:
            text = f"{slot.type.device} and {other.type.device} of {other.name} have different registers"
            raise section.refuse("type", f"{text}: use a bus for each")


def _registers(section: ConfigReader, own: RegisterTable) -> dict[str, int]:
    """Return the required register values by name. Raises ConfigError."""
    return read_required(section, own.title, own.registers, -(2**31), 2**32 - 1)
