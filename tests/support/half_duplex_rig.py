"""A port whose input a test writes, for one half-duplex line."""

from twind_drivers.bus import PortError
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction


class ScriptedPort:
    """`input` is what the host receives next, `writes` what it has sent; `error` meets the next write."""

    name = "port"
    warning = ""

    def __init__(self) -> None:
        self.holds = False
        self.waiting = 0
        self.flushed = 0  # times that the output was dropped
        self.input = b""
        self.writes: list[bytes] = []
        self.error: PortError | None = None
        self.settled = 0  # times that it was waited for the kernel

    @property
    def output(self) -> bytes:
        """All that the host has sent."""
        return b"".join(self.writes)

    def fileno(self) -> int:
        return -1

    def arrival(self) -> float:
        return 0.0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if self.error is not None:
            raise self.error
        self.writes.append(bytes(data))

    def read_into(self, buffer: memoryview) -> int:
        count = min(len(buffer), len(self.input))
        buffer[:count] = self.input[:count]
        self.input = self.input[count:]
        return count

    def settle(self) -> None:
        self.settled += 1

    def drain(self, thrown: bytearray | None = None) -> int:
        if thrown is not None:
            thrown += self.input
        count = len(self.input)
        self.input = b""
        return count

    def backlog(self) -> int:
        return self.waiting

    def flush(self) -> None:
        self.flushed += 1

    def close(self) -> None:
        pass

    def answer(self, line: HalfDuplexTransactor, exchange: SerialTransaction, reply: bytes) -> None:
        """One transaction; `reply` is all that arrives until its deadline."""
        line.send(exchange, 0.0)
        self.input = reply
        while self.input and not line.feed(0.0):
            pass
        line.end()
