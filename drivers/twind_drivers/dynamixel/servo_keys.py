"""Keys of serial servos in a robot file: their buses, types, and slots of joints. Read once, checked.

The units of a type come from the facts of its model; the keys are for models of which the sources disagree,
and for a unit of current that was measured. `position` is the default mode: in it alone the servo's own
position limits (registers 48, 52) are a second fence.
"""

import math
import re
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.actuator_types import TypeSpec
from twind.config.config_reader import ConfigReader
from twind.config.driver_family import SlotEntry
from twind.config.family_keys import BusKeys, SlotKeys, Speed, TypeKeys
from twind.config.robot_spec import ActuatorSlot, BusSpec
from twind.config.supply_limits import heat, supply, usual_heat
from twind_drivers.dynamixel.control_tables import ControlTable, models, number_of, table
from twind_drivers.dynamixel.dynamixel_models import ModelCapabilities
from twind_drivers.dynamixel.operating_modes import mode_of
from twind_drivers.dynamixel.servo_limits import heat_limit, usual_supply
from twind_drivers.dynamixel.servo_type import KIND, OPERATING_MODES, GainSettings, ServoType
from twind_drivers.half_duplex.servo_type_keys import make_slot, require_even_delay

CURRENT_BASED = "current_based_position"
# Modes that the driver has, and no robot: what the executor sends are positions.
TOOLS_ONLY: Mapping[str, str] = {
    "velocity": "speeds",
    "current": "currents",
}
X_SERIES = ModelCapabilities()
ROUNDING = 1e-5  # the vendor's own figures of one model differ by 2e-6

_REGISTER = re.compile(r"[a-z][a-z0-9_]{1,40}")

AS_DELIVERED = GainSettings(-1, -1, -1)  # not given

UnitOfCount = Annotated[float, Meta(gt=0.0, le=1.0)]


class SerialBusKeys(BusKeys):
    """Entry of a serial bus."""

    baud: Literal[9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000] = 1_000_000
    """9600–4500000, a servo rate | | baud rate of the servos"""
    latency_timer_ms: Annotated[int, Meta(ge=0, le=255)] = 1
    """of the USB adapter, for the bus budget only; 0: no USB adapter"""
    one_write: bool = True
    """`false` for adapters or servos that lose back-to-back packets"""


class ServoSlotKeys(SlotKeys, kw_only=True):
    """Keys of what turns by a servo."""

    id: Annotated[int, Meta(ge=0, le=252)]  # e-manual, "ID (7)"
    """0–252; CAN: 1–127, ODrive: 0–63 | | on its bus"""
    registers: ConfigReader
    """number | its type's |"""


class ServoTypeKeys(TypeKeys, kw_only=True):
    """Entry of `types` for serial servos."""

    return_delay_us: Annotated[int, Meta(ge=0, le=508)] = 500  # factory setting: 250 units of 2 µs
    """0–508, even | | twice register 9"""
    gains: GainSettings = AS_DELIVERED
    velocity_limit_rad_s: Speed = 2.0
    """of the motor shaft"""
    torque_constant_nm_per_a: Annotated[float, Meta(gt=0.0, le=1e3)] = math.nan
    """>0 | unknown | without it effort is unknown"""
    current_limit_a: Annotated[float, Meta(gt=0.0, le=1e3)] = math.nan
    """>0 | unknown | written as goal current by `current_based_position`, which requires it; XM430-W350: at
    most 3.209 A"""
    ticks_per_turn: Annotated[int, Meta(ge=256, le=2**24)] | None = None
    """| the model's | only where the model's value is ambiguous"""
    velocity_lsb_rad_s: UnitOfCount | None = None
    """| the model's | rad/s per count; likewise"""
    current_lsb_a: UnitOfCount | None = None
    """| the model's | A per count, if measured"""
    watchdog: Literal["", "none"] = ""
    """refused: these models have a watchdog, which is armed before torque"""
    registers: ConfigReader
    """number | none | required content; compared, never written"""


def servo_bus(name: str, section: ConfigReader) -> BusSpec:
    """One serial bus. Raises ConfigError."""
    given = section.read(SerialBusKeys)
    return BusSpec(name, KIND, given.port, given.baud, given.latency_timer_ms, given.one_write)


def is_servo(device: str) -> bool:
    """Return whether the vendor's index has that model, and this driver moves it."""
    try:
        return not table(number_of(device)).facts.undriven
    except KeyError:
        return False


def driven_models() -> tuple[str, ...]:
    """Return the names of the models of the vendor's index that this driver moves."""
    return tuple(filter(is_servo, models()))


def servo_slot(entry: SlotEntry, kind: TypeSpec) -> ActuatorSlot:
    """The servo of a joint, or of an actuator beside the joints. Raises ConfigError."""
    assert isinstance(kind, ServoType)
    given = entry.section.read(ServoSlotKeys, *entry.beside)
    mode = read_mode(entry.section, kind.mode)
    require_mode(entry.section, mode, kind, entry.type_section)
    registers = read_registers(given.registers, table(number_of(kind.device)))
    return make_slot(entry, given, given.id, kind, mode, registers)


def servo_type(name: str, section: ConfigReader) -> ServoType:
    """One kind of servo. Raises ConfigError."""
    given = section.read(ServoTypeKeys)
    delay = given.return_delay_us
    require_even_delay(section, delay)
    device = given.device
    known = _find_table(section, device)
    if given.watchdog and known.facts.watchdog_from is not None:
        raise section.refuse(
            "watchdog", f"a {device} has a bus watchdog, which is armed before torque: remove this key"
        )
    gains = section.section("gains")
    for key in ("p", "i", "d"):
        most = known[f"position_{key}_gain"].bounds[1]
        if getattr(given.gains, key) > most:
            raise gains.refuse(key, f"{getattr(given.gains, key)} is outside >= 0 and <= {most}")
    ampere = known.facts.ampere_per_count or X_SERIES.ampere_per_count or math.nan
    velocity = given.velocity_lsb_rad_s or known.facts.radians_per_velocity_count
    if velocity is None:
        raise section.refuse("velocity_lsb_rad_s", _unclear(device, "rad/s a count"))
    hottest = heat_limit(device)
    return ServoType(
        name=name,
        device=device,
        mode=read_mode(section, "position"),
        return_delay_us=delay,
        ticks_per_turn=_turn(section, given, known.facts.counts_per_turn),
        gains=_gains(section, device, known) if given.gains is AS_DELIVERED else given.gains,
        torque_constant_nm_per_a=given.torque_constant_nm_per_a,
        current_lsb_a=given.current_lsb_a or ampere,
        velocity_lsb_rad_s=velocity,
        velocity_limit_rad_s=given.velocity_limit_rad_s,
        acceleration_limit_rad_s2=given.acceleration_limit_rad_s2,
        current_limit_a=given.current_limit_a,
        registers=read_registers(given.registers, known),
        supply=supply(section.section("supply"), given.supply, usual_supply(device)),
        heat=heat(section.section("heat"), given.heat, usual_heat(hottest), hottest),
    )


def read_mode(section: ConfigReader, usual: str) -> str:
    """The mode of a servo as it is written. Raises ConfigError: no mode, or one that no robot may have."""
    if not section.has("mode"):
        return usual
    given = section.plain("mode")
    if isinstance(given, int | float):  # what register 11 holds, not what a person can check
        meant = [name for name, number in OPERATING_MODES.items() if number == given and given is not True]
        names = meant or list(OPERATING_MODES)
        raise section.refuse("mode", f"{given} is a number; a mode is named: write {' or '.join(names)}")
    mode = section.choice("mode", (*OPERATING_MODES, *TOOLS_ONLY))
    if mode in TOOLS_ONLY:
        message = f"mode {mode} takes {TOOLS_ONLY[mode]}, and the daemon commands positions"
        raise section.refuse("mode", f"{message}: use one of {', '.join(OPERATING_MODES)}")
    return mode


def require_mode(entry: ConfigReader, mode: str, kind: ServoType, described: ConfigReader) -> None:
    """Raises ConfigError for a mode that a joint's servo cannot have.

    Its model does not have the mode, or current-based position has no current that it takes. `described`:
    the section of `kind`.
    """
    if mode == CURRENT_BASED and kind.cap_counts is None:
        raise entry.refuse(
            "mode", f"mode {mode} needs current_limit_a in type {kind.name}: the most current it may use"
        )
    registers = table(number_of(kind.device))
    try:
        mode_of(f"type {kind.name}", registers, OPERATING_MODES[mode])
    except ValueError as error:
        raise entry.refuse("mode", str(error)) from None
    if mode == CURRENT_BASED:
        _require_current(kind, described, registers["goal_current"].bounds[1])


def read_registers(section: ConfigReader, known: ControlTable) -> dict[str, int]:
    """Return the required register values by name. Raises ConfigError."""
    for key in section:
        if not _REGISTER.fullmatch(key):
            raise section.refuse(key, "a register is named in snake case, as homing_offset")
        if key not in known:
            near = get_close_matches(key, known.fields, 1)
            hint = f"; nearest: {near[0]}" if near else ""
            raise section.refuse(key, f"{known.model} has no {key}{hint}")
    return {key: section.value(key, Annotated[int, Meta(ge=-(2**31), le=2**32 - 1)]) for key in section}


def _find_table(section: ConfigReader, device: str) -> ControlTable:
    """The vendor's table of a type's device. Raises ConfigError: no such model, or one that is not driven."""
    try:
        found = table(number_of(device))
    except KeyError as error:
        raise section.refuse("device", str(error.args[0])) from None
    if found.facts.undriven:
        raise section.refuse("device", f"{device} is not driven here: {found.facts.undriven}")
    return found


def _turn(section: ConfigReader, given: ServoTypeKeys, known: int | None) -> int:
    """Counts a turn. Raises ConfigError against the model: each angle would be wrong by that factor."""
    found = given.ticks_per_turn or known
    if found is None:
        raise section.refuse("ticks_per_turn", _unclear(given.device, "counts a turn"))
    if known is not None and abs(found - known) > ROUNDING * known:
        message = f"{found}, but a {given.device} has {known}"
        raise section.refuse(
            "ticks_per_turn", f"{message}: leave the key out; a gear behind it goes into ratio"
        )
    return found


def _unclear(device: str, what: str) -> str:
    return f"missing: what is printed about the {device} disagrees; give the {what} that you measured"


def _require_current(kind: ServoType, described: ConfigReader, counts: int) -> None:
    """Raises ConfigError where `current_limit_a` is no goal current of 1..`counts`."""
    cap = kind.cap_counts
    most = counts * kind.current_lsb_a
    if cap is None or not 1 <= cap <= counts:
        raise described.refuse(
            "current_limit_a",
            f"{kind.current_limit_a:g} A is outside {kind.current_lsb_a:.4g}..{most:.4g} A, what a "
            f"{kind.device} takes as goal current (102) in mode {CURRENT_BASED}",
        )


def _gains(section: ConfigReader, device: str, known: ControlTable) -> GainSettings:
    """Return the gains of a new servo (e-manual, "Initial Value"). Raises ConfigError: no page has them."""
    values = [known[f"position_{gain}_gain"].rule.default for gain in ("p", "i", "d")]
    stated = [value for value in values if value is not None]
    if len(stated) < len(values):
        raise section.refuse("gains", f"is required: no page states the factory gains of a {device}")
    return GainSettings(*stated)
