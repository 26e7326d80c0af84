"""The register memory of all servos of one bus: one byte array, each register as numbers over all servos."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind_drivers.dynamixel.tables import Field, Table

Ints = NDArray[np.int64]
# What boots in a register whose default the rules leave open, by model number; 0: any other model.
# Source: e-manual control tables. Of the "any" row only the XM430-W350 is exact.
FACTORY: Mapping[int, Mapping[str, int]] = {
    0: {
        "temperature_limit": 80,
        "max_voltage_limit": 160,
        "min_voltage_limit": 95,
        "current_limit": 1193,
        "goal_current": 1193,
        "velocity_limit": 200,
        "velocity_i_gain": 1920,
        "velocity_p_gain": 100,
        "position_p_gain": 800,
        "pwm_limit": 885,
        "goal_pwm": 885,
        "max_position_limit": 4095,
        "status_return_level": 2,
        "operating_mode": 3,
        "shutdown": 52,
    },
    1060: {  # XL430-W250
        "temperature_limit": 72,
        "max_voltage_limit": 140,
        "min_voltage_limit": 60,
        "velocity_limit": 265,
        "velocity_i_gain": 1000,
        "position_d_gain": 4000,
        "position_p_gain": 640,
    },
}
# Not simulated, hence undefined here (error 7) rather than plain memory that pretends to be a mapping.
MISSING = "indirect_"


def factory(field: Field, number: int) -> int:
    """The value of `field` in a new servo of model `number`."""
    if field.rule.default is not None:
        return field.rule.default
    return FACTORY.get(number, {}).get(field.key, FACTORY[0].get(field.key, 0))


class Column:
    """One register of all servos. Where every servo has it at one address, `get` is a view of the memory."""

    def __init__(self, memory: NDArray[np.uint8], addresses: Sequence[int], size: int, signed: bool) -> None:
        kind = f"<{'i' if signed else 'u'}{size}"
        self.address = addresses[0] if len(set(addresses)) == 1 else -1  # -1: not the same for all
        self._memory = memory
        self._bytes = np.asarray(addresses, np.intp)[:, None] + np.arange(size)
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
        self._memory[self._rows[rows], self._bytes[rows]] = raw.view(np.uint8).reshape(count, -1)


class Memory:
    """(m, size) bytes. A register that a model lacks lives behind its table, where no packet reaches it."""

    def __init__(self, tables: Sequence[Table]) -> None:
        self.tables = tuple(tables)
        self.layouts: tuple[Mapping[int, Field], ...] = tuple(_layout(table) for table in tables)
        self.ends = tuple(max(field.end for field in layout.values()) for layout in self.layouts)
        self._hidden = max(self.ends)
        self.raw = np.zeros((len(tables), self._hidden + 256), np.uint8)

    def column(self, key: str, size: int, *, signed: bool = False) -> Column:
        """The register `key` of all servos; `size` and `signed` stand for it where a model lacks it."""
        fields = [table.fields.get(key) for table in self.tables]
        present = [field for field in fields if field is not None]
        spare = self._hidden
        if len(present) < len(fields):
            self._hidden += size
        if present:
            size, signed = present[0].size, present[0].rule.signed
        addresses = [spare if field is None else field.address for field in fields]
        return Column(self.raw, addresses, size, signed)

    def fill(self, row: int, keep: Callable[[Field], bool] = lambda field: False) -> None:
        """Factory values in every register of one servo but those to `keep`."""
        number = self.tables[row].number
        for field in self.layouts[row].values():
            if not keep(field):
                self.store(row, field, factory(field, number))

    def store(self, row: int, field: Field, value: int) -> None:
        """Put one value, without any rule."""
        self.raw[row, field.address : field.end] = np.frombuffer(field.encode(value), np.uint8)

    def value(self, row: int, field: Field) -> int:
        """One value."""
        return field.decode(self.raw[row, field.address : field.end].tobytes())

    def readable(self, row: int, address: int, size: int) -> bool:
        """Is there a register in this span, and does it end inside the table? Gaps read as 0."""
        end = address + size
        if size < 1 or end > self.ends[row]:
            return False
        return any(field.address < end and address < field.end for field in self.layouts[row].values())


def _layout(table: Table) -> dict[int, Field]:
    """Registers by address. Where two names share one, they are the same register."""
    fields = (field for field in table.fields.values() if not field.key.startswith(MISSING))
    return {field.address: field for field in fields}
