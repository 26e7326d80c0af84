"""Virtual Feetech servos of one bus: registers, torque, goals, protection, supply, time.

No packets here (`virtual_feetech_bus`), no physics (`muscles`). Where sources disagree on the behaviour of a
servo, `FeetechServoSpec` chooses.
"""

from collections.abc import Sequence
from math import floor, inf

import numpy as np

from twind_drivers.feetech.feetech_models import AMPERE, FULL, GAIN, STAND_IN, FeetechModel, model
from twind_drivers.feetech.feetech_registers import BAUDS, EPROM_END, GOAL, RegisterMap, register_map
from twind_drivers.feetech.virtual_feetech_spec import DEFAULTS, FIRMWARE, FeetechServoSpec
from twind_drivers.virtual.servo_physics import DriveState, ServoPhysics
from twind_drivers.virtual.servo_strength import DRY, VISCOUS, MotorStrength
from twind_drivers.virtual.virtual_table_servos import VirtualTableServos

CURRENT = 0.00269 / AMPERE  # counts per raw current of the physics
MULTI_TURN = 0x10  # phase bit 4
MIDDLE = 2048


class VirtualFeetechServos(VirtualTableServos):
    """m servos. Rows are indices of `specs`; time (s) is an argument and never goes back."""

    tables: Sequence[RegisterMap]
    BOOT = 0.8  # s in the boot loader after each reset

    def __init__(self, specs: Sequence[FeetechServoSpec], muscles: ServoPhysics, *, now: float = 0.0) -> None:
        """Raises InvalidInput for a model that is not known."""
        self.specs = tuple(specs)
        self.models: list[FeetechModel] = [model(spec.model) for spec in specs]
        maps = [register_map(each.map) for each in self.models]
        super().__init__(
            maps,
            [each.turn for each in maps],
            [spec.hinge for spec in specs],
            [spec.volts for spec in specs],
            muscles,
            size=256,
            now=now,
        )
        other = model(STAND_IN)
        known = [
            each.at(spec.volts) or other.at(spec.volts) for each, spec in zip(self.models, specs, strict=True)
        ]
        stall, speed = np.array(known, np.float64).reshape(-1, 2).T
        self._motor = MotorStrength(
            stall=stall, speed=speed, friction=DRY * stall, damping=VISCOUS * stall / speed
        )
        count = len(specs)
        self._overloaded = [False] * count
        self._load_since: list[float | None] = [None] * count
        self.eprom = [bytearray(EPROM_END) for _ in specs]
        for row in range(count):
            self._make(row)
            self.boot(row)
        self.drive()

    def _make(self, row: int) -> None:
        """Write the factory settings and those of the robot."""
        spec = self.specs[row]
        own = self.tables[row]
        major, minor, end = spec.firmware or FIRMWARE[own.name]
        scs = {"max_position_limit": 1023} if own.big_endian else {}
        identity = {"firmware_major": major, "firmware_minor": minor, "end": end, "id": spec.id}
        identity["model_number"] = self.models[row].number
        for name, value in (DEFAULTS | scs | identity | dict(spec.settings)).items():
            if name in own:
                self.put(row, name, value)
        self.eprom[row][:] = self.ram[row][:EPROM_END]

    def boot(self, row: int) -> None:
        """Power-up: EPROM to RAM, everything else default."""
        spec = self.specs[row]
        self.ram[row][:] = bytes(256)
        self.ram[row][:EPROM_END] = self.eprom[row]
        self.put(row, "lock", 1)
        self.put(row, "torque_enable", int(spec.boots_armed))
        if "torque_limit" in self.tables[row]:
            self.put(row, "torque_limit", self.get(row, "max_torque"))
        if "goal_torque" in self.tables[row]:
            self.put(row, "goal_torque", self.get(row, "protection_current"))
        self.boots_at[row] = inf
        self._overloaded[row] = False
        self._load_since[row] = None
        self._settle_turn(row)

    # ------------------------------------------------------------------------------- registers

    def baud(self, row: int) -> int:
        """Return the rate of a servo."""
        return BAUDS[min(self.get(row, "baud_rate"), len(BAUDS) - 1)]

    def stand_ins(self) -> dict[str, str]:
        """Return the models without motor figures, and the one whose figures they have."""
        return {each.name: STAND_IN for each in self.models if not each.strength}

    def write(self, row: int, address: int, data: bytes) -> None:
        """Carry out a write: values out of range and read-only registers are ignored without a word."""
        own = self.tables[row]
        stored = not self.get(row, "lock")
        known = {each.address: each for each in own.registers.values()}
        place = 0
        while place < len(data):
            field = known.get(address + place)
            size = field.size if field and place + field.size <= len(data) else 1
            raw = data[place : place + size]
            at = address + place
            place += size
            if field is not None and field.size == size:
                value = field.decode(raw)
                if not field.writable or not field.least <= value <= field.most:
                    continue
                if not self._effect(row, field.name, value):
                    continue
            if at == GOAL[0]:
                self._retarget = True
            else:
                self._redrive = True
            self.ram[row][at : at + size] = raw
            if stored and at < EPROM_END:
                self.eprom[row][at : at + size] = raw

    def _effect(self, row: int, name: str, value: int) -> bool:
        """Carry out what a write causes beside the register; return False where that does not change."""
        if name == "torque_enable":
            if value == 128:
                self.calibrate(row, MIDDLE)
                self._redrive = True
                return False
            if value == 0 and not self.specs[row].latches:
                self._overloaded[row] = False
            self._settle_turn(row)
        elif name == "goal_position" and self._mode(row) == 3:
            least, most = self.get(row, "min_position_limit"), self.get(row, "max_position_limit")
            if (least, most) != (0, 0) and not least <= value <= most:
                return False
            if self.specs[row].goal_arms:
                self.put(row, "torque_enable", 1)
                self._redrive = True
        return True

    def calibrate(self, row: int, to: int) -> None:
        """Set the offset so that the present position becomes `to`."""
        if "homing_offset" in self.tables[row]:
            offset = int(self.muscles.position[row]) % 4096 - to
            offset = min(max((offset + 2048) % 4096 - 2048, -2047), 2047)
            self.put(row, "homing_offset", offset)
            self._settle_turn(row)
            self._redrive = True

    def has_turns(self, row: int) -> bool:
        """Return True if positions leave one turn."""
        phase = self.get(row, "phase") & MULTI_TURN
        ends = (self.get(row, "min_position_limit"), self.get(row, "max_position_limit"))
        return not self.tables[row].big_endian and bool(phase or ends == (0, 0))

    def _settle_turn(self, row: int) -> None:
        """Count the encoder's turns anew: the register shows one turn, less the offset."""
        offset = self.get(row, "homing_offset")
        turn = self.turn[row]
        self._shift[row] = offset + turn * floor((self.muscles.position[row] - offset) / turn)

    def encoder(self, row: int, count: float) -> float:
        """Return the encoder count at which the position register shows `count`."""
        return self._shift[row] + count

    def shown(self, row: int) -> int:
        """Return the count that the position register shows."""
        if not self.has_turns(row):
            on = self.get(row, "torque_enable")
            place = float(self.muscles.position[row])
            if not on or not -64 <= place - self._shift[row] < self.turn[row] + 64:
                self._settle_turn(row)
        return round(float(self.muscles.position[row]) - self._shift[row])

    # ------------------------------------------------------------------------------- motors

    def _protect(self) -> None:
        changed = False
        for row, own in enumerate(self.tables):
            if "overload_torque" not in own:
                continue
            over = abs(float(self.muscles.pwm[row])) >= 10.0 * self.get(row, "overload_torque")
            since = self._load_since[row]
            self._load_since[row] = (self.now if since is None else since) if over else None
            late = since is not None and self.now - since >= 0.01 * self.get(row, "protection_time")
            if over and late and not self._overloaded[row]:
                self._overloaded[row] = changed = True
        if changed:
            self.drive()

    def error(self, row: int) -> int:
        """Return the error byte: the state now."""
        return super().error(row) | (self.OVERLOAD if self._overloaded[row] else 0)

    def drive(self) -> None:
        """Let the motors follow the registers."""
        rows = range(len(self.tables))
        on = np.array([self.get(row, "torque_enable") == 1 and self.is_powered(row) for row in rows])
        kind = np.array([self._mode(row) for row in rows])
        p = np.array([GAIN * self.get(row, "position_p_gain") * 4096.0 / self.turn[row] for row in rows])
        nothing = np.zeros(len(self.tables))
        cap = np.array([self._cap(row) for row in rows])
        turn = np.array(self.turn)
        supply = np.array([self._supply(row) for row in rows])
        speed = nothing + 100.0
        self.muscles.drive(
            DriveState(
                on,
                kind,
                p,
                nothing,
                nothing,
                speed,
                nothing + 1920.0,
                cap,
                nothing + inf,
                supply,
                FULL,
                turn,
                60.0 / turn,
                motor=self._motor,
            )
        )
        self._set_goals()

    def _mode(self, row: int) -> int:
        """Return the mode of the physics: position 3, velocity 1, PWM 16."""
        mode = self.get(row, "operating_mode")
        return {1: 1, 2: 16}.get(mode, 3)

    def _goal(self, row: int) -> float:
        kind = self._mode(row)
        if kind == 1:
            return self.get(row, "goal_velocity")
        if kind == 16:
            return self.get(row, "goal_time")
        return self.encoder(row, self.get(row, "goal_position"))

    def _cap(self, row: int) -> float:
        own = self.tables[row]
        if self._overloaded[row]:
            return 10.0 * self.get(row, "protective_torque")
        phase = self.get(row, "phase") if "phase" in own else 8
        stands = own.name == "hls" and not self.get(row, "goal_torque")
        stands |= not phase & 8 and self._mode(row) == 3 and self.get(row, "goal_velocity") == 0
        limit = self.get(row, "torque_limit" if "torque_limit" in own else "max_torque")
        return 0.0 if stands else float(limit)

    def _supply(self, row: int) -> float:
        """Return the share of the nominal voltage, at which the physics has the model's strength."""
        return self.volts[row] / self.specs[row].volts

    def _drives(self, row: int) -> bool:
        return self.get(row, "torque_enable") == 1

    def _show_motion(self, row: int, velocity: float) -> None:
        self.show(row, "present_velocity", round(velocity))
        self.show(row, "present_load", round(float(np.clip(self.muscles.pwm[row], -1000, 1000))))
        self.put(row, "hardware_error_status", self.error(row))
        self.put(row, "moving", int(abs(velocity) > 10))
        if "present_current" in self.tables[row]:
            self.show(row, "present_current", round(float(self.muscles.current[row]) * CURRENT))

    def restore_factory(self, row: int) -> None:
        """Write the factory settings to EPROM; the id stays."""
        id = self.ram[row][5]
        self._make(row)
        self.ram[row][5] = self.eprom[row][5] = id
        self.drive()
