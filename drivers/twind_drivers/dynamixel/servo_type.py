"""Device type of serial servos: properties and capabilities of an entry of `types`, by the model's facts."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

from msgspec import Meta

from twind.config.actuator_types import DeviceWarning, ExpectedDevice, TypeSpec, lag_of
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel import servo_check
from twind_drivers.dynamixel.control_tables import ControlTable, number_of, table
from twind_drivers.dynamixel.dynamixel_models import ModelCapabilities
from twind_drivers.dynamixel.servo_limits import full_counts
from twind_drivers.virtual.dynamixel_motor_figures import motor_figures, stand_in

KIND = "dynamixel2"  # of its buses
# Name in the robot file -> value of the servo's register 11 (e-manual, "Operating Mode").
OPERATING_MODES: Mapping[str, int] = {
    "position": 3,
    "extended_position": 4,
    "current_based_position": 5,
}
MANY_TURNS = 1_048_575  # ticks: goals of the modes without position limits (e-manual, "Goal Position")
Gain = Annotated[int, Meta(ge=0, le=2**31 - 1)]  # the model bounds it further


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

    BUS: ClassVar[str] = KIND

    @property
    def _table(self) -> ControlTable:
        return table(number_of(self.device))

    @property
    def _facts(self) -> ModelCapabilities:
        return self._table.facts

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
        known = self._facts.centre
        return self.ticks_per_turn // 2 if known is None else known

    def refuse_registers(self, registers: Mapping[str, int]) -> Iterator[str]:
        """Yield each value outside the bounds of its register in the control table."""
        known = self._table
        for key, value in registers.items():
            if not known[key].takes(value):
                low, high = known[key].bounds
                yield f"registers.{key}: {value} is outside {low}..{high}, so no servo can hold it"

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

    @property
    def winds(self) -> bool:
        """True: modes beside `position` count turns in RAM. False for a Y: a battery keeps its turns."""
        return not self._facts.keeps_turns

    @property
    def finds_endstops(self) -> bool:
        """True: it has the mode in which its current is capped (register 11, value 5)."""
        return 5 in self._facts.modes

    @property
    def full_current_a(self) -> float:
        """The value of `current_limit_a`."""
        return self.current_limit_a

    @property
    def stiffness_nm_per_rad(self) -> float:
        """Stall torque and P gain give it; NaN for a model whose page prints no stall torque."""
        known = self._table
        counts_per_rad = self.ticks_per_turn / math.tau
        output = counts_per_rad / motor_figures(known).divisor / known["pwm_limit"].bounds[1]
        return self._strength[0] * output * self.gains.p

    @property
    def p_gain(self) -> float:
        """The value of `gains.p`."""
        return float(self.gains.p)

    @property
    def lag_s(self) -> float:
        """The gain and the speed without load give it."""
        return lag_of(self.stiffness_nm_per_rad, self._strength)

    @property
    def _strength(self) -> tuple[float, float]:
        """Stall torque (N·m) and speed without load (rad/s) at the usual supply; NaN: not known."""
        known = self._table
        figures = motor_figures(known)
        return (math.nan, math.nan) if stand_in(known) is not None else figures.at(figures.nominal)[:2]

    def own_current_limit(self, device: IdentifiedDevice) -> int | None:
        """Value of register 38."""
        return device.settings.get("current_limit")

    @property
    def homing_offset_limit(self) -> int | None:
        """Position mode ignores a larger one (e-manual, address 20)."""
        return self._facts.offset_limit

    @property
    def lost_turn_remedy(self) -> str:
        """Its homing offset moves the end of the turn that position mode covers (e-manual, address 20)."""
        return "set homing_offset (20) to 0 and calibrate"

    @property
    def gain_limits(self) -> Mapping[str, float]:
        """P, I and D, as registers hold them."""
        known = self._table
        return {key: float(known[f"position_{key}_gain"].bounds[1]) for key in ("p", "i", "d")}

    def with_gains(self, gains: Mapping[str, float]) -> "ServoType":
        """Return the type with these gains, in whole counts."""
        return replace(self, gains=GainSettings(**{name: int(number) for name, number in gains.items()}))

    def unfit(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[str]:
        """Yield what its registers rule out."""
        return servo_check.unfit(joint, device, self._table)

    def doubts(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[DeviceWarning]:
        """Yield warnings about its registers."""
        return servo_check.doubts(joint, device, self._table, self.return_delay_us)
