"""Register memory of all servos of one bus: one byte array, each register as numbers over all servos."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind_drivers.dynamixel.control_tables import ControlTable, TableRegister, table
from twind_drivers.virtual import indirect_addresses

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]
ASSUMED: Mapping[str, int] = {"velocity_i_gain": 1920, "velocity_p_gain": 100, "position_p_gain": 800}
LIVE = ("present_", "realtime_", "moving", "position_trajectory", "velocity_trajectory")
LIVELIEST = ("present_current", "present_velocity", "present_position")


def factory(field: TableRegister, number: int) -> int:
    """The value of `field` in a new servo of model `number`. What its page leaves open is assumed here alone.

    A goal boots as the limit that bounds it, as the X series' do; gains are those of a 4096 count servo.
    """
    if field.rule.default is not None:
        return field.rule.default
    if field.key in ("goal_pwm", "goal_current"):
        return table(number)[field.rule.limit or field.key].rule.default or 0
    return ASSUMED.get(field.key, 0)


class RegisterColumn:
    """One register of all servos. Where every servo has it at one address, `get` is a view of the memory.

    `sizes`: bytes of it in each table, unsigned where they differ. The upper bytes that a table lacks lie at
    `spare`, and are 0.
    """

    def __init__(
        self,
        memory: NDArray[np.uint8],
        addresses: Sequence[int],
        sizes: Sequence[int],
        spare: int,
        *,
        signed: bool,
    ) -> None:
        size = max(sizes)
        kind = f"<{'i' if signed else 'u'}{size}"
        alike = len(set(addresses)) == 1 and len(set(sizes)) == 1
        self.address = addresses[0] if alike else -1  # -1: not the same for all
        self._memory = memory
        places = np.asarray(addresses, np.intp)[:, None] + np.arange(size)
        self._bytes = np.where(np.arange(size) < np.asarray(sizes)[:, None], places, spare)
        self._rows = np.arange(len(memory))[:, None]
        self._kind = kind
        self._view: NDArray[Any] | None = None
        if self.address >= 0:
            self._view = memory[:, self.address : self.address + size].view(kind)[:, 0]

    def get(self) -> NDArray[Any]:
        """(m,) values; do not write to it."""
        if self._view is not None:
            return self._view
        gathered: NDArray[Any] = self._memory[self._rows, self._bytes].view(self._kind)
        return gathered[:, 0]

    def put(self, values: Any, rows: Any = slice(None)) -> None:
        """Write `values`, all of them or of `rows`."""
        if self._view is not None:
            self._view[rows] = values
            return
        count = self._rows[rows].shape[0]
        raw = np.ascontiguousarray(np.broadcast_to(values, (count,)), self._kind)
        self._memory[self._rows[rows], self._bytes[rows]] = raw.view(np.uint8).reshape(count, raw.itemsize)


class MemoryLayout:
    """The registers that one model has with one firmware, and what single bytes of its table are."""

    def __init__(self, table: ControlTable, firmware: int) -> None:
        self.fields = _fields(table, firmware)  # by address; where two names share one, they are one register
        self.rows = indirect_addresses.rows(table)
        self.end = max(field.end for field in self.fields.values())
        self.defined = np.zeros(self.end, np.bool_)  # (end,) does a register hold this byte?
        self.live = np.zeros(self.end, np.uint8)  # (end,) see `RegisterMemory.live`
        for field in self.fields.values():
            self.defined[field.address : field.end] = True
            live = 1 if field.key in LIVELIEST else 2 if field.key.startswith(LIVE) else 0
            self.live[field.address : field.end] = live
        self._fresh = np.zeros(self.end, np.uint8)
        for field in self.fields.values():
            value = np.frombuffer(field.encode(factory(field, table.number)), np.uint8)
            self._fresh[field.address : field.end] = value
        self._eeprom = np.zeros(self.end, np.bool_)
        for field in self.fields.values():
            self._eeprom[field.address : field.end] = field.eeprom

    def fresh(self, held: Bytes, *, eeprom: bool) -> Bytes:
        """(end,) A table as delivered, but where `eeprom` is False with the EEPROM bytes of `held`."""
        return self._fresh.copy() if eeprom else np.where(self._eeprom, held[: self.end], self._fresh)


@cache
def _layout(number: int, firmware: int) -> MemoryLayout:
    """Return the layout of a model, made once: it is never written."""
    return MemoryLayout(table(number, firmware), firmware)


class RegisterMemory:
    """Memory of (m, size) bytes.

    A register that a model lacks lies behind its table, out of reach of packets.

    `where` (m, size): index of byte `address` of each servo. It differs only for indirect data, and through
    one indirect address only: an entry that points at the data of another reads its byte.
    """

    def __init__(self, tables: Sequence[ControlTable], firmwares: Sequence[int]) -> None:
        self.tables = tuple(tables)
        self.firmwares = tuple(firmwares)
        self._layouts = tuple(
            _layout(table.number, firmware) for table, firmware in zip(tables, firmwares, strict=True)
        )
        self.layouts: tuple[Mapping[int, TableRegister], ...] = tuple(each.fields for each in self._layouts)
        self._hidden = max(each.end for each in self._layouts)
        self.raw = np.zeros((len(tables), self._hidden + 320), np.uint8)
        self.where = np.broadcast_to(np.arange(self.raw.shape[1]), self.raw.shape).copy()

    def column(self, key: str, size: int, *, signed: bool = False) -> RegisterColumn:
        """The register `key` of all servos; `size` and `signed` stand for it where a model lacks it."""
        fields = [table.fields.get(key) for table in self.tables]
        present = [field for field in fields if field is not None]
        spare = self._hidden
        if present:
            size = max(field.size for field in present)
            signed = present[0].rule.signed
        uneven = any(field.size < size for field in present)
        if len(present) < len(fields) or uneven:
            self._hidden += size
        addresses = [spare if field is None else field.address for field in fields]
        sizes = [size if field is None else field.size for field in fields]
        return RegisterColumn(self.raw, addresses, sizes, spare, signed=signed)

    def fill(self, row: int, *, eeprom: bool = True) -> None:
        """Factory values in every register of one servo; `eeprom` False: in RAM only."""
        layout = self._layouts[row]
        self.raw[row, : layout.end] = layout.fresh(self.raw[row], eeprom=eeprom)
        self.remap(row)

    def fresh(self, row: int) -> Bytes:
        """A table as delivered."""
        return self._layouts[row].fresh(self.raw[row], eeprom=True)

    def remap(self, row: int) -> None:
        """An indirect address of one servo changed: its data lies elsewhere."""
        last = self._layouts[row].end - 1
        for each in self._layouts[row].rows:
            words = self.raw[row, each.address : each.address + 2 * each.entries].view("<u2")
            self.where[row, each.data : each.data + each.entries] = np.minimum(words, last)

    def store(self, row: int, field: TableRegister, value: int) -> None:
        """Put one value, without any rule."""
        self.raw[row, field.address : field.end] = np.frombuffer(field.encode(value), np.uint8)

    def value(self, row: int, field: TableRegister) -> int:
        """One value."""
        return field.decode(self.raw[row, field.address : field.end].tobytes())

    def readable(self, row: int, address: int, size: int) -> bool:
        """Return True if the span has a register and ends inside the table. Gaps read as 0.

        Indirect data that points at a gap is a gap.
        """
        layout = self._layouts[row]
        end = address + size
        return size >= 1 and end <= layout.end and bool(layout.defined[self.where[row, address:end]].any())

    def read(self, row: int, address: int, size: int) -> bytes:
        """Return the bytes that a read of one servo gives; indirect data is that of its target."""
        return bytes(self.raw[row, self.where[row, address : address + size]])

    def has_measured_registers(self, row: int, address: int, size: int) -> int:
        """Classify a span by registers that the servo writes. 0: none, 1: `LIVELIEST` only, 2: more."""
        return int(self._layouts[row].live[self.where[row, address : address + size]].max())

    def block(self, rows: Sequence[int], address: int, size: int) -> "RegisterSpan":
        """Return the same span of several servos for repeated reads, until an indirect address changes."""
        return RegisterSpan(self, rows, address, size)


class RegisterSpan:
    """Span of several servos, (k, size) bytes: a slice without indirect addresses, else gathered."""

    def __init__(self, memory: RegisterMemory, rows: Sequence[int], address: int, size: int) -> None:
        """Make the span; it must be readable on all rows."""
        self._raw = memory.raw
        self._span = slice(address, address + size)
        every = list(rows) == list(range(len(memory.raw)))
        self._rows: Any = slice(None) if every else np.asarray(rows, np.intp)
        where = memory.where[np.asarray(rows, np.intp), self._span]
        straight = bool((where == np.arange(address, address + size)).all())
        self._where = None if straight else where
        self._column = np.asarray(rows, np.intp)[:, None]

    def get(self) -> Bytes:
        """Return the present bytes (k, size)."""
        found: Bytes
        if self._where is None:
            found = self._raw[:, self._span][self._rows]
        else:
            found = self._raw[self._column, self._where]
        return found


def _fields(table: ControlTable, firmware: int) -> dict[int, TableRegister]:
    """Return the fields by address. A register newer than the firmware is a gap: reads as 0, not writable."""
    facts = table.facts
    since = {"bus_watchdog": facts.watchdog_from, "backup_ready": facts.backup_from}
    if facts.startup_from is not None:  # None: it exists, but no page states since when
        since["startup_configuration"] = facts.startup_from
    unknown = {key for key, first in since.items() if first is None or firmware < first}
    fields = [each for each in table.fields.values() if not each.key.startswith("indirect_")]
    fields += indirect_addresses.fields(table)
    return {each.address: each for each in fields if each.key not in unknown}
