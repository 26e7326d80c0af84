"""Writer of an LX-16A bus, and the makers of its two halves.

No write is acknowledged, so each is read back. There is no watchdog, no gain and no restart instruction.
"""

from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np

from twind.config.driver_family import BusDriver, BusSetup
from twind_drivers.bus import (
    DeviceRefused,
    GroupWriteBatch,
    NoReply,
    Order,
    Script,
    WireRangeError,
    WriteRequest,
)
from twind_drivers.device_registers import RegisterAddress, RestartResult
from twind_drivers.half_duplex.goal_bounds import bounds_of
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_lx16a.lx16a_packet import LxCommand, find_lx_packets, lx_packet
from twind_lx16a.lx16a_reader import LxReader

AT_ONCE = b"\0\0"  # time of a move: the executor shapes the motion


class LxWriter:
    """Writer to the bus of `reader`. Arrays are (m,), in the order of its ids; goals in counts."""

    def __init__(self, reader: LxReader, lower: np.ndarray, upper: np.ndarray) -> None:
        self._reader = reader
        self._ids = reader.ids
        self._led = np.ones(len(self._ids), np.bool_)
        self._on = np.zeros(len(self._ids), np.bool_)  # torque switched on by this writer
        self.set_goal_limits(lower, upper)

    def set_goal_limits(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Set the range of the goals (m,) and drop pending goals. Raises ValueError."""
        self._lower, self._upper = bounds_of(self._reader.name, len(self._ids), lower, upper)
        self.clear()

    def goals(self, ticks: np.ndarray) -> None:
        """Goals (m,) of the next `request`, to devices whose torque reads on. Raises WireRangeError."""
        self.clear()
        self._check(ticks)
        chosen = self._led & self._on & (self._reader.registers.torque == 1)
        rows = {self._ids[place]: _move(int(ticks[place])) for place in np.flatnonzero(chosen)}
        self._reader.line.goals = self._encode({LxCommand.MOVE: rows})

    def _check(self, ticks: np.ndarray) -> None:
        if ticks.shape != self._lower.shape or ticks.dtype.kind != "i":
            raise ValueError(f"{self._reader.name}: {len(self._ids)} whole ticks needed, got {ticks!r}")
        for id, tick, low, high in zip(self._ids, ticks, self._lower, self._upper, strict=True):
            if not low <= tick <= high:
                raise WireRangeError(self._reader.name, id, int(tick), int(low), int(high))

    def _encode(self, writes: Mapping[int, Mapping[int, bytes]]) -> bytes:
        """Return the packets of writes by command and id, decoded again and checked (WIRE_CLAMP)."""
        data = b"".join(lx_packet(id, code, row) for code, rows in writes.items() for id, row in rows.items())
        found = find_lx_packets(data)
        if sum(each.octets for each in found) != len(data):
            raise WireRangeError(self._reader.name, 0, len(data), 0, 0, "stray bytes in a packet")
        for each in found:
            if each.id not in self._ids or each.code not in (LxCommand.MOVE, LxCommand.LOAD):
                raise WireRangeError(self._reader.name, each.id, each.code, 1, 31, "command")
            if each.code == LxCommand.MOVE:
                place = self._ids.index(each.id)
                goal = int.from_bytes(each.data[:2], "little")
                if not self._lower[place] <= goal <= self._upper[place]:
                    low, high = int(self._lower[place]), int(self._upper[place])
                    raise WireRangeError(self._reader.name, each.id, goal, low, high)
        return data

    def cut(self) -> None:
        """Switch torque off on all devices in the next write of any kind; earlier goals are not sent."""
        self.clear()
        self._on.fill(False)
        self._reader.line.urgent = 2 * self._encode({LxCommand.LOAD: dict.fromkeys(self._ids, b"\0")})

    def clear(self) -> None:
        """Drop pending goals. A pending cut stays."""
        self._reader.line.goals = b""

    def begin(self, order: Order, now: float) -> None:
        """Begin one order; the reader's `answer` ends it. Raises PortError, WireRangeError; TypeError."""
        if isinstance(order, WriteRequest):
            order = GroupWriteBatch((order,))
        if not isinstance(order, GroupWriteBatch):
            raise TypeError(f"{self._reader.name}: not a write: {order}")
        data = b"".join(self._encode({each.address: each.data}) for each in order.writes)
        self._reader.line.send(SerialTransaction(data, None, 0), now)

    # --------------------------------------------------------------------------- scripts

    def prepare(self, ticks: np.ndarray, among: np.ndarray | None = None) -> Script[None]:
        """Check the mode of each device and set its goal. Raises DeviceRefused, NoReply, WireRangeError."""
        self._led = np.ones(len(self._ids), np.bool_) if among is None else among.copy()
        self.clear()
        self._check(ticks)
        silent: list[int] = []
        for place in np.flatnonzero(self._led):
            try:
                id = self._ids[place]
                if (yield from self._reader.read(id, "operating_mode")).value:
                    raise DeviceRefused(self._reader.name, id, "arming", "is in motor mode")
                yield from self._aim({id: int(ticks[place])})
            except NoReply as error:
                silent += error.ids
        if silent:
            raise NoReply(self._reader.name, silent, 0.0, "preparation")

    def write_goals(self, ticks: np.ndarray) -> Script[None]:
        """Write goals (m,), read them back. Raises WireRangeError, DeviceRefused, NoReply."""
        self._check(ticks)
        yield from self._aim({self._ids[place]: int(ticks[place]) for place in np.flatnonzero(self._led)})

    def _aim(self, goals: Mapping[int, int]) -> Script[None]:
        yield WriteRequest({id: _move(tick) for id, tick in goals.items()}, LxCommand.MOVE)
        for id, tick in goals.items():
            value = (yield from self._reader.read(id, "goal_position")).value
            if value != tick:
                raise DeviceRefused(self._reader.name, id, "goal", f"wrote {tick}, reads {value}")

    def read_goals(self) -> Script[np.ndarray]:
        """Read the goals (m,) that the devices hold. Raises NoReply."""
        found = []
        for id in self._ids:
            found.append((yield from self._reader.read(id, "goal_position")).value)
        return np.array(found, np.int64)

    def torque(self, on: bool) -> Script[None]:
        """Switch torque of all devices and read it back. Raises DeviceRefused, NoReply."""
        self._reader.registers.expire_torque(slice(None))
        self._on.fill(False)
        order = WriteRequest(dict.fromkeys(self._ids, bytes((on,))), LxCommand.LOAD)
        yield GroupWriteBatch((order,) if on else (order, order))
        for id in self._ids:
            value = (yield from self._reader.read(id, "torque_enable")).value
            if value != on:
                raise DeviceRefused(self._reader.name, id, "torque", f"reads {value}, not {on:d}")
        self._on.fill(on)

    def damp(self) -> Script[tuple[int, ...]]:
        """Return all ids: an LX-16A has nothing that makes its torque soft."""
        yield from ()
        return self._ids

    def begin_single_device(self, id: int, *, cap: int, profile: int) -> NoReturn:
        """Raise ValueError: it has no limited current."""
        raise ValueError(f"{self._reader.name}: id {id}: an LX-16A has no mode with a limited current")

    def end_single_device(self) -> None:
        """Drop pending goals; no device is ever driven alone."""
        self.clear()

    def write(self, id: int, name: str, value: int) -> Script[RegisterAddress]:
        """Raise ValueError: this driver changes no settings."""
        yield from ()
        self._reader.register(id, name)
        raise ValueError(f"{name} is not written by this driver")

    def reboot(self, id: int, *, shut_down: bool = False) -> Script[RestartResult]:
        """Raise DeviceRefused: it has no such instruction."""
        yield from ()
        raise DeviceRefused(self._reader.name, id, "restart", "an LX-16A has no restart instruction")


def _move(tick: int) -> bytes:
    return tick.to_bytes(2, "little") + AT_ONCE


def _reader(setup: BusSetup, port: Any) -> LxReader:
    return LxReader(setup.bus.name, port, setup.ids, setup.rate_hz)


def _writer(setup: BusSetup, reader: Any) -> LxWriter:
    return LxWriter(reader, setup.lower, setup.upper)


DRIVER = BusDriver(reader=_reader, writer=_writer)
