"""Device type: what one kind of actuator of a robot file is, as the house asks for it.

A driver family derives its own class (`twind.config.driver_family`). No other code asks of which class a type
is: it asks for a property, or for a capability.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import inf, nan
from typing import ClassVar, NamedTuple, Protocol

from twind.config.supply_limits import SupplyLimits, ThermalLimits
from twind_drivers.bus import IdentifiedDevice


class DeviceWarning(NamedTuple):
    """Warning about a setting that works."""

    message: str
    value: float
    bound: float


class ExpectedDevice(Protocol):
    """Device that a joint (`twind.config.robot_spec.JointSpec`) expects; its type compares a found one."""

    @property
    def bus(self) -> str:
        """Name of the bus."""

    @property
    def id(self) -> int:
        """Id on the bus."""

    @property
    def type(self) -> "TypeSpec":
        """Type of the actuator."""

    @property
    def mode(self) -> str:
        """Name of its mode."""

    @property
    def registers(self) -> Mapping[str, int]:
        """Values that registers must hold."""

    @property
    def operating_mode(self) -> int:
        """Mode that the device must report."""

    @property
    def current_cap(self) -> int | None:
        """Largest current (counts) that it may use; None: its mode takes no cap."""


def lag_of(stiffness: float, strength: tuple[float, float]) -> float:
    """Return the time (s) that a servo is behind a moving goal; NaN: unknown.

    Its output, and so its speed without load, grows with its error as its torque does. `stiffness`: N·m/rad;
    `strength`: stall torque (N·m) and speed without load (rad/s).
    """
    stall, speed = strength
    return stall / (stiffness * speed) if stiffness > 0.0 else nan


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
    follow_rad: float | None = field(
        default=None, kw_only=True
    )  # at the joint (FOLLOW_ERR); None: not stated
    follow_s: float | None = field(default=None, kw_only=True)

    BUS: ClassVar[str]  # kind of the buses it may hang on: its driver family

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

    def refuse_registers(self, registers: Mapping[str, int]) -> Iterator[str]:
        """Yield why a register of the robot file cannot hold its value; by default nothing."""
        yield from ()

    @property
    def watched(self) -> bool:
        """True if its own watchdog is armed and read back before torque."""
        return True

    @property
    def lead_limit_rad(self) -> float:
        """Angle that a goal may lead its joint, beyond the sag of its load; inf: its watchdog stops it."""
        return inf

    @property
    def stiffness_nm_per_rad(self) -> float:
        """Torque for each rad of error at rest, by its gains; NaN: unknown."""
        return nan

    @property
    def p_gain(self) -> float:
        """Gain that the stiffness is proportional to, as the robot file states it; NaN: unknown."""
        return nan

    @property
    def lag_s(self) -> float:
        """Time that a moving shaft is behind its goal, by its gains; NaN: unknown."""
        return nan

    @property
    def winds(self) -> bool:
        """True if its count may start off by whole turns, as no turn count survives power-off."""
        return False

    @property
    def finds_endstops(self) -> bool:
        """True if it can be driven alone against a stop with a capped current (`begin_single_device`)."""
        return False

    @property
    def full_current_a(self) -> float:
        """Current at full load, A; NaN: the robot file gives none, or it has no such limit."""
        return nan

    def own_current_limit(self, device: IdentifiedDevice) -> int | None:
        """Largest current (counts) that the device is set to; None: unknown."""
        return None

    @property
    def homing_offset_limit(self) -> int | None:
        """Largest homing offset (counts) that every mode heeds; None: it has no such register."""
        return None

    @property
    def offset_sign(self) -> int:
        """Sign of a homing offset in a count: 1, or -1 where the count is encoder minus offset."""
        return 1

    @property
    def offset_moves_seam(self) -> bool:
        """True if a homing offset shifts the counts of the turn; False if they wrap where they always do."""
        return True

    @property
    def lost_turn_remedy(self) -> str:
        """Remedy, in words, for a count that would be another one at torque-on; empty: none."""
        return ""

    @property
    @abstractmethod
    def gain_limits(self) -> Mapping[str, float]:
        """Names of the gains, each with the largest value that it may have."""

    @abstractmethod
    def with_gains(self, gains: Mapping[str, float]) -> "TypeSpec":
        """Return the type with these gains, by the names of `gain_limits`."""

    @abstractmethod
    def unfit(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[str]:
        """Yield the reasons why a device is unusable for a joint of this type, whatever the calibration."""

    def doubts(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[DeviceWarning]:
        """Yield warnings about settings of a device that works."""
        return iter(())
