"""Driver family `lx16a`: the device type, the keys of a robot file, the cycle budget, the record."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from msgspec import Meta

from twind.config.actuator_types import DeviceWarning, TypeSpec
from twind.config.config_reader import ConfigReader
from twind.config.driver_family import BudgetRequest, DriverFamily, FamilyPart, SlotEntry
from twind.config.family_keys import BusKeys, SlotKeys, Speed
from twind.config.port_names import Medium
from twind.config.robot_spec import ActuatorSlot, BusSpec, JointSpec
from twind.config.supply_limits import SupplyLimits, ThermalLimits, heat, supply
from twind.config.unwatched_type import UnwatchedType, UnwatchedTypeKeys
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.half_duplex.pending_reply import wire

KIND = "lx16a"
MODEL = "LX-16A"
BAUD = 115_200
LAST = 1000  # counts: 0 to 1000 are 240°
TURN = 1500
DELAY = 0.0005  # s from a request to its reply, assumed
CYCLE = 14 + 10  # bytes of one device: its position and its goal
SLOW = 13  # bytes of one slow read in each cycle
HOTTEST = 85.0  # °C, as delivered
HEAT = ThermalLimits(warn=60.0, slow=65.0, settle=70.0, cool=55.0)
STALL = (1.67, 6.54)  # N·m and rad/s: 17 kg·cm and 0.16 s/60° at 7.4 V (vendor's page)


class LxBusKeys(BusKeys):
    """Entry of an LX-16A bus. Its rate is fixed."""


class LxSlotKeys(SlotKeys, kw_only=True):
    """Keys of what turns by an LX-16A."""

    id: Annotated[int, Meta(ge=0, le=253)]


class LxTypeKeys(UnwatchedTypeKeys, kw_only=True):
    """Entry of `types` for LX-16A."""

    velocity_limit_rad_s: Speed = 2.0


@dataclass(frozen=True, slots=True)
class LxType(UnwatchedType):
    """LX-16A. It has no watchdog, no current and no error: the file must say `watchdog: none`."""

    BUS: ClassVar[str] = KIND

    @property
    def effort_lsb_nm(self) -> float:
        """NaN: it reports no torque."""
        return math.nan

    @property
    def effort_limit_nm(self) -> float:
        """Stall torque at 7.4 V."""
        return STALL[0]

    @property
    def full_effort(self) -> float:
        """NaN: it reports none."""
        return math.nan

    @property
    def centre(self) -> int:
        """Middle of its counts."""
        return LAST // 2

    def operating_mode(self, mode: str) -> int:
        """Return 0: servo mode."""
        return 0

    def goals(self, mode: str, own: tuple[int, int] | None) -> tuple[int, int]:
        """Counts that a move may have."""
        return 0, LAST

    def fenced(self, mode: str) -> bool:
        """True: goals beyond its angle limits are not followed."""
        return True

    @property
    def gain_limits(self) -> Mapping[str, float]:
        """It has no gains to set."""
        return {}

    def with_gains(self, gains: Mapping[str, float]) -> "LxType":
        """Return the same type."""
        return self

    def unfit(self, joint: JointSpec, device: IdentifiedDevice) -> Iterator[str]:
        """Yield what rules it out."""
        yield from self.unaccepted()
        if device.settings["operating_mode"]:
            yield "is in motor mode, which turns for ever"

    def doubts(self, joint: JointSpec, device: IdentifiedDevice) -> Iterator[DeviceWarning]:
        """Yield the offset: adopted as it is."""
        if device.settings["homing_offset"]:
            yield DeviceWarning("has an offset of its own", float(device.settings["homing_offset"]), 0.0)


def lx_bus(name: str, section: ConfigReader) -> BusSpec:
    """One bus. Raises ConfigError."""
    given = section.read(LxBusKeys)
    return BusSpec(name, KIND, given.port, BAUD, latency_timer_ms=1)


def lx_type(name: str, section: ConfigReader) -> LxType:
    """One kind of servo. Raises ConfigError."""
    given = section.read(LxTypeKeys)
    if given.device != MODEL:
        raise section.refuse("device", f"{given.device} is not {MODEL}")
    return LxType(
        name=name,
        device=MODEL,
        mode=_mode(section),
        ticks_per_turn=TURN,
        velocity_lsb_rad_s=math.tau / TURN,
        velocity_limit_rad_s=given.velocity_limit_rad_s,
        acceleration_limit_rad_s2=given.acceleration_limit_rad_s2,
        registers={},
        supply=supply(section.section("supply"), given.supply, SupplyLimits()),
        heat=heat(section.section("heat"), given.heat, HEAT, HOTTEST),
        watchdog=given.watchdog,
        lead_limit=given.lead_limit_rad,
    )


def lx_slot(entry: SlotEntry, kind: TypeSpec) -> ActuatorSlot:
    """The servo of a joint. Raises ConfigError."""
    given = entry.section.read(LxSlotKeys, *entry.beside)
    mode = _mode(entry.section)
    return ActuatorSlot(
        entry.name, entry.bus, given.id, kind, given.sign, given.ratio, {}, mode, feedback_id=None
    )


def _mode(section: ConfigReader) -> str:
    return section.choice("mode", ("position",)) if section.has("mode") else "position"


@dataclass(frozen=True, slots=True)
class LxBudget:
    """Cycle of one bus: each device is read and written alone."""

    bus: BusSpec
    count: int
    rate_hz: float

    @property
    def seconds(self) -> float:
        """Bus time of one cycle with its slow read."""
        return wire(self.count * CYCLE + SLOW, BAUD) + (self.count + 1) * DELAY

    @property
    def refusal(self) -> str | None:
        """Why the rate is out of reach; None: it is not."""
        if self.seconds <= 1.0 / self.rate_hz:
            return None
        reach = f"{self.count} servos take {self.seconds * 1e3:.1f} ms: up to {1.0 / self.seconds:.0f} Hz"
        return f"bus {self.bus.name}: {self.rate_hz:g} Hz is out of reach: {reach}"

    @property
    def lines(self) -> tuple[str, ...]:
        """The arithmetic as text lines."""
        reach = f"{self.seconds * 1e3:.1f} ms, up to {1.0 / self.seconds:.0f} Hz"
        return (f"bus {self.bus.name}: {self.count} servos at {BAUD} baud: {reach}",)


def lx_budget(request: BudgetRequest) -> LxBudget:
    """Return the cycle of a bus."""
    return LxBudget(request.bus, len(request.joints), request.rate_hz)


LX16A = DriverFamily(
    kind=KIND,
    medium=Medium.SERIAL,
    bus_keys=LxBusKeys,
    type_keys=LxTypeKeys,
    slot_keys=LxSlotKeys,
    read_bus=lx_bus,
    knows=lambda device: device == MODEL,
    models=lambda: (MODEL,),
    read_type=lx_type,
    read_slot=lx_slot,
    budget=lx_budget,
    driver=FamilyPart("twind_lx16a.lx16a_bus:DRIVER"),
    virtual=FamilyPart("twind_lx16a.lx16a_twin:TWIN"),
)
