"""A small scripted responder for the driver's tests: real bytes in and out, faults by order.

Not the virtual robot: flat register memory without rules, so that each test says itself what a servo answers.
`Wire` is an in-process transport under a fake clock; `PtyServos` is the same behind a real pseudo-terminal.
"""

import os
import pty
import select
import threading
from collections.abc import Callable, Sequence
from math import inf

from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import Framer, Instruction, Packet


class Servos:
    """Registers of some ids; answers every instruction at once."""

    def __init__(self, ids: Sequence[int], model: int = 1020, firmware: int = 45) -> None:
        self.memory = {id: bytearray(1024) for id in ids}
        self.seen: list[Packet] = []
        self.silent: set[int] = set()
        self.error: dict[int, int] = {}  # error byte of an id's statuses
        self.frozen: dict[int, set[int]] = {}  # addresses of an id that ignore writes
        self.deaf_until: dict[int, int] = {}  # pings left before an id answers again
        self._framer = Framer(status=False)
        for id, memory in self.memory.items():
            memory[0:2] = model.to_bytes(2, "little")
            memory[6] = firmware
            memory[7] = id
            memory[11] = 3
            memory[68] = 2

    def put(self, id: int, address: int, value: int, size: int) -> None:
        self.memory[id][address : address + size] = value.to_bytes(size, "little", signed=value < 0)

    def get(self, id: int, address: int, size: int) -> int:
        return int.from_bytes(self.memory[id][address : address + size], "little", signed=True)

    def hear(self, data: bytes) -> bytes:
        """Reply of the bus to `data`."""
        return b"".join(self.answer_packet(each) for each in self._framer.feed(data))

    def answer_packet(self, each: Packet) -> bytes:
        self.seen.append(each)
        match each.instruction:
            case Instruction.SYNC_READ | Instruction.FAST_SYNC_READ:
                address, size = _span(each.params)
                return self._group(each, [(id, address, size) for id in each.params[4:]])
            case Instruction.BULK_READ | Instruction.FAST_BULK_READ:
                rows = [each.params[at : at + 5] for at in range(0, len(each.params), 5)]
                return self._group(each, [(row[0], *_span(row[1:])) for row in rows])
            case Instruction.SYNC_WRITE:
                address, size = _span(each.params)
                for at in range(4, len(each.params), size + 1):
                    self._store(each.params[at], address, each.params[at + 1 : at + 1 + size])
                return b""
            case Instruction.PING if each.id == packet.BROADCAST:
                pings = (Packet(id, each.instruction, b"") for id in sorted(self.memory))
                return b"".join(self._single(ping) for ping in pings)
        return self._single(each)

    def _single(self, each: Packet) -> bytes:
        if each.id not in self.memory or each.id in self.silent:
            return b""
        memory = self.memory[each.id]
        error = self.error.get(each.id, 0)
        if each.instruction == Instruction.PING:
            if self.deaf_until.get(each.id, 0) > 0:
                self.deaf_until[each.id] -= 1
                return b""
            return packet.status(each.id, error, bytes(memory[0:2]) + bytes(memory[6:7]))
        if error & 0x7F:
            return packet.status(each.id, error)
        if each.instruction == Instruction.READ:
            address, size = _span(each.params)
            return packet.status(each.id, error, memory[address : address + size])
        if each.instruction == Instruction.WRITE:
            self._store(each.id, int.from_bytes(each.params[:2], "little"), each.params[2:])
        return packet.status(each.id, error)

    def _group(self, each: Packet, spans: list[tuple[int, int, int]]) -> bytes:
        rows = [
            (self.error.get(id, 0), id, bytes(self.memory[id][address : address + size]))
            for id, address, size in spans
            if id in self.memory
        ]
        if each.instruction in (Instruction.SYNC_READ, Instruction.BULK_READ):
            return b"".join(
                packet.status(id, error, data) for error, id, data in rows if id not in self.silent
            )
        heard = []
        for row in rows:  # a missing servo stops the chain
            if row[1] in self.silent:
                break
            heard.append(row)
        return b"".join(packet.fast_status(heard, sum(size + 4 for _, _, size in spans) + 1))

    def _store(self, id: int, address: int, data: bytes) -> None:
        if id in self.memory and id not in self.silent:
            for at, value in enumerate(data, address):
                if at not in self.frozen.get(id, ()):
                    self.memory[id][at] = value


def _span(params: bytes) -> tuple[int, int]:
    return int.from_bytes(params[:2], "little"), int.from_bytes(params[2:4], "little")


class Wire:
    """Transport to `Servos`. `change` may bend what comes back; `pause` delays it (s) under a fake clock."""

    name = "wire"
    warning = ""
    holds = False

    def __init__(self, servos: Servos) -> None:
        self.servos = servos
        self.change: Callable[[bytes], bytes] = lambda reply: reply
        self.chunk: int | None = None  # bytes a read returns at most
        self.writes: list[bytes] = []
        self.inbox = bytearray()
        # Empty: no read finds the next reply before the next write, or `settle`.
        self.held: bytearray | None = None

    def fileno(self) -> int:
        return -1

    def arrival(self) -> float:
        return 0.0 if self.inbox else inf

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.writes.append(bytes(data))
        reply = self.change(self.servos.hear(bytes(data)))
        if self.held == b"":
            self.held += reply
        else:
            self.settle()
            self.inbox += reply

    def read_into(self, buffer: memoryview) -> int:
        count = min(len(buffer), len(self.inbox), self.chunk or len(buffer))
        buffer[:count] = self.inbox[:count]
        del self.inbox[:count]
        return count

    def settle(self) -> None:
        self.inbox += self.held or b""
        self.held = None

    def drain(self, thrown: bytearray | None = None) -> int:
        if thrown is not None:
            thrown += self.inbox
        count = len(self.inbox)
        self.inbox.clear()
        return count

    def backlog(self) -> int:
        return 0

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


class PtyServos:
    """`Servos` at the master end of a pseudo-terminal, in a thread. A context manager; `path` is the port."""

    def __init__(self, servos: Servos) -> None:
        self.servos = servos
        self.master, self.slave = pty.openpty()
        self.path = os.ttyname(self.slave)
        self._stop, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "PtyServos":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        for fd in (self._stop, self._wake):
            os.close(fd)

    def end(self) -> None:
        """Unplug."""
        if self._thread.is_alive():
            os.write(self._wake, b"x")
            self._thread.join()
            os.close(self.master)
            os.close(self.slave)

    def _run(self) -> None:
        while True:
            ready, _, _ = select.select([self.master, self._stop], [], [])
            if self._stop in ready:
                return
            os.write(self.master, self.servos.hear(os.read(self.master, 4096)))
