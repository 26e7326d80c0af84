"""Virtual Feetech bus: what its instructions do."""

from collections.abc import Sequence

from twind_drivers.feetech.feetech_packet import FeetechInstruction
from twind_drivers.feetech.virtual_feetech_servos import MIDDLE, VirtualFeetechServos
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.half_duplex.checksum_packet import BROADCAST, ChecksumPacket
from twind_drivers.virtual.checksum_bus import ChecksumBus
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.servo_physics import ServoPhysics

TURNAROUND = 0.00005  # s from a request to a reply; register 7 has no function on an STS


class VirtualFeetechBus(ChecksumBus):
    """m servos on one wire. Time (s) is an argument and never goes back."""

    kind = "feetech"

    def __init__(
        self,
        name: str,
        servos: Sequence[FeetechServoSpec],
        muscles: ServoPhysics,
        *,
        baud: int = 1_000_000,
        wire_timing: bool = True,
        now: float = 0.0,
        adapter: SerialAdapter | None = None,
        seed: int = 0,
        waits_for_missing: bool = False,
    ) -> None:
        """Make the bus. `waits_for_missing`: in a sync read, servos behind a silent one are silent too."""
        self.servos = VirtualFeetechServos(servos, muscles, now=now)
        self._waits_for_missing = waits_for_missing
        self._stored: dict[int, tuple[int, bytes]] = {}  # by row: address and data of a reg write
        super().__init__(
            name, self.servos, baud=baud, wire_timing=wire_timing, now=now, adapter=adapter, seed=seed
        )

    def _carry_out(self, packet: ChecksumPacket, at: float) -> None:
        code, data = packet.code, packet.data
        if code == FeetechInstruction.SYNC_READ and packet.id == BROADCAST and len(data) > 2:
            self._sync_read(data)
            return
        if code == FeetechInstruction.SYNC_WRITE and packet.id == BROADCAST and len(data) > 2:
            size = data[1] + 1
            for place in range(2, len(data) - size + 1, size):
                for row in self._rows(data[place], at):
                    self.servos.write(row, data[0], data[place + 1 : place + size])
            return
        replies: list[tuple[int, int, bytes]] = []  # row, id, data
        for row in self._rows(packet.id, at):
            id = self.servos.ram[row][5]
            quiet = not self.servos.get(row, "status_return_level")
            answer = self._single(row, code, data, at)
            told = code in (FeetechInstruction.PING, FeetechInstruction.READ)
            if (
                answer is not None
                and (told or not quiet)
                and (packet.id != BROADCAST or code == FeetechInstruction.PING)
            ):
                replies.append((row, id, answer))
        self._reply(replies)

    def _single(self, row: int, code: int, data: bytes, at: float) -> bytes | None:
        """Carry out an instruction to one servo; return the data of its status; None: it stays silent."""
        servos = self.servos
        if code == FeetechInstruction.PING:
            return b""
        if code == FeetechInstruction.READ and len(data) == 2:
            self.servos.refresh()
            return self._read(row, *data)
        if code == FeetechInstruction.WRITE and len(data) > 1:
            servos.write(row, data[0], data[1:])
        elif code == FeetechInstruction.REG_WRITE and len(data) > 1:
            self._stored[row] = (data[0], data[1:])
        elif code == FeetechInstruction.ACTION:
            if row in self._stored:
                servos.write(row, *self._stored.pop(row))
        elif code == FeetechInstruction.CALIBRATE:
            servos.calibrate(row, int.from_bytes(data, "little") if data else MIDDLE)
        elif code == FeetechInstruction.RECOVERY:
            servos.restore_factory(row)
        elif code == FeetechInstruction.REBOOT:
            servos.reset(row, at + self.servos.BOOT)
            return None
        elif code != FeetechInstruction.CLEAR_TURNS:
            return None
        return b""

    def _sync_read(self, data: bytes) -> None:
        self.servos.refresh()
        replies = []
        for id in data[2:]:
            rows = [row for row in self._rows(id, self.servos.now) if self._knows_groups(row)]
            if not rows and self._waits_for_missing:
                break
            replies += [(row, id, self._read(row, data[0], data[1])) for row in rows]
        self._reply(replies)

    def _knows_groups(self, row: int) -> bool:
        return self.servos.specs[row].sync_read and self.servos.tables[row].sync_read

    def _read(self, row: int, address: int, size: int) -> bytes:
        return bytes(self.servos.ram[row][address : address + size]).ljust(size, b"\0")

    def _reply(self, replies: Sequence[tuple[int, int, bytes]]) -> None:
        """Send statuses (row, id, data) with the error byte of each servo."""
        statuses = [(id, self.servos.error(row), data) for row, id, data in replies]
        self._send(statuses, [TURNAROUND] * len(statuses))
