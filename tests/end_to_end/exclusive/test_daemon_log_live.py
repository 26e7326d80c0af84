"""A standard error that is full, closed or not read costs neither the loop a tick nor a client its answer."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.processes import favour, until
from tests.support.reload_rig import files
from twind.client import CallError, Client, ClientError

SECONDS = 1.5  # that the daemon is asked for without a pause
SLOWEST = 1.0  # s that one answer may take on a busy machine; a blocked front gives none


def full() -> tuple[int, list[int]]:
    return os.open("/dev/full", os.O_WRONLY), []


def unread() -> tuple[int, list[int]]:
    """A pipe without room whose reader sleeps."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writer, b"x" * 4096)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writer, b"x")
    os.set_blocking(writer, True)
    return writer, [reader]


def gone() -> tuple[int, list[int]]:
    """A pipe whose reader has left."""
    reader, writer = os.pipe()
    os.close(reader)
    return writer, []


@contextlib.contextmanager
def daemon(folder: Path, stderr: int | None) -> Iterator[tuple[subprocess.Popen[bytes], Client]]:
    """A sim; `stderr` None: closed."""
    sources = files(folder, "log_level: debug\n")
    command = [
        sys.executable,
        "-m",
        "twind.cli",
        "--config",
        str(sources.config),
        "--socket",
        str(folder / "run"),
    ]
    if stderr is None:
        command = ["sh", "-c", 'exec "$@" 2>&-', "sh", *command]
    process = subprocess.Popen(command, stderr=stderr, stdin=subprocess.DEVNULL)
    favour(process)
    try:
        until(lambda: _answers(folder / "run"), 20.0, "a status")
        with Client(str(folder / "run")) as client:
            yield process, client
    finally:
        if process.poll() is None:
            process.kill()
        process.wait(10.0)


def _answers(folder: Path) -> bool:
    with contextlib.suppress(ClientError), Client(str(folder)) as client:
        return bool(client.call("GetStatus"))
    return False


@pytest.mark.parametrize("how", ["full", "unread", "gone", "closed"])
def test_a_full_or_closed_standard_error_delays_no_tick_and_no_reply(tmp_path: Path, how: str) -> None:
    stderr, others = {"full": full, "unread": unread, "gone": gone, "closed": lambda: (None, [])}[how]()
    try:
        with daemon(tmp_path, stderr) as (process, client):
            began = time.monotonic()
            first = client.call("GetStatus")["status"]["loop"]
            slowest = 0.0
            asked = 0
            while time.monotonic() < began + SECONDS:
                since = time.monotonic()
                with pytest.raises(CallError):  # a line of the log, each
                    client.call("SubmitTrajectory", trajectory={"joint_names": ["nobody"], "points": []})
                client.call("GetStatus")
                slowest = max(slowest, time.monotonic() - since)
                asked = asked + 1
                time.sleep(0.06)  # within the trajectories that one may ask for in a second
            last = client.call("GetStatus")["status"]["loop"]
            took = time.monotonic() - began
            assert slowest < SLOWEST, slowest
            assert asked > 5
            ticks, missed = (last[key] - first[key] for key in ("ticks", "missed"))
            # What is seen of the loop is an overview that comes ten times a second, later on a busy machine.
            assert ticks + missed >= 100.0 * (took - 0.5)
            assert missed <= 0.1 * ticks, "a blocked loop misses all"
            process.terminate()
            assert process.wait(15.0) == 0
    finally:
        for each in (stderr, *others):
            if each is not None:
                os.close(each)
