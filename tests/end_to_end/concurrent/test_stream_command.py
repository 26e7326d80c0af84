"""`twindctl stream` and the example endpoint as processes, beside a daemon: killed, restarted, cut off."""

import argparse
import hashlib
import json
import random
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import until
from tests.support.scripted_endpoint import Odd
from tests.support.stream_rig import (
    PATIENCE,
    Process,
    begun,
    ctl,
    kept,
    killed_at_random,
    reported,
    run,
    simulated,
    streamer,
)
from twind.command_line.verb import UsageError
from twind.learn.streaming import stream_command as verb
from twind.learn.streaming.spool import dead_letters

__all__ = ["run"]


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    """Whoever a failed test left running ends with it."""
    yield
    while Process.begun:
        Process.begun.pop().gone()


def test_an_endpoint_that_is_killed_at_random_gets_every_sample_once(run: Path, tmp_path: Path) -> None:
    """Longer: `python tests/support/stream_sigkill_runs.py SECONDS`."""
    _, samples, told = killed_at_random(run, tmp_path, 4.0, seed=9, up=0.6, down=0.3)
    assert samples > 300
    assert told["failures"] >= 3, told


class Ledger:
    """An endpoint that remembers every message that it was sent, and answers some of them."""

    def __init__(self) -> None:
        self.seen: list[tuple[str, str, list[int]]] = []  # key, digest, ticks
        ledger = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                ticks = [each["tick"] for each in json.loads(body)["samples"]]
                key = self.headers["Idempotency-Key"]
                ledger.seen.append((key, hashlib.sha256(body).hexdigest(), ticks))
                if len(ledger.seen) % 3 == 0:
                    self.close_connection = True
                    return
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, format: str, *given: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,))
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


def test_a_streamer_that_is_killed_goes_on_and_no_key_comes_back_for_other_data(
    run: Path, tmp_path: Path
) -> None:
    rng = random.Random(4)
    endpoint = Ledger()
    spool = tmp_path / "spool"
    try:
        for _ in range(3):
            before = len(endpoint.seen)
            stream = streamer(run, endpoint.url, spool, "--batch", "2")
            until(lambda: len(endpoint.seen) > before + 3, PATIENCE, "it sends")  # noqa: B023
            time.sleep(rng.uniform(0.0, 0.4))
            assert stream.end(signal.SIGKILL)[0] == -signal.SIGKILL
        stream = streamer(run, endpoint.url, spool, "--batch", "2", "--seconds", "1")
        code, said, _ = stream.end(0)
    finally:
        endpoint.close()
    assert code == 0 and json.loads(said)["dropped"] == 0
    digests: dict[str, set[str]] = {}
    for key, digest, _ in endpoint.seen:
        digests.setdefault(key, set()).add(digest)
    assert all(len(each) == 1 for each in digests.values()), "one key for two messages"
    stream_name = endpoint.seen[0][0].partition("-")[0]
    numbers = sorted(int(key.removeprefix(f"{stream_name}-")) for key in digests)
    assert numbers == list(range(1, len(numbers) + 1)), "a number that was given never came"
    ticks = [tick for key, each in {key: ticks for key, _, ticks in endpoint.seen}.items() for tick in each]
    assert len(ticks) == len(set(ticks)), "a sample in two messages"


def test_a_streamer_survives_a_daemon_restart_and_excludes_a_second_streamer(tmp_path: Path) -> None:
    run = tmp_path / "run"
    spool = tmp_path / "spool"
    endpoint = Odd()
    with simulated(run) as daemon:
        stream = streamer(run, endpoint.url, spool, "--batch", "4")
        told = until(lambda: reported(run), PATIENCE, "it reports")
        assert (told["endpoint"], told["dropped"], told["error"]) == (endpoint.url.partition("?")[0], 0, None)
        monitor = [*ctl("--json", "--socket", str(run), "monitor"), "--topics", "stream", "--count", "2"]
        heard = subprocess.run(monitor, capture_output=True, text=True, timeout=PATIENCE).stdout
        first, second = [json.loads(line)["stream"] for line in heard.splitlines()]
        assert first["name"] == second["name"] == told["name"]
        assert second["sent"] > first["sent"]
        other = subprocess.run(
            ctl("--socket", str(run), "stream", "--spool", str(spool)),
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        assert other.returncode == 1 and f"process {stream.pid} streams from it" in other.stderr
        shown = subprocess.run(ctl("--socket", str(run), "status"), capture_output=True, text=True).stdout
        assert f"\nstream   {told['endpoint']}: " in shown
        daemon.end(signal.SIGKILL)
    with simulated(run):
        count = len(endpoint.seen)
        until(lambda: len(endpoint.seen) > count + 10, PATIENCE, "it goes on with the next daemon")
        code, _, said = stream.end()
        assert code == 0
        assert said.count("waiting for the daemon") == said.count("the daemon is there again") == 1, said
        until(lambda: reported(run) is None, PATIENCE, "one that is gone is not told of")
    endpoint.close()


def test_dead_letters_are_listed_and_sent_again_on_request(run: Path, tmp_path: Path) -> None:
    spool = tmp_path / "spool"
    out = tmp_path / "in"
    ingest, url = begun(out, "--refuse", "1")
    code, said, told = streamer(run, url, spool, "--gzip", "--seconds", "2").end(0)
    assert code == 0 and json.loads(said)["dead"] >= 3
    assert told.count("dead letter") == 1 and "refused on purpose" in told
    ingest.end()
    listed = subprocess.run(ctl("--json", "stream", "--spool", str(spool), "--dead"), capture_output=True)
    rows = [json.loads(line) for line in listed.stdout.splitlines()]
    assert len(rows) == json.loads(said)["dead"] == len(dead_letters(spool))
    assert rows[0]["sequence"] == 1 and rows[0]["reason"].startswith("422")
    ingest, _ = begun(out, at=url)
    again = streamer(run, url, spool, "--gzip", "--dead-again")
    until(lambda: len(kept(out)) > len(rows), PATIENCE, "they arrive")
    code, said, _ = again.end()
    ingest.end()
    assert (code, json.loads(said)["dead"]) == (0, 0)
    assert [line["key"].partition("-")[2] for line in kept(out)][:3] == ["1", "2", "3"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--url", "ftp://x/"), "http://HOST"),
        (("--url", "http://user:secret@x/"), "--token-file"),
        (("--rate", "nan"), "above 0"),
        (("--batch", "0"), "from 1"),
        (("--header", "Idempotency-Key: 1"), "'Name: value'"),
        (("--header", "X: a\nY: b"), "'Name: value'"),
        (("--token-file", "/nowhere"), "No such file"),
    ],
)
def test_an_invalid_stream_option_is_refused_before_any_file_is_made(
    tmp_path: Path, words: tuple[str, str], message: str
) -> None:
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    with pytest.raises(UsageError, match=message):
        verb.run(parser.parse_args(["--spool", str(tmp_path / "spool"), *words]))
    assert not (tmp_path / "spool").exists()
