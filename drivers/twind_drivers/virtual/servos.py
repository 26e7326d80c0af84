"""The servos of one bus: what their firmware does with torque, goals, watchdog and time.

No packets here (`bus`), no register rules (`writing`), no physics (`muscles`). Time is an argument. Rows are
places in `specs`. Positions of the motor are encoder ticks, continuous; those in registers have direction,
turn and homing offset. Simulated are the position modes 3, 4 and 5; `writing` refuses the others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind_drivers.dynamixel.packet import ALERT
from twind_drivers.dynamixel.tables import number_of, table
from twind_drivers.virtual.columns import Columns
from twind_drivers.virtual.history import History
from twind_drivers.virtual.memory import Ints, Memory
from twind_drivers.virtual.muscles import Muscles
from twind_drivers.virtual.power import Power
from twind_drivers.virtual.profile import STEP, Profile
from twind_drivers.virtual.readings import Readings

BAUDS = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)  # register 8
REFRESH = 0.001  # s between two refreshes of the present registers
WATCHDOG_UNIT = 0.02  # s, register 98
TRIPPED = 255  # what register 98 reads then (-1)
WIDE = 1_048_575  # ticks, goals of modes 4 and 5
TORQUE_BY_GOAL = 8  # bit of the drive mode
PULL = 64  # ticks beyond where it is that a tripped servo keeps pulling, to carry its load


@dataclass(frozen=True, slots=True)
class ServoSpec:
    """One servo as it is screwed in: id, model, and the EEPROM settings that are not factory ones."""

    id: int
    model: str = "XM430-W350"
    settings: Mapping[str, int] = field(default_factory=dict)  # register -> value
    firmware: int = 47


class Servos:
    """m servos and their rules. `epoch` counts the changes that make a remembered request void."""

    def __init__(
        self, specs: Sequence[ServoSpec], muscles: Muscles, *, now: float = 0.0, keep_goal: bool = True
    ) -> None:
        """`keep_goal`: at torque on the goal register keeps its old value (the harsher case), else present.

        Raises KeyError for an unknown model and ValueError for one without the registers simulated here.
        """
        self.memory = memory = Memory([table(number_of(spec.model), spec.firmware) for spec in specs])
        for each in memory.tables:
            if "bus_watchdog" not in each or "operating_mode" not in each:
                raise ValueError(f"{each.model}: no bus watchdog and operating mode registers: not simulated")
        self.registers = Columns(memory)
        self.muscles, self.keep_goal, self.now, self.epoch = muscles, keep_goal, now, 0
        self.readings = Readings(memory, muscles)
        self.history: History | None = None  # of what the present position registers showed, on order
        self.power = Power(memory, self.registers, muscles)
        self.direction, self.shift = self.power.direction, self.power.shift
        self.profile = Profile.at(muscles.position)
        count = len(specs)
        self.tripped = np.zeros(count, np.bool_)
        self.tripped_at = np.full(count, np.nan)  # s, the last time
        self.trip_delay = np.full(count, np.nan)  # s, from the last packet heard before that
        self.shut = np.zeros(count, np.bool_)  # shut down by its hardware error, until reboot
        self.silenced = np.zeros(count, np.bool_)  # its connector is pulled: it hears and says nothing
        self.heard_at = np.full(count, now)  # s, the last instruction packet that each servo heard
        self.baud = 0  # of the line; 0: whatever each servo is set to
        self.listening = np.ones(count, np.bool_)
        self.alert = np.zeros(count, np.uint8)
        self._capped = np.array(["current_limit" in each for each in memory.tables])
        self._target = muscles.position.copy()
        self._lower, self._upper = np.zeros(count, np.int64), np.zeros(count, np.int64)
        self._timeout, self._shortest, self._event = np.full(count, inf), inf, inf
        self._fresh, self._simple = -inf, True
        self._by_goal: NDArray[np.bool_] | None = None  # whose torque a goal turns on; None: nobody's
        for row, spec in enumerate(specs):
            memory.fill(row)
            own = {
                "model_number": memory.tables[row].number,
                "id": spec.id,
                "firmware_version": spec.firmware,
            }
            for key, value in (own | dict(spec.settings)).items():
                memory.store(row, memory.tables[row][key], value)
            self._boot(row, now)
        self.changed()

    def __getitem__(self, key: str) -> NDArray[Any]:
        """(m,) values of one of `COLUMNS`; do not write to them."""
        return self.registers[key]

    # ------------------------------------------------------------------------------------------- time

    def advance(self, now: float) -> None:
        """Let time pass until `now`, stopping at every watchdog and every end of a boot on the way."""
        self.expire(now)
        if now > self.now:
            self._move(now)

    def expire(self, now: float) -> None:
        """Only what has a time of its own until `now`: watchdogs that trip, boots that end."""
        while self._event <= now:
            at = self._event
            self._move(at)
            for row in np.flatnonzero(self.power.boots_at <= at):
                self._boot(int(row), at)
            self._trip(at)
            self.changed()

    def feed(self, now: float) -> None:
        """An intact instruction packet was on the bus: it feeds the watchdog of every servo that heard it."""
        if self._simple:
            self.heard_at.fill(now)
            self._event = now + self._shortest
        else:
            self.heard_at[self.listening] = now
            self._event = self._next()

    def settle(self, now: float) -> None:
        """Bring the present registers up to `now`, but for what a servo has not refreshed yet."""
        self.expire(now)
        if not 0.0 <= now - self._fresh < REFRESH:
            if now - self.now >= REFRESH:
                self._move(now)
            self._fresh = now
            self.readings.refresh(now, self.direction, self.shift, self.profile.reference)
            if self.history is not None:
                self.history.note(now, self.readings.position.get())

    def _move(self, now: float) -> None:
        if self.profile.shaped:
            while self.now < now and not np.array_equal(self.profile.reference, self._target):
                step = min(self.now + STEP, now)
                self.profile.follow(self._target, step - self.now)
                self.muscles.aim(self.profile.reference)
                self.muscles.advance(step)
                self.now = step
        self.now = now
        self.muscles.advance(now)

    def _next(self) -> float:
        return float(min((self.heard_at + self._timeout).min(), self.power.boots_at.min()))

    def changed(self) -> None:
        """Something rare changed (a register that is no goal, a fault, the line): work out what follows."""
        self.epoch += 1
        self._fresh = -inf
        on, mode = self["torque_enable"] != 0, self["operating_mode"]
        units = self["bus_watchdog"].astype(np.float64)
        self._timeout = np.where(on & (units > 0) & ~self.tripped, units * WATCHDOG_UNIT, inf)
        self._shortest = float(self._timeout.min())
        line = (np.take(BAUDS, self["baud_rate"], mode="clip") == self.baud) | (self.baud == 0)
        self.listening = np.isinf(self.power.boots_at) & ~self.silenced & line
        self._simple = bool(self.listening.all() and np.isinf(self.power.boots_at).all())
        self._event = self._next()
        self.alert = np.where(self["hardware_error_status"] != 0, ALERT, 0).astype(np.uint8)
        by_goal = (self["drive_mode"] & TORQUE_BY_GOAL) != 0
        self._by_goal = by_goal if by_goal.any() else None
        self._lower = np.where(mode == 3, self["min_position_limit"], -WIDE).astype(np.int64)
        self._upper = np.where(mode == 3, self["max_position_limit"], WIDE).astype(np.int64)
        pwm = np.minimum(np.abs(self["goal_pwm"]), self["pwm_limit"]).astype(np.float64)
        current = np.where(self._capped, self["current_limit"], inf)
        goal_current = np.abs(self["goal_current"].astype(np.float64))
        self.muscles.drive(
            on=on,
            p=self["position_p_gain"].astype(np.float64),
            i=self["position_i_gain"].astype(np.float64),
            d=self["position_d_gain"].astype(np.float64),
            pwm_cap=pwm,
            current_cap=np.where(mode == 5, np.minimum(current, goal_current), current),
        )
        self.profile.limit(
            self["profile_velocity"].astype(np.float64), self["profile_acceleration"].astype(np.float64)
        )
        self._retarget()

    # ------------------------------------------------------------------------------------------- goals

    def aim(self, goals: Ints, rows: Any = slice(None)) -> None:
        """Goal positions (k,) for `rows`; those that a rule refuses are dropped, as by a sync write."""
        fine = (goals >= self._lower[rows]) & (goals <= self._upper[rows])
        fine &= self.listening[rows] & ~self.tripped[rows]
        if np.count_nonzero(fine) < len(fine):
            rows = np.arange(self.tripped.size)[rows][fine]
            goals = goals[fine]
        self.registers.put("goal_position", goals, rows)
        if self._by_goal is not None:
            self._torque_by_goal(self._by_goal, rows)
        self._retarget()

    def allows(self, row: int, goal: int) -> bool:
        """Is `goal` inside the position limits of this servo (they count in mode 3 only)?"""
        return bool(self._lower[row] <= goal <= self._upper[row])

    def _torque_by_goal(self, by_goal: NDArray[np.bool_], rows: Any) -> None:
        for row in np.arange(by_goal.size)[rows]:
            if by_goal[row] and not self["torque_enable"][row]:
                goal = self["goal_position"][row]
                self.torque(int(row), True)
                self.registers.put("goal_position", goal, row)
                self.changed()

    def _retarget(self) -> None:
        """Let the position loops pull to the goal registers; a tripped servo keeps where it stopped."""
        target = (self["goal_position"] - self.shift) * self.direction
        if np.count_nonzero(self.tripped):
            target[self.tripped] = self._target[self.tripped]
        self._target = target
        if not self.profile.shaped:
            self.profile.reference = target
        else:
            step = np.isinf(self.profile.velocity)
            self.profile.reference[step] = target[step]
        self.muscles.aim(self.profile.reference)

    # ------------------------------------------------------------------------------------------- torque

    def torque(self, row: int, on: bool) -> None:
        """Torque enable; `changed` must follow. On after a shutdown does nothing: only a reboot restores."""
        was = bool(self["torque_enable"][row])
        if on and self.shut[row]:
            return
        self.registers.put("torque_enable", int(on), row)
        if on and not was:
            if self["operating_mode"][row] == 3:
                self.power.collapse(row)  # e-manual, "Operating Mode" note: one turn, then the offset
            self.profile.reference[row] = self._target[row] = self.muscles.position[row]
            self.profile.speed[row] = 0.0
            if not self.keep_goal:
                self.power.goal_is_present(row)

    def damage(self, row: int, bits: int) -> None:
        """A hardware error: alert on every status, and shutdown where register 63 asks for it."""
        error = int(self["hardware_error_status"][row]) | bits
        self.registers.put("hardware_error_status", error, row)
        if error & int(self["shutdown"][row]):
            self.shut[row] = True
            self.registers.put("torque_enable", 0, row)
        self.changed()

    def reboot(self, row: int, now: float) -> None:
        """Off the bus, torque lost, turns lost; back `BOOT` s later with RAM defaults."""
        self.power.down(row, now)
        self.changed()

    def _boot(self, row: int, now: float) -> None:
        self.tripped[row] = self.shut[row] = False
        self.readings.origin[row] = self.heard_at[row] = now
        self.power.up(row)

    # ------------------------------------------------------------------------------------------- watchdog

    def _trip(self, now: float) -> None:
        """Bus watchdog (e-manual, register 98): stops where it is, goals locked, torque stays on."""
        due = self.heard_at + self._timeout <= now
        if not due.any():
            return
        self.tripped |= due
        self.tripped_at[due] = (self.heard_at + self._timeout)[due]
        self.trip_delay[due] = self._timeout[due]
        self.registers.put("bus_watchdog", TRIPPED, due)
        here = self.muscles.position
        held = here + np.clip(self.profile.reference - here, -PULL, PULL)
        self._target[due] = self.profile.reference[due] = held[due]
        self.profile.speed[due] = 0.0

    def untrip(self, row: int) -> None:
        """Register 98 was written 0: goals are open again; at `changed` the servo resumes to its old goal."""
        self.tripped[row] = False
