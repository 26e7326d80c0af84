"""`twindctl view` beside real daemons, in a real browser: who stops the robot, who moves it, who is gone."""

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import browser, missing, opened
from tests.support.processes import Daemon, Moving, arm, daemon, go, robot, simulated, until
from twind.observe.viewing.operator_lease import ANSWER

pytestmark = [pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")]
LONG = {
    "joint_names": ["l_shoulder_roll"],
    "points": [{"positions": [1.0], "velocities": [0.0], "time_from_start": 12.0}],
}
HOME = {"joint_names": ["l_shoulder_roll"], "points": [{"positions": [0.0], "time_from_start": 2.0}]}
WAIT = 60_000  # ms that a busy machine may be behind
TRIES = 5  # of a motion that a busy machine ends


class Viewing:
    """A `twindctl view` that runs, and its address."""

    def __init__(self, folder: Path, *options: str) -> None:
        command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(folder), "view", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE)
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().decode().split()[1]

    def end(self, number: int = signal.SIGTERM) -> int:
        self.process.send_signal(number)
        code = self.process.wait(10.0)
        assert self.process.stdout is not None
        self.process.stdout.close()
        return code


@contextlib.contextmanager
def viewing(folder: Path, *options: str) -> Iterator[Viewing]:
    view = Viewing(folder, *options)
    try:
        yield view
    finally:
        if view.process.poll() is None:
            view.end(signal.SIGKILL)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


def press(page: Any, name: str) -> None:
    """As an event: a pointer waits until a page stands still, which takes long without a graphics card."""
    page.get_by_role("button", name=name, exact=True).dispatch_event("click", timeout=WAIT)


def stopped(running: Daemon, page: Any) -> str:
    """How a motion ends when Stop is pressed while it runs; anew where a busy machine ended it before."""
    moving = None
    for _ in range(TRIES):
        until(lambda: running.status()["lease"] is None, 5.0, "who armed or moved it is done")
        if moving is not None:
            with running.client() as client:
                go(client, HOME)
        moving = Moving(running, LONG)
        until(lambda moving=moving: running.status()["motion"] == "active" or moving.last, 10.0, "it moves")
        press(page, "Stop")
        moving.join(10.0)
        if moving.last == "cancelled":
            break
        print(f"pressed again: the motion was {moving.last}")
    return "" if moving is None else moving.last


def libraries(process: int) -> list[str]:
    """What GL there is in a process."""
    maps = Path(f"/proc/{process}/maps").read_text().lower()
    return [name for name in ("glfw", "libgl", "libegl", "osmesa") if name in maps]


def test_stop_stops_estop_stops_and_a_killed_viewer_changes_nothing(chromium: Any) -> None:
    with robot() as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        assert [libraries(each) for each in (running.process.pid, running.front(), virtual.process.pid)] == [
            [],
            [],
            [],
        ]
        with viewing(running.sockets) as view, running.client() as operator:
            page = opened(chromium, view.url, looked_at=False)
            assert page.get_by_text("Take the lease").count() == 0  # without --operate there is none
            arm(operator)
            assert stopped(running, page) == "cancelled"
            page.get_by_text("the motion comes to a hold").first.wait_for(timeout=WAIT)

            press(page, "E-STOP")
            page.get_by_text("state estop").first.wait_for(timeout=WAIT)
            assert running.status()["state"] == "estop"

            view.end(signal.SIGKILL)
            before = running.status()
            time.sleep(0.5)
            after = running.status()
            assert after["loop"]["ticks"] > before["loop"]["ticks"] + 30
            assert after["state"] == "estop" and running.process.poll() is None
            page.close()


def test_the_tab_that_took_the_lease_moves_the_robot_until_it_is_closed(
    chromium: Any, tmp_path: Path
) -> None:
    with simulated(tmp_path) as running, viewing(running.sockets, "--operate") as view:
        page = opened(chromium, view.url, looked_at=False)
        assert page.get_by_role("button", name="Play", exact=True).is_disabled()
        assert running.status()["lease"] is None
        assert held(page, running, ANSWER + 1.0)  # longer than a lease lasts, and a page may be silent
        page.close()
        until(lambda: running.status()["lease"] is None, 3.0, "the lease of a tab that is closed")
        until(lambda: running.status()["motion"] == "holding", 3.0, "its motion")

        page = opened(chromium, view.url, looked_at=False)
        assert held(page, running, 0.0)
        view.end(signal.SIGKILL)
        until(lambda: running.status()["lease"] is None, 3.0, "the lease of a killed viewer lapses")
        until(lambda: running.status()["motion"] == "holding", 3.0, "its motion")
        page.close()


def held(page: Any, running: Daemon, seconds: float) -> bool:
    """A motion runs, and the lease is held so long. Taken anew where a busy machine was too slow."""
    for _ in range(TRIES):
        take = page.get_by_role("button", name="Take the lease ...", exact=True)
        until(lambda take=take: take.is_enabled(), 30.0, "the lease may be taken")
        press(page, "Take the lease ...")
        press(page, "Take it")
        until(lambda: running.status()["lease"], 30.0, "the lease")
        play = page.get_by_role("button", name="Play", exact=True)
        until(lambda play=play: play.is_enabled() or not running.status()["lease"], 30.0, "the page may play")
        press(page, "Play")
        with contextlib.suppress(AssertionError):
            until(lambda: running.status()["motion"] == "active", 5.0, "the motion that was played")
            end = time.monotonic() + seconds
            while time.monotonic() < end and running.status()["lease"]:
                time.sleep(0.1)
            if running.status()["lease"]:
                return True
        print("taken again")
    return False


def test_the_page_outlives_the_daemon_and_shows_the_next_ones_robot(chromium: Any, tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(simulated(tmp_path))
        view = stack.enter_context(viewing(first.sockets))
        page = opened(chromium, view.url, looked_at=False)
        page.get_by_text("h24, mode sim").wait_for(timeout=WAIT)
        first.end(signal.SIGKILL)
        page.get_by_text("the daemon is not there, tried again").wait_for(timeout=WAIT)
        press(page, "E-STOP")
        page.get_by_text("use its own switch").wait_for(timeout=WAIT)
        stack.enter_context(simulated(tmp_path, "h24-split"))
        page.get_by_text("h24-split, mode sim").wait_for(timeout=WAIT)
        assert view.end() == 0
        page.close()


def test_without_a_daemon_there_is_nothing_to_show(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(tmp_path), "view"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30.0, check=False)
    assert done.returncode == 3
    assert "no daemon" in done.stderr
