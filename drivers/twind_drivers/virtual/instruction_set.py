"""Instruction set of virtual servos: the effect of one packet, and the replies. No wire, no time of arrival.

Instructions and broadcast rules by e-manual "Protocol 2.0", "Instruction Details".
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

from twind_drivers.dynamixel.packet import BROADCAST, Instruction, Packet, StatusErrorCode
from twind_drivers.virtual.factory_reset import backup, clear, factory_reset
from twind_drivers.virtual.virtual_servos import VirtualServos
from twind_drivers.virtual.write_instruction import judge, write

# least status return level (68) at which a servo answers
PING_LEVEL = 0
READ_LEVEL = 1
WRITE_LEVEL = 2


class ServoStatus(NamedTuple):
    """Status of one servo. `id`: its id when the request came."""

    row: int
    id: int
    error: int
    data: bytes = b""


class InstructionReplies(NamedTuple):
    """Replies in the order on the wire. `promised`: LEN of a common (fast) reply, 0 for separate statuses."""

    statuses: Sequence[ServoStatus]
    level: int
    promised: int = 0


SILENCE = InstructionReplies((), PING_LEVEL)
Places = Mapping[int, Sequence[int]]  # id -> rows that listen; two rows: a duplicate id
Act = Callable[[int, bool], tuple[int, bytes]]  # (row, was it meant by its shadow id?) -> (error, data)


class InstructionSet:
    """Instruction set of the servos of one bus. `places` belongs to the bus and may change."""

    def __init__(self, servos: VirtualServos, places: Places) -> None:
        self._servos = servos
        self._places = places
        self.shadows: dict[int, list[int]] = {}  # secondary id -> rows that listen to it; the bus's too
        self._stored: dict[int, tuple[int, bytes]] = {}  # row -> reg write
        self._known: Mapping[int, Callable[[Packet, float], InstructionReplies]] = {
            Instruction.PING: self._ping,
            Instruction.READ: self._read,
            Instruction.WRITE: self._write,
            Instruction.REG_WRITE: self._reg_write,
            Instruction.ACTION: self._action,
            Instruction.FACTORY_RESET: self._turn_back,
            Instruction.REBOOT: self._reboot,
            Instruction.CLEAR: self._turn_back,
            Instruction.BACKUP: self._turn_back,
            Instruction.SYNC_READ: self._sync_read,
            Instruction.FAST_SYNC_READ: self._sync_read,
            Instruction.SYNC_WRITE: self._sync_write,
            Instruction.BULK_READ: self._bulk_read,
            Instruction.FAST_BULK_READ: self._bulk_read,
            Instruction.BULK_WRITE: self._bulk_write,
        }

    def execute_packet(self, packet: Packet, now: float) -> InstructionReplies:
        """Carry out one packet at `now` (s). `servos.changed` must follow."""
        if not packet.intact:
            return self._refuse(packet, StatusErrorCode.CRC)
        handler = self._known.get(packet.instruction)
        return handler(packet, now) if handler else self._refuse(packet, StatusErrorCode.INSTRUCTION)

    def _refuse(self, packet: Packet, error: int) -> InstructionReplies:
        if packet.id == BROADCAST:
            return SILENCE
        return InstructionReplies(
            [ServoStatus(row, packet.id, error) for row in self._places.get(packet.id, ())], WRITE_LEVEL
        )

    def _each(self, packet: Packet, act: Act, level: int) -> InstructionReplies:
        """Let every servo that is meant act; only one addressed by its own id answers."""
        if packet.id == BROADCAST:
            for row in [row for rows in self._places.values() for row in rows]:
                act(row, False)
            return SILENCE
        own = self._places.get(packet.id, ())
        answers = [ServoStatus(row, packet.id, *act(row, False)) for row in own]
        for row in self.shadows.get(packet.id, ()):
            act(row, True)
        return InstructionReplies(answers, level)

    def _ping(self, packet: Packet, now: float) -> InstructionReplies:
        ids = sorted(self._places) if packet.id == BROADCAST else [packet.id]
        rows = [(row, id) for id in ids for row in self._places.get(id, ())]
        found = [ServoStatus(row, id, 0, self._servos.registers.identity(row)) for row, id in rows]
        return InstructionReplies(found, PING_LEVEL)

    def _read(self, packet: Packet, now: float) -> InstructionReplies:
        if packet.id == BROADCAST:
            return SILENCE
        if len(packet.params) != 4:
            return self._refuse(packet, StatusErrorCode.DATA_LENGTH)
        self._servos.settle(now)
        registers = self._servos.registers
        span = _span(packet.params)
        rows = self._places.get(packet.id, ())
        return InstructionReplies(
            [ServoStatus(row, packet.id, *registers.read(row, *span)) for row in rows], READ_LEVEL
        )

    def _write(self, packet: Packet, now: float) -> InstructionReplies:
        if len(packet.params) < 2:
            return self._refuse(packet, StatusErrorCode.DATA_LENGTH)
        address = int.from_bytes(packet.params[:2], "little")
        data = packet.params[2:]

        def act(row: int, shadow: bool) -> tuple[int, bytes]:
            return write(self._servos, row, address, data, shadow=shadow), b""

        return self._each(packet, act, WRITE_LEVEL)

    def _reg_write(self, packet: Packet, now: float) -> InstructionReplies:
        """Store a write; one that would be refused is refused now: no page states when a servo checks it."""
        if len(packet.params) < 2:
            return self._refuse(packet, StatusErrorCode.DATA_LENGTH)
        address = int.from_bytes(packet.params[:2], "little")
        data = packet.params[2:]

        def store(row: int, shadow: bool) -> tuple[int, bytes]:
            error = judge(self._servos, row, address, data, shadow=shadow)
            if not error:
                self._stored[row] = (address, data)
                self._servos.registers.put("registered_instruction", 1, row)
            return error, b""

        return self._each(packet, store, WRITE_LEVEL)

    def _action(self, packet: Packet, now: float) -> InstructionReplies:
        def act(row: int, shadow: bool) -> tuple[int, bytes]:
            if not self._servos["registered_instruction"][row]:  # RAM: a reboot has forgotten it
                return StatusErrorCode.INSTRUCTION, b""
            self._servos.registers.put("registered_instruction", 0, row)
            return write(self._servos, row, *self._stored.pop(row)), b""

        return self._each(packet, act, WRITE_LEVEL)

    def _reboot(self, packet: Packet, now: float) -> InstructionReplies:
        def restart(row: int, shadow: bool) -> tuple[int, bytes]:
            self._servos.reboot(row, now)
            return StatusErrorCode.NONE, b""

        return self._each(packet, restart, WRITE_LEVEL)

    def _turn_back(self, packet: Packet, now: float) -> InstructionReplies:
        """Reset a servo; by its shadow id it may lose its turns, but no EEPROM value."""
        does = {
            Instruction.FACTORY_RESET: factory_reset,
            Instruction.CLEAR: clear,
            Instruction.BACKUP: backup,
        }
        turn = does[Instruction(packet.instruction)]

        def act(row: int, shadow: bool) -> tuple[int, bytes]:
            locked = shadow and packet.instruction != Instruction.CLEAR
            return (StatusErrorCode.ACCESS if locked else turn(self._servos, row, packet, now)), b""

        return self._each(packet, act, WRITE_LEVEL)

    def _sync_read(self, packet: Packet, now: float) -> InstructionReplies:
        if len(packet.params) < 5:
            return SILENCE
        address, size = _span(packet.params)
        wishes = [(id, address, size) for id in packet.params[4:]]
        return self._group_read(wishes, now, fast=packet.instruction == Instruction.FAST_SYNC_READ)

    def _bulk_read(self, packet: Packet, now: float) -> InstructionReplies:
        rows = range(0, len(packet.params) - 4, 5)
        wishes = [(packet.params[at], *_span(packet.params[at + 1 :])) for at in rows]
        return self._group_read(wishes, now, fast=packet.instruction == Instruction.FAST_BULK_READ)

    def _group_read(
        self, wishes: Sequence[tuple[int, int, int]], now: float, *, fast: bool
    ) -> InstructionReplies:
        """Reply to each (id, address, size) in order. A fast reply ends before the first missing servo."""
        self._servos.settle(now)
        statuses: list[ServoStatus] = []
        registers = self._servos.registers
        for id, address, size in wishes:
            rows = self._places.get(id, ())
            if fast and not (rows := [row for row in rows if self._joins(row)]):
                break
            for row in rows:
                error, data = registers.read(row, address, size)
                statuses.append(ServoStatus(row, id, error, data.ljust(size, b"\0") if fast else data))
        promised = sum(size + 4 for _, _, size in wishes) + 1 if fast else 0
        return InstructionReplies(statuses, READ_LEVEL, promised)

    def _joins(self, row: int) -> bool:
        """Return True if the servo takes its turn in a common reply, by firmware and status level."""
        registers = self._servos.registers
        return registers.answers_fast(row) and registers.level(row) >= READ_LEVEL

    def _sync_write(self, packet: Packet, now: float) -> InstructionReplies:
        address, size = _span(packet.params)
        rows = packet.params[4:]
        if size and len(rows) % (size + 1) == 0:
            for at in range(0, len(rows), size + 1):
                self._write_all(rows[at], address, rows[at + 1 : at + 1 + size])
        return SILENCE

    def _bulk_write(self, packet: Packet, now: float) -> InstructionReplies:
        for id, address, data in _bulk(packet.params):
            self._write_all(id, address, data)
        return SILENCE

    def _write_all(self, id: int, address: int, data: bytes) -> None:
        """Write without reply: a refusal of a servo is only visible in a read-back."""
        for row in self._places.get(id, ()):
            write(self._servos, row, address, data)
        for row in self.shadows.get(id, ()):
            write(self._servos, row, address, data, shadow=True)


def _span(params: bytes) -> tuple[int, int]:
    return int.from_bytes(params[:2], "little"), int.from_bytes(params[2:4], "little")


def _bulk(params: bytes) -> Iterator[tuple[int, int, bytes]]:
    at = 0
    while at + 5 <= len(params):
        address, size = _span(params[at + 1 :])
        yield params[at], address, params[at + 5 : at + 5 + size]
        at += 5 + size
