"""Control of one servo alone in current-based position (mode 5) with capped current, to find an endstop.

The other devices of the bus receive only torque off. The mode is EEPROM: it changes only without torque, and
the change resets gains, profile and goal limits. The position limits (48, 52) have no effect in mode 5
(e-manual, "Operating Mode (11)", "Min/Max Position Limit"). So goals are bounded here, and the earlier
settings are restored and read back. Not verified on hardware.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twind_drivers.bus import DeviceRefused, Order, Script, WireRangeError, WriteRequest
from twind_drivers.device_registers import RestartResult
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.command_packet_check import CommandPacketCheck
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.goal_packets import GoalPacket
from twind_drivers.dynamixel.operating_modes import CURRENT_BASED, block, check_cap, fences, mode_of
from twind_drivers.dynamixel.ram_restore import give_back, let_go, may_return, settings, values
from twind_drivers.dynamixel.servo_command_settings import ServoCommandSettings

# bits of Drive Mode (10)
SLAVE = 2
TIMED = 4
TORQUE_BY_GOAL = 8
FOREIGN = SLAVE | TORQUE_BY_GOAL  # a slave follows another servo; the other bit lets a goal switch torque on
# EEPROM registers that must be unchanged afterwards; only the mode is ever written.
EEPROM = (
    "drive_mode",
    "operating_mode",
    "homing_offset",
    "pwm_limit",
    "current_limit",
    "velocity_limit",
    "max_position_limit",
    "min_position_limit",
)


@dataclass(frozen=True, slots=True)
class SavedSettings:
    """Settings of a servo before a search: register name in snake case -> value."""

    eeprom: Mapping[str, int]
    ram: Mapping[str, int]


class SingleServoControl:
    """Single-device control of a Dynamixel servo (`SingleDeviceControl`). Counts are those of mode 5."""

    def __init__(
        self,
        reader: DynamixelReader,
        servos: Sequence[ServoCommandSettings],
        id: int,
        *,
        cap: int,
        profile: int,
        watchdog: int,
    ) -> None:
        """Make the control; `cap`: largest goal current, raw. `watchdog`: x 20 ms.

        `profile`: profile velocity, raw, at least 1: it bounds the speed towards a distant goal. Raises
        ValueError for an unknown id, a mode or model that cannot be driven so, a cap out of range.
        """
        own = {servo.id: servo for servo in servos}
        if id not in own:
            raise ValueError(f"{reader.name} has no id {id}; its ids are {list(own)}")
        self._reader = reader
        self._was = own[id]
        self.id = id
        where = f"{reader.name}: id {id}"
        table = own[id].table
        if own[id].mode.rests_at_zero:
            raise ValueError(f"{where}: its goals are no positions (mode {own[id].mode.number})")
        mode = mode_of(where, table, CURRENT_BASED)
        check_cap(where, table, mode, cap)
        self._servo = replace(own[id], mode=mode, cap=cap, acceleration=None)
        self._profile = profile
        self.watchdog = watchdog
        self._cap = cap
        self._closed = {
            servo.id: dict.fromkeys(fences(servo.table, servo.mode, 0, 0, servo.cap), (0, -1))
            for servo in servos
        }
        self._goal: GoalPacket | None = None
        self._check = self._fenced(0, -1)

    def set_goal_limits(self, lower: int, upper: int) -> None:
        """Set the range of goals (counts); none may be sent before. Raises ValueError for lower > upper."""
        goal = block(self._servo.table, "goal_position")
        bounds = np.array([lower], np.int64), np.array([upper], np.int64)
        self._goal = GoalPacket(self._reader.name, [self.id], goal, *bounds)
        self._check = self._fenced(lower, upper)

    def judge(self, data: bytes) -> None:
        """Check the bytes of an order while this servo is driven alone. Raises WireRangeError."""
        self._check.judge(data)

    def goal(self, tick: int) -> None:
        """Goal of the next `request`, to this servo alone. Raises WireRangeError; then none is pending."""
        line = self._reader.line
        line.goals = b""
        if self._goal is None:
            raise WireRangeError(self._reader.name, self.id, tick, 0, -1)
        line.goals = self._goal.encode(np.array([tick], np.int64))

    # --------------------------------------------------------------------------- scripts

    def look(self) -> Script[SavedSettings]:
        """Read the settings. Raises DeviceRefused for torque on, a hardware error, a foreign Drive Mode."""
        servo = self._was
        table = self._was.table
        eeprom = yield from values(self._reader, servo, [table[name] for name in EEPROM if name in table])
        state = [table[name] for name in ("torque_enable", "hardware_error_status")]
        ram = yield from values(self._reader, servo, [*settings(servo), *state])
        if ram["torque_enable"]:
            raise self._make_refusal("torque enable (64)", "is on: disarm first")
        if ram["hardware_error_status"]:
            raise self._make_refusal(
                "hardware error (70)", f"is {ram['hardware_error_status']:#04x}: find the cause"
            )
        drive = eeprom.get("drive_mode", 0)  # a gripper has no such register
        if drive & FOREIGN:
            raise self._make_refusal("Drive Mode (10)", f"is {drive}: bits 1 and 3 must be 0")
        return SavedSettings(eeprom, ram)

    def describe_leftovers(self, kept: SavedSettings) -> str:
        """Return a text of the mode and of the settings that its change resets."""
        was = kept.eeprom["operating_mode"]
        return (
            f"Operating Mode (11) {CURRENT_BASED} (was {was}) and gains, profile and Goal Current of a search"
        )

    def enter_current_mode(self, kept: SavedSettings) -> Script[None]:
        """Switch to mode 5 and read it back. Raises DeviceRefused, NoReply."""
        if kept.eeprom["operating_mode"] != CURRENT_BASED:
            yield from self._write("operating_mode", CURRENT_BASED)
        yield from self._verify_register({"operating_mode": CURRENT_BASED})

    def prepare(self, kept: SavedSettings, tick: int) -> Script[None]:
        """Write cap, gains, profile, goal `tick` and watchdog before torque, and read all of them back.

        Raises DeviceRefused, NoReply, WireRangeError.
        """
        # the profile would be a time, not a speed: none is used
        timed = kept.eeprom.get("drive_mode", 0) & TIMED
        gains = {
            f"position_{key}_gain": int.from_bytes(self._servo.gains[at : at + 2], "little")
            for at, key in ((0, "d"), (2, "i"), (4, "p"))
        }
        wanted = {
            "goal_current": self._cap,
            "goal_pwm": kept.eeprom["pwm_limit"],
            **gains,
            "profile_acceleration": 0,
            "profile_velocity": 0 if timed else self._profile,
            "goal_position": tick,
            "bus_watchdog": self.watchdog,
        }
        yield from self._write("bus_watchdog", 0)  # a tripped watchdog locks the goals (error 4)
        for name, value in wanted.items():
            yield from self._write(name, value)
        yield from self._verify_register(wanted | {"operating_mode": CURRENT_BASED, "torque_enable": 0})

    def energise(self) -> Script[None]:
        """Switch torque on and read it back. Raises DeviceRefused, NoReply.

        The mode is read before, since only mode 5 obeys the cap, and again after: a restart in between would
        leave torque without cap and watchdog.
        """
        mode = {"operating_mode": CURRENT_BASED}
        yield from self._verify_register(mode)
        self._reader.registers.expire_torque(self._reader.ids.index(self.id))
        yield from self._write("torque_enable", 1)
        cap = {"goal_current": self._cap, "bus_watchdog": self.watchdog}
        yield from self._verify_register({"torque_enable": 1} | mode | cap)

    def give_back(self, kept: SavedSettings) -> Script[RestartResult]:
        """Switch torque and watchdog off, restore mode and RAM settings, read them back, compare EEPROM.

        The mode comes before the RAM settings, which its change resets. A goal current above the cap of
        mode 5, as a servo has it at power-on, stays as the search left it: `prepare` sets that register
        anew. Raises NoReply; DeviceRefused naming the difference.
        """
        table = self._was.table
        yield from let_go(self._reader, self._was)
        if (yield from self._reader.read(self.id, "operating_mode")).value != kept.eeprom["operating_mode"]:
            yield from self._write("operating_mode", kept.eeprom["operating_mode"])
        restored = yield from give_back(self._reader, self._was, kept.ram)
        fields = [table[name] for name in EEPROM if name in table]
        after = yield from values(self._reader, self._was, fields)
        for field in fields:
            if after[field.key] != kept.eeprom[field.key]:
                reason = f"was {kept.eeprom[field.key]}, reads {after[field.key]}: write it back"
                raise self._make_refusal(f"{field.name} ({field.address})", reason)
        for register, was in restored.differing:
            if not may_return(self._was, table[register.name], was):
                continue
            reason = f"was {was}, reads {register.value}: write it back"
            raise self._make_refusal(f"{register.name} ({register.address})", reason)
        return restored

    # --------------------------------------------------------------------------- parts

    def _fenced(self, lower: int, upper: int) -> CommandPacketCheck:
        own = fences(self._servo.table, self._servo.mode, lower, upper, self._cap)
        return CommandPacketCheck(self._reader.name, self._reader.tables, self._closed | {self.id: own})

    def _write(self, name: str, value: int) -> Script[None]:
        """Write one register with acknowledgement. Raises DeviceRefused with the reported reason."""
        field = self._was.table[name]
        field.check(value)
        order: Order = WriteRequest({self.id: field.encode(value)}, field.address)
        error = (yield order).error.get(self.id, 0)
        if error & 0x7F:
            raise self._make_refusal(f"{field.name} ({field.address}) = {value}", packet.explain(error))

    def _verify_register(self, wanted: Mapping[str, int]) -> Script[None]:
        for name, value in wanted.items():
            found = yield from self._reader.read(self.id, name)
            if found.value != value:
                reason = f"wrote {value}, reads {found.value}"
                raise self._make_refusal(f"{found.name} ({found.address})", reason)

    def _make_refusal(self, what: str, reason: str) -> DeviceRefused:
        return DeviceRefused(self._reader.name, self.id, what, reason)
