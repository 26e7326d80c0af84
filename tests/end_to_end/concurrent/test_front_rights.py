"""Rights and rate limits, with raw bytes on a real front process (RATE_LIMIT to LEASE_MISSING).

Floods are in `exclusive/test_front_reply_times.py`.
"""

import contextlib
import fcntl
import os
import resource
import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.loop_stand_in import NAMES, StandIn
from tests.support.processes import until
from tests.support.raw_connection import Raw, code
from tests.support.shared_front import SharedFront, shared_front, time_stop
from twind import link
from twind.front.interface_methods import METHODS, OBSERVER
from twind.protocol import CONTROL

PATH = {"joint_names": [NAMES[0]], "points": [{"positions": [0.0], "time_from_start": 1.0}]}
ARGUMENTS = {
    "SetMode": {"mode": "live"},
    "SubmitTrajectory": {"trajectory": PATH},
    "Check": {"trajectory": PATH},
    "Setpoint": {"joint_names": [NAMES[0]], "positions": [0.0]},
    "ReadRegister": {"bus": "main", "id": 1, "name": "x"},
    "WriteRegister": {"bus": "main", "id": 1, "name": "x", "value": 1},
    "Reboot": {"bus": "main", "id": 1},
    "SetParameters": {"parameters": {}},
}
BOUND = 1.0  # s within which an e-stop is answered, whatever the others do


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedFront]:
    with shared_front(tmp_path_factory.mktemp("front")) as made:
        yield made


@pytest.fixture
def front(shared: SharedFront) -> SharedFront:
    shared.begin()
    return shared


def await_event(log: Callable[[], str], event: str) -> str:
    """The log, once it has the event."""
    until(lambda: event in log(), 2.0, log)
    return log()


# --------------------------------------------------------------------------- roles


def test_a_wrong_role_is_logged_once_with_code_and_peer_and_published(front: SharedFront) -> None:
    with Raw(front, "observe") as watcher, Raw(front, "observe") as client:
        watcher.send("Monitor", parameters={"topics": ["verdicts"]}, more=True)
        assert "error" not in client.call("GetStatus")
        time.sleep(0.05)
        for _ in range(50):
            assert client.call("Disarm")["error"] == f"{CONTROL}.NotAllowed"
        message = watcher.receive()["parameters"]
        (finding,) = message["verdict"]["refusals"]
        assert (finding["code"], message["sequence"]) == ("AUTH_ROLE", 0)
        assert "control.sock" in finding["message"]
        watcher.socket.settimeout(0.3)
        with pytest.raises(TimeoutError):
            watcher.receive()
    text = await_event(front.logged, "AUTH_ROLE")
    assert text.count("AUTH_ROLE") == 1
    assert f"uid {os.getuid()}, pid {os.getpid()}" in text


@pytest.mark.parametrize("method", sorted(METHODS.keys() - OBSERVER))
def test_an_observer_command_is_refused_and_never_reaches_the_loop(front: SharedFront, method: str) -> None:
    with Raw(front, "observe") as client:
        answer = client.call(method, **ARGUMENTS.get(method, {}))
    assert answer["error"] == f"{CONTROL}.NotAllowed"
    assert answer["parameters"] == {"role": "observer", "method": method}
    assert not front.commands


def test_the_caller_is_identified_by_the_kernel(front: SharedFront) -> None:
    with Raw(front) as client:
        assert "error" not in client.call("AcquireLease")
        command = front.await_command(link.AcquireLease)
    assert isinstance(command, link.AcquireLease)
    assert (command.uid, command.holder) == (os.getuid(), f"uid {os.getuid()}, pid {os.getpid()}")


def test_two_connections_of_a_process_are_two_clients_and_a_copied_descriptor_is_one(
    front: SharedFront,
) -> None:
    with Raw(front) as one, Raw(front) as two:
        for client in (one, two):
            assert "error" not in client.call("AcquireLease")
        copy = os.dup(one.socket.fileno())
        one.socket.close()
        with socket.socket(fileno=copy) as again:
            again.sendall(b'{"method":"io.twind.Control.RenewLease"}\0')
            front.await_command(link.RenewLease)
            assert not [command for command in front.commands if isinstance(command, link.ConnectionClosed)]
        front.await_command(link.ConnectionClosed)
        first, second, renewal, gone = front.commands[:4]
    assert first.client == renewal.client == gone.client != second.client  # type: ignore[union-attr]


def test_the_loop_is_notified_of_a_closed_connection_only_after_a_command(front: SharedFront) -> None:
    for _ in range(100):
        with Raw(front, "observe") as client:
            assert "error" not in client.call("GetStatus")
    with Raw(front) as client:
        assert "error" not in client.call("AcquireLease")
    front.await_command(link.ConnectionClosed)
    assert [type(command) for command in front.commands] == [link.AcquireLease, link.ConnectionClosed]


# --------------------------------------------------------------------------- rates


def test_a_client_that_floods_trajectories_is_disconnected_and_others_are_not(front: SharedFront) -> None:
    with Raw(front) as hasty, Raw(front) as other:
        assert "error" not in other.call("GetStatus")
        for _ in range(60):
            hasty.send("Check", parameters={"trajectory": PATH})
        answers = []
        with contextlib.suppress(EOFError, ConnectionResetError):
            while True:
                answers.append("error" in hasty.receive())
        assert answers == [False] * 20 + [True] * 10
        assert (
            code(other.call("Check", trajectory=PATH)) == "RATE_LIMIT"
        )  # of one process, not one connection
        assert "error" not in other.call("GetStatus")
        time.sleep(1.05)
        assert "error" not in other.call("Check", trajectory=PATH)


def test_a_client_slightly_above_the_rate_limit_is_refused_and_stays_connected(front: SharedFront) -> None:
    with Raw(front) as client:
        refused = 0
        began = time.monotonic()
        for number in range(60):  # 29 a second
            time.sleep(max(0.0, began + 0.035 * number - time.monotonic()))
            refused += "error" in client.call("Check", trajectory=PATH)
        assert 5 <= refused < 40
        assert "error" not in client.call("GetStatus")


# --------------------------------------------------------------------------- what breaks


@pytest.mark.parametrize("number", ["-9223372036854775809", "18446744073709551616", "1" * 400])
def test_a_number_beyond_64_bits_is_refused_before_anything_breaks(front: SharedFront, number: str) -> None:
    with Raw(front) as client:
        call = '{"method":"%s.ReadRegister","parameters":{"bus":"main","id":%s,"name":"x"}}'
        client.bytes((call % (CONTROL, number)).encode() + b"\0")
        assert code(client.receive()) == "BAD_JSON"
        for edge in (-(2**63), 2**63 - 1):
            assert "error" not in client.call("ReadRegister", bus="main", id=edge, name="x")


BROKEN = """
import twind.front.interface_methods as methods
def broken(front, call):
    raise ZeroDivisionError("injected")
def starved(front, call):
    raise MemoryError("injected")
methods.METHODS["GetRobot"], methods.METHODS["GetParameters"] = broken, starved
from twind.front.__main__ import main
main()
"""


def test_a_call_that_breaks_ends_its_own_connection_and_no_other(tmp_path: Path) -> None:
    own = StandIn(tmp_path, program=("-c", BROKEN))
    try:
        with Raw(own, "observe") as watcher, Raw(own) as holder, Raw(own, "observe") as breaker:
            watcher.send("Monitor", parameters={"topics": ["state"], "rate": 50.0}, more=True)
            assert "error" not in holder.call("AcquireLease")
            assert breaker.call("GetParameters")["error"] == f"{CONTROL}.Busy"
            breaker.send("GetRobot")
            assert breaker.ended()
            assert "error" not in holder.call("RenewLease")
            watcher.receive()
            own.answers[link.EStop] = lambda c: [link.Reply(ticket=c.ticket)]
            assert time_stop(own) < BOUND
            ends = [command for command in own.commands if isinstance(command, link.ConnectionClosed)]
            renewed = own.await_command(link.RenewLease)
            assert renewed.client not in [end.client for end in ends]  # type: ignore[union-attr]
        text = await_event(own.log.read_text, "CALL_BROKE")
        assert "injected" in text
        assert "place=broken:" in text
        assert "Traceback" not in text
        assert own.front.poll() is None
    finally:
        own.close()


# --------------------------------------------------------------------------- exhaustion


def descriptors(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/fd"))


def test_without_free_descriptors_new_clients_may_only_stop_and_the_others_continue(
    front: SharedFront,
) -> None:
    front.await_lookahead()
    with Raw(front, "observe") as watcher, Raw(front) as holder, contextlib.ExitStack() as stack:
        watcher.send("Monitor", parameters={"topics": ["state"], "rate": 50.0}, more=True)
        assert "error" not in holder.call("AcquireLease")
        used = {int(number) for number in os.listdir(f"/proc/{front.front.pid}/fd")}
        most = next(n for n in range(1024) if n - len([fd for fd in used if fd < n]) == 2)  # two are free
        resource.prlimit(front.front.pid, resource.RLIMIT_NOFILE, (most, 1024))
        late = [stack.enter_context(Raw(front, "observe")) for _ in range(20)]
        assert late[-1].call("GetStatus")["error"] == f"{CONTROL}.Busy"
        assert "error" not in late[-1].call("EStop")
        assert time_stop(front) < BOUND
        assert time_stop(front, "control") < BOUND
        time.sleep(0.4)  # what the two left is taken back
        # A trajectory needs one too: it is refused, and nobody is hung up on.
        assert holder.call("SubmitTrajectory", trajectory=PATH)["error"] == f"{CONTROL}.Busy"
        assert "error" not in holder.call("RenewLease")
        for _ in range(20):
            assert watcher.receive()["parameters"]["dropped"] == 0
        resource.prlimit(front.front.pid, resource.RLIMIT_NOFILE, (1024, 1024))
    await_event(front.logged, "DESCRIPTORS")
    time.sleep(0.6)
    with Raw(front, "observe") as client:
        assert "error" not in client.call("GetStatus")
    with Raw(front) as client:
        assert "error" not in client.call("SubmitTrajectory", trajectory=PATH)


def test_connections_leave_no_descriptor_behind(front: SharedFront) -> None:
    with Raw(front) as client:
        assert "error" not in client.call("GetStatus")
    time.sleep(0.1)
    before = descriptors(front.front.pid)
    for _ in range(200):
        with Raw(front, "observe") as client:
            client.bytes(b'{"method":"io.twind.Control.GetStatus"}\0')
    until(lambda: descriptors(front.front.pid) <= before, 5.0, "connections keep descriptors")


def test_an_unread_log_delays_no_client_and_lost_lines_are_counted(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    own = StandIn(tmp_path, stderr=writer)
    os.close(writer)
    try:
        with Raw(own, "observe") as client:
            assert "error" not in client.call("GetStatus")
        began = time.monotonic()
        for number in range(120):  # events of 4 KiB: the pipe is full at once, the queue after a while
            for copy in range(25):
                text = "x" * 2000
                own.send(
                    link.Event(time=began + 2.0 * number, sequence=copy, level="info", code="E", message=text)
                )
            if number % 4 == 0:
                assert time_stop(own) < BOUND
            time.sleep(0.01)  # the link takes so much at a time
        text_read = b""
        os.set_blocking(reader, False)
        end = time.monotonic() + 5.0
        while b"lines lost" not in text_read and time.monotonic() < end:
            with contextlib.suppress(BlockingIOError):
                text_read += os.read(reader, 1 << 16)
            with contextlib.suppress(BlockingIOError):
                own.send(link.Event(time=began + 1e4, sequence=1, level="info", code="LATER", message="x"))
        assert b"lines lost" in text_read
        assert own.front.poll() is None
    finally:
        own.inner.close()
        os.close(reader)
        own.close()


def test_an_idle_peer_without_a_first_call_is_disconnected_after_five_seconds(front: SharedFront) -> None:
    with Raw(front) as silent, Raw(front) as unfinished, Raw(front) as speaking:
        unfinished.bytes(b'{"method":"io.twind.Control.GetStatus"}')
        assert "error" not in speaking.call("GetStatus")
        began = time.monotonic()
        silent.socket.settimeout(8.0)
        assert silent.ended()
        assert 4.5 <= time.monotonic() - began <= 6.0
        assert code(unfinished.receive()) == "FRAME_INCOMPLETE"
        assert unfinished.ended()
        assert "error" not in speaking.call("GetStatus")


def test_a_hang_up_by_reset_is_only_a_hang_up(front: SharedFront) -> None:
    client = Raw(front)
    client.send("AcquireLease")
    front.await_command(link.AcquireLease)
    client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    client.socket.close()  # an answer lies unread: the other end finds a reset
    front.await_command(link.ConnectionClosed)
    assert time_stop(front) < BOUND
