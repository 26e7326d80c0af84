"""A standard error that is full, closed or not read costs neither the loop a tick nor a client its answer."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.processes import favour, unread_pipe, until
from tests.support.reload_rig import files
from twind.client import CallError, Client, ClientError

SECONDS = 1.5  # that the daemon is asked for without a pause
SLOWEST = 1.0  # s that one answer may take on a busy machine; a blocked front gives none


@contextlib.contextmanager
def full() -> Iterator[int]:
    """A device without room."""
    descriptor = os.open("/dev/full", os.O_WRONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def gone() -> Iterator[int]:
    """Writing end of a pipe without a reader."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        yield writer
    finally:
        os.close(writer)


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


@pytest.mark.parametrize("stderr", [full, unread_pipe, gone, contextlib.nullcontext])
def test_a_full_or_closed_standard_error_delays_no_tick_and_no_reply(
    tmp_path: Path, stderr: Callable[[], contextlib.AbstractContextManager[int | None]]
) -> None:
    with stderr() as descriptor, daemon(tmp_path, descriptor) as (process, client):
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
