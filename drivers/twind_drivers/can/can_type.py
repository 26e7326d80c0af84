"""Device type of CAN actuators: properties and capabilities of an entry of `types`."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from twind.config.actuator_types import ExpectedDevice, TypeSpec
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.can.can_units import COUNT, EFFORT

KIND = "can"  # of its buses
IMPEDANCE: Final = (
    "impedance"  # torque = kp (goal - position) - kd velocity: how every CAN family here is driven
)
NO_EFFORT = ("odrive",)  # families that report a current and no torque
TAKES_COMMANDS = 1  # operating mode that a CAN bus reports for an actuator that takes these commands
# setting of a CAN device, its range in thousandths -> key of the robot file, unit
RANGES = {
    "pmax_milli": ("position_rad", "rad"),
    "vmax_milli": ("velocity_rad_s", "rad/s"),
    "tmax_milli": ("torque_nm", "N·m"),
}
SAME_RANGE = 1  # thousandths: how far a range may be off by rounding
REPORTS_RANGES = ("damiao",)  # families whose registers hold the ranges


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

    BUS: ClassVar[str] = KIND

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
    def stiffness_nm_per_rad(self) -> float:
        """The value of `gains.kp`."""
        return self.gains.kp

    @property
    def p_gain(self) -> float:
        """The value of `gains.kp`."""
        return self.gains.kp

    @property
    def lag_s(self) -> float:
        """`kd`/`kp`: damping acts against a goal velocity of 0; NaN for a joint without stiffness."""
        return self.gains.kd / self.gains.kp if self.gains.kp > 0.0 else math.nan

    @property
    def watched(self) -> bool:
        """True if the file arms its watchdog."""
        return self.watchdog == "device"

    @property
    def gain_limits(self) -> Mapping[str, float]:
        """Stiffness and damping; the field of its frames is the bound, which the file was checked against."""
        return dict.fromkeys(("kp", "kd"), math.inf)

    def with_gains(self, gains: Mapping[str, float]) -> "CanType":
        """Return the type with that stiffness and damping."""
        return replace(self, gains=Impedance(**gains))

    def unfit(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[str]:
        """Yield the reasons why a CAN actuator is unusable for a joint of this type.

        Many cannot report their model; their ranges are compared instead. A wrong range is a wrong position.
        """
        if device.model_name is not None and device.model_name != self.device:
            number = f"model number {device.model_number}"
            yield f"is {device.model_name} ({number}), the robot file says {self.device}"
        mode = device.settings.get("operating_mode")
        if mode != TAKES_COMMANDS:
            yield (
                f"its operating mode is {mode}: it does not take the commands of the {self.family} family; "
                "set that mode by the vendor's tool, or by its register with torque off"
            )
        for setting, (key, unit) in RANGES.items():
            value = device.settings.get(setting)
            described = getattr(self.ranges, key)
            if value is None and self.family in REPORTS_RANGES:
                yield (
                    f"the range of its {key} was not read, so the scale of its readings is not known: its "
                    "answers were lost, or its register holds no number"
                )
            elif value is not None and abs(value - round(1e3 * described)) > SAME_RANGE:
                yield (
                    f"its frames span {value / 1e3:g} {unit}, the robot file says {described:g}: "
                    f"a wrong range is a wrong reading; correct ranges.{key} of type {self.name}, "
                    "or the register of the device"
                )
