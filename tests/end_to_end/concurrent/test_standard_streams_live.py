"""Real-time tests of streams."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.support.processes import until
from twind.client import Client, ClientError


@contextmanager
def without_streams(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A simulating daemon that was started with its standard streams closed."""
    command = 'exec "$0" -m twind.cli --mode sim --socket "$1" 0<&- 1>&- 2>&-'
    with open(os.devnull, "r+b") as kept:
        daemon = subprocess.Popen(
            ["sh", "-c", command, sys.executable, str(folder)], stdin=kept, stdout=kept, stderr=kept
        )
        try:
            yield daemon
        finally:
            if daemon.poll() is None:
                daemon.kill()
            daemon.wait(10)


def answers(folder: Path) -> bool:
    with suppress(ClientError), Client(str(folder)) as client:
        return bool(client.call("GetStatus")["status"]["mode"] == "sim")
    return False


def test_a_daemon_without_standard_streams_runs_and_nothing_else_gets_their_numbers(tmp_path: Path) -> None:
    with without_streams(tmp_path) as daemon:
        until(lambda: answers(tmp_path), 20.0, "an answer")
        children = Path(f"/proc/{daemon.pid}/task/{daemon.pid}/children").read_text().split()
        for pid in (str(daemon.pid), *children):
            for fd in (0, 1, 2):
                assert os.readlink(f"/proc/{pid}/fd/{fd}") == os.devnull, (pid, fd)
        daemon.terminate()
        assert daemon.wait(20) == 0


def test_a_daemon_survives_a_blocked_standard_error_reader(tmp_path: Path) -> None:
    inner, outer = os.pipe()
    os.set_blocking(outer, False)
    with suppress(BlockingIOError):
        while True:
            os.write(outer, b"x" * 65536)
    os.set_blocking(outer, True)
    command = [sys.executable, "-m", "twind.cli", "--mode", "sim", "--socket", str(tmp_path)]
    daemon = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=outer)
    os.close(outer)
    try:
        until(lambda: answers(tmp_path), 20.0, "an answer")
        with Client(str(tmp_path)) as client:
            for _ in range(20):  # each an event
                client.call("AcquireLease")
                client.call("ReleaseLease")
        daemon.terminate()
        assert daemon.wait(20) == 0
    finally:
        if daemon.poll() is None:
            daemon.kill()
        daemon.wait(10)
        os.close(inner)
