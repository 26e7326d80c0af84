"""Loss of state of a servo without power, and the frame in which its position registers count.

The motor's position is encoder ticks, continuous; the registers show direction * encoder + shift, where
`shift` is whole turns plus the homing offset. Source: e-manual, "Operating Mode" note, "Homing Offset",
"Startup Configuration", and of Protocol 2.0 "Factory Reset" and "Control Table Backup".
"""

from collections.abc import Sequence
from math import inf
from typing import Protocol

import numpy as np

from twind_drivers.virtual.drive_firmware import REVERSE
from twind_drivers.virtual.register_columns import RegisterColumns
from twind_drivers.virtual.register_memory import Bytes, RegisterMemory, factory
from twind_drivers.virtual.servo_physics import ServoPhysics

BOOT = 0.1  # s off the bus after a reboot
TURN = 4096  # ticks, of all models but the P series; also of the gripper, whose pages disagree
OFFSET_IN_MODE_3 = 1024  # of a 4096 tick servo: a homing offset beyond it does nothing in position mode
# bits of the startup configuration
TORQUE_AT_BOOT = 1
RAM_AT_BOOT = 2
MODE_RESETS = (
    "position_d_gain",
    "position_i_gain",
    "position_p_gain",
    "feedforward_2nd_gain",
    "feedforward_1st_gain",
    "profile_acceleration",
    "profile_velocity",
)
# RAM that comes back from a backup: the settings. What moves or reports something does not.
KEPT_IN_BACKUP = (
    *("velocity_i_", "velocity_p_", "position_d_", "position_i_", "position_p_", "feedforward_"),
    *("profile_", "indirect_address_"),
)


class FirmwareQuirks(Protocol):
    """Behaviour of a servo where sources disagree; see `ServoSpec`."""

    @property
    def forgets_offset(self) -> bool:
        """True if a homing offset without effect falls back to 0."""

    @property
    def seam_seed(self) -> int | None:
        """Seed of the encoder's noise at boot; None: there is no noise."""


class ServoPower:
    """Boots and frames of m servos. After each of its methods `servos.changed` must follow."""

    def __init__(
        self,
        memory: RegisterMemory,
        registers: RegisterColumns,
        muscles: ServoPhysics,
        tempers: Sequence[FirmwareQuirks],
    ) -> None:
        count = len(memory.raw)
        self._memory = memory
        self._registers = registers
        self._muscles = muscles
        self.boots_at = np.full(count, inf)  # s, when a rebooting servo is back; inf: it runs
        # register = direction * encoder + shift
        self.direction = np.ones(count)
        self.shift = np.zeros(count)
        self.turn = [table.facts.counts_per_turn or TURN for table in memory.tables]
        facts = [table.facts for table in memory.tables]
        half = [turn // 2 for turn in self.turn]
        self._begin = [  # the first count of the one turn that is left: 0, of the P series -501923
            0 if each.centre is None else each.centre - most for each, most in zip(facts, half, strict=True)
        ]
        self._base = np.zeros(count)  # whole turns in `shift`
        self._keeps = [each.keeps_turns for each in facts]  # by a battery
        self._counted = np.zeros(count, np.bool_)  # its turns have been counted once
        self._forgets = [temper.forgets_offset for temper in tempers]
        seeds = (temper.seam_seed for temper in tempers)
        self._noise = [None if seed is None else np.random.default_rng(seed) for seed in seeds]
        self._backups: dict[int, Bytes] = {}  # row -> its table; survives everything
        self._settings: dict[int, Bytes] = {}  # row -> the EEPROM that it boots with next

    def down(self, row: int, now: float, *, settings: Bytes | None = None) -> None:
        """Off the bus, torque lost; back `BOOT` s later, with the EEPROM of the table `settings` if given."""
        self._registers.put("torque_enable", 0, row)
        self.boots_at[row] = now + BOOT
        if settings is not None:
            self._settings[row] = settings

    def up(self, row: int) -> None:
        """Boot a servo: RAM defaults, caps at their limits, turns lost, goal at its position.

        Torque follows register 60.
        """
        registers = self._registers
        memory = self._memory
        self.boots_at[row] = inf
        settings = self._settings.pop(row, None)
        if settings is not None:
            memory.raw[row, : len(settings)] = settings
        memory.fill(row, eeprom=False)
        self._caps(row)
        startup = int(registers["startup_configuration"][row])
        if row in self._backups:
            self._ready(row)
            if startup & RAM_AT_BOOT:
                self._restore_ram(row)
        self.collapse(row, slip=self._slip(row))
        self.goal_is_present(row)
        registers.put("torque_enable", startup & TORQUE_AT_BOOT, row)

    # ------------------------------------------------------------------------------------- backup

    def back_up(self, row: int) -> None:
        """Keep the table as it is now, through power-off and factory reset."""
        self._backups[row] = self._memory.raw[row].copy()
        self._ready(row)

    def backup(self, row: int) -> Bytes | None:
        """The table that was kept by a backup; None: there is none."""
        return self._backups.get(row)

    def _ready(self, row: int) -> None:
        self._memory.store(row, self._memory.tables[row]["backup_ready"], 1)

    def _restore_ram(self, row: int) -> None:
        kept = self._backups[row]
        for field in self._memory.layouts[row].values():
            if not field.eeprom and field.key.startswith(KEPT_IN_BACKUP):
                self._memory.raw[row, field.address : field.end] = kept[field.address : field.end]
        self._memory.remap(row)

    # ------------------------------------------------------------------------------------- modes, frames

    def reset_mode(self, row: int) -> None:
        """Reset the registers that a change of operating mode resets (e-manual, "Operating Mode")."""
        table = self._memory.tables[row]
        for key in MODE_RESETS:
            if key in table:
                self._memory.store(row, table[key], factory(table[key], table.number))
        self._caps(row)
        self.reframe(row, one_turn=self._registers["operating_mode"][row] == 3)

    def reframe(self, row: int, *, one_turn: bool) -> None:
        """Direction, offset or mode changed: the frame anew. The goal register keeps its number."""
        if one_turn:
            self.collapse(row)
        else:
            self._frame(row)

    def collapse(self, row: int, *, slip: int = 0) -> None:
        """The position count falls back to one turn; the homing offset is added to that.

        `slip`: ticks that the encoder is off while the turn is chosen.
        """
        turn = self.turn[row]
        if self._keeps[row] and self._counted[row]:
            self._frame(row)
            return
        self._counted[row] = True
        self._base[row] = 0.0
        self._frame(row)
        count = np.rint(self._muscles.position[row]) * self.direction[row] + slip
        self._base[row] = -np.floor((count - self._begin[row]) / turn) * turn
        self._frame(row)

    def wind(self, row: int, turns: int) -> None:
        """The count goes on by whole turns, as it does when a limp shaft is turned all the way round."""
        self._base[row] += turns * self.turn[row]
        self._frame(row)

    def encoder(self, row: int, count: float) -> float:
        """Return the bare encoder's position when the present position shows `count`, as framed now."""
        return float((count - self.shift[row]) * self.direction[row])

    def goal_is_present(self, row: int) -> None:
        """The goal register takes the present position."""
        present = np.rint(self._muscles.position[row]) * self.direction[row] + self.shift[row]
        self._registers.put("goal_position", int(present), row)

    def _slip(self, row: int) -> int:
        noise = self._noise[row]
        if noise is None or self._registers["operating_mode"][row] == 3:
            return 0
        return int(noise.integers(-1, 2))

    def _caps(self, row: int) -> None:
        if self._keeps[row]:  # of a Y: 0 until they are written (e-manual, "Goal PWM (524)")
            return
        self._registers.put("goal_pwm", self._registers["pwm_limit"][row], row)
        self._registers.put("goal_current", self._registers["current_limit"][row], row)

    def _frame(self, row: int) -> None:
        offset = int(self._registers["homing_offset"][row])
        inert = self._registers["operating_mode"][row] == 3 and abs(offset) > OFFSET_IN_MODE_3
        if inert and self.turn[row] == TURN:
            offset = 0
            if self._forgets[row]:
                self._registers.put("homing_offset", 0, row)
        self.direction[row] = -1.0 if int(self._registers["drive_mode"][row]) & REVERSE else 1.0
        self.shift[row] = self._base[row] + offset
