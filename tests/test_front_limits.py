"""What one client can cost the others, tried with raw bytes on a real front process: memory, rights, time."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import pytest
from stand_in import StandIn
from test_front_server import Raw

from twind import link
from twind.protocol import CONTROL

pytestmark = pytest.mark.realtime
STATUS = b'{"method":"io.twind.Control.GetStatus","parameters":{"joints":true}}\0'


@pytest.fixture
def own(tmp_path: Path) -> Iterator[StandIn]:
    stand_in = StandIn(tmp_path)
    yield stand_in
    alive = stand_in.front.poll() is None
    assert stand_in.close() == 0
    assert alive
    assert "CALL_BROKE" not in stand_in.log.read_text()


def resident(loop: StandIn) -> float:
    """Memory of the front process, MiB."""
    pages = int(Path(f"/proc/{loop.front.pid}/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def flood(client: Raw, message: bytes) -> None:
    """The same message until the front hangs up."""
    client.socket.settimeout(10.0)
    with contextlib.suppress(OSError):
        while True:
            client.bytes(message * 100)


# --------------------------------------------------------------------------- answers nobody reads


def test_answers_that_are_read_too_slowly_cost_no_memory_and_the_reader_its_connection(own: StandIn) -> None:
    with Raw(own, "observe") as client:
        client.bytes(STATUS)
        client.receive()
        before = most = resident(own)
        sender = Thread(target=flood, args=(client, STATUS))
        sender.start()
        end = time.monotonic() + 8.0
        while sender.is_alive() and time.monotonic() < end:
            with contextlib.suppress(ConnectionResetError):
                client.socket.recv(4096)
            most = max(most, resident(own))
            time.sleep(0.25)
        closed = not sender.is_alive()
    sender.join()
    assert most < before + 16.0
    assert closed
    assert "SLOW_READER" in own.log.read_text()


@pytest.mark.parametrize("half", [False, True])
def test_who_sends_many_calls_before_it_reads_gets_every_answer(own: StandIn, half: bool) -> None:
    with Raw(own) as client:

        def send() -> None:
            client.bytes(STATUS * 1000)
            if half:
                client.socket.shutdown(1)

        sender = Thread(target=send)
        sender.start()
        time.sleep(0.5)  # the queue is full by now
        for _ in range(1000):
            assert len(client.receive()["parameters"]["joints"]) == 24
        sender.join()
        if half:
            assert client.ended()
        else:
            assert "error" not in client.call("GetStatus")


# --------------------------------------------------------------------------- stops


def test_an_unknown_level_of_an_estop_never_reaches_the_loop_however_long(own: StandIn) -> None:
    with Raw(own) as client:
        for level in ("x" * 200_000, "Settle"):
            answer = client.call("EStop", level=level)
            assert answer["error"] == f"{CONTROL}.NotFound"
            assert answer["parameters"]["known"] == ["settle", "cut"]
            assert len(answer["parameters"]["name"]) <= 200
        assert not [command for command in own.commands if isinstance(command, link.EStop)]
        for level in (None, "", "settle", "cut"):
            assert "error" not in client.call("EStop", level=level)


def test_the_reason_of_an_estop_reaches_no_terminal_raw(own: StandIn) -> None:
    with Raw(own, "observe") as client:
        assert "error" not in client.call("EStop", reason="\x1b[2J\r\n\u202e hand " + "\0" * 1000)
    stop = own.await_command(link.EStop)
    assert isinstance(stop, link.EStop)
    assert stop.reason.startswith("\\x1b[2J\\r\\n\\u202e hand \\x00")
    assert stop.reason.isprintable()
    assert len(stop.reason) == 200
