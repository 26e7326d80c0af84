"""Device type of XL-320 and PRO -R: properties and capabilities of an entry of `types`."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

from msgspec import Meta

from twind.config.actuator_types import ExpectedDevice, lag_of
from twind.config.unwatched_type import UnwatchedType
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel2_unwatched.unwatched_identification import kind_of, objections
from twind_drivers.dynamixel2_unwatched.unwatched_models import UnwatchedModel, model
from twind_drivers.dynamixel2_unwatched.unwatched_registers import UnwatchedLayout, layout_of

KIND = "dynamixel2_unwatched"  # of its buses
FULL = 1023  # torque limit: all of the torque
FACTORY_P = 32
Gain = Annotated[int, Meta(ge=0, le=32767)]


@dataclass(frozen=True, slots=True)
class UnwatchedGains:
    """Position gains as register counts; None: as the servo has it."""

    p: Gain | None = None
    """0–16383 | as the servo has it | register counts, written before torque"""
    i: Gain | None = None
    """0–16383 | as the servo has it | register counts, written before torque"""
    d: Gain | None = None
    """0–16383 | as the servo has it | register counts, written before torque"""

    def registers(self) -> dict[str, int]:
        """Return the gain registers that the robot file sets."""
        rows = zip("pid", (self.p, self.i, self.d), strict=True)
        return {f"position_{name}_gain": value for name, value in rows if value is not None}


@dataclass(frozen=True, slots=True)
class UnwatchedServoType(UnwatchedType):
    """XL-320 or PRO -R. They have no watchdog: the file must say that it knows (`watchdog: none`)."""

    gains: UnwatchedGains
    torque_limit: int  # of 1023, of what the servo's EEPROM permits; written before torque
    torque_constant_nm_per_a: float  # NaN: effort unknown
    volts: float  # of the supply
    return_delay_us: int

    BUS: ClassVar[str] = KIND

    @property
    def model(self) -> UnwatchedModel:
        """Model by its name."""
        return model(self.device)

    @property
    def layout(self) -> UnwatchedLayout:
        """Registers of the model."""
        return layout_of(self.model.table)

    @property
    def effort_lsb_nm(self) -> float:
        """N·m of one count of current; NaN: the load of an XL-320 is a share of the output, no torque."""
        ampere = self.model.ampere
        return math.nan if ampere is None else self.torque_constant_nm_per_a * ampere

    @property
    def effort_limit_nm(self) -> float:
        """Stall torque at the given supply, within the torque limit."""
        return self.model.strength(self.volts)[0] * self.torque_limit / FULL

    @property
    def full_effort(self) -> float:
        """Load of full output; NaN for a PRO -R: it depends on its EEPROM."""
        return float(FULL) if self.model.ampere is None else math.nan

    @property
    def centre(self) -> int:
        """Middle of its counts."""
        return (self.model.lowest + self.model.highest + 1) // 2

    def operating_mode(self, mode: str) -> int:
        """Return joint mode of an XL-320 (2), position mode of a PRO -R (3): the only driven ones."""
        return kind_of(self.model.table).mode

    def goals(self, mode: str, own: tuple[int, int] | None) -> tuple[int, int]:
        """Range of its position limits, else of its counts."""
        return own if own is not None else (self.model.lowest, self.model.highest)

    def fenced(self, mode: str) -> bool:
        """True: its position limits."""
        return True

    @property
    def stiffness_nm_per_rad(self) -> float:
        """Stall torque and gain give it; NaN for a PRO -R: no page states its law."""
        if self.model.ampere is not None:
            return math.nan
        share = self.p_gain / (FULL * self.model.figures.divisor)  # of the output, for each count of error
        return self.model.strength(self.volts)[0] * share * self.model.turn / math.tau

    @property
    def p_gain(self) -> float:
        """The value of `gains.p`; an XL-320's as from the factory where the file gives none."""
        if self.gains.p is None:
            return math.nan if self.model.ampere is not None else float(FACTORY_P)
        return float(self.gains.p)

    @property
    def lag_s(self) -> float:
        """The gain and the speed without load give it."""
        return lag_of(self.stiffness_nm_per_rad, self.model.strength(self.volts))

    @property
    def gain_limits(self) -> Mapping[str, float]:
        """Names of the gains, as registers hold them."""
        table = self.layout.table
        return {name.split("_")[1]: float(table[name].most) for name in self.layout.gains}

    def with_gains(self, gains: Mapping[str, float]) -> "UnwatchedServoType":
        """Return the type with these gains, in whole counts."""
        return replace(self, gains=UnwatchedGains(**{name: int(number) for name, number in gains.items()}))

    def refuse_registers(self, registers: Mapping[str, int]) -> Iterator[str]:
        """Yield each value outside the bounds of its register."""
        for name, value in registers.items():
            field = self.layout.table[name]
            if field.writable and not field.least <= value <= field.most:
                yield f"registers.{name}: {value} is outside {field.least}..{field.most}"

    def unfit(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[str]:
        """Yield what rules it out: no word on the watchdog, another model or settings."""
        yield from self.unaccepted()
        if device.model_number != self.model.number:
            yield self.other_model(device)
            return
        yield from objections(self.model.table, device.model_number, device.settings)
        yield from self.other_settings(joint, device, self.return_delay_us)
