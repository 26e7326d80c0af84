"""Other implementations of a control cycle on a Dynamixel bus: vendor's SDK, rustypot, system calls."""

import os
import select
import termios
import tty
from contextlib import suppress
from typing import Any, Protocol

import dynamixel_sdk
import numpy as np

from twind_drivers.dynamixel.packet import fast_sync_read, sync_read, sync_write

rustypot: Any = None
with suppress(ImportError):
    import rustypot

# current, velocity, position; goal position
ADDRESS = 126
SIZE = 10
GOAL = 116
TURN = 2.0 * np.pi / 4096.0
ROW = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])


def missing() -> str:
    """Return the note for rustypot where it is not installed; empty where it is."""
    return "" if rustypot is not None else "; rustypot is not installed (extra [bench])"


class ControlCycle(Protocol):
    """Interface of one repeatable control cycle."""

    def __call__(self, i: int) -> int:
        """Read all servos and write the goals of cycle `i`; return the number of servos that answered."""

    def close(self) -> None:
        """Close the port."""


class DynamixelSdkCycle:
    """Cycle by dynamixel-sdk as in its examples: group read, every value by `getData`, group write."""

    def __init__(self, path: str, count: int, *, fast: bool, baud: int) -> None:
        self.ids = range(1, count + 1)
        self.port = dynamixel_sdk.PortHandler(path)
        self.port.openPort()
        self.port.setBaudRate(baud)
        handler = dynamixel_sdk.PacketHandler(2.0)
        self.read = dynamixel_sdk.GroupSyncRead(self.port, handler, ADDRESS, SIZE)
        self.write = dynamixel_sdk.GroupSyncWrite(self.port, handler, GOAL, 4)
        for id in self.ids:
            self.read.addParam(id)
            self.write.addParam(id, bytes(4))
        self._exchange = self.read.fastSyncRead if fast else self.read.txRxPacket

    def __call__(self, i: int) -> int:
        goal = (2048 + (i & 63)).to_bytes(4, "little")
        for id in self.ids:
            self.write.changeParam(id, goal)
        self.write.txPacket()
        if self._exchange() != dynamixel_sdk.COMM_SUCCESS:
            return 0
        get = self.read.getData
        raw = [[get(id, 126, 2), get(id, 128, 4), get(id, 132, 4)] for id in self.ids]
        values = np.array(raw, np.float64)
        values[:, 2] = (values[:, 2] - 2048) * TURN
        return len(values)

    def close(self) -> None:
        self.port.closePort()


class RustypotCycle:
    """Control cycle by rustypot with raw blocks, its cheapest way, decoded with numpy."""

    def __init__(self, path: str, count: int, *, fast: bool, baud: int) -> None:
        self.ids = list(range(1, count + 1))
        self.io: Any = rustypot.Xl430PyController(path, baud, 0.1)
        self.io.set_fast_sync_read(fast)

    def __call__(self, i: int) -> int:
        goal = list((2048 + (i & 63)).to_bytes(4, "little"))
        self.io.sync_write_raw_data(self.ids, GOAL, [goal] * len(self.ids))
        try:
            raw = self.io.sync_read_raw_data(self.ids, ADDRESS, SIZE)
        except RuntimeError:
            return 0
        rows = np.frombuffer(b"".join(raw), ROW)
        self.position = (rows["position"] - 2048) * TURN
        self.velocity = rows["velocity"] * 0.02398
        self.effort = rows["current"] * 0.00269
        return len(rows)

    def close(self) -> None:
        self.io.close()


class SyscallCycle:
    """Control cycle of system calls alone: write, poll, read until all bytes have arrived."""

    def __init__(self, path: str, count: int, *, fast: bool) -> None:
        ids = range(1, count + 1)
        request = (fast_sync_read if fast else sync_read)(ids, ADDRESS, SIZE)
        self._packet = sync_write(GOAL, {id: bytes(4) for id in ids}) + request
        self._wanted = 8 + count * 14 if fast else count * 21
        self._count = count
        self._room = bytearray(4096)
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.fd, termios.TCSANOW)
        self._poll = select.poll()
        self._poll.register(self.fd, select.POLLIN)

    def __call__(self, i: int) -> int:
        os.write(self.fd, self._packet)
        got = 0
        while got < self._wanted:
            self._poll.poll(1000)
            got += os.readv(self.fd, (self._room,))
        return self._count

    def close(self) -> None:
        os.close(self.fd)
