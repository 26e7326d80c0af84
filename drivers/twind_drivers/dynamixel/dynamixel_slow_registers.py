"""Slow registers of one bus: the order of their slices and the values from the replies. Pure.

They are read block by block, since their addresses lie apart. Adjacent indirect addresses would shorten the
longest slice of 24 servos at 100 Hz from 214 to 87 bytes (fast) and from 296 to 114 (plain). That saves
1.3 ms of a 10 ms tick at 1 Mbaud and 0.4 ms at 3. It is not done: the tick has that time, and a mirror writes
nothing, so it needs the blocks anyway. A restart of a servo also drops the map without notice, just when
these registers matter.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import ReadRequest, SlowRegisterValues
from twind_drivers.dynamixel.control_tables import ControlTable
from twind_drivers.dynamixel.device_layout import DeviceLayout, RegisterBlock
from twind_drivers.dynamixel.error_codes import BITS_BY_CODE
from twind_drivers.dynamixel.serial_cycle_budget import SlowReadSchedule

CODES = np.array(BITS_BY_CODE, np.int16)

Kept = tuple[str, NDArray[Any], float]  # register, array (m,) of its values, unit
Blocks = tuple[RegisterBlock, ...]


@dataclass(frozen=True, slots=True)
class BlockField:
    """Register within a block: its bytes, the array (m,) of its values, its unit."""

    first: int
    last: int  # exclusive
    store: NDArray[Any]
    unit: float
    codes: bool = False  # an error code, whose bits are kept


@dataclass(frozen=True, slots=True)
class BlockDecodePlan:
    """Slow registers in a block, and the time arrays of the groups that are whole in it."""

    parts: tuple[BlockField, ...]
    times: tuple[NDArray[Any], ...]


class DynamixelSlowRegisters:
    """Slow registers of each id with the time of reading.

    They are torque, hardware error, watchdog; voltage, temperature, tick.
    """

    def __init__(
        self, ids: tuple[int, ...], tables: Sequence[ControlTable], layouts: Sequence[DeviceLayout]
    ) -> None:
        """Make the registers of `ids`; `tables`, `layouts` (m): of each id."""
        self.registers = state = SlowRegisterValues.unknown(len(ids))
        self._state_time, self._watch_time, self._fault_time = np.full((3, len(ids)), -np.inf)
        self._index = {id: place for place, id in enumerate(ids)}
        self._layouts = tuple(layouts)
        self._tables = dict(zip(layouts, tables, strict=True))
        torque = ("torque_enable", state.torque, 1)
        fault = ("hardware_error_status", state.fault, 1)
        watchdog = ("bus_watchdog", state.watchdog, 1)
        tick = ("realtime_tick", state.tick, 1)
        voltage = ("present_input_voltage", state.voltage, np.nan)  # its unit depends on the model
        temperature = ("present_temperature", state.temperature, 1.0)
        others = ((self._watch_time, (watchdog,)), (state.health_time, (voltage, temperature, tick)))
        self._groups: tuple[tuple[NDArray[Any], tuple[Kept, ...]], ...] = (
            (self._state_time, (torque, fault)),
            *others,
        )
        # of a layout in which torque and hardware error lie apart
        self._split_groups = ((self._state_time, (torque,)), (self._fault_time, (fault,)), *others)
        # of the blocks read so far, by place of the layout, address and size: layouts are slow to hash
        self._plans: dict[tuple[int, int, int], BlockDecodePlan] = {}
        distinct = list(dict.fromkeys(layouts))
        self._distinct = tuple(distinct)
        self._apart = tuple(len(layout.status) > 1 for layout in distinct)
        self._kind = tuple(distinct.index(layout) for layout in layouts)  # (m,) place of each device's layout
        self._wide: list[ReadRequest] = []
        self._narrow: list[ReadRequest] = []
        self._health: list[ReadRequest] = []
        # next slot and number of slots of a round; next slice of health
        self._slot = 0
        self._slots = 1
        self._is_narrow = False  # the present round reads narrow slices
        self._turn = 0
        self._first: list[ReadRequest] = []  # before all turns
        self._open: ReadRequest | None = None  # health slice with replies missing

    def schedule(
        self, ids: Sequence[int], wide: SlowReadSchedule, narrow: SlowReadSchedule | None = None
    ) -> list[ReadRequest]:
        """Schedule the slices of these `ids` round robin; return all slices.

        `narrow`: the schedule while replies are missing, with the same health slices; None: as `wide`.
        """
        kinds: dict[DeviceLayout, list[int]] = {}
        for id in ids:
            kinds.setdefault(self._layouts[self._index[id]], []).append(id)

        def slices(size: int, blocks: Callable[[DeviceLayout], Blocks]) -> list[ReadRequest]:
            """Split the reads of `blocks` into slices of `size` devices, layout by layout."""
            return [
                read
                for layout, own in kinds.items()
                for block in blocks(layout)
                for read in _slices(own, size, block)
            ]

        def status(plan: SlowReadSchedule) -> list[ReadRequest]:
            """Return the status slices of a round."""
            if not plan.watch:
                return slices(plan.state, lambda layout: layout.status)
            watched = slices(plan.watch, lambda layout: (layout.watchdog,))
            return [*slices(plan.state, lambda layout: layout.state), *watched]

        self._health = slices(wide.health, lambda layout: (layout.health,))
        self._wide = status(wide)
        self._narrow = self._wide if narrow is None else status(narrow)
        self._open = None
        self._slot = 0
        self._is_narrow = False
        self._slots = max(wide.slots - 1, len(self._wide), len(self._narrow)) + 1
        self._turn = 0
        return list(dict.fromkeys((*self._wide, *self._narrow, *self._health)))

    def ask_first(self, id: int) -> None:
        """Schedule all slow registers of a returned device first: it may have restarted."""
        layout = self._layouts[self._index[id]]
        self._first += [
            ReadRequest((id,), block.address, block.size) for block in (*layout.status, layout.health)
        ]

    def next(self, *, narrow: bool = False) -> ReadRequest | None:
        """Return the next slice; None: nothing is due in this turn.

        A round consists of all status slices that fit, then one health slice. It begins with the first status
        slice, so each device has its turn once a round. A round with less slices than turns rests in between.
        A round that has turned narrow stays narrow: a change back would leave devices out.
        """
        if self._first:
            return self._first.pop(0)
        slot = self._slot
        self._slot = (self._slot + 1) % self._slots
        self._is_narrow = narrow or (self._is_narrow and slot > 0)
        if slot == self._slots - 1:
            return self._next_health()
        status = self._narrow if self._is_narrow else self._wide
        return status[slot] if slot < len(status) else None

    def _next_health(self) -> ReadRequest:
        """Return the next health slice; one with missing replies is repeated in the next round.

        Its regular turn comes every 0.2 s. A fault of the same period would otherwise hit the same slice each
        time.
        """
        query = self._open
        self._open = None
        if query is None:
            query = self._open = self._health[self._turn]
            self._turn = (self._turn + 1) % len(self._health)
        return query

    def update_from_replies(
        self, query: ReadRequest, ids: Sequence[int], data: NDArray[np.uint8], time: float
    ) -> None:
        """Store the registers from the replies of `ids` (k) to `query`, `data` (k, size) bytes."""
        if query is self._open and len(ids) == len(query.ids):
            self._open = None
        self.registers.version += 1
        for kind, rows in self._kinds(ids):
            plan = self._plan(kind, query.address, query.size)
            if not plan.parts:
                continue
            places = np.array([self._index[ids[row]] for row in rows], np.intp)
            own = data if len(rows) == len(ids) else data[rows]
            for part in plan.parts:
                raw: NDArray[Any] = (
                    own[:, part.first] if part.last - part.first == 1 else _words(own[:, part.first :])
                )
                if part.codes:
                    raw = CODES[raw]
                part.store[places] = raw if part.unit == 1 else raw * part.unit
            for when in plan.times:
                when[places] = time
            both = np.minimum(self._state_time[places], self._watch_time[places])
            if self._apart[kind]:
                both = np.minimum(both, self._fault_time[places])
            self.registers.status_time[places] = both

    def _kinds(self, ids: Sequence[int]) -> list[tuple[int, list[int]]]:
        """Group the rows of `ids` by the place of their layout; ids of no device of this bus are left out."""
        if len(self._distinct) == 1 and self._index.keys() >= set(ids):
            return [(0, list(range(len(ids))))]
        kinds: dict[int, list[int]] = {}
        for row, id in enumerate(ids):
            if id in self._index:
                kinds.setdefault(self._kind[self._index[id]], []).append(row)
        return list(kinds.items())

    def _plan(self, kind: int, address: int, size: int) -> BlockDecodePlan:
        plan = self._plans.get((kind, address, size))
        if plan is None:
            block = RegisterBlock(address, size)
            table = self._tables[self._distinct[kind]]
            parts = []
            times = []
            for when, kept in self._split_groups if self._apart[kind] else self._groups:
                found = [(block.offset(table.fields[name]), name, store, unit) for name, store, unit in kept]
                parts += [
                    _block_field(table, name, at, store, unit)
                    for at, name, store, unit in found
                    if at is not None
                ]
                if all(at is not None for at, _, _, _ in found):
                    times.append(when)
            plan = self._plans[kind, address, size] = BlockDecodePlan(tuple(parts), tuple(times))
        return plan

    def forget(self, id: int) -> None:
        """Reset the values of a restarted device to unknown."""
        place = self._index[id]
        state = self.registers
        state.version += 1
        for store in (state.torque, state.fault, state.watchdog, state.tick):
            store[place] = -1
        for values in (state.voltage, state.temperature):
            values[place] = np.nan
        times = (self._state_time, self._watch_time, self._fault_time)
        for when in (*times, state.status_time, state.health_time):
            when[place] = -np.inf


def _block_field(table: ControlTable, name: str, at: int, store: NDArray[Any], unit: float) -> BlockField:
    """Return the field at offset `at`. The low byte of a watchdog of 2 bytes tells all: 255 has tripped."""
    field = table.fields[name]
    size = 1 if name == "bus_watchdog" else field.size
    own = table.facts.volts_per_count if name == "present_input_voltage" else unit
    return BlockField(at, at + size, store, own, field.rule.codes is not None)


def _words(data: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return the first two bytes of each row of `data` (k, size) as numbers (k,)."""
    return np.ascontiguousarray(data[:, :2]).view("<u2")[:, 0]


def _slices(ids: Sequence[int], count: int, block: RegisterBlock) -> list[ReadRequest]:
    spans = (tuple(ids[first : first + count]) for first in range(0, len(ids), count))
    return [ReadRequest(own, block.address, block.size) for own in spans]
