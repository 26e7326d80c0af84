"""The sender against odd endpoints: nothing is lost, nothing waits for ever, everything is counted."""

import shutil
import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.support.processes import until
from tests.support.scripted_endpoint import OK, Behaviour, Odd, says
from tests.support.spool_rig import WIDE, carrying, folder
from twind.learn.streaming import spool_sender as sending
from twind.learn.streaming.http_endpoint import HttpEndpoint
from twind.learn.streaming.spool import Spool, dead_letters
from twind.learn.streaming.spool_sender import SpoolSender


def hangs_up(client: socket.socket) -> bool:
    return False


def says_and_hangs_up(data: bytes) -> Behaviour:
    def behave(client: socket.socket) -> bool:
        client.sendall(data)
        return False

    return behave


def never_answers(client: socket.socket) -> bool:
    with suppress(OSError):
        client.settimeout(20.0)
        client.recv(1)
    return False


def dribbles(client: socket.socket) -> bool:
    with suppress(OSError):
        client.sendall(b"HTTP/1.1 200 OK\r\n")
        for _ in range(200):
            client.sendall(b"X: y\r\n"[:1])
            time.sleep(0.05)
    return False


def talks_for_ever(client: socket.socket) -> bool:
    with suppress(OSError):
        client.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 999999999\r\n\r\n")
        for _ in range(100):
            client.sendall(b"x" * 100_000)
    return False


@contextmanager
def sender(endpoint: Odd, timeout: float = 5.0) -> Iterator[tuple[Spool, SpoolSender, list[str]]]:
    lines: list[str] = []
    with folder() as place, Spool(place, WIDE, time.monotonic(), time.time()) as spool:
        for text in ("one", "two", "three"):
            spool.append(carrying(text), time.monotonic(), time.time())
        made = SpoolSender(
            spool, HttpEndpoint(endpoint.url, {"User-Agent": "x"}, timeout=timeout), lines.append
        )
        made.start()
        try:
            yield spool, made, lines
        finally:
            made.finish(0.0)
            endpoint.close()


def arrived(endpoint: Odd) -> list[bytes]:
    """Bodies by key, each once, in the order in which they came first."""
    return list({key: body for key, body, _ in endpoint.seen}.values())


def check_all_arrive(spool: Spool, made: SpoolSender, endpoint: Odd) -> None:
    def all_sent() -> bool:
        made.abort_if_overdue(time.monotonic())
        return spool.tally.waiting == 0

    until(all_sent, 20.0, f"{spool.tally}, {made.error}")
    assert arrived(endpoint) == [b"one", b"two", b"three"]
    stream = spool.tally.stream
    assert list(dict.fromkeys(key for key, _, _ in endpoint.seen)) == [f"{stream}-{n}" for n in (1, 2, 3)]
    assert (spool.tally.sent, spool.tally.dead, spool.tally.dropped) == (3, 0, 0)
    until(lambda: made.error == "", 5.0, "a trouble that is over is still told")


@pytest.mark.parametrize(
    ("behaviour", "message"),
    [
        (says_and_hangs_up(b"\x00\xff rubbish \r\n\r\n"), "no HTTP"),
        (says_and_hangs_up(b"HTTP/1.1 abc\r\n\r\n"), "no HTTP"),
        (says_and_hangs_up(b"HTTP/1.1 200 OK\r\nX: " + b"y" * 100_000), "no HTTP"),
        (hangs_up, "hung up without an answer"),
        (says(b"HTTP/1.1 500 Oh\r\nContent-Length: 0\r\n\r\n"), "500 Oh"),
        (says(b"HTTP/1.1 302 Found\r\nLocation: /x\r\nContent-Length: 0\r\n\r\n"), "302 Found"),
        (says(b"HTTP/1.1 401 Who\r\nContent-Length: 5\r\n\r\nare u"), "401 Who: are u"),
    ],
)
def test_a_misbehaving_endpoint_still_receives_each_message_in_order(
    behaviour: Behaviour, message: str
) -> None:
    endpoint = Odd(behaviour, behaviour)
    with sender(endpoint) as (spool, made, lines):
        check_all_arrive(spool, made, endpoint)
        assert made.failures == 2
        first, last = lines
        assert message in first and "3 messages wait" in first
        assert "takes messages again" in last


def test_an_endpoint_without_or_with_a_slow_reply_is_abandoned_in_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sending, "LONGEST", 0.8)
    endpoint = Odd(never_answers, dribbles)
    with sender(endpoint, timeout=0.4) as (spool, made, _):
        begun = time.monotonic()
        check_all_arrive(spool, made, endpoint)
        assert made.failures == 2
        assert time.monotonic() - begun < 10.0


def test_an_endless_reply_is_cut_off_and_its_message_counts_as_sent() -> None:
    endpoint = Odd(talks_for_ever)
    with sender(endpoint) as (spool, made, _):
        check_all_arrive(spool, made, endpoint)
        assert (made.failures, len(endpoint.seen)) == (0, 3)


def test_a_connection_that_was_closed_between_two_messages_is_no_failure() -> None:
    endpoint = Odd(says_and_hangs_up(OK), says_and_hangs_up(OK))
    with sender(endpoint) as (spool, made, lines):
        check_all_arrive(spool, made, endpoint)
        assert (made.failures, lines) == (0, [])


def test_retry_after_is_honoured() -> None:
    endpoint = Odd(says(b"HTTP/1.1 503 Later\r\nRetry-After: 2\r\nContent-Length: 0\r\n\r\n"))
    with sender(endpoint) as (spool, made, _):
        check_all_arrive(spool, made, endpoint)
        first, second = endpoint.seen[:2]
        assert first[0] == second[0]
        assert second[2] - first[2] >= 2.0


def test_no_more_than_thirty_a_second() -> None:
    endpoint = Odd()
    with sender(endpoint) as (spool, _, _):
        for number in range(20):
            spool.append(carrying(str(number)), time.monotonic(), time.time())
        until(lambda: spool.tally.waiting == 0, 10.0, "all sent")
        times = [when for _, _, when in endpoint.seen]
        assert len(times) == 23
        assert times[-1] - times[0] >= 22 / 30.0 - 0.05


def test_a_permanently_refused_message_is_a_dead_letter_and_delays_no_other() -> None:
    endpoint = Odd(says(b"HTTP/1.1 422 No\r\nContent-Length: 8\r\n\r\nno robot"))
    with sender(endpoint) as (spool, made, lines):
        until(lambda: spool.tally.waiting == 0, 10.0, "the others arrive")
        assert (spool.tally.sent, spool.tally.dead, made.failures) == (2, 1, 0)
        (letter,) = dead_letters(spool.folder)
        assert (letter.sequence, letter.reason, letter.message.body) == (1, "422 No: no robot", b"one")
        assert len(lines) == 1 and "dead letter" in lines[0]


def test_a_disk_that_takes_no_deletion_has_nothing_sent_twice() -> None:
    endpoint = Odd()
    with sender(endpoint) as (spool, made, _):
        acknowledge = spool.acknowledge
        broken = threading.Event()

        def failing(sequence: int) -> None:
            if not broken.is_set():
                raise sending.sqlite3.OperationalError("disk I/O error")
            acknowledge(sequence)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(spool, "acknowledge", failing)
            until(lambda: "disk I/O error" in made.error, 10.0, "it is told")
            broken.set()
            check_all_arrive(spool, made, endpoint)
        assert len(endpoint.seen) == 3


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificate of localhost, signed by itself, with its key."""
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("no openssl here to make a certificate with")
    pem = tmp_path_factory.mktemp("tls") / "both.pem"
    how = ["-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]
    who = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"]
    files = ["-keyout", str(pem.with_name("key")), "-out", str(pem.with_name("crt"))]
    subprocess.run([program, "req", *how, *who, *files], check=True, capture_output=True)
    pem.write_text(pem.with_name("key").read_text() + pem.with_name("crt").read_text())
    return pem


@pytest.mark.parametrize("trusted", [True, False])
def test_https_is_used_only_with_a_trusted_certificate(
    trusted: bool, certificate: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if trusted:
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    endpoint = Odd(context=context)
    with sender(endpoint) as (spool, made, lines):
        if trusted:
            check_all_arrive(spool, made, endpoint)
        else:
            until(lambda: made.failures > 1, 10.0, "it tries")
            assert "TLS: CERTIFICATE_VERIFY_FAILED" in lines[0]
            assert (endpoint.seen, spool.tally.waiting) == ([], 3)


def test_a_refused_connection_keeps_the_messages_and_is_reported_once(tmp_path: Path) -> None:
    endpoint = Odd()
    endpoint.close()
    with sender(endpoint) as (spool, made, lines):
        until(lambda: made.failures > 2, 10.0, "it tries again")
        assert spool.tally.waiting == 3
        assert len(lines) == 1 and "refused" in lines[0]
