"""Keys of Feetech servos in a robot file: their buses, types, and slots of joints. Read once, checked."""

import math
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.actuator_types import TypeSpec
from twind.config.config_reader import ConfigReader
from twind.config.driver_family import BudgetRequest, SlotEntry, unknown_model
from twind.config.family_keys import BusKeys, SlotKeys, Speed
from twind.config.robot_spec import ActuatorSlot, BusSpec
from twind.config.supply_limits import SupplyLimits, ThermalLimits, heat, supply
from twind.config.unwatched_type import UnwatchedTypeKeys
from twind_drivers.feetech.feetech_budget import FeetechCycle, cycle
from twind_drivers.feetech.feetech_models import models
from twind_drivers.feetech.feetech_registers import RegisterMap, register_map
from twind_drivers.feetech.feetech_type import KIND, MANY, POSITION, FeetechGains, FeetechType
from twind_drivers.half_duplex.servo_type_keys import make_slot, read_choice, read_required

HOTTEST = 70.0  # °C, register 13 as delivered; a servo was seen at 71 without switching off
HEAT = ThermalLimits(warn=55.0, slow=60.0, settle=65.0, cool=50.0)


class FeetechBusKeys(BusKeys):
    """Entry of a Feetech bus."""

    baud: Literal[38_400, 57_600, 76_800, 115_200, 128_000, 250_000, 500_000, 1_000_000] = 1_000_000
    """Feetech: 38400–1000000, a servo rate | | baud rate of the servos"""
    latency_timer_ms: Annotated[int, Meta(ge=0, le=255)] = 1
    """of the USB adapter, for the bus budget only; 0: no USB adapter"""
    one_write: bool = True
    """`false` for adapters or servos that lose back-to-back packets"""


class FeetechSlotKeys(SlotKeys, kw_only=True):
    """Keys of what turns by a Feetech servo."""

    id: Annotated[int, Meta(ge=0, le=253)]
    """Feetech: 0–253 | | on its bus"""
    registers: ConfigReader
    """number | its type's |"""


class FeetechTypeKeys(UnwatchedTypeKeys, kw_only=True):
    """Entry of `types` for Feetech servos."""

    gains: FeetechGains
    velocity_limit_rad_s: Speed = 2.0
    """of the motor shaft"""
    torque_constant_nm_per_a: Annotated[float, Meta(gt=0.0, le=1e3)] = math.nan
    """>0 | unknown | without it effort is unknown"""
    torque_limit: Annotated[int, Meta(ge=1, le=1000)] = 1000
    """1–1000 | 1000 | Feetech: 0.1 %, register 48, at most register 16"""
    volts: Annotated[float, Meta(ge=4.0, le=25.0)] = 7.4
    """4–25 | 7.4 | Feetech: V of the supply, of which the strength depends"""
    registers: ConfigReader
    """number | none | required content; compared, never written"""


def feetech_bus(name: str, section: ConfigReader) -> BusSpec:
    """One bus. Raises ConfigError."""
    given = section.read(FeetechBusKeys)
    return BusSpec(name, KIND, given.port, given.baud, given.latency_timer_ms, given.one_write)


def feetech_type(name: str, section: ConfigReader) -> FeetechType:
    """One kind of servo. Raises ConfigError."""
    given = section.read(FeetechTypeKeys)
    known = models().get(given.device)
    if known is None:
        raise section.refuse("device", unknown_model(given.device))
    own = register_map(known.map)
    return FeetechType(
        name=name,
        device=given.device,
        mode=_mode(section, POSITION, own),
        ticks_per_turn=round(own.turn),
        velocity_lsb_rad_s=2.0 * math.pi / own.turn,
        velocity_limit_rad_s=given.velocity_limit_rad_s,
        acceleration_limit_rad_s2=given.acceleration_limit_rad_s2,
        registers=_registers(given.registers, own),
        supply=supply(section.section("supply"), given.supply, SupplyLimits()),
        heat=heat(section.section("heat"), given.heat, HEAT, HOTTEST),
        gains=given.gains,
        torque_constant_nm_per_a=given.torque_constant_nm_per_a,
        torque_limit=given.torque_limit,
        volts=given.volts,
        watchdog=given.watchdog,
        lead_limit=given.lead_limit_rad,
    )


def feetech_slot(entry: SlotEntry, kind: TypeSpec) -> ActuatorSlot:
    """The servo of a joint, or of an actuator beside the joints. Raises ConfigError."""
    assert isinstance(kind, FeetechType)
    given = entry.section.read(FeetechSlotKeys, *entry.beside)
    mode = _mode(entry.section, kind.mode, kind.map)
    return make_slot(entry, given, given.id, kind, mode, _registers(given.registers, kind.map))


def _mode(section: ConfigReader, usual: str, own: RegisterMap) -> str:
    choices = (POSITION,) if own.big_endian else (POSITION, MANY)
    return read_choice(section, choices, usual)


def _registers(section: ConfigReader, own: RegisterMap) -> dict[str, int]:
    """Return the required register values by name. Raises ConfigError."""
    return read_required(section, f"an {own.name.upper()}", own.registers, -32767, 65535)


class FeetechBudget:
    """One Feetech bus at one rate."""

    def __init__(self, bus: BusSpec, rate_hz: float, found: FeetechCycle) -> None:
        self.bus = bus
        self._rate_hz = rate_hz
        self._found = found

    @property
    def refusal(self) -> str | None:
        """Why the rate is out of reach; None: it is not."""
        why = self._found.refusal(self._rate_hz)
        return None if why is None else f"bus {self.bus.name}: {why}"

    @property
    def lines(self) -> tuple[str, ...]:
        """The arithmetic as text lines."""
        found = self._found
        rate = f"{self.bus.baud} baud, {self._rate_hz:g} Hz wanted"
        return (
            f"bus {self.bus.name}: {found.count} servos at {rate}",
            f"  {found.bytes} bytes, {found.seconds * 1e6:.0f} us, up to {found.reachable_hz:.0f} Hz",
            f"    {found.line}",
        )


def feetech_budget(request: BudgetRequest) -> FeetechBudget:
    """Return the cycle of a bus: goals, reading, upkeep and the adapter's latency."""
    maps = [joint.type.map for joint in request.joints if isinstance(joint.type, FeetechType)]
    found = cycle(
        ["present_current" in each for each in maps],
        sum(not each.sync_read for each in maps),
        baud=request.bus.baud,
        rate_hz=request.rate_hz,
        usb_s=request.bus.latency_timer_ms * 1e-3,
    )
    return FeetechBudget(request.bus, request.rate_hz, found)
