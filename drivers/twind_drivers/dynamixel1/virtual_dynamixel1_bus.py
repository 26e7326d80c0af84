"""Virtual bus of Protocol 1.0: what its instructions do."""

from collections.abc import Sequence

from twind_drivers.dynamixel1.dynamixel1_budget import TURNAROUND
from twind_drivers.dynamixel1.dynamixel1_packet import BULK_READ, CHECKSUM, INSTRUCTION, RANGE, RESET
from twind_drivers.dynamixel1.virtual_dynamixel1_servos import VirtualDynamixel1Servos
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.half_duplex.checksum_packet import (
    ACTION,
    BROADCAST,
    PING,
    READ,
    REG_WRITE,
    SYNC_WRITE,
    WRITE,
    ChecksumPacket,
)
from twind_drivers.virtual.checksum_bus import ChecksumBus
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.servo_physics import ServoPhysics

Answer = tuple[int, bytes]  # error bits of the result, data


class VirtualDynamixel1Bus(ChecksumBus):
    """m servos on one wire. Time (s) is an argument and never goes back."""

    kind = "dynamixel1"

    def __init__(
        self,
        name: str,
        servos: Sequence[Dynamixel1ServoSpec],
        muscles: ServoPhysics,
        *,
        baud: int = 1_000_000,
        wire_timing: bool = True,
        now: float = 0.0,
        adapter: SerialAdapter | None = None,
        seed: int = 0,
    ) -> None:
        self.servos = VirtualDynamixel1Servos(servos, muscles, now=now)
        self._stored: dict[int, tuple[int, bytes]] = {}  # by row: address and data of a reg write
        super().__init__(
            name, self.servos, baud=baud, wire_timing=wire_timing, now=now, adapter=adapter, seed=seed
        )

    def _carry_out(self, packet: ChecksumPacket, at: float) -> None:
        code, data = packet.code, packet.data
        if code == BULK_READ and packet.id == BROADCAST and len(data) % 3 == 1:
            self._bulk_read(data, at)
            return
        if code == SYNC_WRITE and packet.id == BROADCAST and len(data) > 2:
            size = data[1] + 1
            for place in range(2, len(data) - size + 1, size):
                for row in self._rows(data[place], at):
                    self.servos.write(row, data[0], data[place + 1 : place + size])
            return
        needed = {PING: 0, READ: 1}.get(code, 2)  # status return level at which it is answered
        replies = []
        for row in self._rows(packet.id, at):
            id = self.servos.ram[row][3]
            told = self.servos.get(row, "status_return_level") >= needed
            result, answer = self._single(row, code, data)
            if told and (packet.id != BROADCAST or code == PING):
                replies.append((row, id, result, answer))
        self._reply(replies)

    def _single(self, row: int, code: int, data: bytes) -> Answer:
        """Carry out an instruction to one servo; return the result of its status."""
        if code == PING:
            return 0, b""
        if code == READ and len(data) == 2:
            self.servos.refresh()
            block = self.servos.read(row, *data)
            return (RANGE, b"") if block is None else (0, block)
        if code == WRITE and len(data) > 1:
            return self.servos.write(row, data[0], data[1:]), b""
        if code == REG_WRITE and len(data) > 1:
            self._stored[row] = (data[0], data[1:])
            self.servos.put(row, "registered_instruction", 1)
            return 0, b""
        if code == ACTION and row in self._stored:
            self.servos.put(row, "registered_instruction", 0)
            return self.servos.write(row, *self._stored.pop(row)), b""
        if code == RESET:
            self.servos.restore_factory(row)
            self.servos.drive()
            return 0, b""
        return INSTRUCTION, b""

    def _bulk_read(self, data: bytes, at: float) -> None:
        """Each servo answers behind the one before it, and so not behind a silent one."""
        self.servos.refresh()
        replies = []
        for place in range(1, len(data), 3):
            size, id, address = data[place : place + 3]
            rows = [row for row in self._rows(id, at) if self._knows_groups(row)]
            if not rows:
                break
            for row in rows:
                block = self.servos.read(row, address, size)
                replies.append((row, id, 0 if block is not None else RANGE, block or b""))
        self._reply(replies)

    def _knows_groups(self, row: int) -> bool:
        level = self.servos.get(row, "status_return_level")
        return self.servos.specs[row].bulk_read and self.servos.models[row].bulk_read and level > 0

    def _hear_damaged(self, id: int) -> None:
        rows = [] if id == BROADCAST else self._rows(id, self.servos.now)
        self._reply([(row, id, CHECKSUM, b"") for row in rows if self.servos.get(row, "status_return_level")])

    def _reply(self, replies: Sequence[tuple[int, int, int, bytes]]) -> None:
        """Send statuses (row, id, error bits of the result, data)."""
        delays = [TURNAROUND + 2e-6 * self.servos.get(row, "return_delay_time") for row, *_ in replies]
        errors = [self.servos.error(row) for row, *_ in replies]
        self._send(
            [
                (id, error | result, data)
                for (_, id, result, data), error in zip(replies, errors, strict=True)
            ],
            delays,
        )
