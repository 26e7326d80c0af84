"""`twindctl fleet --view`: a robot here and one elsewhere on one page, in a real browser. Who is stopped, who
is lost, who comes back."""

import contextlib
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from tests.support.browser import browser, missing, opened
from tests.support.processes import Daemon, Moving, go, simulated, twindctl, until
from tests.support.zenoh_router import Router

pytestmark = [pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")]
HERE = "h24-split"
WAIT = 60_000  # ms that a busy machine may be behind
SLOWLY = {"joint_names": ["l_shoulder_roll"], "points": [{"positions": [1.0], "time_from_start": 40.0}]}
BACK = {"joint_names": ["l_shoulder_roll"], "points": [{"positions": [0.0], "time_from_start": 1.0}]}
TRIES = 5  # of motions that a busy machine ends


@dataclass
class World:
    """`here` is found by its sockets, `far` by its uplink alone."""

    here: Daemon
    far: Daemon
    router: Router
    uplink: subprocess.Popen[str]
    viewer: subprocess.Popen[str]
    page: Any

    def press(self, name: str) -> None:
        """As an event: a pointer waits until a page stands still."""
        self.page.get_by_role("button", name=name, exact=True).dispatch_event("click", timeout=WAIT)

    def reads(self, text: str) -> None:
        """Wait until the page says so."""
        self.page.get_by_text(text).first.wait_for(timeout=WAIT)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "twind").mkdir()
    with contextlib.ExitStack() as stack:
        router = stack.enter_context(Router())
        here = stack.enter_context(simulated(folder / "twind" / "here", HERE))
        far = stack.enter_context(simulated(folder / "far", "h24"))
        joined = ("--connect", router.endpoint)
        socket = ("--socket", str(far.sockets))
        uplink = stack.enter_context(twindctl(*socket, "uplink", "--name", "elsewhere", *joined))
        shown = (HERE, "elsewhere")  # of this machine's other robots none
        view = twindctl("fleet", *shown, "--view", *joined, XDG_RUNTIME_DIR=str(folder))
        viewer = stack.enter_context(view)
        assert viewer.stdout is not None
        url = viewer.stdout.readline().split()[1]
        found = stack.enter_context(browser())
        page = opened(found, url, looked_at=False, shows="E-STOP elsewhere")
        yield World(here, far, router, uplink, viewer, page)


def test_a_stop_button_press_stops_every_moving_robot_local_and_remote(world: World) -> None:
    for _ in range(TRIES):
        both = []
        for daemon in (world.here, world.far):
            with daemon.client() as client:
                go(client, BACK)
            until(lambda daemon=daemon: daemon.status()["lease"] is None, 5.0, "who moved it is done")
            both.append(Moving(daemon, SLOWLY))
        until(lambda both=both: all(each.last for each in both), 10.0, "both move")
        world.press("Stop all robots")
        for each in both:
            each.join(20.0)
        ends = [each.last for each in both]
        if ends == ["cancelled", "cancelled"]:
            world.reads("stop: 2 of 2 robots")
            return
        print(f"moved and pressed again: {ends}")  # a busy machine ended one
    raise AssertionError(ends)


def test_an_estop_stops_the_robot_that_it_names_and_no_other(world: World) -> None:
    world.press("E-STOP elsewhere")
    world.reads("1 e-stop, 1 well")
    assert world.far.status()["state"] == "estop"
    assert world.here.status()["state"] != "estop"
    with world.far.client() as client:
        client.call("Reset")


def test_an_unreachable_robot_is_lost_until_it_returns_and_delays_no_e_stop(world: World) -> None:
    world.router.kill()
    world.reads("1 lost, 1 well")
    world.press("E-STOP all robots")
    world.reads("e-stop: 1 of 2 robots")
    world.reads("use its own switch")
    assert world.here.status()["state"] == "estop"
    world.router.start()
    world.reads("1 e-stop, 1 well")
    assert world.far.status()["state"] != "estop"  # what failed is not done later
    world.uplink.terminate()
    world.reads("1 e-stop, 1 lost")
    assert world.far.status()["motion"] == "holding"


def test_the_page_contacts_only_its_own_server_and_the_server_ends_on_sigterm(world: World) -> None:
    port = world.page.url.split("/")[2]
    own = (f"http://{port}/", f"ws://{port}/", f"blob:http://{port}/", "data:")
    assert len(world.page.asked) >= 2
    assert [url for url in world.page.asked if not url.startswith(own)] == []
    world.viewer.terminate()
    assert world.viewer.wait(10.0) == 0
