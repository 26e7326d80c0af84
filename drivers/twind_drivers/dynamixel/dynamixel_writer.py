"""Writer of a Dynamixel bus: goals, torque, registers. Exists in live only.

Every packet is checked by its bytes before it leaves (WIRE_CLAMP): ids of this bus, writable addresses, goal
words inside what each device may be sent. Devices may differ in model and operating mode
(`operating_modes.py`).
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from twind_drivers.bus import (
    Bools,
    DeviceRefused,
    GroupWriteBatch,
    Ints,
    NoReply,
    Order,
    RebootRequest,
    Script,
    WireRangeError,
    WriteRequest,
)
from twind_drivers.device_registers import RegisterAddress, RestartResult
from twind_drivers.dynamixel import damping, packet
from twind_drivers.dynamixel.command_packet_check import CommandPacketCheck
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.goal_packets import Goals, goal_packets
from twind_drivers.dynamixel.operating_modes import CURRENT_BASED, check_bounds, fences
from twind_drivers.dynamixel.ram_restore import restart
from twind_drivers.dynamixel.replies import StatusReply
from twind_drivers.dynamixel.servo_command_settings import (
    Rows,
    ServoCommandSettings,
    groups,
    rows,
    servos_of,
    writes,
)
from twind_drivers.dynamixel.servo_readback import ServoReadback
from twind_drivers.dynamixel.single_servo import SingleServoControl
from twind_drivers.dynamixel.write_diagnosis import limit_words
from twind_drivers.half_duplex.goal_bounds import bounds_of
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction

# Registers that `write` refuses, with the reason: other paths own them, or the device would be lost.
ELSEWHERE = {
    "torque_enable": "torque is switched by arming and disarming",
    "goal_position": "goals pass the gate",
    "goal_velocity": "goals pass the gate",
    "goal_current": "it is the goal of mode 0, and the cap of mode 5 that preparing for torque sets",
    "id": "it would answer under another id than this bus has",
    "baud_rate": "it would answer at another baud rate than this bus has",
    "protocol_type": "it would no longer speak this protocol",
    "indirect_data": "it is the register that it is mapped to: write that one",
}


class DynamixelWriter:
    """Writer to the bus of `reader`. Arrays are (m,), in the order of its ids; goals in the device's unit."""

    def __init__(
        self,
        reader: DynamixelReader,
        *,
        lower: Ints,
        upper: Ints,
        gains: Sequence[tuple[int | None, int | None, int | None]] | None = None,
        watchdog: int = 5,
        modes: Sequence[int] | None = None,
        current_caps: Sequence[int | None] | None = None,
        accelerations: Sequence[int | None] | None = None,
    ) -> None:
        """Make the writer; `lower`, `upper` (m,): goals that may be sent, each in the unit of its mode.

        `gains` (m): P, I, D each; None: the models' defaults. `watchdog`: x 20 ms, 1..127. `modes` (m):
        operating mode (0, 1, 3, 4, 5) that each device must have; None: all 3. `current_caps` (m): goal
        current of those in mode 5, counts, None elsewhere. `accelerations` (m): profile acceleration of those
        in mode 1, counts; None: as the device has it.

        Raises ValueError: bounds of the wrong shape or outside a mode's, watchdog off, a gain without a known
        default, a mode that is not driven, mode 5 without a cap.
        """
        # 0 would switch the watchdog off: a servo would then hold its last goal for ever after a dead loop.
        if not 1 <= watchdog <= 127:
            raise ValueError(f"{reader.name}: watchdog {watchdog} is outside 1..127 (x 20 ms)")
        self._reader = reader
        self._line = reader.line
        self._name = reader.name
        self._ids = reader.ids
        self._watchdog = watchdog
        self._alone: SingleServoControl | None = None
        self._servos = servos_of(
            reader, modes=modes, caps=current_caps, gains=gains, accelerations=accelerations
        )
        self._readback = ServoReadback(reader, self._servos)
        self._resting = np.array([servo.mode.rests_at_zero for servo in self._servos])
        self._led: tuple[ServoCommandSettings, ...] = self._servos  # devices that get goals ...
        self._places: Ints | None = None  # ... and their indices (k,); None: all
        self.set_goal_limits(lower, upper)
        self._pwm = {
            one.id: one.most_pwm for one in self._servos
        }  # counts by id; the largest of the model until `prepare` has read the limit register
        torque = rows(self._servos, lambda servo: (servo.layout.torque, b"\0"))
        self._off = b"".join(packet.sync_write(where.address, data) for where, data in groups(torque).items())

    def set_goal_limits(self, lower: Ints, upper: Ints) -> None:
        """Set the range of the goals (m,) and drop pending goals.

        Speeds and currents other than 0 are sent only after `prepare` has read their limit registers. Raises
        ValueError as `__init__` does; then nothing changes.
        """
        least, most = bounds_of(self._name, len(self._ids), lower, upper)
        for servo, low, high in zip(self._servos, least, most, strict=True):
            check_bounds(f"{self._name}: id {servo.id}", servo.table, servo.mode, int(low), int(high))
        self._lower = least
        self._upper = most
        self._line.goals = b""
        self._fence({})

    def _fence(self, limits: Mapping[int, int]) -> None:
        """Set the bounds of goals and packets; those of speeds and currents are also the limit registers.

        `limits`: limit register by id. A speed or current whose limit is unknown may only be 0.
        """
        limit = np.array([limits.get(id, 0) for id in self._ids])
        lower = np.where(self._resting, np.maximum(self._lower, -limit), self._lower)
        upper = np.where(self._resting, np.minimum(self._upper, limit), self._upper)
        ids = [servo.id for servo in self._led]
        goals = [servo.goal for servo in self._led]
        self._goals: Goals = goal_packets(self._name, ids, goals, self._of_led(lower), self._of_led(upper))
        if self._places is not None:  # an empty range (0..-1) lets no goal pass
            alone = np.isin(np.arange(len(self._ids)), self._places, invert=True)
            lower = np.where(alone, 0, lower)
            upper = np.where(alone, -1, upper)
        own = zip(self._servos, lower.tolist(), upper.tolist(), strict=True)
        each = {one.id: fences(one.table, one.mode, least, most, one.cap) for one, least, most in own}
        self._check = CommandPacketCheck(self._name, self._reader.tables, each)

    # --------------------------------------------------------------------------- every tick

    def goals(self, ticks: Ints) -> None:
        """Goals (m,) of the next `request`. Raises WireRangeError, ValueError; then nothing is pending."""
        self._line.goals = b""
        if self._alone is not None:  # the other devices must not move while one is driven alone
            raise WireRangeError(
                self._name, self._alone.id, int(ticks[0]), 0, -1, "one is driven alone: goal"
            )
        self._line.goals = self._goals.encode(self._of_led(ticks))

    def cut(self) -> None:
        """Switch torque off on all devices in the next write of any kind; earlier goals are not sent."""
        self._line.urgent = self._off * 2  # twice: a sync write has no reply, and one packet may be lost
        self._line.goals = b""

    def clear(self) -> None:
        """Drop pending goals. A pending cut stays: torque off is never refused."""
        self._line.goals = b""

    # --------------------------------------------------------------------------- the rare path

    def begin(self, order: Order, now: float) -> None:
        """Begin one order; the reader's `answer` ends it. Raises PortError, WireRangeError; TypeError."""
        exchange = self._exchange(order)
        (self._check if self._alone is None else self._alone).judge(exchange.packet)
        self._line.send(exchange, now)

    def _exchange(self, order: Order) -> SerialTransaction:
        if isinstance(order, RebootRequest):
            return SerialTransaction(packet.reboot(order.id), StatusReply((order.id,), 0), 1)
        if isinstance(order, WriteRequest) and len(order.data) == 1:
            [(id, data)] = order.data.items()
            return SerialTransaction(packet.write(id, order.address, data), StatusReply((id,), 0), 1)
        if isinstance(order, WriteRequest | GroupWriteBatch):
            each = (order,) if isinstance(order, WriteRequest) else order.writes
            packets = b"".join(packet.sync_write(one.address, one.data) for one in each)
            return SerialTransaction(packets, None, 0)
        raise TypeError(f"{self._name}: a writer does not read: {order}")

    # --------------------------------------------------------------------------- scripts

    def prepare(self, ticks: Ints, among: Bools | None = None) -> Script[None]:
        """Prepare devices for torque and read back each step; `among` (m,): these alone; None: all.

        Devices outside `among` get no goals from then on. Checks the operating modes. Clears the watchdogs,
        sets the goals to `ticks` (m,), or 0 for speeds and currents, and arms the watchdogs, in one system
        call. Then caps, gains, and profile 0 for positions: the executor shapes the motion. The cap of the
        output is restored last: a damped servo regains its strength only at rest on its goal.

        Raises DeviceRefused, WireRangeError; NoReply after all other devices are prepared: a robot is lowered
        without the silent ones.
        """
        self._lead(among)
        whole = ticks.shape == self._resting.shape  # numpy would stretch another shape; it is refused below
        goal = self._goal_rows(np.where(self._resting, 0, ticks) if whole else ticks)
        there = self._led
        silent = None
        while there:
            try:
                yield from self._prepared(there, goal)
                break
            except NoReply as error:
                silent = error.joined(silent)
                there = tuple(servo for servo in there if servo.id not in error.ids)
        if silent is not None:
            raise silent.with_traceback(None)

    def _prepared(self, servos: tuple[ServoCommandSettings, ...], goals: Rows) -> Script[None]:
        """Run all steps of `prepare` on these devices alone."""
        ids = {servo.id for servo in servos}
        goal = [row for row in goals if row[0] in ids]
        yield from self._require_modes(servos)
        capped = _in(CURRENT_BASED, servos)
        caps = rows(
            capped, lambda servo: (servo.register_span("goal_current"), _encode_uint16(servo.cap or 0))
        )
        off, on = (
            rows(servos, lambda servo, units=units: servo.watchdog_row(units))  # type: ignore[misc]
            for units in (0, self._watchdog)
        )
        # Watchdog 0 first: while it reads 255 the goal registers are locked (error 4, e-manual "Bus Watchdog
        # (98)"). Arming last: earlier it would leave the old goal in force if the packets behind it are lost.
        yield GroupWriteBatch((*writes(off), *writes(caps), *writes(goal), *writes(on)))
        yield from self._readback.verify("bus watchdog", on)
        yield from self._settle(servos, goal)
        yield from self._readback.verify("goal current, the cap of mode 5", caps)
        yield from self._restore_output(servos)

    def _settle(self, servos: tuple[ServoCommandSettings, ...], goal: Rows) -> Script[None]:
        """Write gains and profiles and read them back together with the goals of each mode."""
        moving = [servo for servo in servos if not servo.mode.rests_at_zero]
        gains = rows(moving, lambda servo: (servo.layout.gains, servo.gains))
        profile = rows(moving, lambda servo: (servo.layout.profile, bytes(8)))
        shaped = [servo for servo in servos if servo.acceleration is not None]
        ramps = rows(
            shaped,
            lambda servo: (
                servo.register_span("profile_acceleration"),
                (servo.acceleration or 0).to_bytes(4, "little"),
            ),
        )
        if orders := writes(gains) + writes(profile) + writes(ramps):
            yield GroupWriteBatch(orders)
        yield from self._readback.verify("position gains", gains)
        held = {id: data for id, _, data in goal}
        motion = [row for servo in moving for row in servo.motion_rows(held[servo.id])]
        yield from self._readback.verify("profile and goal position", motion)
        yield from self._readback.verify("profile acceleration", ramps)
        moved = {servo.id for servo in moving}
        yield from self._readback.verify_goals([row for row in goal if row[0] not in moved])

    def _restore_output(self, servos: tuple[ServoCommandSettings, ...]) -> Script[None]:
        """Set goal PWM of modes 3 and 4 to its limit: it caps the force, and damping lowers it.

        Likewise goal current of models that it caps in these modes.
        """
        free = [servo for servo in servos if servo.cap is None and not servo.mode.rests_at_zero]
        self._pwm |= yield from self._readback.raise_cap(free, "PWM")
        capped = [servo for servo in free if servo.table.facts.caps_current]
        yield from self._readback.raise_cap(capped, "current")

    def _require_modes(self, servos: tuple[ServoCommandSettings, ...]) -> Script[None]:
        """Require the operating modes of this writer; read the limit registers that bound its goals."""
        modes = rows(
            servos, lambda servo: (servo.register_span("operating_mode"), bytes((servo.mode.number,)))
        )
        yield from self._readback.verify("operating mode", modes, "needs")
        bounded = [servo for servo in servos if servo.mode.limit is not None]
        self._fence(
            (
                yield from self._readback.words(
                    bounded, lambda servo: servo.register_span(servo.mode.limit or "")
                )
            )
        )
        capped = _in(CURRENT_BASED, servos)
        most = yield from self._readback.words(capped, lambda servo: servo.register_span("pwm_limit"))
        pwm = rows(capped, lambda servo: (servo.register_span("goal_pwm"), _encode_uint16(most[servo.id])))
        yield from self._readback.verify(
            "goal PWM, at its limit", pwm, "needs"
        )  # a lower goal PWM would cap the force of mode 5 as well, without any report

    def write_goals(self, ticks: Ints) -> Script[None]:
        """Write goals (m,), read them back. Raises WireRangeError, DeviceRefused for a difference."""
        goal = self._goal_rows(ticks)
        if not goal:
            return
        yield GroupWriteBatch(writes(goal))
        yield from self._readback.verify_goals(goal)

    def read_goals(self) -> Script[Ints]:
        """Read the goals (m,) that the devices hold, each in its own unit. Raises NoReply."""
        found = yield from self._readback.words(self._servos, lambda servo: servo.goal)
        return np.array([found[id] for id in self._ids], np.int64)

    def torque(self, on: bool) -> Script[None]:
        """Switch torque off in all devices, or on in those that get goals; read it back.

        Off is written twice: a sync write has no reply. On follows only after the goals of speeds and
        currents read back 0: they would move the joint at once. Raises DeviceRefused, NoReply.
        """
        switched = self._led if on else self._servos
        if not switched:
            return
        if on:
            resting = [servo for servo in switched if servo.mode.rests_at_zero]
            yield from self._readback.verify_goals(
                rows(resting, lambda each: (each.goal, each.word(0))), "needs"
            )
        wanted = rows(switched, lambda servo: (servo.layout.torque, bytes((on,))))
        self._reader.registers.expire_torque(slice(None))
        yield GroupWriteBatch(writes(wanted) if on else writes(wanted) * 2)
        yield from self._readback.verify("torque enable", wanted)

    def damp(self) -> Script[tuple[int, ...]]:
        """Make the torque soft (`damping`); return the ids without confirmation, silent ones included."""
        return damping.damp(self._reader, self._servos, self._pwm)

    def begin_single_device(self, id: int, *, cap: int, profile: int) -> SingleServoControl:
        """Drive one device alone with little current; the others receive only torque off until the end.

        `end_single_device` ends it. `cap`: raw current; `profile`: raw velocity. Raises ValueError for a
        device that cannot be driven in this way.
        """
        self._alone = SingleServoControl(
            self._reader, self._servos, id, cap=cap, profile=profile, watchdog=self._watchdog
        )
        self.clear()
        return self._alone

    def end_single_device(self) -> None:
        """Command all devices again, as before `begin_single_device`."""
        self._alone = None
        self.clear()

    def write(self, id: int, name: str, value: int) -> Script[RegisterAddress]:
        """Write one register by name and read it back. EEPROM only while that device's torque is off.

        Raises NoReply, DeviceRefused, KeyError (lists near names), ValueError (range, read-only, not here).
        """
        table = self._reader.table(id)
        field = table[name]
        key = "indirect_data" if field.key.startswith("indirect_data") else field.key
        if key in ELSEWHERE:
            raise ValueError(f"{field.name} is not written here: {ELSEWHERE[key]}")
        field.check(value)
        if field.eeprom and (yield from self._reader.read(id, "torque_enable")).value:
            reason = "is EEPROM, writable only while torque is off: disarm first"
            raise DeviceRefused(self._name, id, field.name, reason)
        reply = yield WriteRequest({id: field.encode(value)}, field.address)
        error = reply.error.get(id, 0)
        if error & 0x7F:
            why = packet.explain(error)
            if error & 0x7F == packet.StatusErrorCode.DATA_LIMIT:
                why += yield from limit_words(self._reader, id, field)
            raise DeviceRefused(self._name, id, f"{field.name} = {value}", why)
        back = yield from self._reader.read(id, field.key)
        if back.value != value:
            raise DeviceRefused(self._name, id, field.name, f"wrote {value}, reads {back.value}")
        return back

    def reboot(self, id: int, *, shut_down: bool = False) -> Script[RestartResult]:
        """Restart one device, wait for its reply, restore its RAM settings. Its torque stays off.

        Refused while torque enable reads on: the device may carry a load. `shut_down`: the device has shut
        down by its hardware error although torque enable reads on; the error must read non-zero. Raises
        NoReply, KeyError, DeviceRefused.
        """
        self._reader.table(id)
        servo = self._servos[self._ids.index(id)]
        return (yield from restart(self._reader, servo, shut_down=shut_down))

    # --------------------------------------------------------------------------- parts

    def _lead(self, among: Bools | None) -> None:
        """Send goals to these devices (m,) alone from now on; None: to all."""
        self._places = None if among is None or among.all() else np.flatnonzero(among)
        self._led = self._servos if self._places is None else tuple(self._servos[row] for row in self._places)
        self.clear()
        self._fence({})

    def _of_led(self, each: Ints) -> Ints:
        """Select from values of all devices (m,) those of the devices that get goals."""
        return each if self._places is None else each[self._places]

    def _goal_rows(self, ticks: Ints) -> Rows:
        """Check the goals here too, so that WireRangeError is raised in the script that sends them."""
        own = self._of_led(ticks)
        self._goals.encode(own)
        return [
            (servo.id, servo.goal, servo.word(int(tick))) for servo, tick in zip(self._led, own, strict=True)
        ]


def _in(mode: int, servos: Iterable[ServoCommandSettings]) -> list[ServoCommandSettings]:
    return [servo for servo in servos if servo.mode.number == mode]


def _encode_uint16(value: int) -> bytes:
    return value.to_bytes(2, "little", signed=True)
