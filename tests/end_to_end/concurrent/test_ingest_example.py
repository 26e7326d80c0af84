"""The example endpoint docs/examples/ingest/ingest.py: each key is kept once, also after a crash."""

import gzip
import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.doc_pages_text import ROOT

# Not imported: that leaves bytecode beside a page of the documents.
ingest = SimpleNamespace(**run_path(str(ROOT / "docs" / "examples" / "ingest" / "ingest.py")))
JSON = {"Content-Type": "application/json"}
BODY = b'{"samples":[{"tick":1},{"tick":2}]}'


def lines(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / ingest.LINES).read_text().splitlines()]


def test_a_key_is_kept_once_also_by_the_next_run(tmp_path: Path) -> None:
    with ingest.IngestStore(tmp_path) as store:
        assert store.keep("a-1", {"content-type": "application/json"}, BODY)
        assert not store.keep("a-1", {"content-type": "application/json"}, BODY)
        assert store.counts() == {"messages": 1, "samples": 2, "duplicates": 1, "failed": 0}
    with ingest.IngestStore(tmp_path) as store:
        assert not store.keep("a-1", {}, BODY)
        assert store.keep("a-2", {"content-type": "application/x-ndjson"}, b'{"head":1}\n{"tick":3}\n')
        assert store.keep("a-3", {"content-type": "image/jpeg"}, b"\xff\xd8")
    assert [each["key"] for each in lines(tmp_path)] == ["a-1", "a-2", "a-3"]
    assert (tmp_path / "a-3.jpg").read_bytes() == b"\xff\xd8"


def test_a_line_that_a_crash_cut_off_is_taken_away_and_its_message_kept_when_it_comes_again(
    tmp_path: Path,
) -> None:
    with ingest.IngestStore(tmp_path) as store:
        store.keep("a-1", {"content-type": "application/json"}, BODY)
        store.keep("a-2", {"content-type": "application/json"}, BODY)
    whole = (tmp_path / ingest.LINES).read_bytes()
    for cut in (1, 7, len(whole) // 2 - 1):
        (tmp_path / ingest.LINES).write_bytes(whole[:-cut])
        with ingest.IngestStore(tmp_path) as store:
            assert store.keep("a-2", {"content-type": "application/json"}, BODY)
        assert [each["key"] for each in lines(tmp_path)] == ["a-1", "a-2"]


def test_two_do_not_write_into_one_folder(tmp_path: Path) -> None:
    with ingest.IngestStore(tmp_path), pytest.raises(OSError):
        ingest.IngestStore(tmp_path)


def test_an_injected_failure_depends_on_the_seed_and_ends() -> None:
    faults = ingest.IngestFaults(fail=0.5, seed=3)
    drawn = [[faults.draw(f"a-{n}", attempt) for attempt in range(1, 40)] for n in range(30)]
    assert drawn == [
        [ingest.IngestFaults(fail=0.5, seed=3).draw(f"a-{n}", each) for each in range(1, 40)]
        for n in range(30)
    ]
    assert all("" in each for each in drawn)
    assert {fault for each in drawn for fault in each} >= {
        "",
        "busy",
        "unavailable",
        "deaf",
        "cut",
        "silent",
        "rubbish",
    }
    refusing = ingest.IngestFaults(refuse=0.5)
    assert all(len({refusing.draw(f"a-{n}", attempt) for attempt in range(9)}) == 1 for n in range(30))


@pytest.mark.parametrize("text", ["", "8000", "x:1", "127.0.0.1:x", "127.0.0.1:99999", "1.2.3:1"])
def test_an_invalid_listen_address_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        ingest.address(text)


def test_an_address_is_classified_as_local_or_public() -> None:
    assert ingest.address("localhost:8000") == ingest.ListenAddress("127.0.0.1", 8000, local=True)
    assert ingest.address("[::1]:1") == ingest.ListenAddress("::1", 1, local=True)
    assert not ingest.address("0.0.0.0:1").local


# ------------------------------------------------------------------------------------------ on the wire


@contextmanager
def serving(folder: Path, faults: Any = None) -> Iterator[int]:
    """The port of a server."""
    with ingest.IngestStore(folder) as store:
        server = ingest.IngestServer(
            ingest.ListenAddress("127.0.0.1", 0, local=True), store, faults or ingest.IngestFaults()
        )
        server.start()
        try:
            yield int(server.url.rpartition(":")[2].partition("/")[0])
        finally:
            server.stop()


def post(port: int, body: bytes, **headers: str) -> tuple[int, str]:
    connection = HTTPConnection("127.0.0.1", port, timeout=10.0)
    try:
        connection.request(
            "POST", "/ingest", body, {name.replace("_", "-"): value for name, value in headers.items()}
        )
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    finally:
        connection.close()


def test_a_message_is_stored_once_plain_or_compressed_and_invalid_bytes_are_refused(tmp_path: Path) -> None:
    with serving(tmp_path) as port:
        plain = {"Content_Type": "application/json"}
        assert post(port, BODY, Idempotency_Key="a-1", **plain)[0] == 201
        assert post(port, BODY, Idempotency_Key="a-1", **plain)[0] == 200
        packed = gzip.compress(BODY)
        zipped = {**plain, "Content_Encoding": "gzip"}
        assert post(port, packed, Idempotency_Key="a-2", **zipped)[0] == 201
        assert post(port, BODY)[0] == 400
        assert post(port, BODY, Idempotency_Key="../../etc/x", **plain)[0] == 400
        assert post(port, b"{", Idempotency_Key="a-3", **plain)[0] == 422
        assert post(port, packed[:-9], Idempotency_Key="a-4", **zipped)[0] == 422
        assert post(port, b"x", Idempotency_Key="a-5", **zipped)[0] == 422
        bomb = gzip.compress(bytes(ingest.LONGEST + 1), 1)
        assert post(port, bomb, Idempotency_Key="a-6", **zipped)[0] == 422
        with socket.create_connection(("127.0.0.1", port)) as client:
            client.sendall(b"POST / HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n")
            assert b" 413 " in client.recv(100)
        with socket.create_connection(("127.0.0.1", port)) as client:
            client.sendall(b"\x00\xff\r\n\r\n")
            client.recv(100)
        with socket.create_connection(("127.0.0.1", port)) as client:
            client.sendall(b"POST / HTTP/1.1\r\nContent-Length: 10\r\nIdempotency-Key: a-7\r\n\r\nabc")
        assert post(port, BODY, Idempotency_Key="a-8", **plain)[0] == 201
    assert [each["key"] for each in lines(tmp_path)] == ["a-1", "a-2", "a-8"]
    assert lines(tmp_path)[1]["body"] == json.loads(BODY)
