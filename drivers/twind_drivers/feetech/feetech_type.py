"""Device type of Feetech servos: properties and capabilities of an entry of `types`."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

from msgspec import Meta

from twind.config.actuator_types import DeviceWarning, ExpectedDevice, lag_of
from twind.config.unwatched_type import UnwatchedType
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.feetech.feetech_identification import objections
from twind_drivers.feetech.feetech_models import AMPERE, FACTORY_P, model, share_per_radian
from twind_drivers.feetech.feetech_registers import RegisterMap, register_map

KIND = "feetech"  # of its buses
POSITION = "position"
MANY = "extended_position"  # phase bit 4, both limits 0
TURNS = 30_719  # counts: goals of several turns, both ways
Gain = Annotated[int, Meta(ge=0, le=254)]


@dataclass(frozen=True, slots=True)
class FeetechGains:
    """Position loop gains as register counts; None: as the servo has it."""

    p: Gain | None = None
    """0–254 | as the servo has it | Feetech: register 21, written to RAM before torque"""
    i: Gain | None = None
    """0–254 | as the servo has it | Feetech: register 23"""
    d: Gain | None = None
    """0–254 | as the servo has it | Feetech: register 22"""


@dataclass(frozen=True, slots=True)
class FeetechType(UnwatchedType):
    """Feetech servos. They have no watchdog: the file must say that it knows (`watchdog: none`)."""

    gains: FeetechGains
    torque_constant_nm_per_a: float  # NaN: effort unknown
    torque_limit: int  # 0.1 %, written before torque
    volts: float  # of the supply

    BUS: ClassVar[str] = KIND

    @property
    def map(self) -> RegisterMap:
        """Registers that the model is expected to have."""
        return register_map(model(self.device).map)

    @property
    def effort_lsb_nm(self) -> float:
        """N·m of one count of current; NaN: it reports none, or its torque constant is not given."""
        return self.torque_constant_nm_per_a * AMPERE if "present_current" in self.map else math.nan

    @property
    def effort_limit_nm(self) -> float:
        """Stall torque at the given supply, within the torque limit; NaN: no page gives it."""
        return self.strength[0] * self.torque_limit / 1000.0

    @property
    def strength(self) -> tuple[float, float]:
        """Stall torque (N·m) and speed without load (rad/s) at the given supply; NaN: no page gives them."""
        return model(self.device).at(self.volts) or (math.nan, math.nan)

    @property
    def full_effort(self) -> float:
        """NaN: no page gives the current of a stalled servo."""
        return math.nan

    @property
    def centre(self) -> int:
        """Middle of its counts."""
        return 512 if self.map.big_endian else 2048

    def operating_mode(self, mode: str) -> int:
        """Return 0 (position): the only one that is driven."""
        return 0

    def goals(self, mode: str, own: tuple[int, int] | None) -> tuple[int, int]:
        """Range of its limit registers, else of its counts; several turns in their mode."""
        if mode == MANY:
            return -TURNS, TURNS
        return own if own is not None and own != (0, 0) else (0, 2 * self.centre - 1)

    def fenced(self, mode: str) -> bool:
        """True in mode `position`: registers 9 and 11."""
        return mode == POSITION

    @property
    def stiffness_nm_per_rad(self) -> float:
        """Stall torque and P gain give it."""
        return self.strength[0] * share_per_radian(self.p_gain)

    @property
    def p_gain(self) -> float:
        """The value of `gains.p`; as from the factory where the file gives none."""
        return float(FACTORY_P if self.gains.p is None else self.gains.p)

    @property
    def lag_s(self) -> float:
        """The gain and the speed without load give it."""
        return lag_of(self.stiffness_nm_per_rad, self.strength)

    @property
    def homing_offset_limit(self) -> int | None:
        """Largest offset in register 31; None: an SCS has no such register."""
        return self.map["homing_offset"].most if "homing_offset" in self.map else None

    @property
    def offset_sign(self) -> int:
        """-1: its count is encoder minus offset, where a Dynamixel adds."""
        return -1

    @property
    def offset_moves_seam(self) -> bool:
        """False: counts are 0 to 4095 with any offset."""
        return False

    @property
    def winds(self) -> bool:
        """True: it loses its turns at power-off."""
        return self.mode == MANY

    @property
    def gain_limits(self) -> Mapping[str, float]:
        """P, I and D, as registers hold them."""
        return dict.fromkeys(("p", "i", "d"), 254.0)

    def with_gains(self, gains: Mapping[str, float]) -> "FeetechType":
        """Return the type with these gains, in whole counts."""
        return replace(self, gains=FeetechGains(**{name: int(number) for name, number in gains.items()}))

    def unfit(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[str]:
        """Yield what rules it out: no word on the watchdog, another model, settings, unknown firmware."""
        yield from self.unaccepted()
        if device.model_number != model(self.device).number:
            yield self.other_model(device)
        yield from objections(self.map, device.settings, turns=joint.mode == MANY)
        yield from self.other_registers(joint, device)

    def doubts(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[DeviceWarning]:
        """Yield the mode without limits of its own."""
        if not self.fenced(joint.mode):
            text = f"in {joint.mode} mode it has no limits of its own: the daemon's clamp is the only fence"
            yield DeviceWarning(text, 0.0, 0.0)
