"""Helpers shared by the computed and the real-time tests of can socketcan."""

import errno
import os
import socket
import struct

from twind_drivers.ports.can_ports import open_channel
from twind_drivers.ports.python_can_channel import PythonCanChannel

# An interface that no machine has: 8 characters, so the kernel looks for it; of each process its own, as one
# owns it.
NOWHERE = f"none{os.getpid() % 10_000:04d}"


class Wire:
    """Behaviour shared by all sockets of one test."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.refuses = 0  # errno of every send
        self.fails = 0  # errno of every reading
        self.gone = 0  # errno of every bind
        self.room = 10**9  # frames until the queue is full
        self.sockets: list[CanSocket] = []

    def socket(self) -> "CanSocket":
        self.sockets.append(CanSocket(self))
        return self.sockets[-1]

    def say(self, id: int, data: bytes) -> None:
        """A frame from the wire, or of the controller."""
        record = struct.pack("<IB3x8s", id, len(data), data)
        self.sockets[-1].theirs.send(record)


class CanSocket:
    """As a raw CAN socket behaves, over a pair of local ones."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def setsockopt(self, *arguments: object) -> None:
        return

    def bind(self, address: tuple[str]) -> None:
        if self.wire.gone:
            self.close()
            raise OSError(self.wire.gone, os.strerror(self.wire.gone))

    def fileno(self) -> int:
        return self.ours.fileno()

    def send(self, data: bytes) -> int:
        if self.wire.refuses:
            raise OSError(self.wire.refuses, os.strerror(self.wire.refuses))
        if len(self.wire.sent) >= self.wire.room:
            raise OSError(errno.ENOBUFS, os.strerror(errno.ENOBUFS))
        self.wire.sent.append(data)
        return len(data)

    def recvmsg(self, size: int, room: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, object]:
        if self.wire.fails:
            raise OSError(self.wire.fails, os.strerror(self.wire.fails))
        stamp = (socket.SOL_SOCKET, 35, struct.pack("@ll", 0, 0))  # SO_TIMESTAMPNS
        return self.ours.recv(size), [stamp], 0, (NOWHERE,)

    def close(self) -> None:
        self.ours.close()
        self.theirs.close()


def opened(*, drives: bool = True) -> PythonCanChannel:
    channel = open_channel(f"can:socketcan:{NOWHERE}", 1_000_000)
    assert isinstance(channel, PythonCanChannel)
    if drives:
        channel.drive(opened)  # which lives for ever
    return channel
