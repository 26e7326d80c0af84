"""Virtual servos of one bus whose registers stand in tables: memory, supply, hands and time.

A family adds its models, what a write causes, and how the motors follow the registers. No packets here, no
physics (`muscles`). Positions of the motor are counts, continuous over turns.
"""

from collections.abc import Sequence
from math import inf
from typing import Any

import numpy as np

from twind_drivers.half_duplex.register_table import RegisterTable
from twind_drivers.virtual.hinge import Hinge
from twind_drivers.virtual.servo_physics import ServoPhysics
from twind_drivers.virtual.shown_position_log import ShownPositionLog

CHECK = 0.01  # s between two checks of the load


class VirtualTableServos:
    """m servos. Rows are indices of `tables`; time (s) is an argument and never goes back."""

    BOOT: float  # s from power-up to the first reply
    VOLTAGE, HEAT, OVERLOAD = 0x01, 0x04, 0x20  # error bits

    def __init__(
        self,
        tables: Sequence[RegisterTable],
        turn: Sequence[float],
        hinges: Sequence[Hinge | None],
        volts: Sequence[float],
        muscles: ServoPhysics,
        *,
        size: int,
        now: float,
    ) -> None:
        """Make the rows, without register values. `turn`: counts per turn; `size`: bytes of a table."""
        self.tables = tables
        self.muscles = muscles
        self.now = now
        self.history: ShownPositionLog | None = None
        self.hinges = list(hinges)
        self.turn = list(turn)
        self.volts = list(volts)
        count = len(tables)
        self.silenced = [False] * count
        self.celsius = [30.0] * count
        self.injected = [0] * count  # error bits by order
        self.frozen: list[int | None] = [None] * count
        self.boots_at = [inf] * count
        self.heard_at = [now] * count
        self.ram = [bytearray(size) for _ in tables]
        self._id_at = [table["id"].address for table in tables]
        self._shift = [0.0] * count  # encoder counts at register position 0
        self._checked_at = now
        self._redrive = self._retarget = False
        self._blocked = np.zeros(count, np.bool_)
        self._hand = np.full(count, np.nan)
        self._reach = np.zeros(count)

    # ------------------------------------------------------------------------------- registers

    def get(self, row: int, name: str) -> int:
        """Return a register's value; 0: its table lacks it."""
        field = self.tables[row].registers.get(name)
        if field is None:
            return 0
        return field.decode(bytes(self.ram[row][field.address : field.address + field.size]))

    def put(self, row: int, name: str, value: int) -> None:
        """Set a register's value, without any effect."""
        field = self.tables[row].registers[name]
        self.ram[row][field.address : field.address + field.size] = field.encode(value)

    def show(self, row: int, name: str, value: int) -> None:
        """Set a present register to a measured value: it stops at what the register can hold."""
        self.put(row, name, self.tables[row].registers[name].clip(value))

    def ids(self) -> list[int]:
        """Return the ids in the order of rows."""
        return [each[at] for each, at in zip(self.ram, self._id_at, strict=True)]

    def is_powered(self, row: int) -> bool:
        """Return True if the servo has power and has booted."""
        return self.boots_at[row] == inf

    def listening(self, row: int) -> bool:
        """Return True if the servo has power, is plugged in and has booted."""
        return not self.silenced[row] and self.is_powered(row)

    def settle(self) -> None:
        """Let the motors follow what was written since the last call."""
        if self._redrive:
            self.drive()
        elif self._retarget:
            self._set_goals()
        self._redrive = self._retarget = False

    def error(self, row: int) -> int:
        """Return the error bits that are the state now."""
        bits = self.injected[row]
        volts = round(self.volts[row] * 10)
        if not self.get(row, "min_voltage_limit") <= volts <= self.get(row, "max_voltage_limit"):
            bits |= self.VOLTAGE
        if self.celsius[row] > self.get(row, "temperature_limit"):
            bits |= self.HEAT
        return bits

    def refresh(self) -> None:
        """Write the present registers."""
        places = [self.shown(row) for row in range(len(self.tables))]
        if self.history is not None:
            self.history.note(self.now, np.array(places))
        for row, place in enumerate(places):
            kept = self.frozen[row]
            self.show(row, "present_position", place if kept is None else kept)
            self.show(row, "present_input_voltage", round(self.volts[row] * 10))
            self.show(row, "present_temperature", round(self.celsius[row]))
            self._show_motion(row, float(self.muscles.velocity[row]))

    # ------------------------------------------------------------------------------- time

    def advance(self, now: float) -> None:
        """Let time pass until `now`: boots end, motors move, overloads and alarms trip."""
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

    def _set_goals(self) -> None:
        self.muscles.set_goals(np.array([self._goal(row) for row in range(len(self.tables))], np.float64))

    # ------------------------------------------------------------------------------- from outside

    def reset(self, row: int, until: float) -> None:
        """Off the bus, torque lost; back at `until` (s) with RAM defaults."""
        self.boots_at[row] = until
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
                    "torque": self.is_powered(row) and self._drives(row),
                    "watchdog": -1,
                    "tripped": False,
                    "listening": self.listening(row),
                    "heard_ago": now - self.heard_at[row],
                    "tripped_at": None,
                    "trip_delay": None,
                }
            )
        return rows

    # ------------------------------------------------------------------------------- of a family

    def boot(self, row: int) -> None:
        """Power-up: kept registers to RAM, everything else default."""
        raise NotImplementedError

    def baud(self, row: int) -> int:
        """Return the rate of a servo."""
        raise NotImplementedError

    def stand_ins(self) -> dict[str, str]:
        """Return the models without motor figures, and the one whose figures they have."""
        raise NotImplementedError

    def drive(self) -> None:
        """Let the motors follow the registers."""
        raise NotImplementedError

    def encoder(self, row: int, count: float) -> float:
        """Return the place of the shaft at which the position register shows `count`."""
        raise NotImplementedError

    def shown(self, row: int) -> int:
        """Return the count that the position register shows."""
        raise NotImplementedError

    def _goal(self, row: int) -> float:
        """Return the goal of the motor in units of the physics."""
        raise NotImplementedError

    def _drives(self, row: int) -> bool:
        """Return True if the registers let the motor drive."""
        raise NotImplementedError

    def _protect(self) -> None:
        """Trip what is overloaded or too hot; called every `CHECK` seconds."""
        raise NotImplementedError

    def _show_motion(self, row: int, velocity: float) -> None:
        """Write the present registers that have units of the family."""
        raise NotImplementedError
