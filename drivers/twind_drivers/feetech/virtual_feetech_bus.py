"""Virtual Feetech bus: bytes from the host in, bytes of the servos out at their time."""

from collections.abc import Sequence
from itertools import accumulate

from twind_drivers.feetech.feetech_models import STAND_IN
from twind_drivers.feetech.feetech_packet import FeetechInstruction
from twind_drivers.feetech.virtual_feetech_faults import FeetechBusFaults
from twind_drivers.feetech.virtual_feetech_servos import (
    BOOT,
    MIDDLE,
    VirtualFeetechServos,
)
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.half_duplex.checksum_packet import (
    BROADCAST,
    HEADER,
    OVERHEAD,
    ChecksumPacket,
    instruction,
    is_sound,
)
from twind_drivers.virtual.faulty_byte_stream import FaultyByteStream, SerialAdapter
from twind_drivers.virtual.half_duplex_wire import HalfDuplexWire
from twind_drivers.virtual.servo_physics import ServoPhysics
from twind_drivers.virtual.shown_position_log import ShownPositionLog
from twind_drivers.virtual.virtual_sensor import VirtualSensor

BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)  # register 6
TURNAROUND = 0.00005  # s from a request to a reply; register 7 has no function on an STS
PAUSE = 0.01  # s without bytes after which half a packet is forgotten; a loaded machine delivers pieces late


class VirtualFeetechBus:
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
        self.name = name
        self.servos = VirtualFeetechServos(servos, muscles, now=now)
        self.wire = HalfDuplexWire(baud, timing=wire_timing)
        self._stream = FaultyByteStream(self.wire, adapter or SerialAdapter(), seed)
        self.faults = FeetechBusFaults(name, self.servos, self.wire, self._stream)
        self.sensor: VirtualSensor | None = None  # an IMU speaks another protocol
        self._waits_for_missing = waits_for_missing
        self._pending = bytearray()
        self._pending_at = now
        self._stored: dict[int, tuple[int, bytes]] = {}  # by row: address and data of a reg write

    @property
    def is_plugged(self) -> bool:
        """True if the adapter is plugged in."""
        return self.faults.plugged

    @property
    def backlog(self) -> int:
        """Bytes that a stalled adapter has taken and not sent."""
        return len(self._stream.held)

    @property
    def history(self) -> ShownPositionLog | None:
        """Counts kept by `record`, in the order of `ids`."""
        return self.servos.history

    def ids(self) -> list[int]:
        """Return the ids of the servos, in the order of rows."""
        return self.servos.ids()

    def truth(self, now: float) -> list[dict[str, object]]:
        """Return the true state of each servo at `now`, independent of the bus."""
        return self.servos.truth(now)

    def motor_stand_ins(self) -> dict[str, str]:
        """Return the models without motor figures, and the one whose figures they have."""
        return {each.name: STAND_IN for each in self.servos.models if not each.strength}

    def skip_time(self, seconds: float) -> None:
        """Skip time in which the servos do not run: they have no clock of their own."""

    def flush(self) -> None:
        """Drop the bytes of the backlog: they are never sent."""
        self._stream.held = b""
        self._stream.look()

    def line(self, baud: int) -> None:
        """Set the host's port to `baud`. Raises ValueError for an invalid rate."""
        if baud <= 0:
            raise ValueError(f"bus {self.name}: {baud} baud is not a rate")
        self.wire.baud = baud

    def advance(self, now: float) -> None:
        """Let time pass without traffic."""
        self.servos.advance(now)

    def next_output_time(self) -> float:
        """Return when the next answer is complete, s; `inf`: none is under way."""
        return self._stream.next_output_time() if self._stream.bent else self.wire.next_output_time()

    def take(self, now: float) -> bytes:
        """Return the bytes of the servos that have arrived by `now`."""
        if not self._stream.bent:
            return self.wire.take(now)
        if self._stream.held:
            self.receive(b"", now)
        return self._stream.take(now)

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host, sent at `now`."""
        if self._stream.bent:
            data = self._stream.send(data, now)
        if not self.is_plugged or not data:
            return
        if now > self._pending_at + PAUSE:
            self._pending.clear()
        self._pending_at = now
        self._pending += data
        while (packet := self._next_packet()) is not None:
            at = self.wire.schedule_request(packet.octets, now)
            self.servos.advance(at)
            self._carry_out(packet, at)
            self.servos.settle()

    def _next_packet(self) -> ChecksumPacket | None:
        """Take the first whole packet out of the bytes received; None: more must come."""
        data = self._pending
        while (at := data.find(HEADER)) >= 0:
            del data[:at]
            if len(data) < OVERHEAD:
                return None
            end = data[3] + 4
            legal = data[2] <= BROADCAST and data[3] >= 2
            if legal and len(data) < end:
                return None
            if legal and is_sound(data, 0, end):
                packet = ChecksumPacket(data[2], data[4], bytes(data[5 : end - 1]))
                del data[:end]
                return packet
            del data[:1]
        del data[: -1 if data.endswith(b"\xff") else len(data)]
        return None

    # ------------------------------------------------------------------------------- instructions

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
            servos.reset(row, at + BOOT)
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
        return self.servos.specs[row].sync_read and self.servos.maps[row].sync_read

    def _read(self, row: int, address: int, size: int) -> bytes:
        return bytes(self.servos.ram[row][address : address + size]).ljust(size, b"\0")

    def _rows(self, id: int, at: float) -> list[int]:
        """Return the servos that hear this id at the line's rate."""
        found = [
            row
            for row, own in enumerate(self.servos.ram)
            if id in (own[5], BROADCAST) and self.servos.listening(row) and self._at_rate(row)
        ]
        for row in found:
            self.servos.heard_at[row] = at
        return found

    def _at_rate(self, row: int) -> bool:
        return BAUDS[min(self.servos.get(row, "baud_rate"), 7)] == self.wire.baud

    def _reply(self, replies: Sequence[tuple[int, int, bytes]]) -> None:
        if not replies:
            return
        pieces = [instruction(id, self.servos.error(row), data) for row, id, data in replies]
        delays = [TURNAROUND] * len(pieces)
        if self.faults.active:
            self.faults.speak([id for _, id, _ in replies], delays, pieces, joint=False)
            return
        sizes = list(map(len, pieces))
        self.wire.schedule_replies(self.wire.ends(delays, sizes), list(accumulate(sizes)), b"".join(pieces))
