"""Recording of the loop for the flight recorder: bytes of its buses, datagrams of its link.

Loop's process. The drivers are independent of it: a recorded port or CAN channel has the same interface.
"""

from collections.abc import Mapping, Sequence
from itertools import count
from typing import Generic, TypeVar

from twind.config.robot_spec import RobotFile
from twind.flight import LOST, NO_BUS, OPENED, REFUSED, EntryKind, FlightEntry, FlightRing, pack
from twind.flight.recorder_ring import TRANSCRIPT
from twind.standard_streams import write_line
from twind_drivers.bus import PortError
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.clock import Clock
from twind_drivers.ports.channel import CanChannel
from twind_drivers.ports.frame import Frames

SPAN = 30.0  # s that a recorder covers
MOST = 64 << 20  # bytes of one recorder: at 500 Hz and four buses of 3 Mbaud it covers some 20 s
_TICK = 800  # bytes of a tick's datagram and of the heads of its records, and for each joint ...
_JOINT = 110  # ... of its arrays
_SLOW = 50_000  # bytes/s of overviews, replies, events and calls


class BusTap:
    """Receiver of what happens on one bus, for a recorder; this base class ignores all of it."""

    def opened(self, where: str) -> None:
        """Report that the port is open."""

    def record_close(self, why: str) -> None:
        """Report that the port was closed or lost."""

    def identifying(self) -> None:
        """Report the start of an identification of all devices."""

    def identified(self, *, whole: bool) -> None:
        """Report the end of an identification; `whole`: every device replied."""


class FlightRecorder:
    """The loop's side of the flight recorder."""

    def __init__(self, ring: FlightRing, buses: Sequence[str], clock: Clock) -> None:
        self._ring = ring
        self._clock = clock
        self.tapes: Mapping[str, RecordingBusTap] = {
            name: RecordingBusTap(ring, place, clock) for name, place in zip(buses, count(), strict=False)
        }

    @property
    def fd(self) -> int:
        """Descriptor of the memory that other processes can read, also when this process is gone."""
        return self._ring.fd

    def link(self, kind: EntryKind, data: bytes) -> None:
        """Record a datagram of the link, or the arrays beside one."""
        self._ring.append(kind, NO_BUS, self._clock.now(), data)

    def sign(self, signature: bytes) -> None:
        """Store the fingerprint of version and files (`briefing.fingerprint`) for a later daemon."""
        self._ring.sign(signature)

    def close(self) -> None:
        """Release the recorder."""
        self._ring.close()


def recorder(robot: RobotFile, rate_hz: float, clock: Clock) -> FlightRecorder | None:
    """Return a recorder for this robot; without memory for it report the reason and return None."""
    try:
        ring = FlightRing.create(size(robot, rate_hz), buses=len(robot.buses))
    except OSError as error:
        write_line(2, "warning", f"twind: no flight recorder, this run leaves nothing behind: {error}")
        return None
    return FlightRecorder(ring, [bus.name for bus in robot.buses], clock)


def size(robot: RobotFile, rate_hz: float) -> int:
    """Bytes of a recorder that holds `SPAN` of this robot, or `MOST`."""
    buses = sum(robot.bus(bus.name).baud / 10.0 for bus in robot.buses)
    return min(MOST, round(SPAN * (buses + rate_hz * (_TICK + _JOINT * len(robot.joints)) + _SLOW)))


class RecordingBusTap(BusTap):
    """Recorder of one bus; the bytes of its last whole identification are kept beside the ring."""

    def __init__(self, ring: FlightRing, place: int, clock: Clock) -> None:
        self._ring = ring
        self._place = place
        self._clock = clock
        self._transcript: list[FlightEntry] | None = None  # of the running identification
        self._length = 0  # bytes of it, heads not counted
        self._whole = False  # the stored identification covers all devices

    def sent(self, data: bytes | bytearray | memoryview) -> None:
        """Record bytes written to the bus."""
        self._note(EntryKind.OUT, data)

    def record_received(self, data: bytes | bytearray | memoryview) -> None:
        """Record bytes read from the bus, whatever they are."""
        self._note(EntryKind.IN, data)

    def _note(self, kind: EntryKind, data: bytes | bytearray | memoryview) -> None:
        now = self._clock.now()
        self._ring.append(kind, self._place, now, data)
        if self._transcript is not None:
            self._transcript.append(FlightEntry(now, kind, self._place, bytes(data)))
            self._length += len(data)
            if self._length > TRANSCRIPT:  # a device sends without end: the stored bytes would be incomplete
                self._transcript = None

    def refused(self, size: int, why: str) -> None:
        """Record that the port did not take `size` bytes."""
        self._port(REFUSED, f"{size} bytes: {why}")

    def opened(self, where: str) -> None:
        """Record that the port is open."""
        self._port(OPENED, where)

    def record_close(self, why: str) -> None:
        """Record that the port was closed or lost."""
        self._transcript = None
        self._port(LOST, why)

    def _port(self, word: bytes, text: str) -> None:
        self._ring.append(EntryKind.PORT, self._place, self._clock.now(), word + b" " + text.encode())

    def identifying(self) -> None:
        """Begin to keep the bytes of an identification."""
        self._transcript = []
        self._length = 0

    def identified(self, *, whole: bool) -> None:
        """Store the bytes of the identification, which are complete.

        An identification with missing devices does not replace one of all devices.
        """
        if self._transcript is not None and (whole or not self._whole):
            self._whole = whole
            self._ring.keep(self._place, pack(self._transcript))
        self._transcript = None


Inside = TypeVar("Inside", ByteTransport, CanChannel)


class _Tapped(Generic[Inside]):
    """Common part of a recorded port and channel; a call without bytes costs nothing more."""

    def __init__(self, inside: Inside, tape: RecordingBusTap) -> None:
        self._inside: Inside = inside
        self._tape = tape
        self.name = inside.name
        self.fileno = inside.fileno
        self.arrival = inside.arrival
        self.close = inside.close

    @property
    def warning(self) -> str:
        """Warning of the inner port or channel."""
        return self._inside.warning

    @warning.setter
    def warning(self, text: str) -> None:
        self._inside.warning = text


class TappedTransport(_Tapped[ByteTransport]):
    """A `Transport` that records the bytes of the inner one."""

    def __init__(self, inside: ByteTransport, tape: RecordingBusTap) -> None:
        super().__init__(inside, tape)
        self.holds = inside.holds
        self.backlog = inside.backlog
        self.settle = inside.settle
        self.flush = inside.flush

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Write through the inner transport; record the bytes, or the refusal and its reason."""
        try:
            self._inside.write(data)
        except PortError as error:
            self._tape.refused(len(data), str(error))
            raise
        self._tape.sent(data)

    def read_into(self, buffer: memoryview) -> int:
        """Read through the inner transport and record the bytes."""
        taken = self._inside.read_into(buffer)
        if taken:
            self._tape.record_received(buffer[:taken])
        return taken

    def drain(self, thrown: bytearray | None = None) -> int:
        """Discard input through the inner transport.

        Of a device that sends without end the last bytes are recorded.
        """
        mine = bytearray()
        try:
            count = self._inside.drain(mine)
        except PortError:
            if mine:
                self._tape.record_received(mine)
            raise
        if count:
            self._tape.record_received(mine)
            if thrown is not None:
                thrown[:] = thrown + mine if len(mine) == count else mine
        return count


class TappedChannel(_Tapped[CanChannel]):
    """A `Channel` that records the frames of the inner one, as the bytes of their records."""

    def __init__(self, inside: CanChannel, tape: RecordingBusTap) -> None:
        super().__init__(inside, tape)
        self.condition = inside.condition
        self.drive = inside.drive
        self.purge = inside.purge

    def send(self, frames: Frames, now: float) -> None:
        """Send through the inner channel and record the frames, or the refusal."""
        try:
            self._inside.send(frames, now)
        except PortError as error:
            self._tape.refused(frames.nbytes, str(error))
            raise
        if frames.size:
            self._tape.sent(frames.tobytes())

    def receive(self, now: float) -> Frames:
        """Receive through the inner channel and record the frames."""
        frames = self._inside.receive(now)
        if frames.size:
            self._tape.record_received(frames.tobytes())
        return frames
