"""What one client can cost the others, tried with raw bytes on a real front process: memory, rights, time."""

import contextlib
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import pytest

from tests.support.loop_stand_in import StandIn
from tests.support.raw_connection import Raw
from twind import link
from twind.protocol import CONTROL

STATUS = b'{"method":"io.twind.Control.GetStatus","parameters":{"joints":true}}\0'


@pytest.fixture
def own(tmp_path: Path) -> Iterator[StandIn]:
    stand_in = StandIn(tmp_path)
    stand_in.await_lookahead()
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
def test_many_calls_sent_before_a_read_all_receive_replies(own: StandIn, half: bool) -> None:
    with Raw(own) as client:

        def send() -> None:
            client.bytes(STATUS * 1000)
            if half:
                client.socket.shutdown(socket.SHUT_WR)

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


def test_a_fifth_estop_of_a_connection_is_busy_and_a_harder_one_is_not(own: StandIn) -> None:
    own.answers[link.EStop] = lambda c: []
    with Raw(own, "observe") as client:
        for level in ["settle"] * 7 + ["cut"]:
            client.send("EStop", parameters={"level": level})
        own.await_message(lambda command: isinstance(command, link.EStop) and command.level == "cut")
        stops = [command for command in own.commands if isinstance(command, link.EStop)]
        assert [stop.level for stop in stops] == ["settle"] * 4 + ["cut"]
        for stop in stops:
            own.send(link.Reply(ticket=stop.ticket, parameters={"state": "estop"}))
        answers = [client.receive().get("error") for _ in range(8)]
        assert answers == [None] * 4 + [f"{CONTROL}.Busy"] * 3 + [None]
        own.answers.clear()
        assert "error" not in client.call("EStop")  # what is answered counts no more


@pytest.mark.parametrize(("method", "most"), [("EStop", 4), ("Cancel", 32), ("Disarm", 32)])
def test_a_flood_of_oneway_stops_is_bounded(own: StandIn, method: str, most: int) -> None:
    kind = getattr(link, method)
    own.answers[kind] = lambda c: []
    with Raw(own) as client:
        call = f'{{"method":"{CONTROL}.{method}","oneway":true}}'.encode() + b"\0"
        client.bytes(call * 3000)
        assert "error" not in client.call("GetStatus")
        client.send("SetMode", parameters={"mode": "sim"})
        own.await_command(link.SetMode)
        assert sum(isinstance(command, kind) for command in own.commands) == most


def test_a_flood_of_other_oneway_commands_leaves_room_for_every_stop(own: StandIn) -> None:
    own.answers[link.RenewLease] = lambda c: []
    with Raw(own) as client:
        for _ in range(100):
            client.send("RenewLease", oneway=True)
        for method in ("EStop", "Cancel", "Disarm"):
            client.send(method, oneway=True)
            own.await_command(getattr(link, method))
    assert sum(isinstance(command, link.RenewLease) for command in own.commands) == 32


# --------------------------------------------------------------------------- monitors


def test_a_monitor_that_is_never_answered_is_not_kept(own: StandIn) -> None:
    monitor = f'{{"method":"{CONTROL}.Monitor","parameters":{{"topics":["verdicts"]}},"oneway":true}}'
    with Raw(own, "observe") as client:
        assert "error" not in client.call("GetStatus")
        before = resident(own)
        client.bytes((monitor.encode() + b"\0") * 20_000)
        client.socket.settimeout(10.0)
        assert "error" not in client.call("GetStatus")
        assert resident(own) < before + 8.0


def test_a_subscriber_gone_before_its_first_message_does_not_affect_others(own: StandIn) -> None:
    with Raw(own, "observe") as gone, Raw(own, "observe") as other:
        for client in (gone, other):
            assert "error" not in client.call("GetStatus")  # the front is up
            client.send("Monitor", parameters={"topics": ["verdicts"]})
        time.sleep(0.1)
        gone.socket.shutdown(socket.SHUT_RD)  # found out by whoever writes to it
        own.send(link.VerdictReport(time=1.0, sequence=1, id="x", verdict={"refusals": []}))
        assert other.receive()["parameters"]["topic"] == "verdicts"
        assert "error" not in other.call("GetStatus")
    assert "Traceback" not in own.log.read_text()
