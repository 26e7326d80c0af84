"""Bounds on what one client costs the others: memory, rights and time of a real front process."""

import contextlib
import json
import os
import socket
import time
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from tests.support.loop_stand_in import NAMES, StandIn
from tests.support.raw_connection import Raw
from tests.support.shared_front import SharedFront
from twind import link
from twind.loop.ipc.front_process import HEARTBEAT
from twind.protocol import CONTROL

STATUS = b'{"method":"io.twind.Control.GetStatus","parameters":{"joints":true}}\0'


def resident(loop: StandIn) -> float:
    """Memory of the front process, MiB, once its model is loaded."""
    loop.await_lookahead()
    pages = int(Path(f"/proc/{loop.front.pid}/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def computed(loop: StandIn) -> float:
    """Return the processor time (s) of the front process."""
    user, system = Path(f"/proc/{loop.front.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def flood(client: Raw, message: bytes) -> None:
    """The same message until the front hangs up."""
    client.socket.settimeout(10.0)
    with contextlib.suppress(OSError):
        while True:
            client.bytes(message * 100)


# --------------------------------------------------------------------------- memory


# First: memory that an earlier test freed would hide what this one keeps.
def test_a_monitor_that_is_never_answered_is_not_kept(loop: StandIn) -> None:
    monitor = f'{{"method":"{CONTROL}.Monitor","parameters":{{"topics":["verdicts"]}},"oneway":true}}'
    with Raw(loop, "observe") as client:
        assert "error" not in client.call("GetStatus")
        before = resident(loop)
        client.bytes((monitor.encode() + b"\0") * 20_000)
        client.socket.settimeout(10.0)
        assert "error" not in client.call("GetStatus")
        assert resident(loop) < before + 8.0


def test_answers_that_are_read_too_slowly_cost_no_memory_and_the_reader_its_connection(
    loop: SharedFront,
) -> None:
    with Raw(loop, "observe") as client:
        client.bytes(STATUS)
        client.receive()
        before = most = resident(loop)
        sender = Thread(target=flood, args=(client, STATUS))
        sender.start()
        end = time.monotonic() + 8.0
        while sender.is_alive() and time.monotonic() < end:
            with contextlib.suppress(ConnectionResetError):
                client.socket.recv(4096)
            most = max(most, resident(loop))
            time.sleep(0.25)
        closed = not sender.is_alive()
    sender.join()
    assert most < before + 16.0
    assert closed
    assert "SLOW_READER" in loop.logged()


@pytest.mark.parametrize("half", [False, True])
def test_many_calls_sent_before_a_read_all_receive_replies(loop: StandIn, half: bool) -> None:
    with Raw(loop) as client:

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


def test_an_unknown_level_of_an_estop_never_reaches_the_loop_however_long(loop: StandIn) -> None:
    with Raw(loop) as client:
        for level in ("x" * 200_000, "Settle"):
            answer = client.call("EStop", level=level)
            assert answer["error"] == f"{CONTROL}.NotFound"
            assert answer["parameters"]["known"] == ["settle", "cut"]
            assert len(answer["parameters"]["name"]) <= 200
        assert not [command for command in loop.commands if isinstance(command, link.EStop)]
        for level in (None, "", "settle", "cut"):
            assert "error" not in client.call("EStop", level=level)


def test_the_reason_of_an_estop_reaches_no_terminal_raw(loop: StandIn) -> None:
    with Raw(loop, "observe") as client:
        assert "error" not in client.call("EStop", reason="\x1b[2J\r\n\u202e hand " + "\0" * 1000)
    stop = loop.await_command(link.EStop)
    assert isinstance(stop, link.EStop)
    assert stop.reason.startswith("\\x1b[2J\\r\\n\\u202e hand \\x00")
    assert stop.reason.isprintable()
    assert len(stop.reason) == 200


def test_a_fifth_estop_of_a_connection_is_busy_and_a_harder_one_is_not(loop: StandIn) -> None:
    loop.answers[link.EStop] = lambda c: []
    with Raw(loop, "observe") as client:
        for level in ["settle"] * 7 + ["cut"]:
            client.send("EStop", parameters={"level": level})
        loop.await_message(lambda command: isinstance(command, link.EStop) and command.level == "cut")
        stops = [command for command in loop.commands if isinstance(command, link.EStop)]
        assert [stop.level for stop in stops] == ["settle"] * 4 + ["cut"]
        for stop in stops:
            loop.send(link.Reply(ticket=stop.ticket, parameters={"state": "estop"}))
        answers = [client.receive().get("error") for _ in range(8)]
        assert answers == [None] * 4 + [f"{CONTROL}.Busy"] * 3 + [None]
        loop.answers.clear()
        assert "error" not in client.call("EStop")  # what is answered counts no more


@pytest.mark.parametrize(("method", "most"), [("EStop", 4), ("Cancel", 32), ("Disarm", 32)])
def test_a_flood_of_oneway_stops_is_bounded(loop: StandIn, method: str, most: int) -> None:
    kind = getattr(link, method)
    loop.answers[kind] = lambda c: []
    with Raw(loop) as client:
        call = f'{{"method":"{CONTROL}.{method}","oneway":true}}'.encode() + b"\0"
        client.bytes(call * 3000)
        assert "error" not in client.call("GetStatus")
        client.send("SetMode", parameters={"mode": "sim"})
        loop.await_command(link.SetMode)
        assert sum(isinstance(command, kind) for command in loop.commands) == most


def test_a_flood_of_other_oneway_commands_leaves_room_for_every_stop(loop: StandIn) -> None:
    loop.answers[link.RenewLease] = lambda c: []
    with Raw(loop) as client:
        for _ in range(100):
            client.send("RenewLease", oneway=True)
        for method in ("EStop", "Cancel", "Disarm"):
            client.send(method, oneway=True)
            loop.await_command(getattr(link, method))
    assert sum(isinstance(command, link.RenewLease) for command in loop.commands) == 32


# --------------------------------------------------------------------------- monitors


def test_a_subscriber_gone_before_its_first_message_does_not_affect_others(loop: StandIn) -> None:
    with Raw(loop, "observe") as gone, Raw(loop, "observe") as other:
        for client in (gone, other):
            assert "error" not in client.call("GetStatus")  # the front is up
            client.send("Monitor", parameters={"topics": ["verdicts"]})
        time.sleep(0.1)
        gone.socket.shutdown(socket.SHUT_RD)  # found out by whoever writes to it
        loop.send(link.VerdictReport(time=1.0, sequence=1, id="x", verdict={"refusals": []}))
        assert other.receive()["parameters"]["topic"] == "verdicts"
        assert "error" not in other.call("GetStatus")


POINT = {"positions": [0.0], "velocities": [0.0], "time_from_start": 1.0}


@pytest.mark.parametrize(
    ("method", "parameters"),
    [
        ("Setpoint", {"joint_names": [NAMES[0]] * 300_000, "positions": []}),
        ("Setpoint", {"joint_names": ["toe"] * 300_000, "positions": []}),
        (
            "Check",
            {
                "trajectory": {
                    "joint_names": [NAMES[0]],
                    "points": [POINT],
                    "tolerances": [{"joint": f"toe_{place}"} for place in range(150_000)],
                }
            },
        ),
        ("Check", {"trajectory": {"joint_names": ["toe " * 900_000], "points": [POINT]}}),
    ],
    ids=["one joint often", "unknown joints", "unknown tolerances", "a long name"],
)
def test_a_call_as_large_as_it_may_be_does_not_hold_up_the_others(
    loop: StandIn, method: str, parameters: dict[str, Any]
) -> None:
    """A front process that sends no heartbeat for so long is killed, and all leases end."""
    with Raw(loop) as client:
        client.call("GetStatus")
        before = computed(loop)
        refused = client.call(method, **parameters)
    assert len(json.dumps(refused)) < 100_000
    assert computed(loop) - before < 0.5 * HEARTBEAT
