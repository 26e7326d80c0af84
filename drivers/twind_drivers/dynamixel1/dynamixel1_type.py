"""Device type of Protocol 1.0: properties and capabilities of an entry of `types`."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

from msgspec import Meta

from twind.config.actuator_types import ExpectedDevice, lag_of
from twind.config.unwatched_type import UnwatchedType
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel1.dynamixel1_identification import objections
from twind_drivers.dynamixel1.dynamixel1_models import Dynamixel1Model, model, share_per_radian
from twind_drivers.dynamixel1.dynamixel1_registers import table_of
from twind_drivers.half_duplex.register_table import RegisterTable

KIND = "dynamixel1"  # of its buses
POSITION = "position"
FACTORY_GAIN = 32  # registers 28 and 29: P of an MX, compliance slope of the others
FULL = 1023  # torque limit: all of the torque
Gain = Annotated[int, Meta(ge=0, le=254)]


@dataclass(frozen=True, slots=True)
class Dynamixel1Gains:
    """Position gains as register counts; None: as the servo has it."""

    p: Gain | None = None
    """0–16383; Feetech, Dynamixel 1.0: 0–254 | factory gains; those: as the servo has it | register counts,
    written before torque"""
    i: Gain | None = None
    """0–16383; Feetech, Dynamixel 1.0: 0–254 | factory gains; those: as the servo has it | register counts,
    written before torque"""
    d: Gain | None = None
    """0–16383; Feetech, Dynamixel 1.0: 0–254 | factory gains; those: as the servo has it | register counts,
    written before torque"""
    slope: Annotated[int, Meta(ge=1, le=254)] | None = None
    """1–254 | as the servo has it | AX, RX, EX: compliance slope, registers 28 and 29; larger is softer"""


@dataclass(frozen=True, slots=True)
class Dynamixel1Type(UnwatchedType):
    """Servos of Protocol 1.0. They have no watchdog: the file must say that it knows (`watchdog: none`)."""

    gains: Dynamixel1Gains
    torque_limit: int  # of 1023, written before torque
    volts: float  # of the supply
    return_delay_us: int

    BUS: ClassVar[str] = KIND

    @property
    def model(self) -> Dynamixel1Model:
        """Model by its name."""
        return model(self.device)

    @property
    def table(self) -> RegisterTable:
        """Registers of the model."""
        return table_of(self.model)

    @property
    def effort_lsb_nm(self) -> float:
        """NaN: the load is a share of the output, no torque."""
        return math.nan

    @property
    def effort_limit_nm(self) -> float:
        """Stall torque at the given supply, within the torque limit; NaN: no page gives it."""
        return self.strength[0] * self.torque_limit / FULL

    @property
    def strength(self) -> tuple[float, float]:
        """Stall torque (N·m) and speed without load (rad/s) at the given supply; NaN: no page gives them."""
        return self.model.strength(self.volts) or (math.nan, math.nan)

    @property
    def full_effort(self) -> float:
        """Load of full output."""
        return float(FULL)

    @property
    def centre(self) -> int:
        """Middle of its counts."""
        return self.model.counts // 2

    def operating_mode(self, mode: str) -> int:
        """Return 0 (joint mode): the only one that is driven."""
        return 0

    def goals(self, mode: str, own: tuple[int, int] | None) -> tuple[int, int]:
        """Range of its angle limits, else of its counts."""
        return own if own is not None and own != (0, 0) else (0, self.model.counts - 1)

    def fenced(self, mode: str) -> bool:
        """True: registers 6 and 8."""
        return True

    @property
    def stiffness_nm_per_rad(self) -> float:
        """Stall torque and gain give it; the gain as from the factory where the file gives none."""
        given = self.gains.p if self.model.bulk_read else self.gains.slope
        return self.strength[0] * share_per_radian(self.model, FACTORY_GAIN if given is None else given)

    @property
    def p_gain(self) -> float:
        """The value of `gains.p`; of an AX, RX or EX the inverse of its slope."""
        given = self.gains.p if self.model.bulk_read else self.gains.slope
        known = float(FACTORY_GAIN if given is None else given)
        return known if self.model.bulk_read else 1.0 / known

    @property
    def lag_s(self) -> float:
        """The gain and the speed without load give it."""
        return lag_of(self.stiffness_nm_per_rad, self.strength)

    @property
    def gain_limits(self) -> Mapping[str, float]:
        """Names of the gains, as registers hold them."""
        names = ("p", "i", "d") if self.model.bulk_read else ("slope",)
        return dict.fromkeys(names, 254.0)

    def with_gains(self, gains: Mapping[str, float]) -> "Dynamixel1Type":
        """Return the type with these gains, in whole counts."""
        return replace(self, gains=Dynamixel1Gains(**{name: int(number) for name, number in gains.items()}))

    def unfit(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[str]:
        """Yield what rules it out: no word on the watchdog, another model, firmware or settings."""
        yield from self.unaccepted()
        if device.model_number != self.model.number:
            yield self.other_model(device)
        yield from objections(device.model_number, device.settings)
        yield from self.other_settings(joint, device, self.return_delay_us)
