"""One line, one transaction at a time: deadlines, what stays pending, what nobody asked for, a full port."""

import pytest

from tests.support.driver_rig import is_output_full
from twind_drivers.bus import PortError
from twind_drivers.byte_transport import output_full
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.replies import FastSyncReadReply, StatusReply
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction


class Port:
    """A port that takes everything, or nothing while `full`; `late` bytes wait in its input."""

    name = "port"
    warning = ""

    def __init__(self) -> None:
        self.full = False
        self.late = b""
        self.taken = b""
        self.holds = False
        self.waiting = 0
        self.flushed = 0
        self.writes = 0
        self.cut_short = False

    def fileno(self) -> int:
        return -1

    def arrival(self) -> float:
        return 0.0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if self.full:
            raise PortError(self.name, "full")
        if self.cut_short:
            raise output_full(self.name, 1, len(data))
        self.taken += bytes(data)
        self.writes += 1

    def read_into(self, buffer: memoryview) -> int:
        count = min(len(buffer), len(self.late))
        buffer[:count] = self.late[:count]
        self.late = self.late[count:]
        return count

    def settle(self) -> None:
        pass

    def drain(self, thrown: bytearray | None = None) -> int:
        if thrown is not None:
            thrown += self.late
        count = len(self.late)
        self.late = b""
        return count

    def backlog(self) -> int:
        return self.waiting

    def flush(self) -> None:
        self.flushed += self.waiting
        self.waiting = 0

    def close(self) -> None:
        pass


PING = SerialTransaction(p.ping(1), StatusReply((1,), 3), 1)
ORDER = SerialTransaction(p.sync_write(64, dict.fromkeys(range(50), b"\0")), None, 0)


def port_of(line: HalfDuplexTransactor) -> Port:
    port = line.transport
    assert isinstance(port, Port)
    return port


def talk(
    line: HalfDuplexTransactor, answer: bytes, exchange: SerialTransaction | None = None, now: float = 0.0
) -> None:
    """One transaction; `answer` is what arrives until its deadline."""
    port = port_of(line)
    line.send(exchange or PING, now)
    port.late = answer
    while port.late and not line.feed(now):
        pass
    line.end()


@pytest.fixture
def line() -> HalfDuplexTransactor:
    return HalfDuplexTransactor(
        "main", Port(), baud=10_000, return_delay_s=0.004, slack=0.002, find_packets=p.find_packets
    )


def test_an_order_without_answer_is_done_at_once_but_keeps_the_wire_busy(line: HalfDuplexTransactor) -> None:
    line.send(ORDER, 1.0)
    assert line.feed(1.0)
    assert line.deadline == pytest.approx(1.114)
    line.send(PING, 1.0)
    assert line.deadline == pytest.approx(1.114 + 0.010 + 0.014 + 0.004 + 0.002)
    line.send(PING, 9.0)
    assert line.deadline == pytest.approx(9.030)


def test_an_unsent_request_is_not_sent_later_unless_it_is_urgent(line: HalfDuplexTransactor) -> None:
    port = port_of(line)
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


def test_late_bytes_are_dropped_and_counted_before_a_request(line: HalfDuplexTransactor) -> None:
    port = port_of(line)
    port.late = p.status(1, 0, b"\1\2\3")
    line.send(PING, 0.0)
    assert not line.feed(0.0)
    line.end()
    assert line.strays == 14


def test_the_time_of_a_reply_is_that_of_its_last_byte(line: HalfDuplexTransactor) -> None:
    port = port_of(line)
    line.send(PING, 0.0)
    reply = p.status(1, 0, b"\1\2\3")
    port.late = reply[:5]
    assert not line.feed(0.01)
    port.late = reply[5:]
    assert line.feed(0.02)
    assert line.feed(0.5)
    assert line.received == 0.02


def test_nothing_under_way_is_nothing_to_wait_for(line: HalfDuplexTransactor) -> None:
    assert line.feed(0.0)
    assert line.end() is None


# ---------------------------------------------------------------------------------- unasked (FOREIGN_TRAFFIC)

OWN = p.status(1, 0, b"\1\2\3")
OTHERS = {
    "a status of an id nobody knows": p.status(99, 0, b"\1\2\3"),
    "a second status of one device": p.status(1, 0, b"\1\2\3"),
    "a status of another length": p.status(1, 0, b"\1\2\3\4"),
    "another master's read": p.read(1, 132, 4),
    "another master's goals": p.sync_write(116, {1: bytes(4), 2: bytes(4)}),
}


@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("before", [True, False])
def test_foreign_packets_are_counted(line: HalfDuplexTransactor, other: str, before: bool) -> None:
    """FOREIGN_TRAFFIC: e-manual, "Protocol 2.0": one master, and a device speaks only when asked."""
    talk(line, OWN)
    assert line.foreign == 0
    talk(line, OTHERS[other] + OWN if before else OWN + OTHERS[other])
    assert line.foreign == 1
    assert line.strays >= len(OWN)


@pytest.mark.parametrize("other", OTHERS)
def test_bytes_that_arrive_between_transactions_are_counted_with_the_next_request(
    line: HalfDuplexTransactor, other: str
) -> None:
    port = port_of(line)
    talk(line, OWN)
    port.late = OTHERS[other] + b"noise" + OTHERS[other]
    talk(line, OWN)
    assert line.foreign == 2
    assert line.strays == 2 * len(OTHERS[other]) + 5


def test_bytes_around_a_fast_reply_are_judged_as_well(line: HalfDuplexTransactor) -> None:
    fast = SerialTransaction(p.fast_sync_read((1, 2), 126, 10), FastSyncReadReply((1, 2), 10), 1)
    joint = b"".join(p.fast_status([(0, 1, bytes(10)), (0, 2, bytes(10))], 29))
    talk(line, joint, fast)
    assert (line.foreign, line.strays) == (0, 0)
    talk(line, p.status(9, 0, bytes(3)) + joint + p.ping(1), fast)
    assert line.foreign == 2
    assert line.strays == 14 + 10


def test_an_answer_that_comes_too_late_is_none_of_them_for_a_second(line: HalfDuplexTransactor) -> None:
    port = port_of(line)
    talk(line, b"", now=1.0)
    port.late = OWN  # of the first
    talk(line, OWN[:5], now=1.1)
    assert line.foreign == 0
    talk(line, p.status(1, 0, b"\1\2") + OWN, now=1.2)
    assert line.foreign == 0
    assert line.strays == 13
    talk(line, OWN + OWN, now=2.05)
    assert line.foreign == 0
    talk(line, OWN + OWN, now=2.15)
    talk(line, OWN + OWN, now=2.2)
    assert line.foreign == 1
    talk(line, p.status(99, 0, b"\1\2\3") + p.ping(1), now=2.3)
    talk(line, p.status(99, 0, b"\1\2\3") + p.ping(1) + OWN, now=2.4)  # of others nothing was awaited
    assert line.foreign == 5


def test_noise_is_not_foreign(line: HalfDuplexTransactor) -> None:
    talk(line, bytes(range(256)) + OWN[:-1] + b"x" + OWN)
    assert line.foreign == 0
    assert line.strays == 256 + 14


# --------------------------------------------------------------------------------------------- echo


def test_an_echo_is_recognised_once_and_then_taken_off_each_answer(line: HalfDuplexTransactor) -> None:
    """Half-duplex adapters without a direction switch give back what they send."""
    assert not line.echo
    for _ in range(3):
        line.goals = p.sync_write(116, {1: bytes(4)})
        lead = line.goals
        line.send(PING, 0.0, goals=True)
        port = port_of(line)
        port.late = lead + p.ping(1) + OWN
        while not line.feed(0.0):
            pass
        exchange = line.end()
        assert exchange is not None
        assert exchange.reply is not None
        assert exchange.reply.heard.all()
        assert line.echo
        assert (line.strays, line.foreign) == (0, 0)


def test_the_echo_of_an_order_that_is_never_answered_is_no_traffic_either(line: HalfDuplexTransactor) -> None:
    port = port_of(line)
    line.send(ORDER, 0.0)
    port.late = ORDER.packet
    talk(line, PING.packet + OWN)
    assert line.echo
    assert (line.strays, line.foreign) == (0, 0)


def test_a_damaged_echo_costs_no_answer(line: HalfDuplexTransactor) -> None:
    talk(line, PING.packet + OWN)
    assert line.echo
    for damaged in (b"\0" + PING.packet[1:], PING.packet[:5], PING.packet[:-1] + b"\0"):
        talk(line, PING.packet + OWN)
        talk(line, damaged + OWN)
        assert PING.reply is not None
        assert PING.reply.heard.all()
        assert line.foreign == 0


def test_the_same_packet_of_another_master_behind_the_answer_is_no_echo(line: HalfDuplexTransactor) -> None:
    talk(line, OWN + PING.packet)
    assert not line.echo
    assert line.foreign == 1


# --------------------------------------------------------------------------------------------- a full port


def test_a_port_that_still_holds_more_than_the_last_packet_is_flushed_and_nothing_is_sent(
    line: HalfDuplexTransactor,
) -> None:
    """TX_BACKLOG: goals that wait in the port would arrive late, one after the other."""
    port = port_of(line)
    talk(line, OWN)
    port.holds = True
    port.waiting = len(PING.packet)
    sent = port.taken
    talk(line, OWN)  # the last packet may still be on its way
    assert port.taken != sent
    port.waiting = len(PING.packet) + 1
    sent = port.taken
    line.goals = b"goals"
    line.urgent = b"off"
    with pytest.raises(PortError, match=r"11 bytes still wait.*had 10.*nothing sent", check=is_output_full):
        line.send(PING, 1.0, goals=True)
    assert (port.taken, port.flushed) == (sent, 11)
    assert line.feed(1.0)
    assert line.end() is None
    talk(line, OWN)
    assert port.taken == sent + b"off" + PING.packet


def test_a_port_without_an_input_count_is_not_flushed(line: HalfDuplexTransactor) -> None:
    port = port_of(line)
    port.waiting = 1000
    talk(line, OWN)
    assert port.flushed == 0


@pytest.mark.parametrize(("one_write", "writes"), [(True, 1), (False, 2)])
def test_goals_and_request_leave_in_one_write_or_in_two(one_write: bool, writes: int) -> None:
    port = Port()
    line = HalfDuplexTransactor(
        "main",
        port,
        baud=10_000,
        return_delay_s=0.0,
        slack=0.002,
        find_packets=p.find_packets,
        one_write=one_write,
    )
    line.goals = b"goals"
    line.send(PING, 0.0, goals=True)
    assert (port.taken, port.writes) == (b"goals" + PING.packet, writes)
    line.send(PING, 0.0, goals=True)
    assert port.writes == writes + 1


def test_torque_off_that_is_thrown_away_with_what_waited_leaves_again_until_an_answer_shows_it_left(
    line: HalfDuplexTransactor,
) -> None:
    """TX_BACKLOG on a stalled adapter: the port takes the packet, and the next look throws it away."""
    port = port_of(line)
    port.holds = True
    line.urgent = b"off"
    talk(line, b"")
    port.waiting = len(b"off" + PING.packet)
    talk(line, b"", now=0.1)
    for now in (0.2, 0.4):
        port.waiting = 1000
        with pytest.raises(PortError, check=is_output_full):
            line.send(PING, now)
        port.taken = b""
        talk(line, b"", now=now + 0.1)
        assert port.taken == b"off" + PING.packet
    talk(line, OWN, now=1.0)
    port.waiting = 1000
    port.taken = b""
    with pytest.raises(PortError, check=is_output_full):
        line.send(PING, 1.1)
    talk(line, OWN, now=1.2)
    assert port.taken == PING.packet


def test_a_packet_that_the_port_cuts_short_is_no_question_and_torque_off_goes_before_the_next(
    line: HalfDuplexTransactor,
) -> None:
    port = port_of(line)
    line.urgent = b"off"
    talk(line, b"")
    port.cut_short = True
    line.goals = b"goals"
    with pytest.raises(PortError, check=is_output_full):
        line.send(PING, 0.1, goals=True)
    assert line.feed(0.1)
    assert line.end() is None
    port.cut_short = False
    port.taken = b""
    talk(line, OWN, now=0.2)
    assert port.taken == b"off" + PING.packet


# --------------------------------------------------------------------------------------------- who only tells

TOLD = p.status(200, 0, b"\xff\xff\xfd\0\5\6")  # stuffed on the wire


@pytest.fixture
def telling() -> HalfDuplexTransactor:
    return HalfDuplexTransactor(
        "main",
        Port(),
        baud=10_000,
        return_delay_s=0.004,
        slack=0.002,
        find_packets=p.find_packets,
        sensors=(200,),
    )


@pytest.mark.parametrize("where", ["before the request", "before the answer", "behind it"])
def test_a_late_status_of_a_sensor_is_neither_astray_nor_foreign(
    telling: HalfDuplexTransactor, where: str
) -> None:
    talk(telling, OWN)
    port = port_of(telling)
    port.late = TOLD if where == "before the request" else b""
    talk(telling, {"before the answer": TOLD + OWN, "behind it": OWN + TOLD}.get(where, OWN))
    assert (telling.strays, telling.foreign, telling.late) == (0, 0, [6])


def test_noise_beside_it_stays_astray(telling: HalfDuplexTransactor) -> None:
    talk(telling, b"noise" + TOLD + OWN)
    assert (telling.strays, telling.late) == (5, [6])


def test_bytes_behind_a_sensor_reply_are_not_counted_as_strays(telling: HalfDuplexTransactor) -> None:
    """And only that: behind a servo's answer it is astray."""
    port = port_of(telling)
    ask = SerialTransaction(p.read(200, 16, 6), StatusReply((200,), 6), 1)
    for exchange, answer, strays in ((ask, TOLD, 0), (PING, OWN, 5)):
        talk(telling, answer, exchange)
        port.late = b"noise"
        telling.send(PING, 1.0)
        assert telling.strays == strays
        telling.end()
