"""Virtual Feetech servos of one bus: registers, torque, goals, protection, supply, time.

No packets here (`virtual_feetech_bus`), no physics (`muscles`). Where sources disagree on the behaviour of a
servo, `FeetechServoSpec` chooses. Positions of the motor are encoder counts, continuous over turns.
"""

from collections.abc import Sequence
from math import floor, inf
from typing import Any

import numpy as np

from twind_drivers.feetech.feetech_models import AMPERE, FULL, GAIN, STAND_IN, FeetechModel, model
from twind_drivers.feetech.feetech_registers import BAUDS, EPROM_END, GOAL, RegisterMap, register_map
from twind_drivers.feetech.virtual_feetech_spec import DEFAULTS, FIRMWARE, FeetechServoSpec
from twind_drivers.virtual.servo_physics import DriveState, ServoPhysics
from twind_drivers.virtual.servo_strength import DRY, VISCOUS, MotorStrength
from twind_drivers.virtual.shown_position_log import ShownPositionLog

CHECK = 0.01  # s between two checks of the load, the unit of the protection time
CURRENT = 0.00269 / AMPERE  # counts per raw current of the physics
MULTI_TURN = 0x10  # phase bit 4
MIDDLE = 2048
OVERLOAD = 0x20


class VirtualFeetechServos:
    """m servos. Rows are indices of `specs`; time (s) is an argument and never goes back."""

    BOOT = 0.8  # s in the boot loader after each reset

    def __init__(self, specs: Sequence[FeetechServoSpec], muscles: ServoPhysics, *, now: float = 0.0) -> None:
        """Raises InvalidInput for a model that is not known."""
        self.specs = tuple(specs)
        self.models: list[FeetechModel] = [model(spec.model) for spec in specs]
        self.maps: list[RegisterMap] = [register_map(each.map) for each in self.models]
        self.muscles = muscles
        other = model(STAND_IN)
        known = [
            each.at(spec.volts) or other.at(spec.volts) for each, spec in zip(self.models, specs, strict=True)
        ]
        stall, speed = np.array(known, np.float64).reshape(-1, 2).T
        self._motor = MotorStrength(
            stall=stall, speed=speed, friction=DRY * stall, damping=VISCOUS * stall / speed
        )
        self.now = now
        self.history: ShownPositionLog | None = None
        self.hinges = [spec.hinge for spec in specs]
        self.turn = [each.turn for each in self.maps]
        count = len(specs)
        self.silenced = [False] * count
        self.volts = [spec.volts for spec in specs]
        self.celsius = [30.0] * count
        self.injected = [0] * count  # error bits by order
        self.frozen: list[int | None] = [None] * count
        self.boots_at = [inf] * count
        self.heard_at = [now] * count
        self._overloaded = [False] * count
        self._load_since: list[float | None] = [None] * count
        self._shift = [0.0] * count  # encoder counts at register position 0
        self._checked_at = now
        self._redrive = self._retarget = False
        self._blocked = np.zeros(count, np.bool_)
        self._hand = np.full(count, np.nan)
        self._reach = np.zeros(count)
        self.ram = [bytearray(256) for _ in specs]
        self.eprom = [bytearray(EPROM_END) for _ in specs]
        for row in range(count):
            self._make(row)
            self.boot(row)
        self.drive()

    def _make(self, row: int) -> None:
        """Write the factory settings and those of the robot."""
        spec = self.specs[row]
        own = self.maps[row]
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
        if "torque_limit" in self.maps[row]:
            self.put(row, "torque_limit", self.get(row, "max_torque"))
        if "goal_torque" in self.maps[row]:
            self.put(row, "goal_torque", self.get(row, "protection_current"))
        self.boots_at[row] = inf
        self._overloaded[row] = False
        self._load_since[row] = None
        self._settle_turn(row)

    # ------------------------------------------------------------------------------- registers

    def get(self, row: int, name: str) -> int:
        """Return a register's value."""
        field = self.maps[row].registers[name]
        data = self.ram[row]
        if field.size == 1:
            return data[field.address]
        return field.decode(bytes(data[field.address : field.address + 2]))

    def put(self, row: int, name: str, value: int) -> None:
        """Set a register's value, without any effect."""
        field = self.maps[row].registers[name]
        self.ram[row][field.address : field.address + field.size] = field.encode(value)

    def ids(self) -> list[int]:
        """Return the ids in the order of rows."""
        return [each[5] for each in self.ram]

    def baud(self, row: int) -> int:
        """Return the rate of a servo."""
        return BAUDS[min(self.get(row, "baud_rate"), len(BAUDS) - 1)]

    def stand_ins(self) -> dict[str, str]:
        """Return the models without motor figures, and the one whose figures they have."""
        return {each.name: STAND_IN for each in self.models if not each.strength}

    def listening(self, row: int) -> bool:
        """Return True if the servo has power, is plugged in and has booted."""
        return not self.silenced[row] and self.boots_at[row] == inf

    def write(self, row: int, address: int, data: bytes) -> None:
        """Carry out a write: values out of range and read-only registers are ignored without a word."""
        own = self.maps[row]
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

    def settle(self) -> None:
        """Let the motors follow what was written since the last call."""
        if self._redrive:
            self.drive()
        elif self._retarget:
            self._set_goals()
        self._redrive = self._retarget = False

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
        if "homing_offset" in self.maps[row]:
            offset = int(self.muscles.position[row]) % 4096 - to
            offset = min(max((offset + 2048) % 4096 - 2048, -2047), 2047)
            self.put(row, "homing_offset", offset)
            self._settle_turn(row)
            self._redrive = True

    def _offset(self, row: int) -> int:
        return self.get(row, "homing_offset") if "homing_offset" in self.maps[row] else 0

    def has_turns(self, row: int) -> bool:
        """Return True if positions leave one turn."""
        own = self.maps[row]
        phase = "phase" in own and self.get(row, "phase") & MULTI_TURN
        ends = (self.get(row, "min_position_limit"), self.get(row, "max_position_limit"))
        return not own.big_endian and bool(phase or ends == (0, 0))

    def _settle_turn(self, row: int) -> None:
        """Count the encoder's turns anew: the register shows one turn, less the offset."""
        offset = self._offset(row)
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

    # ------------------------------------------------------------------------------- time

    def advance(self, now: float) -> None:
        """Let time pass until `now`: boots end, motors move, overloads trip."""
        while min(self.boots_at) <= now:
            row = int(np.argmin(self.boots_at))
            self._pass(self.boots_at[row])
            self.boot(row)
            self.drive()
        self._pass(now)

    def _pass(self, now: float) -> None:
        if now > self.now:
            self.now = now
            self.muscles.advance(now)
            if now >= self._checked_at + CHECK:
                self._checked_at = now
                self._protect()

    def _protect(self) -> None:
        changed = False
        for row, own in enumerate(self.maps):
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
        bits = self.injected[row] | (OVERLOAD if self._overloaded[row] else 0)
        volts = round(self.volts[row] * 10)
        if not self.get(row, "min_voltage_limit") <= volts <= self.get(row, "max_voltage_limit"):
            bits |= 1
        if self.celsius[row] > self.get(row, "temperature_limit"):
            bits |= 4
        return bits

    def drive(self) -> None:
        """Let the motors follow the registers."""
        rows = range(len(self.maps))
        on = np.array([self.get(row, "torque_enable") == 1 and self.listening_power(row) for row in rows])
        kind = np.array([self._mode(row) for row in rows])
        p = np.array([GAIN * self.get(row, "position_p_gain") * 4096.0 / self.turn[row] for row in rows])
        nothing = np.zeros(len(self.maps))
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

    def _set_goals(self) -> None:
        self.muscles.set_goals(np.array([self._goal(row) for row in range(len(self.maps))], np.float64))

    def listening_power(self, row: int) -> bool:
        """Return True if the servo has power and has booted."""
        return self.boots_at[row] == inf

    def _mode(self, row: int) -> int:
        """Return the mode of the physics: position 3, velocity 1, PWM 16."""
        mode = self.get(row, "operating_mode") if "operating_mode" in self.maps[row] else 0
        return {1: 1, 2: 16}.get(mode, 3)

    def _goal(self, row: int) -> float:
        kind = self._mode(row)
        if kind == 1:
            return self.get(row, "goal_velocity")
        if kind == 16:
            return self.get(row, "goal_time")
        return self.encoder(row, self.get(row, "goal_position"))

    def _cap(self, row: int) -> float:
        own = self.maps[row]
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

    def refresh(self) -> None:
        """Write the present registers."""
        places = [self.shown(row) for row in range(len(self.maps))]
        if self.history is not None:
            self.history.note(self.now, np.array(places))
        for row, own in enumerate(self.maps):
            kept = self.frozen[row]
            self.put(row, "present_position", places[row] if kept is None else kept)
            self.put(row, "present_velocity", round(float(self.muscles.velocity[row])))
            self.put(row, "present_load", round(float(np.clip(self.muscles.pwm[row], -1000, 1000))))
            self.put(row, "present_input_voltage", round(self.volts[row] * 10))
            self.put(row, "present_temperature", round(self.celsius[row]))
            self.put(row, "hardware_error_status", self.error(row))
            self.put(row, "moving", int(abs(float(self.muscles.velocity[row])) > 10))
            if "present_current" in own:
                self.put(row, "present_current", round(float(self.muscles.current[row]) * CURRENT))

    # ------------------------------------------------------------------------------- from outside

    def reset(self, row: int, until: float) -> None:
        """Off the bus, torque lost; back at `until` (s) with RAM defaults."""
        self.boots_at[row] = until
        self.drive()

    def restore_factory(self, row: int) -> None:
        """Write the factory settings to EPROM; the id stays."""
        id = self.ram[row][5]
        self._make(row)
        self.ram[row][5] = self.eprom[row][5] = id
        self.drive()

    def block(self, row: int, on: bool) -> None:
        """Hold this shaft fast, or release it."""
        self._blocked[row] = on
        self.muscles.block(self._blocked)

    def set_hand_position(self, row: int, place: float, speed: float) -> None:
        """Move a limp shaft by hand to `place` (encoder counts; NaN: release it), counts/s."""
        self._hand[row] = place
        self._reach[row] = speed
        self.muscles.set_hand_positions(self._hand, self._reach)

    def truth(self, now: float) -> list[dict[str, object]]:
        """Return the true state of each servo, with the same keys as that of other families."""
        self.advance(now)
        rows: list[dict[str, Any]] = []
        for row, id in enumerate(self.ids()):
            rows.append(
                {
                    "id": id,
                    "position": float(self.muscles.position[row]) - self._shift[row],
                    "encoder": float(self.muscles.position[row]),
                    "velocity": float(self.muscles.velocity[row]),
                    "goal": self.get(row, "goal_position"),
                    "torque": self.get(row, "torque_enable") == 1 and self.listening_power(row),
                    "watchdog": -1,
                    "tripped": False,
                    "listening": self.listening(row),
                    "heard_ago": now - self.heard_at[row],
                    "tripped_at": None,
                    "trip_delay": None,
                }
            )
        return rows
