"""Bytes of a connection: cut anywhere, the messages are the same; what is dropped is counted."""

import asyncio
import json
import socket
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.front.message_stream import LARGE, PATIENCE, QUEUE, MessageStream


class Owner:
    """Takes messages; says no after every `pause`-th."""

    def __init__(self, pause: int, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.messages: list[bytes] = []
        self.limit: int | None = None
        self.closed = 0
        self.pause = pause

    def message(self, data: bytes) -> bool:
        self.messages.append(data)
        return not (self.pause and len(self.messages) % self.pause == 0)

    def too_large(self, limit: int) -> None:
        self.limit = limit

    def ended(self) -> None:
        self.closed += 1


class Watcher:
    dropped = 0


def run(
    body: Callable[[MessageStream, Owner, socket.socket], None], *, limit: int = 1000, pause: int = 0
) -> Owner:
    """A stream in a loop of its own, and the other end of its socket."""
    loop = asyncio.new_event_loop()
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    owner = Owner(pause, loop)
    stream = MessageStream(ours, limit, loop)
    stream.start(owner)
    try:
        with theirs:
            body(stream, owner, theirs)
    finally:
        stream.close()
        loop.close()
    assert owner.closed == 1
    return owner


def turn(loop: asyncio.AbstractEventLoop) -> None:
    """Run one turn of the stream's loop."""
    loop.call_soon(loop.stop)
    loop.run_forever()


@examples(60)
@given(
    st.lists(
        st.binary(min_size=1, max_size=30).map(lambda b: b"{" + b.replace(b"\0", b"0").replace(b"\n", b"n"))
    ),
    st.sampled_from([b"\0", b"\n"]),
    st.lists(st.integers(1, 40), min_size=1),
    st.integers(0, 3),
)
def test_however_it_is_cut_the_same_messages_come(
    messages: list[bytes], end: bytes, cuts: list[int], pause: int
) -> None:
    data = b"".join(message + end for message in messages)

    def body(stream: MessageStream, owner: Owner, peer: socket.socket) -> None:
        rest = data
        place = 0
        while rest:
            size = cuts[place % len(cuts)]
            place += 1
            peer.sendall(rest[:size])
            rest = rest[size:]
            turn(owner.loop)
            stream.resume()
        for _ in messages:
            stream.resume()
            turn(owner.loop)

    assert run(body, pause=pause).messages == messages


@pytest.mark.parametrize("terminated", [True, False])
@pytest.mark.parametrize("excess", [0, 1])
def test_the_limit_is_exact_and_holds_without_a_terminator(terminated: bool, excess: int) -> None:
    def body(stream: MessageStream, owner: Owner, peer: socket.socket) -> None:
        peer.sendall(b"x" * (1000 + excess) + (b"\0" if terminated else b""))
        turn(owner.loop)

    owner = run(body)
    assert owner.limit == (1000 if excess else None)
    assert len(owner.messages) == (1 if terminated and not excess else 0)


def test_answers_survive_where_telemetry_is_dropped_and_counted() -> None:
    watcher = Watcher()
    sent = 500

    def body(stream: MessageStream, owner: Owner, peer: socket.socket) -> None:
        for number in range(sent):
            stream.publish(b'"n":%d,"fill":"%s"}}' % (number, b"x" * 4000), watcher)
            if number % 50 == 0:
                stream.send(b'{"parameters":{"answer":%d}}' % number)
            assert stream.backlog <= QUEUE + 10_000
        received = b""
        peer.settimeout(1.0)
        stream.finish()
        while data := peer.recv(1 << 20):
            received += data
            turn(owner.loop)
        said = [json.loads(message)["parameters"] for message in received.split(b"\0")[:-1]]
        news = [message for message in said if "n" in message]
        assert [message["answer"] for message in said if "answer" in message] == list(range(0, sent, 50))
        assert len(news) + sum(message["dropped"] for message in news) == sent
        before = -1
        for message in news:
            assert message["n"] - before - 1 == message["dropped"]
            before = message["n"]
        assert before == sent - 1  # the newest is never the one that is dropped

    run(body)


def test_a_large_message_neither_throws_out_the_others_nor_is_thrown_out_by_them() -> None:
    watcher = Watcher()
    body_of = b'"%s":%d,"fill":"%s"}}'

    def body(stream: MessageStream, owner: Owner, peer: socket.socket) -> None:
        def small(numbers: range) -> None:
            for number in numbers:
                stream.publish(body_of % (b"n", number, b"x" * 1000), watcher)

        stream.publish(b'"first":0,"fill":"%s"}}' % (b"x" * LARGE), watcher)  # the pipe is full with it
        small(range(100))
        for path in range(3):
            stream.publish(body_of % (b"path", path, b"x" * 3_000_000), watcher)
            small(range(100 + 10 * path, 110 + 10 * path))
        assert stream.backlog < QUEUE + 3_100_000
        received = b""
        peer.settimeout(1.0)
        stream.finish()
        while data := peer.recv(1 << 20):
            received += data
            turn(owner.loop)
        said = [json.loads(message)["parameters"] for message in received.split(b"\0")[:-1]]
        assert [message["n"] for message in said if "n" in message] == list(range(130))
        assert [message["path"] for message in said if "path" in message] == [2]
        assert sum(message["dropped"] for message in said) == 2

    run(body)


def test_a_peer_that_reads_nothing_is_stuck_and_one_without_pending_data_is_not() -> None:
    def body(stream: MessageStream, owner: Owner, peer: socket.socket) -> None:
        now = owner.loop.time()
        assert not stream.stuck(now + 1000.0)
        stream.send(b"x" * (4 << 20))
        assert not stream.stuck(now + PATIENCE)
        assert stream.stuck(now + PATIENCE + 1.0)

    run(body)


def test_a_half_closed_connection_is_distinguished_from_a_hang_up() -> None:
    def half(stream: MessageStream, owner: Owner, peer: socket.socket) -> None:
        peer.shutdown(socket.SHUT_WR)
        turn(owner.loop)
        assert stream.half_closed
        assert not stream.peer_gone()
        stream.send(b"still here")
        assert peer.recv(100) == b"still here\0"

    def whole(stream: MessageStream, owner: Owner, peer: socket.socket) -> None:
        peer.close()
        turn(owner.loop)
        assert stream.closed

    run(half)
    run(whole)


def test_finishing_waits_until_all_is_sent() -> None:
    def body(stream: MessageStream, owner: Owner, peer: socket.socket) -> None:
        stream.send(b"x" * (1 << 20))
        stream.finish()
        assert not stream.closed
        got = 0
        while got <= 1 << 20:
            got += len(peer.recv(1 << 18))
            turn(owner.loop)
        assert stream.closed

    run(body)
