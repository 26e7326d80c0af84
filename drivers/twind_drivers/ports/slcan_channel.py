"""Channel over a serial adapter with the slcan protocol: one write per cycle, one split per read.

slcan has no checksum, no time stamps and no report of a controller that left the wire. The state of the line
comes from two signs: the adapter refuses frames (BEL) while none is received, and its status flags where it
answers `F`.
"""

from math import inf

import numpy as np

from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.byte_transport import ByteTransport, output_full
from twind_drivers.ports.channel import CanChannelStatus, CanErrorState
from twind_drivers.ports.frame import NOTHING, Frames
from twind_drivers.ports.slcan_codec import SlcanDecoder, encode
from twind_drivers.ports.transmit_stall import DEAD, ChannelStatusTracker, TransmitStall, dead

# LAWICEL's table; the manual calls S7 800 kbit/s, python-can 750: it is left out.
RATES = {
    10_000: b"S0",
    20_000: b"S1",
    50_000: b"S2",
    100_000: b"S3",
    125_000: b"S4",
    250_000: b"S5",
    500_000: b"S6",
    1_000_000: b"S8",
}
ASK = b"F\r"
STATUS_INTERVAL = 0.1  # s
GIVE_UP = 1.0  # s without a reply to the first status request: the adapter does not support it
ANSWERS = 0.1  # s after an opening that BELs are answers to it: `C` is refused where it was closed already
# an adapter that restarts when its port is opened loses earlier commands
RETRY = 0.5
TRIES = 10
# As LAWICEL numbers them (the SJA1000's; read in public sources, unverified on an adapter; others give
# the bits other meanings). Bit 2 is the warning level, which is no state of its own.
PASSIVE = 0x20
BUS_ERROR = 0x80
# bytes of one read, and reads of one `receive`: a babbling line never runs dry
ROOM = 4096
READS = 16


def opening(bitrate: int) -> bytes:
    """Return the bytes that open an adapter's channel with empty queues.

    Raises ValueError for another bitrate.
    """
    if bitrate not in RATES:
        rates = ", ".join(str(rate) for rate in RATES)
        raise ValueError(f"bitrate {bitrate} is not a bitrate of slcan: {rates}")
    # The first line ends terminate a partial line of an earlier owner.
    return b"\r\rC\r" + RATES[bitrate] + b"\rO\r"


class SlcanChannel:
    """One adapter on a byte transport. `bitrate` in bit/s, of the CAN side."""

    def __init__(self, transport: ByteTransport, bitrate: int) -> None:
        """Opens the adapter's channel at once, and waits for nothing. Raises PortError."""
        self.name = transport.name
        self.warning = transport.warning
        self.condition = CanChannelStatus()
        try:
            self._opening = opening(bitrate)
        except ValueError as error:
            raise PortError(self.name, str(error)) from None
        self._transport = transport
        self._lines = SlcanDecoder()
        self._standing = ChannelStatusTracker(self.condition)  # of the wire: what the adapter refuses
        self._port = TransmitStall()  # of the serial side: bytes that do not leave
        self._buffer = bytearray(ROOM)
        self._room = memoryview(self._buffer)
        self._flushed = True  # an empty output proves nothing after a flush
        self._answering = self._since = inf  # s; of the present opening, once time is known
        self._answered = False
        self._tries = 0
        # for flags at all; it has answered
        self._polls_status = True
        self._supports_status = False
        self._polled_at = -inf  # s
        self._last = 0  # bytes of the last write
        self._open = True
        transport.drain()
        transport.write(self._opening)

    def fileno(self) -> int:
        """Return the file descriptor of the transport; -1 where it has none."""
        return self._transport.fileno()

    def arrival(self) -> float:
        """Return the arrival time of the transport, s."""
        return self._transport.arrival()

    def send(self, frames: Frames, now: float) -> None:
        """All frames in one write. Raises PortError, ValueError for what is no frame.

        Kind OUTPUT_FULL: more than the last write still waits in the port, or it took a part of this one. All
        of that is dropped.
        """
        if not len(frames):
            return
        lines = encode(frames)
        try:
            if self._transport.holds:
                self._require_room()
            self._last = len(lines)
            self._transport.write(lines)
            self._flushed = False
        except PortError as error:
            if error.lost:
                raise
            self._on_port_full(now, len(frames))
            if error.kind is PortErrorCause.OUTPUT_FULL:
                raise
            raise output_full(self.name, len(lines), len(lines)) from error

    def receive(self, now: float) -> Frames:
        """All frames that have arrived. Raises PortError of kind LOST."""
        if self._since == inf:
            self._since = now
            self._answering = now + ANSWERS
        found = self._drain(now)
        if self._polls_status or not self._answered:
            self._converse(now)
        return found

    def drive(self, owner: object) -> None:
        """Do nothing: `purge` empties an exclusively owned adapter in any case."""

    def purge(self) -> None:
        """Empty the port's output, and the adapter's queue by closing and opening its channel.

        What a wedged port does not take is no failure here: `send` tells. Raises PortError of kind LOST.
        """
        self._transport.flush()
        self._reopen()
        self._flushed = True
        self._standing.stall.emptied()

    def close(self) -> None:
        """Purge, close the adapter's channel, release the port. May be called twice; never raises."""
        if not self._open:
            return
        self._open = False
        try:
            self._transport.flush()
            self._transport.write(b"\r\rC\r")
        except PortError:
            pass  # lost or blocked: no command can reach the adapter
        self._transport.close()

    # ------------------------------------------------------------------------------- inside

    def _require_room(self) -> None:
        waiting = self._transport.backlog()
        if waiting > self._last:
            raise output_full(self.name, waiting, self._last)
        if not waiting and not self._flushed:
            self._port.record_acceptance()

    def _on_port_full(self, now: float, count: int) -> None:
        """The port was full. Raises PortError when it has been for a second."""
        self.condition.refused += count
        waited = self._port.record_refusal(now)
        self.purge()
        if waited >= DEAD:
            raise dead(self.name, waited)

    def _reopen(self) -> None:
        self._lines.forget()
        self._since = self._answering = inf
        try:
            self._transport.write(self._opening)
        except PortError as error:
            if error.lost:
                raise

    def _drain(self, now: float) -> Frames:
        parts: list[Frames] = []
        lines = self._lines
        before = lines.refused
        acknowledged = lines.acknowledged
        errors = lines.errors
        for _ in range(READS):
            count = self._transport.read_into(self._room)
            if count:
                self._answered = True
                parts.append(lines.take(self._room[:count]))
            if count < ROOM:
                break
        if not parts:
            return NOTHING
        found = parts[0] if len(parts) == 1 else np.concatenate(parts)
        if not self._transport.holds:
            self._port.record_acceptance()  # an adapter that sends does not hang; slcan has no better sign
        self.condition.errors += lines.errors - errors
        if lines.acknowledged > acknowledged:
            self._standing.stall.record_acceptance()
        if len(found):
            self._standing.stall.record_reception(now)
        if lines.refused > before and now >= self._answering:
            self._refuse(lines.refused - before, now)
        if lines.flags >= 0:
            self._flags(lines.flags)
        self._standing.settle()
        return found

    def _refuse(self, count: int, now: float) -> None:
        """Handle BELs.

        Raises PortError when the adapter took no frame for a second, and no device answered.
        """
        self.condition.refused += count
        stall = self._standing.stall
        waited = stall.record_refusal(now)
        if stall.blocked and waited >= DEAD:
            self.purge()
            self._standing.settle()
            raise dead(self.name, waited)

    def _flags(self, flags: int) -> None:
        self._lines.flags = -1
        self._supports_status = True
        self.condition.errors += bool(flags & BUS_ERROR)
        self._standing.record_status(CanErrorState.PASSIVE if flags & PASSIVE else CanErrorState.ACTIVE)

    def _converse(self, now: float) -> None:
        """Reopen an adapter that has never sent a byte; request its flags where it reports them."""
        if not self._answered and self._tries < TRIES and now - self._since >= RETRY:
            self._tries += 1
            self._polls_status = True
            self._polled_at = -inf
            self._reopen()
        elif self._polls_status and now - self._polled_at >= STATUS_INTERVAL:
            self._request_status(now)

    def _request_status(self, now: float) -> None:
        if not self._supports_status and self._polled_at > -inf:
            self._polls_status = now - self._polled_at < GIVE_UP
            return
        self._polled_at = now
        try:
            if not (self._transport.holds and self._transport.backlog()):
                self._transport.write(ASK)
        except PortError as error:
            if error.lost:
                raise
