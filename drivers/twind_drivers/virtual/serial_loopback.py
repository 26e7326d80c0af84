"""In-process transport to the virtual bus: the mock bus of the tests, under a fake clock."""

from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.clock import Clock
from twind_drivers.virtual.faulty_byte_stream import MOST
from twind_drivers.virtual.servable_bus import ServableBus


class Loopback:
    """`ByteTransport` without descriptor: `arrival` gives the clock the time of the next complete reply."""

    def __init__(self, bus: ServableBus, clock: Clock) -> None:
        self.name = f"virtual:{bus.name}"
        self.warning = ""
        self.holds = True
        self._bus = bus
        self._clock = clock
        self._open = True
        self._left = b""  # taken from the bus, not yet read

    def fileno(self) -> int:
        """-1: nothing to poll."""
        return -1

    def arrival(self) -> float:
        """Time (s) of the next complete answer; an unplugged port wakes its reader at once."""
        if self._left or not self._bus.is_plugged:
            return self._clock.now()
        return self._bus.next_output_time()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Hand `data` to the servos.

        Raises PortError: `lost` when unplugged or closed, else a stalled adapter is full.
        """
        self._check()
        if self._bus.backlog + len(data) > MOST:
            backlog = f"0 of {len(data)} bytes taken: earlier packets still wait in the port's output"
            raise PortError(self.name, backlog)
        self._bus.receive(bytes(data), self._clock.now())

    def read_into(self, buffer: memoryview) -> int:
        """Bytes whose time has come, as many as fit; 0 if there are none. Raises PortError of kind LOST."""
        self._check()
        self._left += self._bus.take(self._clock.now())
        count = min(len(self._left), len(buffer))
        buffer[:count] = self._left[:count]
        self._left = self._left[count:]
        return count

    def drain(self, thrown: bytearray | None = None) -> int:
        """Throw away what has arrived; bytes thrown, put into `thrown` too."""
        self._check()
        gone = self._left + self._bus.take(self._clock.now())
        self._left = b""
        if thrown is not None:
            thrown += gone
        return len(gone)

    def backlog(self) -> int:
        """Bytes written that have not left yet: those of a stalled adapter. Raises PortError of kind LOST."""
        self._check()
        return self._bus.backlog

    def settle(self) -> None:
        """Do nothing: no kernel is in between."""

    def flush(self) -> None:
        """Throw those away. Raises PortError of kind LOST."""
        self._check()
        self._bus.flush()

    def close(self) -> None:
        """Release the port."""
        self._open = False

    def _check(self) -> None:
        if not self._open:
            raise PortError(self.name, "the port is closed", kind=PortErrorCause.LOST)
        if not self._bus.is_plugged:
            raise PortError(self.name, "the adapter was unplugged", kind=PortErrorCause.LOST)
