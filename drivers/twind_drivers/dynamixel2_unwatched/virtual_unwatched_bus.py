"""Virtual bus of XL-320 or PRO -R: what the instructions of Protocol 2.0 do."""

from collections.abc import Mapping, Sequence

from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import BROADCAST, Framer, Instruction, StatusErrorCode
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.dynamixel2_unwatched.virtual_unwatched_servos import VirtualUnwatchedServos
from twind_drivers.half_duplex.checksum_packet import ChecksumPacket
from twind_drivers.virtual.checksum_bus import ChecksumBus
from twind_drivers.virtual.checksum_bus_faults import ChecksumBusFaults
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.servo_physics import ServoPhysics

TURNAROUND = 0.00005  # s from a request to its reply beside the return delay (assumed)
BROKEN = -1  # instruction of a packet with a wrong CRC
Answer = tuple[int, bytes]  # error number, data


class Protocol2Packet(ChecksumPacket):
    """Instruction packet of Protocol 2.0: its code is the instruction, its data the params."""

    __slots__ = ()

    @property
    def octets(self) -> int:
        """Bytes of the packet on the wire, nothing stuffed."""
        return len(self.data) + packet.OVERHEAD


class Protocol2Faults(ChecksumBusFaults):
    """Faults of one bus with Protocol 2.0."""

    def _status(self, id: int, data: bytes) -> bytes:
        return packet.status(id, 0, data)

    def _payload(self, piece: bytes) -> bytes:
        return piece[9:-2]


class VirtualUnwatchedBus(ChecksumBus):
    """m servos of one table on one wire. Time (s) is an argument and never goes back."""

    kind = "dynamixel2_unwatched"
    FAULTS = Protocol2Faults

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
        self.servos = VirtualUnwatchedServos(servos, muscles, now=now)
        self._stored: dict[int, tuple[int, bytes]] = {}  # by row: address and data of a reg write
        self._framer = Framer(status=False, broken=True)
        self._found: list[Protocol2Packet] = []
        super().__init__(
            name, self.servos, baud=baud, wire_timing=wire_timing, now=now, adapter=adapter, seed=seed
        )

    def _next_packet(self) -> Protocol2Packet | None:
        if self._pending:
            found = self._framer.feed(self._pending)
            self._pending.clear()
            self._found += [
                Protocol2Packet(each.id, each.instruction if each.intact else BROKEN, each.params)
                for each in found
            ]
        return self._found.pop(0) if self._found else None

    def _frame(self, id: int, code: int, data: bytes) -> bytes:
        return packet.status(id, code, data)

    def _carry_out(self, packet: ChecksumPacket, at: float) -> None:
        code, data = packet.code, packet.data
        if code in (Instruction.SYNC_READ, Instruction.BULK_READ):
            self._group_read(_wishes(code, data), at)
            return
        if code == Instruction.SYNC_WRITE and len(data) > 4:
            address, size = _span(data)
            for place in range(4, len(data) - size, size + 1):
                for row in self._rows(data[place], at):
                    self.servos.write(row, address, data[place + 1 : place + 1 + size])
            return
        needed = 0 if code == Instruction.PING else 1 if code == Instruction.READ else 2
        replies = []
        for row in self._rows(packet.id, at):
            told = self.servos.get(row, "status_return_level") >= needed
            id = self.servos.ids()[row]
            result, answer = self._single(row, code, data)
            if told and (packet.id != BROADCAST or code == Instruction.PING):
                replies.append((row, id, result, answer))
        self._reply(replies)

    def _single(self, row: int, code: int, data: bytes) -> Answer:
        """Carry out an instruction to one servo; return the result of its status."""
        servos = self.servos
        if code == BROKEN:
            return StatusErrorCode.CRC, b""
        if code == Instruction.PING:
            number = servos.get(row, "model_number").to_bytes(2, "little")
            return 0, number + bytes((servos.get(row, "firmware_version"),))
        if code == Instruction.READ and len(data) == 4:
            servos.refresh()
            block = servos.read(row, *_span(data))
            return (StatusErrorCode.ACCESS, b"") if block is None else (0, block)
        if code in (Instruction.WRITE, Instruction.REG_WRITE) and len(data) > 2:
            place = (int.from_bytes(data[:2], "little"), data[2:])
            if code == Instruction.WRITE:
                return servos.write(row, *place), b""
            self._stored[row] = place
            servos.put(row, "registered_instruction", 1)
            return 0, b""
        if code == Instruction.ACTION and row in self._stored:
            servos.put(row, "registered_instruction", 0)
            return servos.write(row, *self._stored.pop(row)), b""
        if code == Instruction.REBOOT:
            servos.reset(row, servos.now + servos.BOOT)
            return 0, b""
        if code == Instruction.FACTORY_RESET:
            servos.restore_factory(row)
            servos.drive()
            return 0, b""
        return StatusErrorCode.INSTRUCTION, b""

    def _group_read(self, wishes: Mapping[int, tuple[int, int]], at: float) -> None:
        """Each servo answers for itself; a silent one leaves a gap."""
        self.servos.refresh()
        replies = []
        for id, (address, size) in wishes.items():
            for row in self._rows(id, at):
                if self.servos.get(row, "status_return_level"):
                    block = self.servos.read(row, address, size)
                    result = 0 if block is not None else int(StatusErrorCode.ACCESS)
                    replies.append((row, id, result, block or b""))
        self._reply(replies)

    def _reply(self, replies: Sequence[tuple[int, int, int, bytes]]) -> None:
        """Send statuses (row, id, error number, data)."""
        delays = [TURNAROUND + 2e-6 * self.servos.get(row, "return_delay_time") for row, *_ in replies]
        alerts = [packet.ALERT if self.servos.error(row) else 0 for row, *_ in replies]
        self._send(
            [
                (id, alert | number, data)
                for (_, id, number, data), alert in zip(replies, alerts, strict=True)
            ],
            delays,
        )


def _span(params: bytes) -> tuple[int, int]:
    return int.from_bytes(params[:2], "little"), int.from_bytes(params[2:4], "little")


def _wishes(code: int, params: bytes) -> dict[int, tuple[int, int]]:
    """Return address and size by id, in the order of replies."""
    if code == Instruction.SYNC_READ:
        return dict.fromkeys(params[4:], _span(params))
    return {params[at]: _span(params[at + 1 :]) for at in range(0, len(params) - 4, 5)}
