"""One line: how long each transaction lasts and its replies are waited for, and what is left from before."""

from math import inf

import pytest

from tests.support.driver_rig import is_output_full
from tests.support.half_duplex_rig import ScriptedPort
from twind_drivers.bus import PortError
from twind_drivers.byte_transport import output_full
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.replies import StatusReply
from twind_drivers.feetech.feetech_packet import sync_read
from twind_drivers.half_duplex import checksum_packet
from twind_drivers.half_duplex.chained_read import chained_read
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.pending_reply import PacketFramer

BYTE = 0.001  # s
DELAY = 0.004  # s
SLACK = 0.002  # s
ADAPTER = 0.001  # s, of each further request of a chain
ANSWER = p.status(1, 0, b"\1\2\3")
GOALS = p.sync_write(116, {1: bytes(4)})
STATUS = checksum_packet.instruction(1, 0, bytes(6))


def ping() -> SerialTransaction:
    return SerialTransaction(p.ping(1), StatusReply((1,), 3), 1)


def order() -> SerialTransaction:
    return SerialTransaction(GOALS, None, 0)


def line_of(
    port: ScriptedPort, framer: PacketFramer = p.find_packets, **more: object
) -> HalfDuplexTransactor:
    return HalfDuplexTransactor(
        "main",
        port,
        baud=10_000,
        return_delay_s=DELAY,
        slack=SLACK,
        find_packets=framer,
        **more,  # type: ignore[arg-type]
    )


@pytest.fixture
def port() -> ScriptedPort:
    return ScriptedPort()


@pytest.fixture
def line(port: ScriptedPort) -> HalfDuplexTransactor:
    return line_of(port)


@pytest.fixture
def chaining(port: ScriptedPort) -> HalfDuplexTransactor:
    return line_of(port, checksum_packet.find_packets)


# ---------------------------------------------------------------------------------- before and after


def test_before_the_first_transaction_nothing_has_been_sent(line: HalfDuplexTransactor) -> None:
    assert (line.sent, line.received, line.deadline) == (-inf, -inf, -inf)
    assert (line.strays, line.foreign, line.goals, line.urgent) == (0, 0, b"", b"")
    assert line.feed(0.0)


def test_goals_wait_for_the_request_that_they_belong_to_and_leave_in_its_write(
    line: HalfDuplexTransactor, port: ScriptedPort
) -> None:
    line.goals = GOALS
    line.send(ping(), 0.0)
    assert port.writes == [p.ping(1)]
    line.send(ping(), 0.1, goals=True)
    assert port.writes == [p.ping(1), GOALS + p.ping(1)]
    line.send(ping(), 0.2, goals=True)
    assert port.writes[2:] == [p.ping(1)]


def test_a_transaction_without_an_answer_was_received_when_it_was_sent(line: HalfDuplexTransactor) -> None:
    line.send(ping(), 0.5)
    line.end()
    line.send(ping(), 1.5)
    assert not line.feed(1.6)
    line.end()
    assert (line.sent, line.received) == (1.5, 1.5)


def test_noise_behind_a_sensor_is_its_own_until_the_next_request_even_one_without_reply(
    port: ScriptedPort,
) -> None:
    line = line_of(port, sensors=(200,))
    read = SerialTransaction(p.read(200, 16, 6), StatusReply((200,), 6), 1)
    port.answer(line, read, p.status(200, 0, bytes(6)))
    port.input = b"noise"
    line.send(order(), 0.1)
    assert line.strays == 0
    line.end()
    port.input = b"noise"
    line.send(ping(), 0.2)
    assert line.strays == 5


# ---------------------------------------------------------------------------------- times


def test_the_time_of_a_transaction_is_its_bytes_its_delays_and_what_its_device_takes_longer(
    line: HalfDuplexTransactor, chaining: HalfDuplexTransactor
) -> None:
    slow = SerialTransaction(p.ping(1), StatusReply((1,), 3), 1, extra=0.5)
    assert line.span(ping()) == pytest.approx((10 + 14) * BYTE + DELAY)
    assert line.span(slow) == pytest.approx((10 + 14) * BYTE + DELAY + 0.5)
    assert line.span(order()) == pytest.approx(len(GOALS) * BYTE)
    chain = chained_read((1, 2, 3), 56, 6, lambda _: False, sync_read)
    assert chaining.span(chain) == pytest.approx(3 * (8 + 12) * BYTE + 3 * DELAY + 2 * ADAPTER)


@pytest.mark.parametrize("latest", [-inf, 1.04, 1.5])
def test_a_reply_is_awaited_for_its_bytes_those_of_the_goals_and_the_slack_or_longer_where_asked(
    line: HalfDuplexTransactor, latest: float
) -> None:
    line.goals = GOALS
    line.send(ping(), 1.0, goals=True, latest=latest)
    least = 1.0 + (len(GOALS) + 10 + 14) * BYTE + DELAY + SLACK
    assert line.deadline == pytest.approx(max(least, latest))
    line.send(order(), 2.0, latest=latest + 2.0)
    assert line.deadline == pytest.approx(2.0 + len(GOALS) * BYTE)  # nothing follows


def test_after_a_full_port_the_wire_is_free_at_once(line: HalfDuplexTransactor, port: ScriptedPort) -> None:
    line.send(order(), 1.0)
    port.error = output_full("port", 1, 10)
    with pytest.raises(PortError, check=is_output_full):
        line.send(ping(), 1.0)
    assert line.feed(1.0)
    port.error = None
    line.send(ping(), 1.0)
    assert line.deadline == pytest.approx(1.0 + (10 + 14) * BYTE + DELAY + SLACK)


def test_after_any_other_error_the_wire_is_as_busy_as_before(
    line: HalfDuplexTransactor, port: ScriptedPort
) -> None:
    line.send(order(), 1.0)
    line.urgent = b"off"
    port.error = PortError("port", "no")
    with pytest.raises(PortError, match="no"):
        line.send(ping(), 1.0)
    port.error = None
    line.urgent = b""
    line.send(ping(), 1.0)
    assert line.deadline == pytest.approx(1.0 + (len(GOALS) + 10 + 14) * BYTE + DELAY + SLACK)


@pytest.mark.parametrize("latest", [-inf, 9.0])
def test_each_request_of_a_chain_has_its_own_time_and_the_last_one_what_is_left_of_the_tick(
    chaining: HalfDuplexTransactor, port: ScriptedPort, latest: float
) -> None:
    chain = chained_read((1, 2, 3, 4), 56, 6, lambda id: id in (2, 3), sync_read)
    group = len(chain.packet) + 2 * 12
    chaining.goals = bytes(100)
    chaining.send(chain, 1.0, goals=True, latest=latest)
    each = ADAPTER * 2 / 2
    assert chaining.deadline == pytest.approx(1.0 + (100 + group) * BYTE + 2 * DELAY + each + SLACK)
    for id in (2, 3):
        port.input += checksum_packet.instruction(id, 0, bytes(6))
    assert not chaining.feed(2.0)
    assert chaining.deadline == pytest.approx(2.0 + (8 + 12) * BYTE + DELAY + each + SLACK)
    port.input = STATUS
    assert not chaining.feed(3.0)
    assert chaining.deadline == pytest.approx(max(3.0 + (8 + 12) * BYTE + DELAY + each + SLACK, latest))
    assert port.writes == [
        bytes(100) + chain.packet,
        checksum_packet.read(1, 56, 6),
        checksum_packet.read(4, 56, 6),
    ]


def test_a_chain_whose_replies_are_all_there_asks_for_no_more(
    chaining: HalfDuplexTransactor, port: ScriptedPort
) -> None:
    """Late replies of the cycle before: a further request would meet the next transaction."""
    chain = chained_read((1, 2), 56, 6, lambda _: False, sync_read)
    chaining.send(chain, 0.0)
    port.input = STATUS + checksum_packet.instruction(2, 0, bytes(6))
    assert chaining.feed(0.1)
    assert port.writes == [chain.packet]


# ---------------------------------------------------------------------------------- bytes held back


def test_bytes_that_the_kernel_holds_back_are_awaited_only_after_a_missed_reply(port: ScriptedPort) -> None:
    line = line_of(port, sensors=(200,))
    line.settle((1,))
    assert port.settled == 0
    port.answer(line, ping(), b"")
    port.answer(line, SerialTransaction(p.read(200, 16, 6), StatusReply((200,), 6), 1), b"")
    for ids, settled in (((2,), 0), ((200,), 0), ((1,), 1), ((2, 200), 2), ((2, 1), 3), ((), 3)):
        line.settle(ids)
        assert port.settled == settled, ids


# ---------------------------------------------------------------------------------- echo


def test_an_adapter_that_ends_its_echo_completes_the_reading(
    line: HalfDuplexTransactor, port: ScriptedPort
) -> None:
    """The request is longer than its answer, which so is read in place of the echo."""
    port.answer(line, ping(), p.ping(1) + ANSWER)
    assert line.echo
    line.goals = GOALS
    line.send(ping(), 1.0, goals=True)
    assert len(GOALS) + 10 > len(ANSWER)
    port.input = ANSWER
    assert line.feed(1.0) is True
    line.end()
    assert not line.echo
    line.send(ping(), 2.0)
    assert line.feed(2.0) is False


def test_an_echo_in_pieces_is_taken_off_and_the_reply_behind_it_read_at_once(
    line: HalfDuplexTransactor, port: ScriptedPort
) -> None:
    port.answer(line, ping(), p.ping(1) + ANSWER)
    assert line.echo
    line.send(ping(), 1.0)
    port.input = p.ping(1)[:4]
    assert not line.feed(1.0)
    port.input = p.ping(1)[4:] + ANSWER
    assert line.feed(1.1)
    line.end()
    assert (line.echo, line.strays, line.foreign) == (True, 0, 0)


def test_an_echo_that_comes_in_pieces_longer_than_the_reply_is_recognised(
    line: HalfDuplexTransactor, port: ScriptedPort
) -> None:
    line.goals = GOALS
    line.send(ping(), 0.0, goals=True)
    sent = GOALS + p.ping(1)
    for piece in (sent[: len(ANSWER) + 1], sent[len(ANSWER) + 1 :] + ANSWER):
        port.input = piece
        line.feed(0.0)
    line.end()
    assert (line.echo, line.strays, line.foreign) == (True, 0, 0)


@pytest.mark.parametrize("before", [b"noise", ANSWER])
def test_the_packet_of_another_master_behind_other_bytes_is_no_echo(
    line: HalfDuplexTransactor, port: ScriptedPort, before: bytes
) -> None:
    port.answer(line, ping(), before + p.ping(1))
    assert not line.echo
    assert line.foreign == 1


def test_bytes_before_the_first_request_are_no_echo(line: HalfDuplexTransactor, port: ScriptedPort) -> None:
    port.input = p.ping(1)
    line.send(ping(), 0.0)
    assert not line.echo
    assert line.foreign == 1


# ---------------------------------------------------------------------------------- late, foreign, urgent


def test_packets_between_transactions_are_judged_once(line: HalfDuplexTransactor, port: ScriptedPort) -> None:
    port.input = p.status(99, 0)
    for _ in range(3):
        line.send(ping(), 0.0)
        line.end()
        port.input = b"noise"
    assert line.foreign == 1


def test_a_late_reply_is_measured_from_its_request(line: HalfDuplexTransactor, port: ScriptedPort) -> None:
    line.send(ping(), 1.0)
    line.end()
    port.input = ANSWER
    line.send(ping(), 1.25)
    assert list(line.late_replies.delays) == [0.25]


def test_a_request_to_a_sensor_by_another_master_is_foreign(port: ScriptedPort) -> None:
    line = line_of(port, sensors=(200,))
    request = p.read(200, 16, 6)
    port.answer(line, ping(), request + ANSWER)
    assert (line.foreign, line.late, line.strays) == (1, [], len(request))


def test_torque_off_has_left_once_any_device_of_a_reading_answers(
    line: HalfDuplexTransactor, port: ScriptedPort
) -> None:
    read = SerialTransaction(p.sync_read((1, 2), 132, 4), StatusReply((1, 2), 4), 2)
    line.urgent = b"off"
    port.answer(line, read, p.status(1, 0, bytes(4)))
    port.error = output_full("port", 1, 10)
    with pytest.raises(PortError, check=is_output_full):
        line.send(ping(), 1.0)
    assert line.urgent == b""


def test_a_chain_leaves_room_for_its_last_request_alone(
    chaining: HalfDuplexTransactor, port: ScriptedPort
) -> None:
    chain = chained_read((1, 2), 56, 6, lambda _: False, sync_read)
    chaining.goals = bytes(100)
    chaining.send(chain, 0.0, goals=True)
    port.input = STATUS
    chaining.feed(0.1)
    chaining.end()
    port.holds = True
    port.waiting = 8
    chaining.goals = bytes(100)
    chaining.send(chain, 1.0, goals=True)
    port.input = STATUS
    chaining.feed(1.1)
    port.waiting = 9
    with pytest.raises(PortError, match="9 bytes still wait in the output, the last packet had 8"):
        chaining.send(chain, 2.0)
    assert port.flushed == 1


@pytest.mark.parametrize("error", [output_full("port", 1, 10), PortError("port", "gone")])
def test_after_an_error_nothing_is_under_way(
    line: HalfDuplexTransactor, port: ScriptedPort, error: PortError
) -> None:
    line.send(ping(), 0.0)
    port.error = error
    with pytest.raises(PortError):
        line.send(ping(), 1.0)
    assert line.feed(1.0)
    assert line.end() is None
    port.error = None
    line.send(ping(), 2.0)
    assert line.end() is not None
    assert line.end() is None
