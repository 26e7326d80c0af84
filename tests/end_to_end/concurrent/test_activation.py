"""Sockets that were there before the daemon: handed over by name, served, kept; real processes."""

import fcntl
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import until
from twind.client import Client, ClientError

ACTIVATE = shutil.which("systemd-socket-activate")
needs_activate = pytest.mark.skipif(ACTIVATE is None, reason="systemd-socket-activate is not installed")
SIM = ("-m", "twind.cli", "--mode", "sim")


class Waiting:
    """A client that connects and asks at once, whoever may be there to answer."""

    def __init__(self, path: Path, method: str, **parameters: Any) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(20.0)
        self.socket.connect(str(path))
        call = {"method": f"io.twind.Control.{method}", "parameters": parameters}
        self.socket.sendall(json.dumps(call).encode() + b"\0")

    def answer(self) -> dict[str, Any]:
        """Waited for."""
        data = b""
        with self.socket:
            while not data.endswith(b"\0"):
                more = self.socket.recv(1 << 16)
                assert more, "the connection was closed without an answer"
                data += more
        found: dict[str, Any] = json.loads(data[:-1])
        return found


@contextmanager
def activated(folder: Path, names: str, *paths: str) -> Iterator[subprocess.Popen[bytes]]:
    """A daemon that begins with the first connection to one of these; its own sockets would be in `own`."""
    assert ACTIVATE is not None
    listen = [part for path in paths for part in ("-l", str(folder / path))]
    command = [ACTIVATE, *listen, f"--fdname={names}", sys.executable, *SIM, "--socket", str(folder / "own")]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=log)
    try:
        until(lambda: all((folder / path).is_socket() for path in paths), 5.0, "sockets")
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait(10)


def front_of(pid: int) -> int:
    """The child that serves."""

    def look() -> int | None:
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            if b"twind.front" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
        return None

    return until(look, 10.0, "a front")


def mode_of(answer: dict[str, Any]) -> str:
    mode: str = answer["parameters"]["status"]["mode"]
    return mode


@needs_activate
def test_both_sockets_are_served_by_their_names_and_outlive_front_and_daemon(tmp_path: Path) -> None:
    observe, control = "a", "b"
    with activated(tmp_path, "observe:control", observe, control) as daemon:
        inodes = [(tmp_path / path).stat().st_ino for path in "ab"]
        first = [Waiting(tmp_path / path, "GetStatus") for path in (observe, control, observe)]
        assert [mode_of(each.answer()) for each in first] == ["sim"] * 3
        assert "NotAllowed" in Waiting(tmp_path / observe, "AcquireLease").answer()["error"]
        assert "error" not in Waiting(tmp_path / control, "AcquireLease").answer()
        assert not (tmp_path / "own").exists()  # nothing of its own was bound
        os.kill(front_of(daemon.pid), signal.SIGKILL)
        waits = Waiting(tmp_path / control, "GetStatus")
        assert mode_of(waits.answer()) == "sim"
        daemon.terminate()
        assert daemon.wait(20) == 0
        assert [(tmp_path / path).stat().st_ino for path in "ab"] == inodes


@needs_activate
def test_a_missing_inherited_socket_is_created_and_an_unknown_one_is_reported(tmp_path: Path) -> None:
    with activated(tmp_path, "control:varlink", "a", "b") as daemon:
        assert mode_of(Waiting(tmp_path / "a", "GetStatus").answer()) == "sim"
        assert sorted(path.name for path in (tmp_path / "own").iterdir()) == ["observe.sock"]
        assert mode_of(Waiting(tmp_path / "own" / "observe.sock", "GetStatus").answer()) == "sim"
        assert "'varlink' was handed over" in (tmp_path / "log").read_text()
        daemon.terminate()
        assert daemon.wait(20) == 0


# ------------------------------------------------------------------------------------- a restart


class Manager:
    """Service manager: it listens itself, and passes its sockets to one daemon after the other."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.daemon = None
        self.listeners = []
        for name in ("control", "observe"):
            listener = socket.socket(socket.AF_UNIX)
            listener.bind(str(folder / f"{name}.sock"))
            listener.listen(128)
            self.listeners.append(listener)

    def start(self) -> subprocess.Popen[bytes]:
        """A daemon with these sockets as 3 and 4."""
        fds = [listener.fileno() for listener in self.listeners]
        # Numbers that are free, and neither 3 nor 4: a fixed one may be somebody else's of this process.
        high = [fcntl.fcntl(fd, fcntl.F_DUPFD, 10) for fd in fds]
        moved = " ".join(f"{place}<&{fd} {fd}<&-" for place, fd in zip((3, 4), high, strict=True))
        command = f'exec {moved}; LISTEN_PID=$$ exec "$0" "$@"'
        environment = {**os.environ, "LISTEN_FDS": "2", "LISTEN_FDNAMES": "control:observe"}
        own = ("--socket", str(self.folder / "own"))
        with (self.folder / "log").open("ab") as log:
            daemon = subprocess.Popen(
                ["bash", "-c", command, sys.executable, *SIM, *own],
                pass_fds=high,
                env=environment,
                stderr=log,
            )
        for fd in high:
            os.close(fd)
        return daemon


def test_a_call_sent_after_the_daemon_died_is_served_by_the_next_daemon(
    tmp_path: Path,
) -> None:
    manager = Manager(tmp_path)
    first = second = None
    try:
        first = manager.start()
        assert mode_of(Waiting(tmp_path / "control.sock", "GetStatus").answer()) == "sim"
        first.kill()  # while its front loads the model
        first.wait(10)
        stop = Waiting(tmp_path / "observe.sock", "EStop", level="settle", reason="while it restarts")
        asks = Waiting(tmp_path / "control.sock", "GetStatus")
        second = manager.start()
        assert "error" not in stop.answer()
        asks.answer()
        with suppress(ClientError), Client(str(tmp_path)) as client:
            faults = client.call("GetStatus")["status"]["faults"]
        assert [(fault["code"], fault["message"]) for fault in faults] == [("ESTOP", "while it restarts")]
        second.terminate()
        assert second.wait(20) == 0
    finally:
        for daemon in (first, second):
            if daemon is not None and daemon.poll() is None:
                daemon.kill()
            if daemon is not None:
                daemon.wait(10)
        for listener in manager.listeners:
            listener.close()
