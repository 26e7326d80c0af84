"""Virtual servos of Protocol 1.0 on one bus: registers, torque, goals, alarms, supply, time.

No packets here (`virtual_dynamixel1_bus`), no physics (`muscles`).
"""

from collections.abc import Mapping, Sequence
from math import inf
from typing import Any

import numpy as np

from twind_drivers.dynamixel1.dynamixel1_identification import LAST
from twind_drivers.dynamixel1.dynamixel1_models import DIVISOR, STAND_IN, model
from twind_drivers.dynamixel1.dynamixel1_packet import ANGLE_LIMIT, RANGE
from twind_drivers.dynamixel1.dynamixel1_registers import EEPROM_END, baud_of, table_of
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import (
    FIRMWARE,
    RAM,
    Dynamixel1ServoSpec,
    factory_settings,
)
from twind_drivers.half_duplex.register_table import MappedRegister, RegisterTable
from twind_drivers.virtual.servo_physics import DriveState, ServoPhysics
from twind_drivers.virtual.servo_strength import Motors
from twind_drivers.virtual.virtual_table_servos import VirtualTableServos

FULL = 1023
PATIENCE = 2.0  # s of full output after which an overload trips (assumed: no page gives it)
ENDS = {"ax": 50, "ex": 58, "mx": 74, "mx_current": 74}  # first address behind the table


class VirtualDynamixel1Servos(VirtualTableServos):
    """m servos. Rows are indices of `specs`; time (s) is an argument and never goes back."""

    BOOT = 0.3  # s from power-up to the first reply (assumed)
    KEPT_END = EEPROM_END  # the first RAM register
    SIZE = 128  # bytes of the table, at least
    RAM: Mapping[str, int] = RAM  # defaults
    # Results of a write: unknown or read-only register; value out of range; goal outside the limits.
    UNKNOWN, OUTSIDE, BEYOND = RANGE, RANGE, ANGLE_LIMIT

    def __init__(self, specs: Sequence[Dynamixel1ServoSpec], muscles: ServoPhysics, *, now: float) -> None:
        """Raises InvalidInput for a model that is not known."""
        self.specs = tuple(specs)
        self.models = [self._find_model(spec.model) for spec in specs]
        super().__init__(
            [self._find_table(each) for each in self.models],
            [each.turn for each in self.models],
            [spec.hinge for spec in specs],
            [spec.volts or own.volts for spec, own in zip(specs, self.models, strict=True)],
            muscles,
            size=self.SIZE,
            now=now,
        )
        count = len(specs)
        self._nominal = np.array(self.volts)
        other = model(STAND_IN).figures
        assert other is not None
        self._motors = Motors([each.figures or other for each in self.models], self._nominal)
        self._full_since: list[float | None] = [None] * count  # s, of full output
        self.eeprom = [bytes(self.KEPT_END)] * count
        for row in range(count):
            self.restore_factory(row, settings=True)
        self.drive()

    def restore_factory(self, row: int, *, settings: bool = False) -> None:
        """Write the factory settings, id 1; with `settings` those of the spec, and its id."""
        spec = self.specs[row]
        values = {**self._factory(row), "model_number": self.models[row].number, "id": 1}
        if settings:
            values.update({**spec.settings, "id": spec.id})
        for name, value in values.items():
            if name in self.tables[row]:
                self.put(row, name, value)
        self.eeprom[row] = bytes(self.ram[row][: self.KEPT_END])
        self.boot(row)

    def boot(self, row: int) -> None:
        """Power-up: EEPROM to RAM, everything else default; the goal is the present position."""
        self.ram[row][:] = bytes(self.SIZE)
        self.ram[row][: self.KEPT_END] = self.eeprom[row]
        for name, value in self.RAM.items():
            if name in self.tables[row] and not self.tables[row][name].kept:
                self.put(row, name, value)
        if "max_torque" in self.tables[row]:
            self.put(row, "torque_limit", self.get(row, "max_torque"))
        self.put(row, "goal_position", self.shown(row))
        self.boots_at[row] = inf
        self._full_since[row] = None

    # ------------------------------------------------------------------------------- registers

    def baud(self, row: int) -> int:
        """Return the rate that register 4 stands for."""
        return baud_of(self.ram[row][4])

    def read(self, row: int, address: int, size: int) -> bytes | None:
        """Return a block; None: it leaves the table."""
        end = self._end(row)
        return bytes(self.ram[row][address : address + size]) if address + size <= end else None

    def write(self, row: int, address: int, data: bytes) -> int:
        """Carry out a write; return the error bits. A write that has any changes nothing."""
        known = {each.address: each for each in self.tables[row].registers.values()}
        changes: list[tuple[MappedRegister, int]] = []
        place = 0
        while place < len(data):
            field = known.get(address + place)
            if field is None or not field.writable or place + field.size > len(data):
                return self.UNKNOWN
            value = field.decode(data[place:])
            place += field.size
            changes.append((field, value))
            if self._is_locked(row, field, value):
                return self.UNKNOWN
            if not field.least <= value <= field.most:
                return self.OUTSIDE
            if field.name == "goal_position" and not self._is_within(row, value):
                return self.BEYOND
        for field, value in changes:
            self._store(row, field, value)
        return 0

    def _is_locked(self, row: int, field: MappedRegister, value: int) -> bool:
        """Return True for EEPROM behind its lock, and for the lock, which opens at power-up only."""
        return (field.kept and bool(self.get(row, "lock"))) or (field.name == "lock" and not value)

    def _is_within(self, row: int, goal: int) -> bool:
        """Return True for a goal within the angle limits; in wheel and multi-turn mode they are none."""
        ends = (self.get(row, "min_position_limit"), self.get(row, "max_position_limit"))
        return ends in ((0, 0), (LAST, LAST)) or ends[0] <= goal <= ends[1]

    def _store(self, row: int, field: MappedRegister, value: int) -> None:
        self.put(row, field.name, value)
        if field.kept:
            self.eeprom[row] = bytes(self.ram[row][: self.KEPT_END])
        if field.name == "goal_position":
            self._retarget = True
            if self.specs[row].goal_arms and not self.get(row, "torque_enable"):
                self.put(row, "torque_enable", 1)
                self._redrive = True
        else:
            self._redrive = True

    def encoder(self, row: int, count: float) -> float:
        """Return the place of the shaft at which the position register shows `count`."""
        turn: float = self.turn[row]
        return count + turn * (float(self.muscles.position[row]) // turn)

    def shown(self, row: int) -> int:
        """Return the count that the position register shows: one turn, at most the largest count."""
        count: int = round(float(self.muscles.position[row])) % round(self.turn[row])
        last: int = self.models[row].counts - 1
        return min(count, last)

    # ------------------------------------------------------------------------------- motors

    def _protect(self) -> None:
        """Unload each servo whose alarm is in its shutdown mask."""
        changed = False
        for row in range(len(self.specs)):
            full = self._cap(row)
            at_limit = 0 < full <= abs(float(self.muscles.pwm[row])) + 1.0
            since = self._full_since[row]
            self._full_since[row] = (self.now if since is None else since) if at_limit else None
            if full and self.error(row) & self.get(row, "shutdown"):
                self._unload(row)
                changed = True
        if changed:
            self.drive()

    def _unload(self, row: int) -> None:
        self.put(row, "torque_limit", 0)

    def _cap(self, row: int) -> float:
        """Return the largest output, PWM counts."""
        return float(self.get(row, "torque_limit"))

    def error(self, row: int) -> int:
        """Return the error bits that are the state now."""
        since = self._full_since[row]
        overloaded = since is not None and self.now - since >= PATIENCE
        return super().error(row) | (self.OVERLOAD if overloaded else 0)

    def drive(self) -> None:
        """Let the motors follow the registers."""
        rows = range(len(self.specs))
        powered = np.array([self.boots_at[row] == inf for row in rows])
        on = powered & np.array([self.get(row, "torque_enable") == 1 for row in rows])
        nothing = np.zeros(len(self.specs))
        supply = np.array(self.volts) / self._nominal
        self.muscles.drive(
            DriveState(
                on,
                np.array([1 if self._is_wheel(row) else 3 for row in rows]),
                np.array([self._gain(row) for row in rows]),
                nothing,
                nothing,
                nothing + 100.0,
                nothing + 1920.0,
                np.array([self._cap(row) for row in rows]),
                nothing + inf,
                supply,
                float(FULL),
                np.array(self.turn),
                np.array([each.rpm for each in self.models]),
                motor=self._motors.strength(supply),
            )
        )
        self._set_goals()

    def _is_wheel(self, row: int) -> bool:
        return not self.get(row, "min_position_limit") and not self.get(row, "max_position_limit")

    def _gain(self, row: int) -> float:
        """Return the stiffness as a P gain: that of an MX, or of a compliance slope."""
        if self.models[row].bulk_read:
            return float(self.get(row, "position_p_gain"))
        slope = (self.get(row, "cw_compliance_slope") + self.get(row, "ccw_compliance_slope")) / 2.0
        return DIVISOR * FULL / max(slope, 1.0)

    def _goal(self, row: int) -> float:
        if self._is_wheel(row):
            speed = self.get(row, "moving_speed")
            return float(-(speed & FULL) if speed > FULL else speed)
        return self.encoder(row, self.get(row, "goal_position"))

    def _drives(self, row: int) -> bool:
        return self.get(row, "torque_enable") == 1 and self.get(row, "torque_limit") > 0

    def _show_motion(self, row: int, velocity: float) -> None:
        self.show(row, "present_velocity", round(np.clip(velocity, -FULL, FULL)))
        self.show(row, "present_load", round(float(np.clip(self.muscles.pwm[row], -FULL, FULL))))
        self.put(row, "moving", int(abs(velocity) > 5))

    # ------------------------------------------------------------------------------- of a model

    def _find_model(self, name: str) -> Any:
        """Return a model by its name: a `Dynamixel1Model`, or that of a family with such tables."""
        return model(name)

    def _find_table(self, own: Any) -> RegisterTable:
        return table_of(own)

    def _factory(self, row: int) -> dict[str, int]:
        """Return the EEPROM content of a new servo, with its firmware, without model number and id."""
        own = self.models[row]
        firmware = self.specs[row].firmware
        version = FIRMWARE[own.table] if firmware is None else firmware
        return {**factory_settings(own), "firmware_version": version}

    def _end(self, row: int) -> int:
        """Return the first address behind the table."""
        return ENDS["ex" if "EX" in self.models[row].name else self.models[row].table]

    def stand_ins(self) -> dict[str, str]:
        """Return the models without motor figures, and the one whose figures they have."""
        return {each.name: STAND_IN for each in self.models if each.figures is None}
