"""The kinds of actuator that a robot file describes: the interface of all, and the properties of each.

Code that needs units, strength or bounds uses `TypeSpec`. Only code that opens a bus, makes a virtual
actuator or compares devices looks at the kind itself.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from twind.config.supply_limits import SupplyLimits, ThermalLimits, full_counts
from twind_drivers.can.can_units import COUNT, EFFORT
from twind_drivers.dynamixel.control_tables import number_of, table

# kinds of bus
SERIAL = "dynamixel2"
CAN = "can"

# Name in the robot file -> value of the servo's register 11 (e-manual, "Operating Mode").
OPERATING_MODES: Mapping[str, int] = {
    "position": 3,
    "extended_position": 4,
    "current_based_position": 5,
}
MANY_TURNS = 1_048_575  # ticks: goals of the modes without position limits (e-manual, "Goal Position")
IMPEDANCE: Final = (
    "impedance"  # torque = kp (goal - position) - kd velocity: how every CAN family here is driven
)
NO_EFFORT = ("odrive",)  # families that report a current and no torque
TAKES_COMMANDS = 1  # operating mode that a CAN bus reports for an actuator that takes these commands
MOST_GAIN = 16383  # of a servo's gain registers (e-manual, addresses 80 to 84)
Gain = Annotated[int, Meta(ge=0, le=MOST_GAIN)]


@dataclass(frozen=True, slots=True)
class TypeSpec(ABC):
    """One kind of actuator, shared by joints."""

    name: str
    device: str  # as the driver's table spells it: XM430-W350, DM4340
    mode: str  # a joint may have another
    ticks_per_turn: int
    velocity_lsb_rad_s: float
    velocity_limit_rad_s: float
    acceleration_limit_rad_s2: float
    registers: Mapping[str, int]  # what a register must hold, by its name in snake case
    supply: SupplyLimits  # V that it bears
    heat: ThermalLimits  # °C, and for how long how much of its strength

    BUS: ClassVar[str]  # kind of the buses it may hang on

    @property
    @abstractmethod
    def effort_lsb_nm(self) -> float:
        """N·m of one raw effort; NaN: it reports no torque."""

    @property
    @abstractmethod
    def effort_limit_nm(self) -> float:
        """Largest torque, N·m; NaN: unknown."""

    @property
    @abstractmethod
    def full_effort(self) -> float:
        """Raw effort at full load; NaN: unknown."""

    @property
    @abstractmethod
    def centre(self) -> int:
        """Count in the middle of the turn in which it boots. Raises KeyError: no such model."""

    @abstractmethod
    def operating_mode(self, mode: str) -> int:
        """Return the operating mode that a device in `mode` must report."""

    @abstractmethod
    def goals(self, mode: str, own: tuple[int, int] | None) -> tuple[int, int]:
        """The smallest and the largest goal (counts) it takes; `own`: its limits when it was calibrated."""

    @abstractmethod
    def fenced(self, mode: str) -> bool:
        """Return whether it refuses goals beyond limits of its own."""

    def current_cap(self, mode: str) -> int | None:
        """Largest current (counts) that it may use, where `mode` takes such a cap."""
        return None

    @property
    def watched(self) -> bool:
        """True if its own watchdog is armed and read back before torque."""
        return True


@dataclass(frozen=True, slots=True)
class GainSettings:
    """Position loop gains as register counts; they are written before torque and read back."""

    p: Gain
    """register counts, written before torque"""
    i: Gain
    """register counts, written before torque"""
    d: Gain
    """register counts, written before torque"""


@dataclass(frozen=True, slots=True)
class ServoType(TypeSpec):
    """Serial servos. `mode` is one of OPERATING_MODES."""

    return_delay_us: int
    gains: GainSettings
    torque_constant_nm_per_a: float  # NaN: effort unknown
    current_lsb_a: float
    current_limit_a: float  # NaN: unknown

    BUS: ClassVar[str] = SERIAL

    @property
    def effort_lsb_nm(self) -> float:
        """N·m of one count of current."""
        return self.torque_constant_nm_per_a * self.current_lsb_a

    @property
    def effort_limit_nm(self) -> float:
        """Torque at `current_limit_a`, N·m."""
        return self.torque_constant_nm_per_a * self.current_limit_a

    @property
    def full_effort(self) -> float:
        """Counts of its current (or load) register at its limit."""
        return full_counts(self.device, self.current_limit_a, self.current_lsb_a)

    @property
    def centre(self) -> int:
        """X series 2048, P series 0 (e-manual, "Goal Position"); where no source states it, half a turn."""
        known = table(number_of(self.device)).facts.centre
        return self.ticks_per_turn // 2 if known is None else known

    def operating_mode(self, mode: str) -> int:
        """Return the value of register 11 (operating mode) for `mode`."""
        return OPERATING_MODES[mode]

    def goals(self, mode: str, own: tuple[int, int] | None) -> tuple[int, int]:
        """Mode `position`: range of its limit registers, else one turn; others: many turns (48, 52)."""
        if not self.fenced(mode):
            return -MANY_TURNS, MANY_TURNS
        first = self.centre - self.ticks_per_turn // 2
        return own if own is not None else (first, first + self.ticks_per_turn - 1)

    def fenced(self, mode: str) -> bool:
        """True in mode `position` alone (e-manual, registers 48 and 52)."""
        return mode == "position"

    def current_cap(self, mode: str) -> int | None:
        """Goal current (102), in current-based position mode."""
        return self.cap_counts if mode == "current_based_position" else None

    @property
    def cap_counts(self) -> int | None:
        """`current_limit_a` in counts, rounded down; None where it is not given."""
        if not math.isfinite(self.current_limit_a):
            return None
        return math.floor(self.current_limit_a / self.current_lsb_a + 1e-9)  # 2.69 A is 1000 of 2.69 mA


@dataclass(frozen=True, slots=True)
class Impedance:
    """Stiffness and damping of a CAN actuator at its output."""

    kp: Annotated[float, Meta(ge=0.0)]  # N·m/rad
    """0 to the field's maximum, mostly 500 | | CAN: stiffness, N·m/rad"""
    kd: Annotated[float, Meta(ge=0.0)]  # N·m·s/rad
    """0 to the field's maximum, mostly 5 | | CAN: damping, N·m·s/rad. A moving joint lags by `kd`/`kp` s"""


@dataclass(frozen=True, slots=True)
class FrameRanges:
    """Ranges of the fields in a CAN actuator's frames, symmetric about 0."""

    position_rad: float
    velocity_rad_s: float
    torque_nm: float


@dataclass(frozen=True, slots=True)
class CanType(TypeSpec):
    """CAN actuators. Raw units are those of `twind_drivers.can.can_units`, at the output."""

    family: str  # damiao, cubemars, robstride or odrive
    gains: Impedance
    ranges: FrameRanges
    torque_limit_nm: float
    watchdog: str  # `device`: armed and read back before torque; `unverified`: it cannot be read back

    BUS: ClassVar[str] = CAN

    @property
    def effort_lsb_nm(self) -> float:
        """N·m of one count of the driver's raw effort; NaN: its family reports a current, and no torque."""
        return math.nan if self.family in NO_EFFORT else EFFORT

    @property
    def effort_limit_nm(self) -> float:
        """The value of `torque_limit_nm`."""
        return self.torque_limit_nm

    @property
    def full_effort(self) -> float:
        """Raw effort at `torque_limit_nm`; NaN: it reports no effort."""
        return self.torque_limit_nm / self.effort_lsb_nm

    @property
    def centre(self) -> int:
        """0: its turn lies around its zero."""
        return 0

    @property
    def most(self) -> int:
        """The largest count that its position field holds."""
        return math.floor(self.ranges.position_rad / COUNT)

    def operating_mode(self, mode: str) -> int:
        """Return the code of an actuator that takes these commands."""
        return TAKES_COMMANDS

    def goals(self, mode: str, own: tuple[int, int] | None) -> tuple[int, int]:
        """Range of the position field, by the file and the device."""
        low, high = own if own is not None else (-self.most, self.most)
        return max(low, -self.most), min(high, self.most)

    def fenced(self, mode: str) -> bool:
        """False: it goes wherever the position field can represent."""
        return False

    @property
    def watched(self) -> bool:
        """True if the file arms its watchdog."""
        return self.watchdog == "device"
