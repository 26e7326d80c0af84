"""What a servo forgets without power, and the frame that its position registers count in.

The motor's position is encoder ticks, continuous; the registers show direction * encoder + shift, where
`shift` is whole turns plus the homing offset. Source: e-manual, "Operating Mode" note and "Homing Offset".
"""

from math import inf

import numpy as np

from twind_drivers.virtual.columns import Columns
from twind_drivers.virtual.memory import Memory, factory
from twind_drivers.virtual.muscles import Muscles

BOOT = 0.1  # s off the bus after a reboot
TURN = 4096  # ticks
OFFSET_IN_MODE_3 = 1024  # a homing offset beyond it is silently ignored in position mode
REVERSE = 1  # bit of the drive mode
TORQUE_AT_BOOT = 1  # bit of the startup configuration
MODE_RESETS = (
    "position_d_gain",
    "position_i_gain",
    "position_p_gain",
    "profile_acceleration",
    "profile_velocity",
)


class Power:
    """Boots and frames of m servos. After each of its methods `servos.changed` must follow."""

    def __init__(self, memory: Memory, registers: Columns, muscles: Muscles) -> None:
        count = len(memory.raw)
        self._memory, self._registers, self._muscles = memory, registers, muscles
        self.boots_at = np.full(count, inf)  # s, when a rebooting servo is back; inf: it runs
        self.direction, self.shift = np.ones(count), np.zeros(count)  # register = direction * encoder + shift
        self._base = np.zeros(count)  # whole turns in `shift`

    def down(self, row: int, now: float) -> None:
        """Off the bus, torque lost; back `BOOT` s later."""
        self._registers.put("torque_enable", 0, row)
        self.boots_at[row] = now + BOOT

    def up(self, row: int) -> None:
        """RAM defaults, the caps at their limits, turns lost, the goal where it is, torque as 60 says."""
        registers = self._registers
        self.boots_at[row] = inf
        self._memory.fill(row, keep=lambda register: register.eeprom)
        self._caps(row)
        self.collapse(row)
        self.goal_is_present(row)
        startup = int(registers["startup_configuration"][row])
        registers.put("torque_enable", startup & TORQUE_AT_BOOT, row)

    def reset_mode(self, row: int) -> None:
        """What a change of operating mode resets (e-manual, "Operating Mode")."""
        table = self._memory.tables[row]
        for key in MODE_RESETS:
            self._registers.put(key, factory(table[key], table.number), row)
        self._caps(row)
        self.reframe(row, one_turn=self._registers["operating_mode"][row] == 3)

    def reframe(self, row: int, *, one_turn: bool) -> None:
        """Direction, offset or mode changed: the frame anew. The goal register keeps its number."""
        if one_turn:
            self.collapse(row)
        else:
            self._frame(row)

    def collapse(self, row: int) -> None:
        """The position count falls back to one turn; the homing offset is added to that."""
        self._base[row] = 0.0
        self._frame(row)
        count = np.rint(self._muscles.position[row]) * self.direction[row]
        self._base[row] = -np.floor(count / TURN) * TURN
        self._frame(row)

    def goal_is_present(self, row: int) -> None:
        """The goal register takes the present position."""
        present = np.rint(self._muscles.position[row]) * self.direction[row] + self.shift[row]
        self._registers.put("goal_position", int(present), row)

    def _caps(self, row: int) -> None:
        self._registers.put("goal_pwm", self._registers["pwm_limit"][row], row)
        self._registers.put("goal_current", self._registers["current_limit"][row], row)

    def _frame(self, row: int) -> None:
        offset = int(self._registers["homing_offset"][row])
        if self._registers["operating_mode"][row] == 3 and abs(offset) > OFFSET_IN_MODE_3:
            offset = 0
        self.direction[row] = -1.0 if int(self._registers["drive_mode"][row]) & REVERSE else 1.0
        self.shift[row] = self._base[row] + offset
