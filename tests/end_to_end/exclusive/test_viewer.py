"""`twindctl view` in a real browser: it stops a robot, its tab holds the lease, its end moves nothing."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import browser, missing, opened
from tests.support.processes import Daemon, Moving, arm, daemon, rearm, robot, simulated, until
from tests.support.viewer_process import TRIES, WAIT, press, viewing
from twind.observe.viewing.operator_lease import ANSWER

pytestmark = [pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")]


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


def swing(place: float) -> dict[str, Any]:
    """A motion that lasts longer than a press takes to arrive."""
    point = {"positions": [place], "velocities": [0.0], "time_from_start": 12.0}
    return {"joint_names": ["l_shoulder_roll"], "points": [point]}


def stopped(running: Daemon, page: Any) -> str:
    """End of a motion when Stop is pressed while it runs; repeated where a busy machine ended it before.

    A press that arrives late cancels the next motion, which shows the same.
    """
    last = ""
    for at in range(TRIES):
        until(lambda: running.status()["lease"] is None, 5.0, "who armed or moved it is done")
        if running.status()["faults"]:
            with running.client() as client:
                client.call("AcquireLease")
                rearm(client)
        moving = Moving(running, swing(float(at % 2 == 0)))
        until(lambda moving=moving: running.status()["motion"] == "active" or moving.last, 10.0, "it moves")
        press(page, "Stop")
        moving.join(10.0)
        last = moving.last
        if last == "cancelled":
            break
        print(f"pressed again: the motion was {last}")
    return last


def libraries(process: int) -> list[str]:
    """GL library that a process has loaded."""
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
        with viewing(running.sockets) as (view, url), running.client() as operator:
            page = opened(chromium, url, looked_at=False)
            assert page.get_by_text("Take the lease").count() == 0  # without --operate there is none
            arm(operator)
            assert stopped(running, page) == "cancelled"
            page.get_by_text("the motion comes to a hold").first.wait_for(timeout=WAIT)

            press(page, "E-STOP")
            page.get_by_text("state estop").first.wait_for(timeout=WAIT)
            assert running.status()["state"] == "estop"

            view.kill()
            before = running.status()
            ticks = before["loop"]["ticks"] + 30
            until(lambda: running.status()["loop"]["ticks"] > ticks, 10.0, "the loop goes on")
            assert running.status()["state"] == "estop" and running.process.poll() is None
            page.close()


@pytest.fixture(scope="module")
def simulation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with simulated(tmp_path_factory.mktemp("run")) as running:
        yield running


def held(page: Any, running: Daemon, seconds: float) -> bool:
    """A motion runs, and the lease is held so long. Taken anew where a busy machine was too slow."""
    page.locator("[data-twind-row]").first.wait_for(timeout=WAIT)  # the robot and its motions are known
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


def test_the_tab_that_took_the_lease_moves_the_robot_until_it_is_closed(
    chromium: Any, simulation: Daemon
) -> None:
    with viewing(simulation.sockets, "--operate") as (view, url):
        page = opened(chromium, url, looked_at=False)
        assert page.get_by_role("button", name="Play", exact=True).is_disabled()
        assert simulation.status()["lease"] is None
        assert held(page, simulation, ANSWER + 1.0)  # longer than a lease lasts, and a page may be silent
        page.close()
        until(lambda: simulation.status()["lease"] is None, 3.0, "the lease of a closed tab")
        until(lambda: simulation.status()["motion"] == "holding", 3.0, "its motion")

        page = opened(chromium, url, looked_at=False)
        assert held(page, simulation, 0.0)
        view.kill()
        until(lambda: simulation.status()["lease"] is None, 3.0, "the lease of a killed viewer lapses")
        until(lambda: simulation.status()["motion"] == "holding", 3.0, "its motion")
        page.close()
