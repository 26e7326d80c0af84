"""One line, one transaction at a time: deadlines while our own bytes still go out, and what stays pending."""

import pytest

from twind_drivers.bus import PortError
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.line import Exchange, Line
from twind_drivers.dynamixel.replies import PlainReply


class Port:
    """A port that takes everything, or nothing while `full`; `late` bytes wait in its input."""

    name = "port"
    warning = ""
    holds = False

    def __init__(self) -> None:
        self.full, self.late, self.taken = False, b"", b""

    def fileno(self) -> int:
        return -1

    def arrival(self) -> float:
        return 0.0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if self.full:
            raise PortError(self.name, "full")
        self.taken += bytes(data)

    def read_into(self, buffer: memoryview) -> int:
        count = min(len(buffer), len(self.late))
        buffer[:count] = self.late[:count]
        self.late = self.late[count:]
        return count

    def drain(self, thrown: bytearray | None = None) -> int:
        if thrown is not None:
            thrown += self.late
        count, self.late = len(self.late), b""
        return count

    def backlog(self) -> int:
        return 0

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


PING = Exchange(p.ping(1), PlainReply((1,), 3), 1)
ORDER = Exchange(p.sync_write(64, dict.fromkeys(range(50), b"\0")), None, 0)


@pytest.fixture
def line() -> Line:
    return Line("main", Port(), baud=10_000, return_delay_s=0.004, slack=0.002)


def test_an_order_without_answer_is_done_at_once_but_keeps_the_wire_busy(line: Line) -> None:
    line.send(ORDER, 1.0)
    assert line.feed(1.0)
    assert line.deadline == pytest.approx(1.114)
    line.send(PING, 1.0)
    assert line.deadline == pytest.approx(1.114 + 0.010 + 0.014 + 0.004 + 0.002)
    line.send(PING, 9.0)
    assert line.deadline == pytest.approx(9.030)


def test_what_could_not_be_sent_does_not_leave_later_unless_it_is_urgent(line: Line) -> None:
    port = line.transport
    assert isinstance(port, Port)
    port.full = True
    line.goals = b"goals"
    with pytest.raises(PortError):
        line.send(PING, 0.0, goals=True)
    line.urgent = b"off"
    with pytest.raises(PortError):
        line.send(PING, 0.0)
    port.full = False
    line.send(PING, 0.0, goals=True)
    assert port.taken == b"off" + p.ping(1)
    assert line.urgent == b""


def test_late_bytes_are_dropped_and_counted_before_a_request(line: Line) -> None:
    port = line.transport
    assert isinstance(port, Port)
    port.late = p.status(1, 0, b"\1\2\3")
    line.send(PING, 0.0)
    assert not line.feed(0.0)
    line.end()
    assert line.strays == 14


def test_the_time_of_a_reply_is_that_of_its_last_byte(line: Line) -> None:
    port = line.transport
    assert isinstance(port, Port)
    line.send(PING, 0.0)
    reply = p.status(1, 0, b"\1\2\3")
    port.late = reply[:5]
    assert not line.feed(0.01)
    port.late = reply[5:]
    assert line.feed(0.02)
    assert line.feed(0.5)
    assert line.received == 0.02


def test_nothing_under_way_is_nothing_to_wait_for(line: Line) -> None:
    assert line.feed(0.0)
    assert line.end() is None
