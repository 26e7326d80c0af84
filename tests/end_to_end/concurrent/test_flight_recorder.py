"""The recorder of a real daemon: dumped, left behind by a kill, and of no harm where it cannot be written."""

import contextlib
import os
import signal
import socket
import stat
from pathlib import Path

import pytest

from tests.support.processes import Daemon, until
from twind import link
from twind.client import CallError, ClientError
from twind.ctl.ctl_main import main
from twind.flight import EntryKind, load


def daemon(tmp_path: Path, **more: str) -> Daemon:
    """In sim mode, which needs no robot, and has ticked."""
    environment = {"STATE_DIRECTORY": str(tmp_path), **more}
    started = Daemon(tmp_path / "run", "--mode", "sim", environment=environment)
    try:
        started.reach()
    except AssertionError:
        started.kill()
        raise
    return started


def files(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "flight" / "sim").glob("flight-*.flight"))


def test_dump_prints_the_path_of_a_file_that_contains_the_events(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    twind = daemon(tmp_path)
    try:
        with twind.client() as client:
            client.call("Mark", kind="note", text="it wobbles")
        assert main(["--socket", str(twind.sockets), "dump", "wobbles"]) == 0
        path = Path(capsys.readouterr().out.strip())
        assert files(tmp_path) == [path]
        assert path.name.endswith("-wobbles.flight")
        flight = load(path)
        news = [
            link.decode_news(each.data) for each in flight.contents.entries if each.kind is EntryKind.NEWS
        ]
        assert [each.code for each in news if isinstance(each, link.Event)][-1] == "NOTE"
        assert any(isinstance(each, link.Tick) for each in news)
        commands = [
            link.decode_command(each.data)
            for each in flight.contents.entries
            if each.kind is EntryKind.COMMAND
        ]
        assert isinstance(commands[0], link.Mark)  # that its client is gone the loop may not have heard yet
        assert flight.briefing.robot == "h24"
        assert stat.S_IMODE(path.stat().st_mode) & 0o137 == 0
        shown = twind.status()["flight"]
        assert (shown["last"], shown["bytes"] > 0) == (str(path), True)
    finally:
        twind.end()
    assert files(tmp_path) == [path]  # an end that was asked for leaves none


def test_the_front_of_a_loop_that_was_killed_writes_it_down_before_it_ends(tmp_path: Path) -> None:
    twind = daemon(tmp_path)
    front = twind.front()
    pipe = tmp_path / "flight" / "sim" / "flight-x-CRASH.flight"  # what is there is looked into before
    pipe.parent.mkdir(parents=True)
    os.mkfifo(pipe)
    with twind.client() as client:
        client.call("GetStatus")
        assert twind.end(signal.SIGKILL) == -signal.SIGKILL
        with pytest.raises(ClientError):
            list(client.stream("Monitor", topics=["state"], rate=100.0))
    until(lambda: not Path(f"/proc/{front}").exists(), 10.0, "a front that ends, in spite of the pipe")
    pipe.unlink()
    (path,) = files(tmp_path)
    flight = load(path)
    assert (flight.meta["reason"], flight.meta["mode"]) == ("crash", "sim")
    assert "FLIGHT_WRITTEN" in twind.log.read_text()
    ticks = [
        news
        for each in flight.contents.entries
        if each.kind is EntryKind.NEWS and isinstance(news := link.decode_news(each.data), link.Tick)
    ]
    assert [tick.sequence for tick in ticks] == list(range(ticks[0].sequence, ticks[-1].sequence + 1))


def test_an_unwritable_flight_recorder_folder_is_reported_and_the_daemon_continues(tmp_path: Path) -> None:
    (tmp_path / "flight").write_text("no folder")
    twind = daemon(tmp_path)
    try:
        with twind.client() as client:
            with pytest.raises(CallError, match="not written: "):
                client.call("DumpRecorder")
            client.call("EStop")
            until(lambda: "FLIGHT_NOT_WRITTEN" in twind.log.read_text(), 10.0, "a line of the log")
            assert client.call("GetStatus")["status"]["flight"]["last"] is None
    finally:
        assert twind.end() == 0
    assert (tmp_path / "flight").read_text() == "no folder"


def test_the_service_manager_keeps_the_recorder_of_a_front_that_had_to_be_killed(tmp_path: Path) -> None:
    """It may have had a file to write. test_service_notify_live.py has the front that ends."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(10.0)
        twind = daemon(tmp_path, NOTIFY_SOCKET=str(tmp_path / "notify"))
        try:
            while b"FDSTORE=1" not in manager.recv(4096):
                pass
            os.kill(twind.front(), signal.SIGSTOP)
            assert twind.end() == 0
        finally:
            twind.kill()
        told: list[str] = []
        manager.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                told.append(manager.recv(4096).decode())
    assert sum(said.startswith("STOPPING=1") for said in told) == 2
    assert not any(said.startswith("FDSTOREREMOVE=1") for said in told)
