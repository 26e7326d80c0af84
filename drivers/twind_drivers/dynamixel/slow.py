"""The slowly read registers of one bus: which slice is next, and what a reply says of them. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from twind_drivers.bus import Read, Registers
from twind_drivers.dynamixel.budget import Upkeep
from twind_drivers.dynamixel.layout import Block, Layout
from twind_drivers.dynamixel.tables import Field, Table

VOLT = 0.1  # V per raw unit of the input voltage register


@dataclass(frozen=True, slots=True)
class Part:
    """A register within a block: which bytes of it, where they are kept, and their unit."""

    first: int
    last: int  # exclusive
    store: NDArray[Any]
    unit: float


@dataclass(frozen=True, slots=True)
class Plan:
    """What a block holds of these registers, and the times of the groups that are whole in it."""

    parts: tuple[Part, ...]
    times: tuple[NDArray[Any], ...]


class SlowRegisters:
    """Torque, hardware error, bus watchdog; voltage, temperature: of each id, with the time of reading."""

    def __init__(self, ids: tuple[int, ...], tables: Sequence[Table], layout: Layout, plan: Upkeep) -> None:
        self.registers = state = Registers.unknown(len(ids))
        self._index = {id: place for place, id in enumerate(ids)}
        fields = tables[0].fields  # one layout: the same addresses for all
        self._status: list[tuple[Field, NDArray[Any], float]] = [
            (fields["torque_enable"], state.torque, 1),
            (fields["hardware_error_status"], state.fault, 1),
            (fields["bus_watchdog"], state.watchdog, 1),
        ]
        self._health: list[tuple[Field, NDArray[Any], float]] = [
            (fields["present_input_voltage"], state.voltage, VOLT),
            (fields["present_temperature"], state.temperature, 1.0),
        ]
        self._plans: dict[tuple[int, int], Plan] = {}  # by address and size of the blocks read so far
        status = _slices(ids, plan.status, layout.status)
        health = _slices(ids, plan.health, layout.health)
        self._turns = _turns(status, health, plan.slots - 1)
        self.queries = [*status, *health]
        self._next = 0

    def next(self) -> Read:
        """The slice whose turn it is."""
        query = self._turns[self._next]
        self._next = (self._next + 1) % len(self._turns)
        return query

    def fold(self, query: Read, data: Mapping[int, bytes], time: float) -> None:
        """Keep what a reply says of these registers, whoever asked."""
        plan = self._plan(query.address, query.size)
        for id, raw in data.items():
            place = self._index.get(id)
            if place is None:
                continue
            for part in plan.parts:
                part.store[place] = int.from_bytes(raw[part.first : part.last], "little") * part.unit
            for when in plan.times:
                when[place] = time

    def _plan(self, address: int, size: int) -> Plan:
        plan = self._plans.get((address, size))
        if plan is None:
            block, parts, times = Block(address, size), [], []
            groups = ((self._status, self.registers.status_time), (self._health, self.registers.health_time))
            for fields, when in groups:
                found = [(block.offset(field), field.size, store, unit) for field, store, unit in fields]
                parts += [
                    Part(at, at + size, store, unit) for at, size, store, unit in found if at is not None
                ]
                if all(at is not None for at, _, _, _ in found):
                    times.append(when)
            plan = self._plans[address, size] = Plan(tuple(parts), tuple(times))
        return plan

    def forget(self, id: int) -> None:
        """A restarted device: what was read of it no longer holds."""
        place = self._index[id]
        for _, store, _ in (*self._status, *self._health):
            store[place] = -1
        self.registers.voltage[place] = self.registers.temperature[place] = float("nan")
        self.registers.tick[place] = -1
        self.registers.status_time[place] = self.registers.health_time[place] = float("-inf")


def _slices(ids: tuple[int, ...], count: int, block: Block) -> list[Read]:
    return [
        Read(ids[first : first + count], block.address, block.size) for first in range(0, len(ids), count)
    ]


def _turns(status: list[Read], health: list[Read], each: int) -> list[Read]:
    """`each` status turns, then one of health, and again until every health slice had its turn.

    Every round begins with the first status slice, so each device's turn comes every `each + 1` calls.
    """
    turns: list[Read] = []
    for one in health:
        turns += [status[k % len(status)] for k in range(each)]
        turns.append(one)
    return turns
