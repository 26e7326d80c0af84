"""Motor commands from the registers: gains, caps and goals of each operating mode.

Sources: e-manual, "Goal PWM" (a cap in every mode but 16, where it is the goal), "Goal Current" (a cap in
mode 5, the goal in mode 0), "Goal Velocity"; the limit registers 36, 38 and 44 bound them all.
"""

from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind_drivers.dynamixel.dynamixel_models import X_SPEED
from twind_drivers.virtual.mode_units import (
    CURRENT,
    CURRENT_POSITION,
    POSITION,
    PWM,
    VELOCITY,
    seeks_position,
)
from twind_drivers.virtual.register_columns import RegisterColumns
from twind_drivers.virtual.register_memory import RegisterMemory
from twind_drivers.virtual.servo_physics import DriveState
from twind_drivers.virtual.servo_strength import MotorStrength

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[Any]
# bits of the drive mode
REVERSE = 1
SLAVE = 2
TIMED = 4
TORQUE_BY_GOAL = 8
GAINS = ("position_p_gain", "position_i_gain", "position_d_gain", "velocity_p_gain", "velocity_i_gain")
BOUNDS = ("temperature_limit", "min_voltage_limit", "max_voltage_limit")
WANTED = {CURRENT: "current", VELOCITY: "velocity", PWM: "pwm"}


class DriveFirmware:
    """Motor commands of m servos, as of the latest `changed`. Arrays (m,)."""

    def __init__(self, memory: RegisterMemory, registers: RegisterColumns) -> None:
        self._registers = registers
        self._capped = np.array(["current_limit" in each for each in memory.tables])
        wide = [each["goal_position"].bounds for each in memory.tables]
        self._widest = np.array(wide, np.int64).reshape(-1, 2).T  # ticks, where no limit register counts
        facts = [each.facts for each in memory.tables]
        self._always_capped = np.array([each.caps_current for each in facts])  # by goal current
        self.full = np.array([float(each["pwm_limit"].bounds[1]) for each in memory.tables])
        self.turn = np.array([float(each.counts_per_turn or 4096) for each in facts])
        self.rpm = np.array([(each.radians_per_velocity_count or X_SPEED) * 30.0 / np.pi for each in facts])
        # e-manual, "Drive Mode": there the reverse bit inverts velocity, current and PWM too
        self._inverts = np.array([each.stem.startswith("mx") or "540" in each.stem for each in memory.tables])
        self.reload_registers()

    def reload_registers(self) -> None:
        """Read the registers anew."""
        registers = self._registers
        modes = self._registers["drive_mode"]
        self.mode = registers["operating_mode"].astype(np.int64)
        self.on = registers["torque_enable"] != 0
        limited = self.mode == POSITION  # e-manual, "Min/Max Position Limit": in mode 3 only
        self.lower = np.where(limited, registers["min_position_limit"], self._widest[0]).astype(np.int64)
        self.upper = np.where(limited, registers["max_position_limit"], self._widest[1]).astype(np.int64)
        self.seeks = seeks_position(self.mode)
        self.mixed = bool(np.count_nonzero(self.seeks) < len(self.seeks))
        self.spins = self.mode == VELOCITY
        self.timed = (modes & TIMED) != 0
        self.way = np.where(self._inverts & ((modes & REVERSE) != 0), -1.0, 1.0)

    def bounds(self) -> tuple[Floats, Floats, Floats]:
        """Highest temperature (°C), lowest and highest voltage (V): registers 31, 34 and 32."""
        hottest, lowest, highest = (self._registers[key].astype(np.float64) for key in BOUNDS)
        return hottest, lowest / 10.0, highest / 10.0

    def shape(self) -> tuple[Ints, Ints, Bools, Bools]:
        """Return profile velocity and acceleration (112, 108), servos with times in ms and with velocity
        goals.

        112 counts in the position modes only (e-manual, "Profile Velocity"): current and PWM have no profile.
        """
        velocity = np.where(self.seeks, self._registers["profile_velocity"], 0)
        return velocity, self._registers["profile_acceleration"], self.timed, self.spins

    def drive(self, supply: Floats, ampere: Floats, motor: MotorStrength) -> DriveState:
        """Return the drive of each motor. `supply` (m,): share of the nominal voltage; `ampere`: per count.

        A slave follows only its master's cable (e-manual, "Dual Mode"), which is not simulated: it has no
        drive.
        """
        registers = self._registers
        gains = {key: registers[key].astype(np.float64) for key in GAINS}
        most = registers["pwm_limit"].astype(np.float64)
        goal_pwm = np.abs(registers["goal_pwm"].astype(np.float64))
        # In the other modes nothing limits the current: an XL330 at its limit register kept full output.
        capped = (self.mode == CURRENT_POSITION) | (self._always_capped & (self.mode != CURRENT))
        limited = self._capped & ((self.mode == CURRENT) | capped)
        current = np.where(limited, registers["current_limit"], inf)
        goal_current = np.abs(registers["goal_current"].astype(np.float64))
        return DriveState(
            on=self.on & ((registers["drive_mode"] & SLAVE) == 0),
            mode=self.mode,
            p=gains["position_p_gain"],
            i=gains["position_i_gain"],
            d=gains["position_d_gain"],
            velocity_p=gains["velocity_p_gain"],
            velocity_i=gains["velocity_i_gain"],
            pwm_cap=np.where(self.mode == PWM, most, np.minimum(most, goal_pwm)),
            current_cap=np.where(capped, np.minimum(current, goal_current), current),
            supply=supply,
            full=self.full,
            turn=self.turn,
            rpm=self.rpm,
            ampere=ampere,
            motor=motor,
        )

    def goals(self, position: Floats) -> Floats:
        """Return `position` in position modes, else raw current, velocity or PWM inside its limit."""
        registers = self._registers
        bounds = {mode: registers[f"{key}_limit"].astype(np.float64) for mode, key in WANTED.items()}
        goals = [
            np.clip(registers[f"goal_{key}"], -bounds[mode], bounds[mode]) for mode, key in WANTED.items()
        ]
        wanted = [self.mode == mode for mode in WANTED]
        return np.select(wanted, [goal * self.way for goal in goals], position)
