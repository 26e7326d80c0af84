"""A port whose input a test writes, for one half-duplex line."""

from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction


class ScriptedPort:
    """`input` is what the host receives next, `output` what it has sent."""

    name = "port"
    warning = ""
    holds = False

    def __init__(self) -> None:
        self.input = b""
        self.output = b""

    def fileno(self) -> int:
        return -1

    def arrival(self) -> float:
        return 0.0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.output += bytes(data)

    def read_into(self, buffer: memoryview) -> int:
        count = min(len(buffer), len(self.input))
        buffer[:count] = self.input[:count]
        self.input = self.input[count:]
        return count

    def settle(self) -> None:
        pass

    def drain(self, thrown: bytearray | None = None) -> int:
        if thrown is not None:
            thrown += self.input
        count = len(self.input)
        self.input = b""
        return count

    def backlog(self) -> int:
        return 0

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass

    def answer(self, line: HalfDuplexTransactor, exchange: SerialTransaction, reply: bytes) -> None:
        """One transaction; `reply` is all that arrives until its deadline."""
        line.send(exchange, 0.0)
        self.input = reply
        while self.input and not line.feed(0.0):
            pass
        line.end()
