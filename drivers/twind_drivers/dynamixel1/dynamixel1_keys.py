"""Keys of servos of Protocol 1.0 in a robot file: buses, types, and slots of joints. Read once, checked."""

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
from twind_drivers.dynamixel1.dynamixel1_budget import Dynamixel1Cycle
from twind_drivers.dynamixel1.dynamixel1_models import models
from twind_drivers.dynamixel1.dynamixel1_registers import table_of
from twind_drivers.dynamixel1.dynamixel1_type import KIND, POSITION, Dynamixel1Gains, Dynamixel1Type
from twind_drivers.half_duplex.register_table import RegisterTable
from twind_drivers.half_duplex.servo_type_keys import (
    make_slot,
    read_choice,
    read_required,
    require_even_delay,
)

HEAT = ThermalLimits(warn=55.0, slow=60.0, settle=65.0, cool=50.0)


class Dynamixel1BusKeys(BusKeys):
    """Entry of a bus of Protocol 1.0."""

    baud: Literal[
        9_600, 19_200, 57_600, 115_200, 200_000, 250_000, 400_000, 500_000, 1_000_000, 2_250_000, 2_500_000,
        3_000_000,
    ] = 1_000_000  # fmt: skip
    """9600–4500000, a servo rate | | baud rate of the servos"""
    latency_timer_ms: Annotated[int, Meta(ge=0, le=255)] = 1
    """of the USB adapter, for the bus budget only; 0: no USB adapter"""
    one_write: bool = True
    """`false` for adapters or servos that lose back-to-back packets"""


class Dynamixel1SlotKeys(SlotKeys, kw_only=True):
    """Keys of what turns by a servo of Protocol 1.0."""

    id: Annotated[int, Meta(ge=0, le=253)]
    """Dynamixel 1.0: 0–253 | | on its bus"""
    registers: ConfigReader
    """number | its type's |"""


class Dynamixel1TypeKeys(UnwatchedTypeKeys, kw_only=True):
    """Entry of `types` for servos of Protocol 1.0."""

    gains: Dynamixel1Gains
    velocity_limit_rad_s: Speed = 2.0
    """of the motor shaft"""
    torque_limit: Annotated[int, Meta(ge=1, le=1023)] = 1023
    """1–1000; Dynamixel 1.0: 1–1023 | all | 0.1 %; Feetech: register 48, at most register 16;
    Dynamixel 1.0: register 34, at most register 14"""
    volts: Annotated[float, Meta(ge=4.0, le=25.0)] = math.nan
    """4–25 | Feetech: 7.4; Dynamixel 1.0: of its page | V of the supply, of which the strength depends"""
    return_delay_us: Annotated[int, Meta(ge=0, le=508)] = 500
    """0–508, even | 500 | twice register 9; Dynamixel 1.0: twice register 5, or more"""
    registers: ConfigReader
    """number | none | required content; compared, never written"""


def dynamixel1_bus(name: str, section: ConfigReader) -> BusSpec:
    """One bus. Raises ConfigError."""
    given = section.read(Dynamixel1BusKeys)
    return BusSpec(name, KIND, given.port, given.baud, given.latency_timer_ms, given.one_write)


def dynamixel1_type(name: str, section: ConfigReader) -> Dynamixel1Type:
    """One kind of servo. Raises ConfigError."""
    given = section.read(Dynamixel1TypeKeys)
    known = models().get(given.device)
    if known is None:
        raise section.refuse("device", unknown_model(given.device))
    require_even_delay(section, given.return_delay_us)
    strange = [
        each
        for each in (("slope",) if known.bulk_read else ("p", "i", "d"))
        if getattr(given.gains, each) is not None
    ]
    if strange:
        own = "p, i and d" if known.bulk_read else "slope"
        raise section.refuse("gains", f"a {known.name} has no gain {strange[0]}; it has {own}")
    return Dynamixel1Type(
        name=name,
        device=given.device,
        mode=read_choice(section, (POSITION,), POSITION),
        ticks_per_turn=round(known.turn),
        velocity_lsb_rad_s=known.rpm * 2.0 * math.pi / 60.0,
        velocity_limit_rad_s=given.velocity_limit_rad_s,
        acceleration_limit_rad_s2=given.acceleration_limit_rad_s2,
        registers=_registers(given.registers, table_of(known)),
        supply=supply(section.section("supply"), given.supply, SupplyLimits()),
        heat=heat(section.section("heat"), given.heat, HEAT, known.hottest),
        gains=given.gains,
        torque_limit=given.torque_limit,
        volts=known.volts if math.isnan(given.volts) else given.volts,
        watchdog=given.watchdog,
        return_delay_us=given.return_delay_us,
        lead_limit=given.lead_limit_rad,
    )


def dynamixel1_slot(entry: SlotEntry, kind: TypeSpec) -> ActuatorSlot:
    """The servo of a joint, or of an actuator beside the joints. Raises ConfigError."""
    assert isinstance(kind, Dynamixel1Type)
    given = entry.section.read(Dynamixel1SlotKeys, *entry.beside)
    mode = read_choice(entry.section, (POSITION,), kind.mode)
    return make_slot(entry, given, given.id, kind, mode, _registers(given.registers, kind.table))


def _registers(section: ConfigReader, own: RegisterTable) -> dict[str, int]:
    """Return the required register values by name. Raises ConfigError."""
    return read_required(section, own.title, own.registers, -1023, 65535)


class Dynamixel1Budget:
    """One bus of Protocol 1.0 at one rate."""

    def __init__(self, bus: BusSpec, rate_hz: float, found: Dynamixel1Cycle) -> None:
        self.bus = bus
        self._rate_hz = rate_hz
        self._found = found
        self._usb_s = bus.latency_timer_ms * 1e-3

    @property
    def refusal(self) -> str | None:
        """Why the rate is out of reach; None: it is not."""
        why = self._found.refusal(self._rate_hz, self._usb_s)
        return None if why is None else f"bus {self.bus.name}: {why}"

    @property
    def lines(self) -> tuple[str, ...]:
        """The arithmetic as text lines."""
        found = self._found
        whole = found.whole(self._rate_hz, self._usb_s)
        rate = f"{self.bus.baud} baud, {self._rate_hz:g} Hz wanted"
        return (
            f"bus {self.bus.name}: {found.count} servos at {rate}",
            f"  {found.bytes} bytes, {whole * 1e6:.0f} us, up to {1.0 / whole:.0f} Hz",
            f"    {found.line}",
        )


def dynamixel1_budget(request: BudgetRequest) -> Dynamixel1Budget:
    """Return the cycle of a bus: goals, reading, upkeep and the adapter's latency."""
    kinds = [joint.type for joint in request.joints if isinstance(joint.type, Dynamixel1Type)]
    alone = sum(not kind.model.bulk_read for kind in kinds)
    delay = max(kind.return_delay_us for kind in kinds) * 1e-6
    found = Dynamixel1Cycle(len(kinds), alone, request.bus.baud, delay)
    return Dynamixel1Budget(request.bus, request.rate_hz, found)
