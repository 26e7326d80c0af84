"""Real-time tests of loop notify."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.processes import Daemon, until
from tests.support.service_notify_rig import Manager


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Manager]:
    address = str(tmp_path / "notify") if request.param == "path" else f"@twind-test-{os.getpid()}"
    manager = Manager(address)
    yield manager
    manager.socket.close()


def test_a_daemon_notifies_readiness_once_it_answers_and_its_stop(tmp_path: Path) -> None:
    manager = Manager(str(tmp_path / "notify"))
    told: list[str] = []

    def said(what: str) -> bool:
        told.extend(manager.told())
        return any(line.startswith(what) for line in told)

    environment = {"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "400000"}
    daemon = Daemon(tmp_path / "run", "--mode", "sim", environment=environment)
    try:
        until(lambda: said("READY=1"), 20.0, "READY=1")
        assert (daemon.sockets / "control.sock").is_socket()
        until(lambda: said("STATUS=sim, disconnected, 0 of 24 joints fresh, 100 Hz"), 5.0, "STATUS")
        until(lambda: said("") and told.count("WATCHDOG=1") > 2, 5.0, "WATCHDOG=1")
        front = Path(f"/proc/{daemon.front()}/environ").read_bytes()
        assert b"NOTIFY_SOCKET" not in front
        assert b"WATCHDOG" not in front
        assert daemon.end() == 0
        assert not list(daemon.sockets.glob("*.sock"))
        assert said("STOPPING=1")
        assert told.count("READY=1") == 1
    finally:
        if daemon.process.poll() is None:
            daemon.process.kill()
        daemon.process.wait(10)
        manager.socket.close()


def test_a_start_asks_for_time_before_it_is_ready_and_the_status_names_a_port_that_is_missing(
    tmp_path: Path,
) -> None:
    manager = Manager("@twind-test-start")
    told: list[str] = []

    def said(what: str) -> bool:
        told.extend(manager.told())
        return any(what in line for line in told)

    options = ("--mode", "mirror", "--port", f"main={tmp_path / 'ttyUSB9'}")
    daemon = Daemon(tmp_path / "run", *options, environment={"NOTIFY_SOCKET": manager.address})
    try:
        until(lambda: said("ttyUSB9: no such port"), 20.0, "STATUS with the port")
        starting = next(place for place, line in enumerate(told) if line.startswith("EXTEND_TIMEOUT_USEC="))
        assert starting < told.index("READY=1")
        assert sum("READY=1" in line for line in told) == 1
        assert daemon.end() == 0
    finally:
        if daemon.process.poll() is None:
            daemon.process.kill()
        daemon.process.wait(10)
        manager.socket.close()
