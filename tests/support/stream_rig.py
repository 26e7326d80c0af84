"""Streaming processes, their daemon and their endpoint."""

import json
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import pytest

from tests.support.doc_pages_text import ROOT
from tests.support.processes import simulated, until
from twind.client import Client, ClientError

INGEST = ROOT / "docs" / "examples" / "ingest" / "ingest.py"
PATIENCE = 30.0  # s that a busy machine may take


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a daemon's sockets."""
    with simulated(tmp_path_factory.mktemp("run")) as daemon:
        yield daemon.sockets


def ctl(*words: str) -> list[str]:
    return [sys.executable, "-m", "twind.ctl.ctl_main", *words]


class Process:
    """A verb or another program that runs, and its output. `begun` has all of them, until a test ends."""

    begun: ClassVar[list["Process"]] = []

    def __init__(self, *words: str, program: Sequence[str] = ()) -> None:
        self.begun.append(self)
        command = [*(program or ctl("--json")), *words]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.pid = self._process.pid

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def first(self) -> Any:
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str, str]:
        """Its exit code, and what it said at last on both."""
        if self._process.poll() is None:
            self._process.send_signal(number)
        out, err = self._process.communicate(timeout=PATIENCE)
        return self._process.returncode, out, err

    def gone(self) -> None:
        """End it at once, if it has not ended."""
        if self._process.poll() is None:
            self._process.kill()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()
        self._process.wait(PATIENCE)


def begun(out: Path, *more: str, at: str = "http://127.0.0.1:0/") -> tuple[Process, str]:
    """An ingest server that serves, and its address."""
    words = ["--listen", at.split("/")[2], "--out", str(out), *more]
    process = Process(*words, program=[sys.executable, str(INGEST)])
    return process, process.first()["url"]


def streamer(run: Path, url: str, spool: Path, *more: str) -> Process:
    return Process("--socket", str(run), "stream", "--url", url, "--spool", str(spool), *more)


def reported(run: Path) -> dict[str, Any] | None:
    """Status of the only streamer, as the daemon reports it."""
    with suppress(ClientError), Client(run, name="observe") as client:
        streams: list[dict[str, Any]] = client.call("GetStatus")["status"]["streams"]
        return streams[0] if streams else None
    return None


def caught_up(run: Path) -> bool:
    """Nothing waits, as reported within the last second."""
    told = reported(run)
    return told is not None and told["waiting"] == 0


def kept(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "messages.ndjson").read_text().splitlines()]


def check_all_samples(lines: list[dict[str, Any]]) -> int:
    """Every number of the stream once, in any order, and in their order every tick of the loop; how many."""
    keys = [line["key"] for line in lines]
    assert len(set(keys)) == len(keys)
    lines = sorted(lines, key=lambda line: int(line["key"].partition("-")[2]))
    assert [int(line["key"].partition("-")[2]) for line in lines] == list(range(1, len(lines) + 1))
    ticks = [sample["tick"] for line in lines for sample in line["body"]["samples"]]
    lost = [line["body"]["lost"] for line in lines]
    assert all(not any(each.values()) for each in lost), lost
    missing = set(range(ticks[0], ticks[-1] + 1)) - set(ticks)
    assert not missing and len(ticks) == len(set(ticks)), sorted(missing)
    return len(ticks)


def killed_at_random(
    run: Path, folder: Path, seconds: float, seed: int, up: float = 1.0, down: float = 0.5
) -> tuple[int, int, dict[str, Any]]:
    """Endpoints of which a fifth of the attempts fails, each killed after at most `up` s, for so long.

    Kills, samples, each of which arrived once, and what the streamer says at its end.
    """
    rng = random.Random(seed)
    out = folder / "in"
    kills = 0
    ingest, url = begun(out, "--fail", "0.2")
    stream = streamer(run, url, folder / "spool")
    until(lambda: (out / "messages.ndjson").read_bytes(), PATIENCE, "it has begun")
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(rng.uniform(0.1, up))
        ingest.end(signal.SIGKILL)
        kills += 1
        time.sleep(rng.uniform(0.0, down))
        ingest, _ = begun(out, "--fail", "0.2", at=url)
    ingest.end(signal.SIGKILL)
    ingest, _ = begun(out, at=url)
    until(lambda: caught_up(run), PATIENCE + seconds, "it catches up")
    code, said, _ = stream.end()
    assert ingest.end()[0] == 0
    told: dict[str, Any] = json.loads(said)
    assert (code, told["waiting"], told["dropped"], told["dead"]) == (0, 0, 0, 0), told
    lines = kept(out)
    assert told["sent"] == len(lines)
    return kills + 1, check_all_samples(lines), told
