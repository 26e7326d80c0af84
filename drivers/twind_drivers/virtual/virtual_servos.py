"""Servos of one bus: the behaviour of their firmware with torque, goals, watchdog and time.

No packets here (`virtual_serial_bus`), no register rules (`write_instruction`), no physics (`muscles`). Time
is an argument. Rows are indices of `specs`. Positions of the motor are encoder ticks, continuous; those in
registers have direction, turn and homing offset. Goals of the other modes are raw velocity, current or PWM.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind_drivers.dynamixel.control_tables import ControlTable, number_of, table
from twind_drivers.dynamixel.error_codes import CODE_BY_BIT, WATCHDOG
from twind_drivers.dynamixel.packet import ALERT
from twind_drivers.virtual.backlash import Backlash
from twind_drivers.virtual.drive_firmware import TORQUE_BY_GOAL, DriveFirmware
from twind_drivers.virtual.hinge import Hinge
from twind_drivers.virtual.present_registers import PresentRegisters
from twind_drivers.virtual.register_columns import RegisterColumns
from twind_drivers.virtual.register_memory import Ints, RegisterMemory
from twind_drivers.virtual.servo_physics import ServoPhysics
from twind_drivers.virtual.servo_power import BOOT, ServoPower
from twind_drivers.virtual.servo_profile import STEP, ServoProfile
from twind_drivers.virtual.servo_protection import ServoProtection
from twind_drivers.virtual.shown_position_log import ShownPositionLog

SLOW = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
BAUDS = (*SLOW, 6_000_000, 10_500_000)  # register 8
REFRESH = 0.001  # s between two refreshes of the present registers
CHECK = 0.1  # s between two checks of supply, heat and load
SAGGED = 0.005  # share of the nominal voltage by which a changed supply changes the motors
WATCHDOG_UNIT = 0.02  # s, register 98
TRIPPED = 255  # what register 98 reads then (-1)
PULL = 64  # ticks beyond where it is that a tripped servo keeps pulling, to carry its load


@dataclass(frozen=True, slots=True)
class ServoSpec:
    """One servo as it is screwed in: id, model, and the EEPROM settings that are not factory ones.

    `forgets_offset`: a homing offset that counts for nothing in mode 3 falls back to 0 (ROBOTIS forum 5477);
    else the register keeps it. `seam_seed`: the encoder reads up to a tick off at boot, drawn by this seed,
    so near tick 0 a servo of many turns comes back a turn away (DynamixelSDK #380, #515); None: it does not.
    `powered`: s that it has had power when time begins. `hinge`: the joint that it turns. `turns`: how many
    the count is off when time begins, until it is lost. `backlash`: ticks of play between encoder and joint.
    """

    id: int
    model: str = "XM430-W350"
    settings: Mapping[str, int] = field(default_factory=dict)  # register -> value
    firmware: int = 47
    forgets_offset: bool = False
    seam_seed: int | None = None
    powered: float = 0.0
    hinge: Hinge | None = None
    turns: int = 0
    backlash: float = 0.0


def _simulated_table(spec: ServoSpec) -> ControlTable:
    found = table(number_of(spec.model), spec.firmware)
    if found.facts.undriven:
        raise ValueError(f"{found.model}: not simulated: {found.facts.undriven}")
    return found


class VirtualServos:
    """m servos and their rules. `epoch` counts the changes that make a remembered request void."""

    def __init__(
        self, specs: Sequence[ServoSpec], muscles: ServoPhysics, *, now: float = 0.0, keep_goal: bool = True
    ) -> None:
        """Make the servos; `keep_goal`: at torque on the goal register keeps its value (the harsher case).

        Raises KeyError for an unknown model and ValueError for one without the registers simulated here.
        """
        tables = [_simulated_table(spec) for spec in specs]
        if any(spec.backlash for spec in specs):
            muscles = Backlash(muscles, np.array([spec.backlash for spec in specs]))
        self.memory = memory = RegisterMemory(tables, [spec.firmware for spec in specs])
        self.registers = RegisterColumns(memory)
        self.muscles = muscles
        self.keep_goal = keep_goal
        self.now = now
        self.epoch = 0
        self.protection = ServoProtection(memory.tables, now)
        self.readings = PresentRegisters(memory, muscles, self.protection)
        self.history: ShownPositionLog | None = (
            None  # of what the present position registers showed, on order
        )
        self.power = ServoPower(memory, self.registers, muscles, specs)
        self.hinges = [spec.hinge for spec in specs]
        self.direction = self.power.direction
        self.shift = self.power.shift
        count = len(specs)
        # a tripped watchdog of 2 bytes reads -1, too
        self._tripped_word = np.array(
            [TRIPPED if each["bus_watchdog"].size == 1 else 0xFFFF for each in tables]
        )
        self._coded = np.array([each.codes_errors for each in tables])
        self.tripped, self.shut, self.silenced, self._blocked = (np.zeros(count, np.bool_) for _ in range(4))
        # shut: by a hardware error, until reboot; silenced: connector pulled, it receives and sends nothing
        # s, the last time, and how long after the last received packet before that
        self.tripped_at = np.full(count, np.nan)
        self.trip_delay = np.full(count, np.nan)
        self.heard_at = np.full(count, now)  # (m,) s, last instruction packet that each servo received
        self.baud = 0  # of the line; 0: whatever each servo is set to
        # ticks, ticks/s; NaN: no hand
        self._hand = np.full(count, np.nan)
        self._reach = np.zeros(count)
        self.listening = np.ones(count, np.bool_)
        self.alert = np.zeros(count, np.uint8)
        self._check_at = now + CHECK
        self._timeout = np.full(count, inf)
        self._shortest = inf
        self._event = inf
        self._fresh = -inf
        self._simple = True
        self._by_goal: NDArray[np.bool_] | None = (
            None  # servos whose torque a goal position turns on; None: none
        )
        for row, spec in enumerate(specs):
            memory.fill(row)
            self._fit(row, spec)
            self._boot(row, now)
            self.power.wind(row, spec.turns)
            self.readings.origin[row] = now - spec.powered
        self._firmware = DriveFirmware(memory, self.registers)
        self.profile = ServoProfile(muscles.position, turn=self._firmware.turn, rpm=self._firmware.rpm)
        self.invalidate_cache()

    def _fit(self, row: int, spec: ServoSpec) -> None:
        registers = self.memory.tables[row]
        own = {"model_number": registers.number, "id": spec.id, "firmware_version": spec.firmware}
        for key, value in (own | dict(spec.settings)).items():
            self.memory.store(row, registers[key], value)

    def __getitem__(self, key: str) -> NDArray[Any]:
        """(m,) values of one of `COLUMNS`; do not write to them."""
        return self.registers[key]

    def advance(self, now: float) -> None:
        """Let time pass until `now`, stopping at every watchdog and every end of a boot on the way."""
        self.run_timers(now)
        if now > self.now:
            self._move(now)

    def run_timers(self, now: float) -> None:
        """Run all timers until `now`: watchdogs that trip, boots that end."""
        while self._event <= now:
            at = self._event
            self._move(at)
            for row in np.flatnonzero(self.power.boots_at <= at):
                self._boot(int(row), at)
            self._trip(at)
            self.invalidate_cache()

    def feed(self, now: float) -> None:
        """Feed the watchdog of every servo that received an intact instruction packet."""
        if self._simple:
            self.heard_at.fill(now)
            self._event = now + self._shortest
        else:
            self.heard_at[self.listening] = now
            self._event = self._next()

    def settle(self, now: float, *, whole: bool = True) -> None:
        """Bring the present registers up to `now`, but for what a servo has not refreshed yet.

        `whole` False: only those of position, velocity and current.
        """
        self.run_timers(now)
        if not 0.0 <= now - self._fresh < REFRESH:
            if now - self.now >= REFRESH:
                self._move(now)
            self._fresh = now
            self.readings.refresh(now, self.direction, self.shift)
            if self.history is not None:
                self.history.note(now, self.readings.position.get())
        if whole:
            self.readings.refresh_slow_values(self.direction, self.shift, self.profile)

    def _move(self, now: float) -> None:
        while self._check_at <= now:
            at = self._check_at if np.count_nonzero(self._firmware.on) else now
            self._glide(at)
            self._check(at)
        self._glide(now)

    def _glide(self, now: float) -> None:
        if self.profile.shaped:
            while self.now < now and np.count_nonzero(self.profile.running):
                step = min(self.now + STEP, now)
                self.profile.follow(step)
                self.muscles.set_goals(self.profile.reference)
                self.muscles.advance(step)
                self.now = step
        self.now = now
        self.muscles.advance(now)

    def _check(self, now: float) -> None:
        """Supply, heat and load: brown-outs and hardware errors that come by themselves."""
        self._check_at = now + CHECK
        wrong = self.protection.step(
            now, self.muscles.current, np.abs(self.muscles.pwm) / self._firmware.full
        )
        if np.abs(self.protection.supply_share - self._supply).max(initial=0.0) > SAGGED:
            self._power()
            self.muscles.set_goals(self.profile.reference)
        if not wrong:
            return
        awake = np.isinf(self.power.boots_at)
        dark = self.protection.dark
        for row in np.flatnonzero(dark & awake):
            self.reboot(int(row), now)
        known = self["hardware_error_status"].astype(np.int64)
        known = np.where(self._coded & (known != 0), 0xFF, known)
        found = np.where(awake & ~dark, self.protection.errors() & ~known, 0)
        for row in np.flatnonzero(found):
            self.inject_error(int(row), int(found[row]))

    def _power(self) -> None:
        """Give the motors the strength that the supply has now."""
        protection = self.protection
        self._supply = supply = protection.supply_share
        strength = protection.motors.strength(supply)
        self.muscles.drive(self._firmware.drive(supply, protection.ampere, strength))

    def _next(self) -> float:
        return float(min((self.heard_at + self._timeout).min(), self.power.boots_at.min()))

    def invalidate_cache(self) -> None:
        """Something rare changed (a register that is no goal, a fault, the line): work out what follows."""
        self.epoch += 1
        self._fresh = -inf
        self._firmware.reload_registers()
        units = self["bus_watchdog"].astype(np.float64)
        self._timeout = np.where(self._firmware.on & (units > 0) & ~self.tripped, units * WATCHDOG_UNIT, inf)
        self._shortest = float(self._timeout.min())
        line = (np.take(BAUDS, self["baud_rate"], mode="clip") == self.baud) | (self.baud == 0)
        self.listening = np.isinf(self.power.boots_at) & ~self.silenced & line
        self._simple = bool(self.listening.all() and np.isinf(self.power.boots_at).all())
        self._event = self._next()
        self.alert = np.where(self["hardware_error_status"] != 0, ALERT, 0).astype(np.uint8)
        by_goal = self._firmware.seeks & ((self["drive_mode"] & TORQUE_BY_GOAL) != 0)
        self._by_goal = by_goal if np.count_nonzero(by_goal) else None
        self.readings.follow(self._firmware.way, self._firmware.seeks)
        self.profile.limit(*self._firmware.shape())
        self.protection.watch(*self._firmware.bounds())
        self._power()
        self._retarget()

    def set_goals(self, goals: Ints, rows: Any = slice(None)) -> None:
        """Goal positions (k,) for `rows`; those that a rule refuses are dropped, as by a sync write."""
        fine = (goals >= self._firmware.lower[rows]) & (goals <= self._firmware.upper[rows])
        fine &= self.listening[rows] & ~self.tripped[rows]
        if np.count_nonzero(fine) < len(fine):
            rows = np.arange(self.tripped.size)[rows][fine]
            goals = goals[fine]
        self.registers.put("goal_position", goals, rows)
        if self._by_goal is not None:
            self._torque_by_goal(self._by_goal, rows)
        self._retarget()

    def allows(self, row: int, goal: int) -> bool:
        """Return True if `goal` is inside the position limits of this servo (they count in mode 3 only)."""
        return bool(self._firmware.lower[row] <= goal <= self._firmware.upper[row])

    def _torque_by_goal(self, by_goal: NDArray[np.bool_], rows: Any) -> None:
        for row in np.arange(by_goal.size)[rows]:
            if by_goal[row] and not self["torque_enable"][row]:
                goal = self["goal_position"][row]
                self.torque(int(row), True)
                self.registers.put("goal_position", goal, row)
                self.invalidate_cache()

    def _retarget(self) -> None:
        """Let the loops follow the goal registers; a tripped servo keeps what it stopped at."""
        target = (self["goal_position"] - self.shift) * self.direction
        if self._firmware.mixed:
            target = self._firmware.goals(target)
        if np.count_nonzero(self.tripped):
            target[self.tripped] = self.profile.target[self.tripped]
        if self.profile.shaped:  # without torque there is nothing to shape
            off = ~self._firmware.on
            self.profile.hold(off, target[off])
        self.profile.set_targets(target, self.now)
        self.muscles.set_goals(self.profile.reference)

    def torque(self, row: int, on: bool) -> None:
        """Torque enable; `changed` must follow. On after a shutdown does nothing: only a reboot restores."""
        was = bool(self["torque_enable"][row])
        if on and self.shut[row]:
            return
        self.registers.put("torque_enable", int(on), row)
        if on and not was:
            if self["operating_mode"][row] == 3:
                self.power.collapse(row)  # e-manual, "Operating Mode" note: one turn, then the offset
            self.profile.hold(row, self.muscles.position[row] if self._firmware.seeks[row] else 0.0)
            if not self.keep_goal:
                self.power.goal_is_present(row)

    def inject_error(self, row: int, bits: int) -> None:
        """Raise a hardware error: alert on every status, and shutdown where register 63 selects it."""
        if self._coded[row]:
            self._inject_code(row, CODE_BY_BIT.get(bits & -bits, 0))
            return
        error = int(self["hardware_error_status"][row]) | bits
        self.registers.put("hardware_error_status", error, row)
        if error & int(self["shutdown"][row]):
            self.shut[row] = True
            self.registers.put("torque_enable", 0, row)
        self.invalidate_cache()

    def untrip(self, row: int) -> None:
        """Watchdog 0: goals are open again; `changed` resumes the old one."""
        self.tripped[row] = False
        if self._coded[row] and self["hardware_error_status"][row] == WATCHDOG:
            self.registers.put("hardware_error_status", 0, row)
            self.alert[row] = 0

    def _inject_code(self, row: int, code: int) -> None:
        """Raise an error of a Y by its code: without torque until a restart. 0: nothing."""
        if code:
            self.registers.put("hardware_error_status", code, row)
            self.shut[row] = True
            self.registers.put("torque_enable", 0, row)
        self.invalidate_cache()

    def supply(self, volts: float) -> None:
        """Set the supply of the bus, V; too little reboots the servos. Raises ValueError outside 0..60 V."""
        self.protection.supply(volts)
        self._check(self.now)
        self.invalidate_cache()

    def block(self, row: int, on: bool) -> None:
        """Something holds this shaft fast, or lets it go."""
        self._blocked[row] = on
        self.muscles.block(self._blocked)

    def set_hand_position(self, row: int, place: float, speed: float) -> None:
        """Move a shaft by hand to `place` (encoder ticks; NaN: release it), ticks/s, and hold it there.

        No register shows it; where torque is on the hand slips.
        """
        self._hand[row] = place
        self._reach[row] = speed
        self.muscles.set_hand_positions(self._hand, self._reach)

    def reboot(self, row: int, now: float) -> None:
        """Off the bus, torque lost, turns lost; back `BOOT` s later with RAM defaults."""
        self.power.down(row, now)
        self.invalidate_cache()

    def _boot(self, row: int, now: float) -> None:
        if self.protection.dark[row]:
            self.power.boots_at[row] = now + BOOT
            return
        self.protection.rest(row)
        self.tripped[row] = self.shut[row] = False
        self.readings.wake(row, now)
        self.heard_at[row] = now
        self.power.up(row)

    def _trip(self, now: float) -> None:
        """Bus watchdog (e-manual, register 98): stops with the profile as 0, goals locked, torque stays on.

        A position is held; a velocity, current or PWM becomes 0.
        """
        due = self.heard_at + self._timeout <= now
        self.tripped |= due
        self.tripped_at[due] = (self.heard_at + self._timeout)[due]
        self.trip_delay[due] = self._timeout[due]
        self.registers.put("bus_watchdog", self._tripped_word[due], due)
        if np.count_nonzero(due & self._coded):
            self.registers.put("hardware_error_status", WATCHDOG, due & self._coded)
        here = self.muscles.position
        held = here + np.clip(self.profile.reference - here, -PULL, PULL)
        self.profile.hold(due, np.where(self._firmware.seeks, held, 0.0)[due])
