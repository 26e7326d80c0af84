"""Client of the control socket: answers, errors, streams, bounded waits."""

import contextlib
import errno
import json
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from twind.client import (
    CallError,
    Client,
    ClientError,
    Disconnected,
    NoDaemon,
    Refused,
    socket_path,
)

FINDING = {"code": "POS_LIMIT", "joint": "knee", "message": "knee: position 3 rad, bound 2 rad"}


class Peer:
    """A listener that answers one connection with a function of each call."""

    def __init__(self, directory: Path, answer: Callable[[dict[str, Any]], list[bytes]]) -> None:
        self.calls: list[dict[str, Any]] = []
        self._answer = answer
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(directory / "control.sock"))
        self._listener.listen()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # nobody came before the end
            return
        with connection, contextlib.suppress(OSError):  # a client may leave in the middle
            buffer = b""
            while data := connection.recv(65536):
                buffer += data
                while b"\0" in buffer:
                    message, _, buffer = buffer.partition(b"\0")
                    self.calls.append(json.loads(message))
                    answers = self._answer(self.calls[-1])
                    if not answers:
                        return
                    for answer in answers:
                        connection.sendall(answer)

    def wait_for_end_of_file(self) -> None:
        self._thread.join(60.0)
        assert not self._thread.is_alive()

    def close(self) -> None:
        with contextlib.suppress(OSError):  # closed twice
            self._listener.shutdown(socket.SHUT_RDWR)  # wakes `accept`
        self._thread.join(60.0)
        self._listener.close()


Answer = Callable[[dict[str, Any]], list[bytes]]
Dial = Callable[[Answer], tuple[Client, Peer]]


@pytest.fixture
def dial(tmp_path: Path) -> Iterator[Dial]:
    """Start a peer that answers, and a client for it."""
    with contextlib.ExitStack() as stack:

        def begin(answer: Answer) -> tuple[Client, Peer]:
            peer = Peer(tmp_path, answer)
            stack.callback(peer.close)
            return stack.enter_context(Client(tmp_path, timeout=20.0)), peer

        yield begin


def reply(**keys: Any) -> bytes:
    return json.dumps(keys).encode() + b"\0"


def test_a_call_names_the_interface_and_leaves_out_what_is_not_given(dial: Dial) -> None:
    client, peer = dial(lambda call: [reply(parameters={"mode": "sim"})])
    assert client.call("SetMode", mode="sim", other=None) == {"mode": "sim"}
    client.call("org.varlink.service.GetInfo")
    assert peer.calls == [
        {"method": "io.twind.Control.SetMode", "parameters": {"mode": "sim"}},
        {"method": "org.varlink.service.GetInfo", "parameters": {}},
    ]


def test_an_answer_may_come_in_pieces_and_without_parameters(dial: Dial) -> None:
    client, _ = dial(lambda call: [b'{"para', b'meters"', b":null}", b"\0"])
    assert client.call("ReleaseLease") == {}


def test_an_answer_may_be_taken_later_but_before_anything_else_is_asked(dial: Dial) -> None:
    refused = reply(error="io.twind.Control.Refused", parameters={"findings": [FINDING]})
    client, _ = dial(
        lambda call: [refused if "Setpoint" in call["method"] else reply(parameters={"mode": "sim"})]
    )
    assert client.finish() is None
    client.begin("Setpoint", positions=[9.0])
    with pytest.raises(RuntimeError, match="Setpoint is not answered yet"):
        client.call("GetStatus")
    with pytest.raises(Refused):
        client.finish()
    assert client.finish() is None and client.call("GetStatus") == {"mode": "sim"}
    client.begin("GetStatus")
    client.close()
    assert client.finish() is None  # it went with its connection


def test_a_refusal_carries_every_finding(dial: Dial) -> None:
    client, _ = dial(
        lambda call: [reply(error="io.twind.Control.Refused", parameters={"findings": [FINDING, FINDING]})]
    )
    with pytest.raises(Refused) as caught:
        client.call("SubmitTrajectory", trajectory={})
    assert caught.value.findings == [FINDING, FINDING]
    assert str(caught.value) == "\n".join(["POS_LIMIT: knee: position 3 rad, bound 2 rad"] * 2)


@pytest.mark.parametrize(
    ("name", "parameters", "text"),
    [
        (
            "NotFound",
            {"what": "mode", "name": "fly", "known": ["sim", "live"]},
            "no mode 'fly'; known: sim, live",
        ),
        (
            "NotFound",
            {"what": "bus", "name": "", "known": ["arm", "legs"]},
            "name a bus: arm, legs",
        ),
        (
            "WrongState",
            {"state": "armed", "allowed": ["disarmed"]},
            "not in this state: armed; needs: disarmed",
        ),
        (
            "LeaseHeld",
            {"lease": {"holder": "uid 5", "uid": 5, "expires_in": 0.5}},
            "held by uid 5, unless it is not renewed for 0.50 s",
        ),
        ("Busy", {"what": "arming"}, "busy: arming"),
        ("BusFailed", {"bus": "main", "message": "gone"}, "bus main: gone"),
        ("NotAllowed", {"role": "observer", "method": "Arm"}, "Arm is not for the role observer"),
        ("Newer", {"a": 1}, "Newer: a=1"),
        ("NotFound", {"else": 1}, "NotFound: else=1"),
    ],
)
def test_every_error_reads_as_a_sentence(
    dial: Dial, name: str, parameters: dict[str, Any], text: str
) -> None:
    client, _ = dial(lambda call: [reply(error=f"io.twind.Control.{name}", parameters=parameters)])
    with pytest.raises(CallError) as caught:
        client.call("Arm")
    assert caught.value.name == name
    assert text in str(caught.value)


def test_a_stream_gives_every_answer_and_the_connection_stays_usable(dial: Dial) -> None:
    def answer(call: dict[str, Any]) -> list[bytes]:
        if not call.get("more"):
            return [reply(parameters={})]
        return [reply(parameters={"n": n}, continues=n < 2) for n in range(3)]

    client, _ = dial(answer)
    assert [step["n"] for step in client.stream("Scan")] == [0, 1, 2]
    assert client.call("GetStatus") == {}


def test_an_error_ends_a_stream_and_not_the_connection(dial: Dial) -> None:
    def answer(call: dict[str, Any]) -> list[bytes]:
        error = reply(error="io.twind.Control.Busy", parameters={"what": "x"})
        return [reply(parameters={}, continues=True), error] if call.get("more") else [reply(parameters={})]

    client, _ = dial(answer)
    with pytest.raises(CallError, match="busy"):
        list(client.stream("Monitor", topics=["state"]))
    assert client.call("GetStatus") == {}


def test_a_stream_left_early_closes_the_connection(dial: Dial) -> None:
    client, peer = dial(lambda call: [reply(parameters={}, continues=True)] * 3)
    for _ in client.stream("Monitor", topics=["state"]):
        break
    peer.wait_for_end_of_file()


def test_bursts_are_all_answers_that_have_come_as_their_bytes(dial: Dial) -> None:
    whole = [reply(parameters={"n": n}, continues=True) for n in range(5)]
    client, peer = dial(lambda call: [whole[0] + whole[1] + whole[2][:7], whole[2][7:] + whole[3], whole[4]])
    received: list[bytes] = []
    for burst in client.bursts("Monitor", topics=["state"]):
        assert burst
        received += burst
        if len(received) == 5:
            break
    assert [each + b"\0" for each in received] == whole
    assert peer.calls[0]["more"] is True
    peer.wait_for_end_of_file()


def test_bursts_end_as_a_stream_does(dial: Dial) -> None:
    client, _ = dial(lambda call: [])
    with pytest.raises(Disconnected):
        list(client.bursts("Monitor", topics=["state"]))


def test_during_a_stream_no_other_call_is_made(dial: Dial) -> None:
    client, _ = dial(lambda call: [reply(parameters={}, continues=True)])
    stream = client.stream("Monitor", topics=["state"])
    next(stream)
    with pytest.raises(RuntimeError, match="another Client"):
        client.call("GetStatus")
    stream.close()


def test_a_lost_connection_and_an_absent_daemon_raise_different_errors(dial: Dial, tmp_path: Path) -> None:
    client, peer = dial(lambda call: [])
    with pytest.raises(Disconnected, match="during Arm"):
        client.call("Arm")
    peer.close()
    with pytest.raises(NoDaemon, match="no process listens"):
        client.call("Arm")
    with pytest.raises(NoDaemon, match="start one with"):
        Client(tmp_path / "nowhere").call("Arm")


@pytest.mark.parametrize(
    "malformed",
    [b"not json", b"\xff\xfe", b"[" * 100_000, b"[]", b'{"parameters": [1]}', b'{"error": 7}'],
)
def test_an_answer_that_is_none_ends_the_connection(dial: Dial, malformed: bytes) -> None:
    client, _ = dial(lambda call: [malformed + b"\0"])
    with pytest.raises(Disconnected, match="answer to GetStatus is no valid message"):
        client.call("GetStatus")
    assert not client.connected


def test_a_call_that_waits_is_broken_off_by_another_thread(dial: Dial) -> None:
    came = threading.Event()
    over = threading.Event()

    def silent(call: dict[str, Any]) -> list[bytes]:
        came.set()
        over.wait(20.0)
        return []

    client, _ = dial(silent)
    client.cut()  # of none it is nothing

    def cut() -> None:
        came.wait(20.0)
        client.cut()

    thread = threading.Thread(target=cut)
    thread.start()
    begun = time.monotonic()
    with pytest.raises(Disconnected):
        client.call("SubmitTrajectory")
    took = time.monotonic() - begun
    over.set()
    thread.join()
    assert took < 10.0 and not client.connected


def test_nan_never_leaves(dial: Dial) -> None:
    client, peer = dial(lambda call: [reply(parameters={})])
    with pytest.raises(ClientError, match="NaN or infinite"):
        client.call("Setpoint", positions=[float("nan")])
    assert not peer.calls


def test_the_users_own_daemon_comes_before_the_systems(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "twind").mkdir()
    path = tmp_path / "twind" / "observe.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        assert socket_path(name="observe") == str(path)
        assert socket_path(path) == str(path)
        assert socket_path(tmp_path, "control") == str(tmp_path / "control.sock")
    path.unlink()
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert socket_path().startswith("/run/twind/")


def test_a_shorter_patience_ends_with_its_context() -> None:
    client = Client("nowhere", timeout=9.0)
    with contextlib.suppress(ClientError), client.within(2.0):
        assert client.timeout == 2.0
        raise ClientError("whatever happens in it")
    assert client.timeout == 9.0


def test_a_program_without_descriptors_gets_the_error_of_a_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_given: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(socket, "socket", refuse)
    with pytest.raises(NoDaemon, match="Too many open files: this program has no descriptor left"):
        Client("nowhere").connect()
