"""`twindctl monitor` on a terminal: resized, frozen, ended, without its daemon; and as NDJSON."""

import json
import re
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.loop_stand_in import NAMES, StandIn
from tests.support.pty_screen import Run, Screen
from twind.client import Client
from twind.ctl.dashboard.live_dashboard import MonitorFeed

FRAME = b"\x1b[?2026h"


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StandIn]:
    stand_in = StandIn(tmp_path_factory.mktemp("monitor"))
    yield stand_in
    assert stand_in.close() == 0


def command(directory: Path, *arguments: str) -> list[str]:
    return [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(directory), "monitor", *arguments]


@pytest.fixture
def run(loop: StandIn) -> Iterator[Callable[..., Run]]:
    """A monitor on a terminal of its own, its first picture drawn."""
    begun: list[Run] = []

    def begin(*arguments: str, columns: int = 100, rows: int = 30, **environment: str) -> Run:
        begun.append(Run(command(loop.directory, *arguments), columns, rows, **environment))
        begun[-1].until(whole)
        return begun[-1]

    yield begin
    for each in begun:
        each.close()


def whole(screen: Screen) -> bool:
    """A picture of this size: the header above, joints, keys in the last line."""
    last = screen.lines[screen.rows - 1]
    joints = [line for line in screen.lines if line[2:].startswith("joint_")]
    return (
        screen.lines[0].startswith(" stand-in  LIVE  armed")
        and len(joints) >= 3
        and ("Tab" in last or "q ends" in last)
    )


def given_back(run: Run) -> bool:
    """The terminal is as it was found: its first screen, its cursor, its echo."""
    modes = {key: value for key, value in run.screen.modes.items() if key in ("1049", "25", "7", "2026")}
    same = termios.tcgetattr(run.fd)[:6] == run.attributes[:6]
    return same and modes == {"1049": False, "25": True, "7": True, "2026": False}


def stopped(pid: int) -> bool:
    """It sleeps until somebody sends SIGCONT."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"


def test_the_monitor_follows_the_window_size_at_once_without_residue(run: Callable[..., Run]) -> None:
    one = run("--rate", "0.5", columns=80, rows=24)  # the next picture in its own time would be 2 s later
    for columns, rows in ((120, 40), (60, 20), (200, 60), (81, 25)):
        begun = time.monotonic()
        emptied = one.screen.emptied
        one.resize(columns, rows)
        one.until(lambda screen, before=emptied: screen.emptied > before and whole(screen))
        assert time.monotonic() - begun < 1.5
        assert all(len(line) <= columns for line in one.screen.lines)
        assert sum(line.startswith(" stand-in") for line in one.screen.lines) == 1
    assert sum(line[2:].startswith("joint_") for line in one.screen.lines) < len(NAMES)
    one.resize(120, 60)
    one.until(lambda screen: sum(line[2:].startswith("joint_") for line in screen.lines) == len(NAMES))


def test_space_freezes_tab_turns_the_page_and_q_ends(run: Callable[..., Run]) -> None:
    one = run("--rate", "20")
    one.type(" ")
    one.until(lambda screen: re.match(r" FROZEN for [1-9]\d* s ", screen.lines[-1]))
    one.type(" ")
    one.until(lambda screen: "FROZEN" not in screen.lines[-1])
    one.type("\t\t")
    one.until(lambda screen: any("latency, hop by hop" in line for line in screen.lines))
    assert not any(line[2:].startswith("joint_") for line in one.screen.lines)
    one.type("\t\t")
    one.until(whole)
    one.type("q")
    assert one.end() == 0
    assert given_back(one)


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_the_terminal_is_restored_after_any_end_of_the_monitor(
    run: Callable[..., Run], number: int, status: int
) -> None:
    one = run()
    assert not given_back(one)
    assert one.end(number) == status
    assert given_back(one)
    assert b"Traceback" not in one.raw


def test_ctrl_z_gives_the_terminal_to_the_shell_and_fg_draws_all_anew(run: Callable[..., Run]) -> None:
    one = run()
    one.type("\x1a")
    one.until(lambda _screen: given_back(one) and stopped(one.pid))
    subprocess.run(["kill", "-CONT", str(one.pid)], check=True)
    one.until(lambda screen: screen.modes["1049"] and whole(screen))


def test_news_that_come_faster_than_pictures_are_drawn_make_no_more_of_them(run: Callable[..., Run]) -> None:
    one = run("--rate", "100")
    before = one.raw.count(FRAME)
    begun = time.monotonic()
    one.watch(2.0)
    assert one.raw.count(FRAME) - before <= 17 * (time.monotonic() - begun)


def test_the_colour_setting_of_the_environment_is_honoured(run: Callable[..., Run]) -> None:
    assert re.search(rb"\x1b\[[\d;]*3[1-7]m", run("--count", "2").raw)
    assert not re.search(rb"\x1b\[[\d;]*[34][0-7]m", run("--count", "2", NO_COLOR="1").raw)


def test_a_terminal_that_moves_no_cursor_gets_plain_text(loop: StandIn) -> None:
    one = Run(command(loop.directory, "--count", "1"), 80, 24, TERM="dumb")
    assert one.end() == 0
    one.close()
    assert b"\x1b" not in one.raw
    assert one.raw.count(b"joint_5 ") == 1


def test_a_daemon_that_restarts_is_waited_for(tmp_path: Path) -> None:
    first = StandIn(tmp_path)
    one = Run(command(tmp_path, "--rate", "20"), 100, 30)
    stream = subprocess.Popen(
        command(tmp_path, "--json", "--topics", "state,status", "--rate", "10"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    lines = Lines(stream)
    try:
        one.until(whole)
        lines.until(lambda got: {json.loads(line)["topic"] for line in got} == {"state", "status"})
        first.close()
        one.until(lambda screen: re.match(r"!! no daemon since [1-9]\d* s;", screen.lines[1]))
        for name in ("control", "observe"):
            (tmp_path / f"{name}.sock").unlink()
        second = StandIn(tmp_path)
        before = len(lines.got)
        one.until(lambda screen: whole(screen) and not any("no daemon" in line for line in screen.lines))
        lines.until(lambda got: len(got) > before)
        assert one.end(signal.SIGTERM) == 143
        stream.terminate()
        _, complaint = stream.communicate(timeout=10.0)
        assert complaint.count(b"waiting for the next daemon") == 1
        second.close()
    finally:
        one.close()
        stream.kill()
        stream.wait()


class Lines:
    """Lines that a program prints, read by a thread."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self.got: list[bytes] = []
        assert process.stdout is not None
        self._from = process.stdout
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self._from:
            self.got.append(line)

    def until(self, wanted: Callable[[list[bytes]], bool], seconds: float = 15.0) -> None:
        end = time.monotonic() + seconds
        while not wanted(list(self.got)):
            assert time.monotonic() < end, self.got[-3:]
            time.sleep(0.02)


def test_an_invalid_monitor_option_exits_with_two(loop: StandIn) -> None:
    for arguments in (["--rate", "0"], ["--rate", "nan"], ["--count", "0"]):
        done = subprocess.run(
            command(loop.directory, *arguments), capture_output=True, text=True, timeout=20.0
        )
        assert (done.returncode, done.stdout) == (2, "")
        assert "must be positive" in done.stderr


def test_while_the_terminal_stands_still_no_news_are_lost(run: Callable[..., Run]) -> None:
    """650 kB a second come; what nobody took of more than half a second's would have been dropped."""
    one = run("--rate", "100")
    one.type("\x13")  # Ctrl-S
    one.watch(0.2)
    before = one.raw.count(FRAME)
    one.watch(1.5)
    assert one.raw.count(FRAME) == before
    one.type("\x11")
    one.watch(0.5)
    assert one.raw.count(FRAME) > before
    assert not any("news lost" in line for line in one.screen.lines)


def test_messages_are_collected_while_nothing_is_drawn(loop: StandIn) -> None:
    feed = MonitorFeed(lambda: Client(loop.directory, name="observe"), rate=100.0)
    try:
        end = time.monotonic() + 10.0
        while not feed.watched.is_complete:
            assert time.monotonic() < end
            time.sleep(0.01)
        before = feed.watched.count
        end = time.monotonic() + 3.0
        while feed.watched.count - before < 150:
            assert time.monotonic() < end, feed.watched.count - before
            time.sleep(0.1)
        assert feed.watched.view(time.monotonic()).lost == 0
    finally:
        feed.close()
