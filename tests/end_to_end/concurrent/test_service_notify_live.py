"""Real-time tests of loop notify."""

from pathlib import Path

from tests.support.processes import Daemon, until
from tests.support.service_notify_rig import Manager


def places(lines: list[str], prefix: str) -> list[int]:
    """Places of the messages that begin with these words."""
    return [place for place, line in enumerate(lines) if line.startswith(prefix)]


def test_a_daemon_notifies_readiness_once_it_answers_and_its_stop(tmp_path: Path) -> None:
    """At its end it asks for time to lower the robot. The recorder is dropped after the front has ended."""
    manager = Manager(str(tmp_path / "notify"))
    told: list[str] = []

    def has_line(what: str) -> bool:
        told.extend(manager.received())
        return any(line.startswith(what) for line in told)

    environment = {"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "400000"}
    daemon = Daemon(tmp_path / "run", "--mode", "sim", environment=environment)
    try:
        until(lambda: has_line("READY=1"), 20.0, "READY=1")
        assert (daemon.sockets / "control.sock").is_socket()
        until(lambda: has_line("STATUS=sim, disconnected, 0 of 24 joints fresh, 100 Hz"), 5.0, "STATUS")
        until(lambda: has_line("") and told.count("WATCHDOG=1") > 2, 5.0, "WATCHDOG=1")
        front = Path(f"/proc/{daemon.front()}/environ").read_bytes()
        assert b"NOTIFY_SOCKET" not in front
        assert b"WATCHDOG" not in front
        assert daemon.end() == 0
        assert not list(daemon.sockets.glob("*.sock"))
        assert has_line("STOPPING=1")
        assert told.count("READY=1") == 1 == len(places(told, "FDSTORE=1"))
        when_told, before_the_front = places(told, "STOPPING=1")
        assert told[when_told].split() == ["STOPPING=1", "EXTEND_TIMEOUT_USEC=30000000"]
        (drop,) = [place for place in places(told, "FDSTOREREMOVE=1") if place > when_told]
        assert drop > before_the_front
        assert "control socket for group " in daemon.log.read_text()
    finally:
        daemon.kill()
        manager.socket.close()


def test_a_start_asks_for_time_before_it_is_ready_and_the_status_names_a_port_that_is_missing(
    tmp_path: Path,
) -> None:
    manager = Manager("@twind-test-start")
    told: list[str] = []

    def has_line(what: str) -> bool:
        told.extend(manager.received())
        return any(what in line for line in told)

    options = ("--mode", "mirror", "--port", f"main={tmp_path / 'ttyUSB9'}")
    daemon = Daemon(tmp_path / "run", *options, environment={"NOTIFY_SOCKET": manager.address})
    try:
        until(lambda: has_line("ttyUSB9: no such port"), 20.0, "STATUS with the port")
        starting = next(place for place, line in enumerate(told) if line.startswith("EXTEND_TIMEOUT_USEC="))
        assert starting < told.index("READY=1")
        assert sum("READY=1" in line for line in told) == 1
        assert daemon.end() == 0
    finally:
        daemon.kill()
        manager.socket.close()
