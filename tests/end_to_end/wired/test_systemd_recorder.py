"""The flight recorder outlives a crash of loop and front together: the next start writes it down, once."""

import shutil
import signal
import stat
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.systemd.machine import Machine
from tests.support.systemd.service import Robot, Service, settings
from twind.flight import EntryKind, load

FLIGHTS = "/var/lib/twind/flight"


@pytest.fixture(scope="module")
def recorded(machine: Machine, robot: Robot) -> Iterator[Service]:
    """A daemon that reads a robot, and has done so for a moment."""
    shutil.rmtree(machine.inside(FLIGHTS), ignore_errors=True)  # of this machine, shown through
    settings(machine, "recorded", robot.settings(mode="mirror"))
    service = Service(machine, "twind@recorded.service", "/run/twind/recorded").start()
    service.reach(hw_connected=True)
    yield service
    service.stop()


def crashes(service: Service) -> list[Path]:
    """Files of crashes, the oldest first."""
    return sorted(service.machine.inside(FLIGHTS).glob("*-CRASH*.flight"))


def crash(service: Service) -> float:
    """Everything of it at once, as by the kernel; s, when (monotonic). It is back, and serves."""
    main = service.show("MainPID")
    at = time.monotonic()
    service.machine.run("systemctl", "kill", "-s", signal.SIGKILL.name, "--kill-whom=all", service.unit)
    service.machine.until(
        lambda: service.show("ActiveState") == "active" and service.show("MainPID") != main,
        20.0,
        "a new daemon",
    )
    service.reach(hw_connected=True)
    return at


def test_the_recording_of_a_crash_is_written_by_the_next_daemon(recorded: Service) -> None:
    assert recorded.show("NFileDescriptorStore") == "1"
    assert crashes(recorded) == []
    at = crash(recorded)
    (path,) = recorded.machine.until(lambda: crashes(recorded), 10.0, "a file of the crash")
    recorded.says(5.0, "the file", lambda line: line.get("TWIND_CODE") == "FLIGHT_WRITTEN")
    flight = load(path)
    assert (flight.meta["reason"], flight.meta["code"]) == ("crash", "CRASH")
    entries = flight.contents.entries
    assert {each.kind for each in entries} >= {EntryKind.NEWS, EntryKind.OUT, EntryKind.IN, EntryKind.PORT}
    assert entries[-1].time < at + 1.0  # of the old daemon, up to its end
    assert at - entries[-1].time < 0.2
    assert len(flight.contents.kept[0]) > 24
    found = path.stat()
    assert stat.S_IMODE(found.st_mode) == 0o640
    user = recorded.machine.run("id", "-u", "twind").strip()
    assert str(found.st_uid) == user
    assert recorded.show("NFileDescriptorStore") == "1"  # that of the new daemon; the old one is let go


def test_a_repeated_crash_writes_no_second_file(recorded: Service) -> None:
    before = crashes(recorded)
    crash(recorded)
    recorded.says(5.0, "that it is left out", lambda line: line.get("TWIND_CODE") == "FLIGHT_LEFT_OUT")
    assert crashes(recorded) == before


def test_an_end_that_was_asked_for_is_no_crash(recorded: Service) -> None:
    before = crashes(recorded)
    for path in before:
        path.unlink()
    recorded.machine.run("systemctl", "restart", recorded.unit, seconds=20.0)
    recorded.reach(hw_connected=True)
    with (
        recorded.client() as client
    ):  # files are written one after the other: a crash would be there before it
        client.call("DumpRecorder", name="after")
    assert crashes(recorded) == []


def test_a_crash_that_cannot_be_written_yet_is_not_lost_by_the_next_one(recorded: Service) -> None:
    folder = recorded.machine.inside(FLIGHTS)
    aside = folder.with_name("flight-aside")
    folder.rename(aside)
    folder.write_text("no folder")
    recorded.reset()  # starts are counted
    try:
        at = crash(recorded)
        recorded.says(5.0, "a line", lambda line: line.get("TWIND_CODE") == "FLIGHT_NOT_WRITTEN")
        assert recorded.show("NFileDescriptorStore") == "1"
    finally:
        folder.unlink()
        aside.rename(folder)
    crash(recorded)
    (path,) = recorded.machine.until(lambda: crashes(recorded), 10.0, "a file of the crash")
    flight = load(path)
    assert flight.contents.entries[-1].time < at + 1.0  # the first one's
    assert flight.meta["files"] == "same"
