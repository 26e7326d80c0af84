"""Writer of a Feetech bus: goals, torque, registers. Exists in live only.

A Feetech servo has no watchdog: it holds its last goal when its master dies. Its errors do not latch, a write
of a bad value is ignored without a word, and EPROM can be written under torque. So every write is read back,
settings are checked before torque, and EPROM is written with torque off: unlock, write, read back, lock.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from twind_drivers.bus import (
    TRIPPED,
    Bools,
    DeviceRefused,
    GroupWriteBatch,
    Ints,
    NoReply,
    Order,
    PingRequest,
    RebootRequest,
    Script,
    WriteRequest,
)
from twind_drivers.device_registers import RegisterAddress, RestartResult
from twind_drivers.feetech.feetech_identification import BLOCKS, objections
from twind_drivers.feetech.feetech_packet import FeetechInstruction
from twind_drivers.feetech.feetech_reader import FeetechReader
from twind_drivers.feetech.feetech_registers import GOAL, FeetechRegister, map_of_firmware
from twind_drivers.feetech.feetech_write_check import OFF, TORQUE, FeetechWriteCheck
from twind_drivers.half_duplex import checksum_packet as packet
from twind_drivers.half_duplex.checksum_reply import ChecksumReply
from twind_drivers.half_duplex.goal_bounds import bounds_of
from twind_drivers.half_duplex.goal_words import GoalWords
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_drivers.single_device import SingleDeviceControl

# Registers that `write` refuses, with the reason: other paths own them, or the device would be lost.
ELSEWHERE = {
    "torque_enable": "torque is switched by arming and disarming",
    "goal_position": "goals pass the gate",
    "goal_velocity": "it is set by preparing for torque",
    "goal_time": "it is set by preparing for torque",
    "goal_torque": "it is set by preparing for torque",
    "lock": "it is opened and closed around each write to EPROM",
    "operating_mode": "modes other than position are not driven",
    "id": "it would answer under another id than this bus has",
    "baud_rate": "it would answer at another baud rate than this bus has",
    "status_return_level": "at 0 it would confirm no write",
}
SOFT_START = 300  # torque limit (0.1 %) at torque on; then it rises
RAMP = (0.5, 0.75, 1.0)  # of the full torque limit
SHARE = 0.3  # of the full torque limit that damping leaves
SOFT = 8  # divisor of the P gain that damping sets
SPEED = {
    "sts": 6000,
    "smbl": 6000,
    "hls": 120,
    "scs": 0,
}  # goal velocity: faster than any servo; SCS: 0 is so
BOOT_ATTEMPTS = 300  # pings after a restart: 3 s at 100 Hz; the boot loader takes 0.8 s
GAINS = ("position_p_gain", "position_d_gain", "position_i_gain")  # registers 21, 22, 23
Row = tuple[int, str, int]  # id, register, value


class FeetechWriter:
    """Writer to the bus of `reader`. Arrays are (m,), in the order of its ids; goals in counts."""

    def __init__(
        self,
        reader: FeetechReader,
        *,
        lower: Ints,
        upper: Ints,
        gains: Sequence[tuple[int | None, int | None, int | None]] | None = None,
        torque_limits: Sequence[int | None] | None = None,
    ) -> None:
        """Make the writer; `lower`, `upper` (m,): counts that may be sent.

        `gains` (m): P, I, D each; None: as the servo has it. `torque_limits` (m): 0.1 %; None: register 16.
        Raises ValueError for bounds of the wrong shape or beyond the goal register.
        """
        self._reader = reader
        self._line = reader.line
        self._name = reader.name
        self._ids = reader.ids
        self._index = {id: place for place, id in enumerate(self._ids)}
        self._wanted_gains = dict(zip(self._ids, gains or (), strict=False))
        self._wanted_limits = dict(zip(self._ids, torque_limits or (), strict=False))
        self._gains: dict[int, tuple[int, ...]] = {}  # by id, of each prepared servo: P, D, I
        self._full: dict[int, int] = {}  # by id, of each prepared servo: torque limit
        self._led: Bools = np.ones(len(self._ids), np.bool_)
        self._on: Bools = np.zeros(len(self._ids), np.bool_)  # torque switched on by this writer
        reader.watchdog.watched = self._on
        self._version = -1  # of the slow registers that the choice of devices for goals rests on
        self.set_goal_limits(lower, upper)

    def set_goal_limits(self, lower: Ints, upper: Ints) -> None:
        """Set the range of the goals (m,) and drop pending goals. Raises ValueError; then nothing changes."""
        least, most = bounds_of(self._name, len(self._ids), lower, upper)
        maps = [self._reader.maps[id] for id in self._ids]
        for own, low, high in zip(maps, least.tolist(), most.tolist(), strict=True):
            if "goal_position" in own:
                for value in (low, high):
                    own["goal_position"].check(value)
        self._goals = GoalWords(
            self._name, GOAL[0], self._ids, [each.big_endian for each in maps], least, most
        )
        bounds = dict(zip(self._ids, zip(least.tolist(), most.tolist(), strict=True), strict=True))
        self._check = FeetechWriteCheck(self._name, self._reader.maps, bounds)
        self._version = -1
        self._line.goals = b""

    # --------------------------------------------------------------------------- every tick

    def goals(self, ticks: Ints) -> None:
        """Goals (m,) of the next `request`, to servos with torque. Raises WireRangeError, ValueError.

        A servo whose torque reads off has lost its supply, and one that was parked may have: it gets no goal,
        which could switch torque on. One that was silent for 0.1 s gets none until it is prepared.
        """
        self._line.goals = b""
        registers = self._reader.registers
        if registers.version != self._version:
            self._version = registers.version
            self._on &= registers.torque != 0
            well = (registers.torque == 1) & (registers.watchdog != TRIPPED) & ~self._reader.watchdog.overdue
            chosen = self._led & self._on & well
            if np.flatnonzero(chosen).tolist() != self._goals.places:
                self._goals.choose(chosen)
        self._line.goals = self._goals.encode(ticks)

    def cut(self) -> None:
        """Switch torque off on all devices in the next write of any kind; earlier goals are not sent."""
        self._line.urgent = OFF * 3  # it has no reply, and a packet may be lost
        self._line.goals = b""
        self._switched(False)

    def clear(self) -> None:
        """Drop pending goals. A pending cut stays: torque off is never refused."""
        self._line.goals = b""

    # --------------------------------------------------------------------------- the rare path

    def begin(self, order: Order, now: float) -> None:
        """Begin one order; the reader's `answer` ends it. Raises PortError, WireRangeError; TypeError."""
        exchange = self._exchange(order)
        self._check.judge(exchange.packet)
        self._line.send(exchange, now)

    def _exchange(self, order: Order) -> SerialTransaction:
        if isinstance(order, RebootRequest):
            return SerialTransaction(packet.instruction(order.id, FeetechInstruction.REBOOT), None, 0)
        if isinstance(order, WriteRequest) and len(order.data) == 1:
            [(id, data)] = order.data.items()
            return SerialTransaction(packet.write(id, order.address, data), ChecksumReply((id,), 0), 1)
        if isinstance(order, WriteRequest | GroupWriteBatch):
            each = (order,) if isinstance(order, WriteRequest) else order.writes
            packets = b"".join(packet.sync_write(one.address, one.data) for one in each)
            return SerialTransaction(packets, None, 0)
        raise TypeError(f"{self._name}: a writer does not read: {order}")

    # --------------------------------------------------------------------------- scripts

    def prepare(self, ticks: Ints, among: Bools | None = None) -> Script[None]:
        """Prepare devices for torque and read back each step; `among` (m,): these alone; None: all.

        Reads registers 0 to 70 and refuses what must not get torque (`objections`). Sets the goals to `ticks`
        (m,), the speed, the gains and a low torque limit; a servo that has torque gets its full limit back.

        Raises DeviceRefused, WireRangeError; NoReply after all other devices are prepared.
        """
        self._led = np.ones(len(self._ids), np.bool_) if among is None else among.copy()
        self._version = -1
        self.clear()
        self._goals.check(ticks)
        there = [id for id, led in zip(self._ids, self._led.tolist(), strict=True) if led]
        silent = None
        while there:
            try:
                yield from self._prepare(there, ticks)
                break
            except NoReply as error:
                silent = silent or error
                there = [id for id in there if id not in error.ids]
        if silent is not None:
            raise silent.with_traceback(None)

    def _prepare(self, ids: Sequence[int], ticks: Ints) -> Script[None]:
        state = yield from self._settings(ids)
        holding = {id for id in ids if state[id]["torque_enable"]}
        yield from self._set([(id, "lock", 1) for id in ids if not state[id]["lock"]])
        rows: list[Row] = []
        for id in ids:
            own = self._reader.maps[id]
            found = state[id]
            wish = self._wanted_limits.get(id)
            self._full[id] = min(found["max_torque"], 1000 if wish is None else wish)
            p, i, d = self._wanted_gains.get(id, (None, None, None))
            kept = self._gains.setdefault(id, tuple(found[name] for name in GAINS))
            self._gains[id] = tuple(a if b is None else b for a, b in zip(kept, (p, d, i), strict=True))
            rows += [(id, name, value) for name, value in zip(GAINS, self._gains[id], strict=True)]
            if "acceleration" in own:
                rows.append((id, "acceleration", 0))  # no limit: the executor shapes the motion
            if "torque_limit" in own and id not in holding:
                rows.append((id, "torque_limit", min(SOFT_START, self._full[id])))
            rows.append((id, "goal_velocity", SPEED[own.name]))
            rows.append((id, "goal_position", int(ticks[self._index[id]])))
        yield from self._set(rows)
        self._reader.watchdog.clear(np.isin(self._ids, ids))
        yield from self._set(self._limits(holding, 1.0))
        # Torque that another writer switched on is taken over: its goals leave from now on.
        self._on[[self._index[id] for id in holding]] = True
        self._version = -1

    def _settings(self, ids: Sequence[int]) -> Script[dict[int, dict[str, int]]]:
        """Read registers 0 to 70. Raises DeviceRefused for what must not get torque."""
        state: dict[int, dict[str, int]] = {id: {} for id in ids}
        for address, size in BLOCKS:
            for id, raw in (yield from self._reader.collect(ids, address, size)).items():
                own = self._reader.maps[id]
                if address == 0 and map_of_firmware(*raw[:3]).name != own.name:
                    reason = f"firmware {raw[0]}.{raw[1]} has not the registers of an {own.name.upper()}"
                    raise DeviceRefused(self._name, id, "arming", reason)
                state[id] |= own.values(address, raw)
        for id, found in state.items():
            place = self._index[id]
            own = self._reader.maps[id]
            turns = not own.big_endian and bool(
                self._goals.lower[place] < 0 or self._goals.upper[place] >= own.turn
            )
            reasons = objections(own, found, turns=turns)
            if reasons:
                raise DeviceRefused(self._name, id, "arming", "; ".join(reasons))
        return state

    def write_goals(self, ticks: Ints) -> Script[None]:
        """Write goals (m,), read them back. Raises WireRangeError, DeviceRefused for a difference."""
        self._goals.check(ticks)
        rows = zip(self._ids, ticks.tolist(), self._led.tolist(), strict=True)
        yield from self._set([(id, "goal_position", tick) for id, tick, led in rows if led])

    def read_goals(self) -> Script[Ints]:
        """Read the goals (m,) that the devices hold. Raises NoReply."""
        found = yield from self._reader.values(self._ids, *GOAL)
        return np.array([found[id]["goal_position"] for id in self._ids], np.int64)

    def torque(self, on: bool) -> Script[None]:
        """Switch torque of all devices and read it back. Raises DeviceRefused, NoReply.

        Off is written three times. On follows only after `prepare`; then the torque limit rises in steps.
        """
        for id in self._ids if on else ():
            if id not in self._full:
                raise DeviceRefused(self._name, id, "torque", "it is not prepared for torque")
        self._reader.registers.expire_torque(slice(None))
        self._switched(False)
        order = WriteRequest({id: bytes((on,)) for id in self._ids}, TORQUE)
        yield GroupWriteBatch((order,) if on else (order, order, order))
        found = yield from self._reader.collect(self._ids, TORQUE, 1)
        for id in self._ids:
            if found[id] != bytes((on,)):
                raise DeviceRefused(self._name, id, "torque enable (40)", f"reads {found[id][0]}, not {on:d}")
        self._switched(on)
        for share in RAMP if on else ():
            yield from self._set(self._limits(self._ids, share), verify=share == RAMP[-1])

    def damp(self) -> Script[tuple[int, ...]]:
        """Lower torque limit and gains (RAM copies); return the ids that did not confirm it."""
        ids = [id for id in self._ids if id in self._full]
        rows = self._limits(ids, SHARE)
        for id in ids:
            p, d, _ = self._gains[id]
            rows += [(id, name, value) for name, value in zip(GAINS, (p // SOFT, d, 0), strict=True)]
        bad = set(self._ids).difference(ids)
        while True:
            try:
                yield from self._set([row for row in rows if row[0] not in bad])
                return tuple(sorted(bad))
            except NoReply as error:
                bad |= set(error.ids)
            except DeviceRefused as error:
                bad.add(error.id)

    def begin_single_device(self, id: int, *, cap: int, profile: int) -> SingleDeviceControl:
        """Raise ValueError: a servo without a current mode cannot feel an endstop softly."""
        raise ValueError(f"{self._name}: id {id}: a Feetech servo has no mode with a limited current")

    def end_single_device(self) -> None:
        """Drop pending goals; no device is ever driven alone."""
        self.clear()

    def write(self, id: int, name: str, value: int) -> Script[RegisterAddress]:
        """Write one register by name and read it back. EPROM only while that device's torque is off.

        An EPROM register that already has the value is not written: its endurance is not known. Raises
        NoReply, DeviceRefused, KeyError, ValueError (name, range, read-only, not here).
        """
        field = self._reader.table(id)[name]
        if field.name in ELSEWHERE:
            raise ValueError(f"{field.name} is not written here: {ELSEWHERE[field.name]}")
        field.check(value)
        if not field.eprom:
            yield from self._write(id, field, value)
        elif (yield from self._reader.read(id, name)).value != value:
            yield from self._write_eprom(id, field, value)
        return RegisterAddress(field.name, field.address, field.size, value, field.eprom)

    def _write_eprom(self, id: int, field: FeetechRegister, value: int) -> Script[None]:
        if (yield from self._reader.read(id, "torque_enable")).value:
            reason = "is EPROM, written only while torque is off: disarm first"
            raise DeviceRefused(self._name, id, field.name, reason)
        lock = self._reader.maps[id]["lock"]
        self._check.unlocked = id
        try:
            yield from self._write(id, lock, 0)
            yield from self._write(id, field, value)
        finally:
            self._check.unlocked = None
            # A script that is closed here leaves the lock open; `prepare` closes it before torque.
        yield from self._write(id, lock, 1)
        yield from self._verify([(id, field.name, value)])

    def _write(self, id: int, field: FeetechRegister, value: int) -> Script[None]:
        reply = yield WriteRequest({id: field.encode(value)}, field.address)
        if id not in reply.error:
            raise NoReply(self._name, (id,), reply.waited, f"write of {field.name}")
        yield from self._verify([(id, field.name, value)])

    def reboot(self, id: int, *, shut_down: bool = False) -> Script[RestartResult]:
        """Restart one device, wait for its reply. All its RAM is default then: it must be prepared anew.

        Refused while torque enable reads on: the device may carry a load. `shut_down`: the device has
        unloaded by an error, which must read non-zero. Raises NoReply, KeyError, DeviceRefused.
        """
        self._reader.table(id)
        state = (yield from self._reader.values((id,), *BLOCKS[1]))[id]
        if state["torque_enable"] and not (shut_down and state["hardware_error_status"]):
            reason = "its torque is on and a restart would drop what it carries: disarm, then reboot"
            raise DeviceRefused(self._name, id, "reboot", reason)
        self._full.pop(id, None)
        self._on[self._index[id]] = False
        waited = (yield RebootRequest(id)).waited
        self._reader.slow.forget(id)
        for _ in range(BOOT_ATTEMPTS):
            reply = yield PingRequest(id)
            waited += reply.waited
            if id in reply.data:
                break
        else:
            raise NoReply(self._name, (id,), waited, f"{BOOT_ATTEMPTS} pings after a reboot")
        yield from self._write(id, self._reader.maps[id]["torque_enable"], 0)
        return RestartResult()

    # --------------------------------------------------------------------------- parts

    def _switched(self, on: bool) -> None:
        self._on.fill(on)
        self._version = -1

    def _limits(self, ids: Iterable[int], share: float) -> list[Row]:
        own = [id for id in ids if "torque_limit" in self._reader.maps[id]]
        return [(id, "torque_limit", int(self._full[id] * share)) for id in own]

    def _set(self, rows: Sequence[Row], *, verify: bool = True) -> Script[None]:
        """Write rows in one system call and read them back. Raises DeviceRefused, NoReply."""
        if not rows:
            return
        writes: dict[tuple[int, int], dict[int, bytes]] = {}
        for id, name, value in rows:
            field = self._reader.maps[id][name]
            writes.setdefault((field.address, field.size), {})[id] = field.encode(value)
        yield GroupWriteBatch(tuple(WriteRequest(data, where) for (where, _), data in writes.items()))
        if verify:
            yield from self._verify(rows)

    def _verify(self, rows: Sequence[Row]) -> Script[None]:
        """Read each row back, registers of one area of a device together."""
        wanted: dict[int, dict[str, int]] = {}
        for id, name, value in rows:
            wanted.setdefault(id, {})[name] = value
        spans: dict[tuple[int, int], list[int]] = {}
        for id, own in wanted.items():
            for span in _spans([self._reader.maps[id][name] for name in own]):
                spans.setdefault(span, []).append(id)
        for (address, size), ids in spans.items():
            found: Mapping[int, Mapping[str, int]] = yield from self._reader.values(ids, address, size)
            for id in ids:
                for name, value in found[id].items():
                    wish = wanted[id].get(name, value)
                    if wish != value:
                        raise DeviceRefused(self._name, id, name, f"wrote {wish}, reads {value}")


def _spans(fields: Sequence[FeetechRegister]) -> list[tuple[int, int]]:
    """Return one block (address, size) for the EPROM area and one for RAM, of those that `fields` lie in."""
    spans = []
    for eprom in (True, False):
        own = [each for each in fields if each.eprom is eprom]
        if own:
            first = min(each.address for each in own)
            spans.append((first, max(each.address + each.size for each in own) - first))
    return spans
