"""Writer of a bus of serial servos without a watchdog, the part that the families share.

Goals, torque with a limit that rises in steps, registers by name. Every write is read back. A family adds how
a servo is prepared, how registers that survive power-off are written, and how it restarts.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import ClassVar

import numpy as np

from twind_drivers.bus import (
    TRIPPED,
    Bools,
    DeviceRefused,
    GroupWriteBatch,
    Ints,
    NoReply,
    Order,
    RebootRequest,
    Script,
    WriteRequest,
)
from twind_drivers.device_registers import RegisterAddress, RestartResult
from twind_drivers.half_duplex.goal_bounds import bounds_of
from twind_drivers.half_duplex.goal_words import GoalEncoder, GoalWords
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_drivers.half_duplex.register_reader import RegisterReader
from twind_drivers.half_duplex.register_restart import reboot, require_unloaded
from twind_drivers.half_duplex.register_table import MappedRegister, spans_of
from twind_drivers.half_duplex.register_write_check import RegisterWriteCheck
from twind_drivers.single_device import SingleDeviceControl

RAMP = (0.5, 0.75, 1.0)  # of the full torque limit, after torque on
SHARE = 0.3  # of the full torque limit: at torque on, and what damping leaves
Row = tuple[int, str, int]  # id, register, value


class RegisterWriter:
    """Writer to the bus of `reader`. Arrays are (m,), in the order of its ids; goals in counts."""

    GOAL: tuple[int, int]  # address and size
    TORQUE: int  # address
    LIMIT = "torque_limit"  # RAM register that caps the torque
    # Registers that `write` refuses, with the reason: other paths own them, or the device would be lost.
    ELSEWHERE: ClassVar[Mapping[str, str]]

    def __init__(self, reader: RegisterReader, *, lower: Ints, upper: Ints) -> None:
        """Make the writer; `lower`, `upper` (m,): counts that may be sent.

        Raises ValueError for bounds of the wrong shape or beyond the goal register.
        """
        self._bus = reader
        self._line = reader.line
        self._name = reader.name
        self._ids = reader.ids
        self._index = {id: place for place, id in enumerate(self._ids)}
        self._full: dict[int, int] = {}  # by id, of each prepared servo: torque limit ...
        self._gains: dict[int, dict[str, int]] = {}  # ... and gains
        self._aimed: set[int] = set()  # ids with a goal since they were prepared
        self._soft: set[int] = set()  # ids that damping has softened since
        self._led: Bools = np.ones(len(self._ids), np.bool_)
        self._on: Bools = np.zeros(len(self._ids), np.bool_)  # torque switched on by this writer
        self._dropped: Bools = np.zeros(len(self._ids), np.bool_)  # its torque read off since
        reader.watchdog.watched = self._on
        self.set_goal_limits(lower, upper)

    def set_goal_limits(self, lower: Ints, upper: Ints) -> None:
        """Set the range of the goals (m,) and drop pending goals. Raises ValueError; then nothing changes."""
        least, most = bounds_of(self._name, len(self._ids), lower, upper)
        tables = [self._bus.tables[id] for id in self._ids]
        for own, low, high in zip(tables, least.tolist(), most.tolist(), strict=True):
            for value in (low, high) if "goal_position" in own else ():
                own["goal_position"].check(value)
        self._goals = self._make_goals(least, most)
        bounds = dict(zip(self._ids, zip(least.tolist(), most.tolist(), strict=True), strict=True))
        self._check = self._make_check(bounds)
        # Of the slow registers that the choice of devices for goals rests on; None: they are chosen anew.
        self._version: int | None = None
        self._line.goals = b""

    # --------------------------------------------------------------------------- every tick

    def goals(self, ticks: Ints) -> None:
        """Goals (m,) of the next `request`, to servos with torque. Raises WireRangeError, ValueError.

        A servo whose torque reads off has lost its supply, and one that was parked may have: it gets no goal,
        which could switch torque on. One whose torque then reads on again counts as tripped.
        One that was silent for 0.1 s gets none until it is prepared.
        """
        self._line.goals = b""
        registers = self._bus.registers
        if registers.version != self._version:
            self._dropped |= self._on & (registers.torque == 0)
            self._on &= ~self._dropped
            registers.trip(self._dropped & (registers.torque == 1))
            self._version = registers.version
            well = (registers.torque == 1) & (registers.watchdog != TRIPPED) & ~self._bus.watchdog.overdue
            chosen = self._led & self._on & well
            if np.flatnonzero(chosen).tolist() != self._goals.places:
                self._goals.choose(chosen)
        self._line.goals = self._goals.encode(ticks)

    def cut(self) -> None:
        """Switch torque off on all devices in the next write of any kind; earlier goals are not sent."""
        self._line.urgent = self._off() * 3  # it has no reply, and a packet may be lost
        self._line.goals = b""
        self._mark_energised(self._ids, False)

    def clear(self) -> None:
        """Drop pending goals. A pending cut stays: torque off is never refused."""
        self._line.goals = b""

    def begin(self, order: Order, now: float) -> None:
        """Begin one order; the reader's `answer` ends it. Raises PortError, WireRangeError; TypeError."""
        exchange = self._exchange(order)
        self._check.judge(exchange.packet)
        self._line.send(exchange, now)

    def _exchange(self, order: Order) -> SerialTransaction:
        if isinstance(order, RebootRequest):
            return self._restart(order)
        if isinstance(order, WriteRequest) and len(order.data) == 1:
            [(id, data)] = order.data.items()
            codec = self._bus.codec
            return SerialTransaction(codec.write(id, order.address, data), codec.confirmation((id,), 0), 1)
        if isinstance(order, WriteRequest | GroupWriteBatch):
            each = (order,) if isinstance(order, WriteRequest) else order.writes
            packets = b"".join(self._bus.codec.sync_write(one.address, one.data) for one in each)
            return SerialTransaction(packets, None, 0)
        raise TypeError(f"{self._name}: a writer does not read: {order}")

    # --------------------------------------------------------------------------- scripts

    def prepare(self, ticks: Ints, among: Bools | None = None) -> Script[None]:
        """Prepare devices for torque and read back each step; `among` (m,): these alone; None: all.

        Refuses what must not get torque. Sets the speed, the gains and a low torque limit. A servo that has
        torque gets `ticks` (m,) as its goal and its full limit back. One without gets its goal by
        `write_goals` alone: these steps take up to 0.2 s, and a goal that is so old may switch torque on.

        Raises DeviceRefused, WireRangeError; NoReply after all other devices are prepared. A device that this
        writer holds and that refuses is left out like a silent one: the others can be lowered.
        """
        self._led = np.ones(len(self._ids), np.bool_) if among is None else among.copy()
        self._version = None
        self.clear()
        self._goals.check(ticks)
        there = self._led_ids()
        silent = None
        self._aimed.difference_update(there)
        while there:
            try:
                holding = yield from self._prepare(there, ticks)
                yield from self._set(self._limits(holding, 1.0))
                self._mark_energised(holding, True)
                self._aimed |= holding
                self._bus.watchdog.clear(np.isin(self._ids, there))
                self._soft.difference_update(there)
                break
            except NoReply as error:
                silent = error.joined(silent)
                there = [id for id in there if id not in error.ids]
            except DeviceRefused as error:
                if not self._on[self._index[error.id]]:
                    raise
                silent = NoReply(self._name, (error.id,), 0.0, f"preparation ({error})").joined(silent)
                there = [id for id in there if id != error.id]
        if silent is not None:
            raise silent.with_traceback(None)

    def write_goals(self, ticks: Ints) -> Script[None]:
        """Write goals (m,), read them back. Raises WireRangeError, DeviceRefused for a difference."""
        self._goals.check(ticks)
        ids = self._led_ids()
        yield from self._set([self._goal_row(id, ticks) for id in ids])
        self._aimed.update(ids)

    def read_goals(self) -> Script[Ints]:
        """Read the goals (m,) that the devices hold. Raises NoReply."""
        found = yield from self._bus.values(self._ids, *self.GOAL)
        return np.array([found[id]["goal_position"] for id in self._ids], np.int64)

    def torque(self, on: bool) -> Script[None]:
        """Switch torque off in all devices, or on in those that were prepared; read it back.

        Off is written three times. On raises the torque limit in steps. Raises DeviceRefused, NoReply.
        """
        ids = self._led_ids() if on else self._ids
        if not ids:
            return
        for id in ids if on else ():
            if id not in self._full:
                raise DeviceRefused(self._name, id, "torque", "it is not prepared for torque")
            if id not in self._aimed:
                raise DeviceRefused(self._name, id, "torque", "it got no goal since it was prepared")
        self._bus.registers.expire_torque(slice(None))
        self._mark_energised(self._ids, False)
        order = (WriteRequest({id: bytes((on,)) for id in ids}, self.TORQUE),) * (1 if on else 3)
        yield GroupWriteBatch(order)
        try:
            found = yield from self._bus.collect(ids, self.TORQUE, 1)
            for id in ids:
                if found[id] != bytes((on,)):
                    where = f"torque enable ({self.TORQUE})"
                    raise DeviceRefused(self._name, id, where, f"reads {found[id][0]}, not {on:d}")
        except (NoReply, DeviceRefused):
            if not on:  # the order goes again at once: restoring gains takes time until the caller repeats it
                yield from self._restore_gains(self._limp_ids(), order)
            raise
        self._mark_energised(ids, on)
        if not on:
            yield from self._restore_gains(ids)
        for share in RAMP if on else ():
            yield from self._set(self._limits(ids, share), verify=share == RAMP[-1])

    def damp(self) -> Script[tuple[int, ...]]:
        """Lower torque limit and gains (RAM copies); return the ids that did not confirm it.

        A servo without torque is left alone: a torque limit may switch on one that its alarm has shut down.
        """
        limp = self._limp_ids()
        ids = [id for id in self._ids if id in self._full and id not in limp]
        rows = [*self._limits(ids, SHARE), *(row for id in ids for row in self._soft_gains(id))]
        bad = set(self._ids).difference(ids, limp)
        self._soft.update(ids)
        while True:
            try:
                before = self._writes(self._before_gains([id for id in ids if id not in bad]))
                yield from self._set([row for row in rows if row[0] not in bad], before)
                return tuple(sorted(bad))
            except NoReply as error:
                bad |= set(error.ids)
            except DeviceRefused as error:
                bad.add(error.id)

    def begin_single_device(self, id: int, *, cap: int, profile: int) -> SingleDeviceControl:
        """Raise ValueError: a servo without a current mode cannot feel an endstop softly."""
        raise ValueError(f"{self._name}: id {id}: this servo has no mode with a limited current")

    def end_single_device(self) -> None:
        """Drop pending goals; no device is ever driven alone."""
        self.clear()

    def reboot(self, id: int, *, shut_down: bool = False) -> Script[RestartResult]:
        """Restart one device, wait for its reply. All its RAM is default then: it must be prepared anew.

        Refused while torque enable reads on: the device may carry a load. `shut_down`: the device has
        unloaded by an error, which must read non-zero. Raises NoReply, KeyError, DeviceRefused.
        """
        yield from require_unloaded(self._bus, id, shut_down=shut_down)
        self._full.pop(id, None)
        self._soft.discard(id)
        self._on[self._index[id]] = False
        yield from reboot(self._bus, id)
        yield from self._write(id, self._bus.table(id)["torque_enable"], 0)
        return RestartResult()

    def write(self, id: int, name: str, value: int) -> Script[RegisterAddress]:
        """Write one register by name and read it back. EEPROM only while that device's torque is off.

        An EEPROM register that already has the value is not written: its endurance is not known. Raises
        NoReply, DeviceRefused, KeyError, ValueError (name, range, read-only, not here).
        """
        field = self._bus.table(id)[name]
        if field.name in self.ELSEWHERE:
            raise ValueError(f"{field.name} is not written here: {self.ELSEWHERE[field.name]}")
        field.check(value)
        if not field.kept:
            yield from self._write(id, field, value)
        elif (yield from self._bus.read(id, name)).value != value:
            if (yield from self._bus.read(id, "torque_enable")).value:
                reason = "is EEPROM, written only while torque is off: disarm first"
                raise DeviceRefused(self._name, id, field.name, reason)
            yield from self._write_kept(id, field, value)
        if id in self._soft and field.name in self._gains[id]:
            self._gains[id][field.name] = value  # what torque off restores
        return RegisterAddress(field.name, field.address, field.size, value, field.kept)

    # --------------------------------------------------------------------------- parts

    def _gain_rows(self, id: int, found: Mapping[str, int], wanted: Mapping[str, int]) -> list[Row]:
        """Choose the gains of a servo: `wanted`, the others as `found`, or as they were before damping."""
        self._gains[id] = {**found, **(self._gains[id] if id in self._soft else {}), **wanted}
        return [(id, name, value) for name, value in self._gains[id].items()]

    def _restore_gains(self, limp: Collection[int], before: Sequence[WriteRequest] = ()) -> Script[None]:
        """Undo damping of servos without torque: the next writer would take soft gains for their own.

        `before`: orders that go out first, where there is anything to undo.
        """
        with suppress(NoReply, DeviceRefused):  # torque off does not depend on it
            soft = [id for id in limp if id in self._soft]
            rows = [(id, *gain) for id in soft for gain in self._gains[id].items()]
            yield from self._set(rows, (*before, *self._writes(self._before_gains(soft))))
            self._soft.difference_update(soft)

    def _limp_ids(self) -> list[int]:
        """Return the ids of the devices whose torque reads off."""
        return [id for id, on in zip(self._ids, self._bus.registers.torque.tolist(), strict=True) if on == 0]

    def _led_ids(self) -> list[int]:
        """Return the ids of the devices that `prepare` chose."""
        return [id for id, led in zip(self._ids, self._led.tolist(), strict=True) if led]

    def _mark_energised(self, ids: Collection[int], on: bool) -> None:
        """Note whether this writer has switched torque of `ids` on: goals leave for no others."""
        self._on[places := [self._index[id] for id in ids]] = on
        self._dropped[places] = False
        self._version = None

    def _goal_row(self, id: int, ticks: Ints) -> Row:
        """Return the goal of a device; `ticks` (m,): of all."""
        return (id, "goal_position", int(ticks[self._index[id]]))

    def _limits(self, ids: Iterable[int], share: float) -> list[Row]:
        own = [id for id in ids if self.LIMIT in self._bus.tables[id]]
        return [(id, self.LIMIT, int(self._full[id] * share)) for id in own]

    def _write(self, id: int, field: MappedRegister, value: int) -> Script[None]:
        reply = yield WriteRequest({id: field.encode(value)}, field.address)
        if id not in reply.error:
            raise NoReply(self._name, (id,), reply.waited, f"write of {field.name}")
        yield from self._verify([(id, field.name, value)])

    def _set(
        self, rows: Sequence[Row], before: Sequence[WriteRequest] = (), *, verify: bool = True
    ) -> Script[None]:
        """Write rows, after `before`, in one system call; read rows back. Raises DeviceRefused, NoReply."""
        if not rows:
            return
        yield GroupWriteBatch((*before, *self._writes(rows)))
        if verify:
            yield from self._verify(rows)

    def _writes(self, rows: Sequence[Row]) -> list[WriteRequest]:
        """Return the group writes of rows, one for each register."""
        writes: dict[tuple[int, int], dict[int, bytes]] = {}
        for id, name, value in rows:
            field = self._bus.tables[id][name]
            writes.setdefault((field.address, field.size), {})[id] = field.encode(value)
        return [WriteRequest(data, where) for (where, _), data in writes.items()]

    def _verify(self, rows: Sequence[Row]) -> Script[None]:
        """Read each row back, registers of one area of a device together."""
        wanted: dict[int, dict[str, int]] = {id: {} for id, _, _ in rows}
        for id, name, value in rows:
            wanted[id][name] = value
        spans: dict[tuple[int, int], list[int]] = {}
        for id, own in wanted.items():
            for span in spans_of([self._bus.tables[id][name] for name in own]):
                spans.setdefault(span, []).append(id)
        for (address, size), ids in spans.items():
            found: Mapping[int, Mapping[str, int]] = yield from self._bus.values(ids, address, size)
            for id in ids:
                for name, value in found[id].items():
                    wish = wanted[id].get(name, value)
                    if wish != value:
                        raise DeviceRefused(self._name, id, name, f"wrote {wish}, reads {value}")

    def _off(self) -> bytes:
        """Return the packet that switches torque of all devices off."""
        return self._bus.codec.write(self._bus.codec.broadcast, self.TORQUE, b"\0")

    # ------------------------------------------------------------------------- what a family answers

    def _make_goals(self, least: Ints, most: Ints) -> GoalEncoder:
        """Return the encoder of the goals within `least`..`most` (m,)."""
        big = [self._bus.tables[id].is_big_endian for id in self._ids]
        return GoalWords(self._name, self.GOAL[0], self._ids, big, least, most)

    def _make_check(self, bounds: Mapping[int, tuple[int, int]]) -> RegisterWriteCheck:
        """Return the last check of packets; `bounds`: range of the goals by id."""
        return RegisterWriteCheck(self._name, self._bus.tables, bounds, self._off())

    def _prepare(self, ids: Sequence[int], ticks: Ints) -> Script[set[int]]:
        """Prepare these devices for torque; set `_full` of each. Return those that have torque.

        `ticks` (m,): goals of these, by the rows of all.
        """
        raise NotImplementedError

    def _soft_gains(self, id: int) -> list[Row]:
        """Return the rows that damp a prepared device."""
        raise NotImplementedError

    def _before_gains(self, ids: Sequence[int]) -> list[Row]:
        """Return the rows without which gains of `ids` might be written beyond their RAM copies."""
        return []

    def _write_kept(self, id: int, field: MappedRegister, value: int) -> Script[None]:
        """Write a register that survives power-off, of a device without torque, and read it back."""
        raise NotImplementedError

    def _restart(self, order: RebootRequest) -> SerialTransaction:
        """Return the transaction of a restart; by default there is none."""
        raise TypeError(f"{self._name}: these servos have no restart: {order}")
