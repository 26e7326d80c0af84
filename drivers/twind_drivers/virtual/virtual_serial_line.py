"""One wire of virtual servos and the adapter between it and the host, for a bus of any protocol."""

from twind_drivers.virtual.faulty_byte_stream import FaultyByteStream, SerialAdapter
from twind_drivers.virtual.half_duplex_wire import HalfDuplexWire
from twind_drivers.virtual.serial_line_faults import SerialLineFaults


class VirtualSerialLine:
    """A virtual serial bus without its servos (`ServableBus`). Time (s) never goes back."""

    faults: SerialLineFaults

    def __init__(
        self, name: str, baud: int, *, wire_timing: bool, adapter: SerialAdapter | None, seed: int
    ) -> None:
        """`seed`: of the random faults; the same orders and bytes then give the same bytes."""
        self.name = name
        self.wire = HalfDuplexWire(baud, timing=wire_timing)
        self._stream = FaultyByteStream(self.wire, adapter or SerialAdapter(), seed)

    @property
    def is_plugged(self) -> bool:
        """True if the adapter is plugged in."""
        return self.faults.plugged

    @property
    def backlog(self) -> int:
        """Bytes that a stalled adapter has taken and not sent."""
        return len(self._stream.held)

    def flush(self) -> None:
        """Drop the bytes of the backlog: they are never sent."""
        self._stream.held = b""
        self._stream.look()

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
        raise NotImplementedError
