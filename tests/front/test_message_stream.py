"""Bytes of a connection: messages do not depend on how they are cut, and dropped telemetry is counted."""

import asyncio
import json
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.front.message_stream import LARGE, PATIENCE, QUEUE, MessageStream


class Connection:
    """A stream in an event loop of its own, its owner, and the other end of its socket.

    The owner declines more messages after every `pause`-th one; 0: never. Messages have at most 1000 bytes.
    """

    dropped = 0

    def __init__(self, pause: int = 0) -> None:
        self.loop = asyncio.new_event_loop()
        self.messages: list[bytes] = []
        self.limit: int | None = None
        self.closed = 0
        self._pause = pause
        ours, self.peer = socket.socketpair()
        ours.setblocking(False)
        self.peer.settimeout(1.0)
        self.stream = MessageStream(ours, 1000, self.loop)
        self.stream.start(self)

    def message(self, data: bytes) -> bool:
        self.messages.append(data)
        return not (self._pause and len(self.messages) % self._pause == 0)

    def too_large(self, limit: int) -> None:
        self.limit = limit

    def ended(self) -> None:
        self.closed += 1

    def turn(self) -> None:
        """Run one turn of the event loop."""
        self.loop.call_soon(self.loop.stop)
        self.loop.run_forever()

    def publish(self, key: str, number: int, size: int) -> None:
        """Send telemetry of about `size` bytes."""
        self.stream.publish(b'"%s":%d,"fill":"%s"}}' % (key.encode(), number, b"x" * size), self)

    def rest(self) -> list[dict[str, Any]]:
        """Finish the stream; return the parameters of all that it still sends."""
        received = b""
        self.stream.finish()
        while data := self.peer.recv(1 << 20):
            received += data
            self.turn()
        return [json.loads(message)["parameters"] for message in received.split(b"\0")[:-1]]

    def close(self) -> None:
        self.stream.close()
        self.peer.close()
        self.loop.close()
        assert self.closed == 1


@pytest.fixture
def line() -> Iterator[Connection]:
    made = Connection()
    yield made
    made.close()


@examples(60)
@given(
    st.lists(
        st.binary(min_size=1, max_size=30).map(lambda b: b"{" + b.replace(b"\0", b"0").replace(b"\n", b"n"))
    ),
    st.sampled_from([b"\0", b"\n"]),
    st.lists(st.integers(1, 40), min_size=1),
    st.integers(0, 3),
)
def test_messages_are_the_same_however_the_bytes_are_cut(
    messages: list[bytes], end: bytes, cuts: list[int], pause: int
) -> None:
    line = Connection(pause)
    rest = b"".join(message + end for message in messages)
    place = 0
    while rest:
        size = cuts[place % len(cuts)]
        place += 1
        line.peer.sendall(rest[:size])
        rest = rest[size:]
        line.turn()
        line.stream.resume()
    for _ in messages:
        line.stream.resume()
        line.turn()
    line.close()
    assert line.messages == messages


@pytest.mark.parametrize("terminated", [True, False])
@pytest.mark.parametrize("excess", [0, 1])
def test_the_limit_is_exact_and_holds_without_a_terminator(
    line: Connection, terminated: bool, excess: int
) -> None:
    line.peer.sendall(b"x" * (1000 + excess) + (b"\0" if terminated else b""))
    line.turn()
    assert line.limit == (1000 if excess else None)
    assert len(line.messages) == (1 if terminated and not excess else 0)


def test_answers_are_kept_where_telemetry_is_dropped_and_counted(line: Connection) -> None:
    sent = 500
    for number in range(sent):
        line.publish("n", number, 4000)
        if number % 50 == 0:
            line.stream.send(b'{"parameters":{"answer":%d}}' % number)
        assert line.stream.backlog <= QUEUE + 10_000
    received = line.rest()
    assert [message["answer"] for message in received if "answer" in message] == list(range(0, sent, 50))
    before = -1
    for message in received:
        if "n" in message:
            assert message["n"] - before - 1 == message["dropped"]
            before = message["n"]
    assert before == sent - 1  # the newest is never the one that is dropped


def test_a_large_message_and_small_ones_do_not_displace_each_other(line: Connection) -> None:
    line.publish("first", 0, LARGE)  # fills the pipe
    for number in range(130):
        if number >= 100 and number % 10 == 0:
            line.publish("path", number, 3_000_000)
        line.publish("n", number, 1000)
    assert line.stream.backlog < QUEUE + 3_100_000
    received = line.rest()
    assert [message["n"] for message in received if "n" in message] == list(range(130))
    assert [message["path"] for message in received if "path" in message] == [120]
    assert sum(message["dropped"] for message in received) == 2


def test_calls_of_a_slow_reader_of_a_large_message_are_read_and_it_stays_connected(line: Connection) -> None:
    """Its e-stop would wait unread. Answers alone hold back its calls, since telemetry is dropped instead."""
    line.publish("path", 1, 3 << 20)
    line.publish("state", 2, 100)
    line.peer.sendall(b"EStop\0")
    line.turn()
    assert line.messages == [b"EStop"]
    line.stream.send(b"an answer")
    assert len(line.peer.recv(QUEUE)) > 0
    line.turn()
    assert line.stream.backlog > QUEUE
    assert not line.stream.stuck(line.loop.time() + 0.9 * PATIENCE)
    line.peer.sendall(b"GetStatus\0")
    line.turn()
    assert line.messages == [b"EStop", b"GetStatus"]


def test_a_peer_that_reads_nothing_is_stuck_and_one_without_pending_data_is_not(line: Connection) -> None:
    now = line.loop.time()
    assert not line.stream.stuck(now + 1000.0)
    line.stream.send(b"x" * (4 << 20))
    assert not line.stream.stuck(now + PATIENCE)
    assert line.stream.stuck(now + PATIENCE + 1.0)


def test_a_half_closed_connection_is_still_answered(line: Connection) -> None:
    line.peer.shutdown(socket.SHUT_WR)
    line.turn()
    assert line.stream.half_closed
    assert not line.stream.peer_gone()
    line.stream.send(b"still here")
    assert line.peer.recv(100) == b"still here\0"


@pytest.mark.parametrize(
    ("sent", "unfinished"), [(b"{}\0", 0), (b"{}\0{", 1), (b'{"method"', 9), (b"{}\n \r", 0)]
)
def test_a_message_without_a_terminator_is_counted_and_dropped_once(
    line: Connection, sent: bytes, unfinished: int
) -> None:
    line.peer.send(sent)
    line.turn()
    assert line.stream.drop_unfinished() == unfinished
    assert line.stream.drop_unfinished() == 0


def test_a_complete_message_that_waits_is_not_unfinished() -> None:
    line = Connection(pause=1)
    line.peer.send(b"{}\0{}\0{")
    line.turn()
    assert line.messages == [b"{}"] and line.stream.drop_unfinished() == 0
    line.close()


def test_a_hang_up_closes_the_stream(line: Connection) -> None:
    line.peer.close()
    line.turn()
    assert line.stream.closed


def test_finishing_waits_until_all_is_sent(line: Connection) -> None:
    line.stream.send(b"x" * (1 << 20))
    line.stream.finish()
    assert not line.stream.closed
    got = 0
    while got <= 1 << 20:
        got += len(line.peer.recv(1 << 18))
        line.turn()
    assert line.stream.closed
