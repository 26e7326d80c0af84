"""Virtual bus of servos with the framing `FF FF`: bytes of the host in, those of the servos out in time.

A family adds what its instructions do.
"""

from collections.abc import Sequence
from itertools import accumulate

from twind_drivers.half_duplex.checksum_packet import (
    BROADCAST,
    HEADER,
    OVERHEAD,
    ChecksumPacket,
    instruction,
    is_sound,
)
from twind_drivers.virtual.checksum_bus_faults import ChecksumBusFaults
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.shown_position_log import ShownPositionLog
from twind_drivers.virtual.virtual_sensor import VirtualSensor
from twind_drivers.virtual.virtual_serial_line import VirtualSerialLine
from twind_drivers.virtual.virtual_table_servos import VirtualTableServos

PAUSE = 0.01  # s without bytes after which half a packet is forgotten; a loaded machine delivers pieces late


class ChecksumBus(VirtualSerialLine):
    """m servos on one wire. Time (s) is an argument and never goes back."""

    kind: str
    FAULTS = ChecksumBusFaults

    def __init__(
        self,
        name: str,
        servos: VirtualTableServos,
        *,
        baud: int,
        wire_timing: bool,
        now: float,
        adapter: SerialAdapter | None,
        seed: int,
    ) -> None:
        super().__init__(name, baud, wire_timing=wire_timing, adapter=adapter, seed=seed)
        self._all = servos
        self.faults = self.FAULTS(name, servos, self.wire, self._stream)
        self.sensor: VirtualSensor | None = None  # an IMU speaks another protocol
        self._pending = bytearray()
        self._pending_at = now

    @property
    def history(self) -> ShownPositionLog | None:
        """Counts kept by `record`, in the order of `ids`."""
        return self._all.history

    def ids(self) -> list[int]:
        """Return the ids of the servos, in the order of rows."""
        return self._all.ids()

    def truth(self, now: float) -> list[dict[str, object]]:
        """Return the true state of each servo at `now`, independent of the bus."""
        return self._all.truth(now)

    def motor_stand_ins(self) -> dict[str, str]:
        """Return the models without motor figures, and the one whose figures they have."""
        return self._all.stand_ins()

    def skip_time(self, seconds: float) -> None:
        """Skip time in which the servos do not run: they have no clock of their own."""

    def line(self, baud: int) -> None:
        """Set the host's port to `baud`. Raises ValueError for an invalid rate."""
        if baud <= 0:
            raise ValueError(f"bus {self.name}: {baud} baud is not a rate")
        self.wire.baud = baud

    def advance(self, now: float) -> None:
        """Let time pass without traffic."""
        self._all.advance(now)

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
            self._all.advance(at)
            self._carry_out(packet, at)
            self._all.settle()

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
            if legal:
                self._hear_damaged(data[2])
            del data[:1]
        del data[: -1 if data.endswith(b"\xff") else len(data)]
        return None

    def _rows(self, id: int, at: float) -> list[int]:
        """Return the servos that hear this id at the line's rate."""
        found = [
            row
            for row, own in enumerate(self._all.ids())
            if id in (own, BROADCAST) and self._all.listening(row) and self._all.baud(row) == self.wire.baud
        ]
        for row in found:
            self._all.heard_at[row] = at
        return found

    def _send(self, replies: Sequence[tuple[int, int, bytes]], delays: Sequence[float]) -> None:
        """Send statuses (id, error, data), each after its delay (s)."""
        if not replies:
            return
        pieces = [self._frame(*each) for each in replies]
        if self.faults.active:
            self.faults.speak([id for id, _, _ in replies], list(delays), pieces, joint=False)
            return
        sizes = list(map(len, pieces))
        self.wire.schedule_replies(self.wire.ends(delays, sizes), list(accumulate(sizes)), b"".join(pieces))

    # ------------------------------------------------------------------------- what a family answers

    def _frame(self, id: int, code: int, data: bytes) -> bytes:
        """Return a status with this error byte."""
        return instruction(id, code, data)

    def _carry_out(self, packet: ChecksumPacket, at: float) -> None:
        """Carry out one packet that arrived at `at` (s)."""
        raise NotImplementedError

    def _hear_damaged(self, id: int) -> None:
        """Take note of a packet with a wrong checksum; by default servos are silent."""
