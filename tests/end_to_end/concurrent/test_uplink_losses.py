"""Loss of router, link, sender, uplink or daemon. The motion is released, the loop never waits, and the
uplink reconnects.
"""

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import pytest

from tests.support.processes import Daemon, until
from tests.support.uplink_rig import (
    JOINT,
    PATIENCE,
    Far,
    NetworkConfig,
    Site,
    Uplink,
    ended,
    phases,
    site,
    up,
)
from twind.client import Client, ClientError

Brief = Callable[[Uplink], Uplink]
LONG = 20.0  # s of a motion that somebody has to let go
LET_GO = 3.0  # s after a fault until the motion is let go: a lease lasts 1, and this machine is busy


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory, blank_messages: None) -> Iterator[Site]:
    with site(tmp_path_factory.mktemp("site")) as made:
        yield made


@pytest.fixture(scope="module")
def quiet(here: Site) -> tuple[int, int]:
    """Ticks missed, and ticks, in a second without a motion."""
    before = status(here)["loop"]
    time.sleep(1.0)
    return missed(before, status(here)["loop"])


@pytest.fixture(autouse=True)
def at_rest(here: Site) -> Iterator[None]:
    """Each begins with a robot that is there and that nobody has; and leaves it so."""
    until(here.far.there, PATIENCE, f"the robot is there: {here.uplink.output}")
    until(lambda: free(here), PATIENCE, "nobody has it")
    yield
    here.far.deaf()


@pytest.fixture
def brief() -> Iterator[Brief]:
    """For uplinks that end with the test."""
    with ended() as one:
        yield one


def status(here: Site) -> dict[str, Any]:
    """As somebody beside the robot sees it."""
    return here.daemon.status()


def free(here: Site) -> bool:
    with suppress(ClientError):
        return status(here)["lease"] is None and status(here)["motion"] != "active"
    return False


class Watched:
    """Ends of motions as the daemon tells them beside the robot, and the ticks that were missed."""

    def __init__(self, here: Site, quiet: tuple[int, int]) -> None:
        """`quiet`: ticks missed and ticks while nothing moved: how busy this machine is anyway."""
        self._here = here
        self._quiet = quiet
        self._client = Client(here.daemon.sockets, name="observe", timeout=PATIENCE)
        self._ends: list[tuple[float, str]] = []  # s, monotonic; phase
        self._thread = threading.Thread(target=self._follow)
        self._thread.start()

    def _follow(self) -> None:
        with suppress(ClientError):
            for said in self._client.stream("Monitor", topics=["events"]):
                if said.get("topic") == "events" and said["event"]["code"] == "MOTION":
                    self._ends.append((said["time"], said["event"]["phase"]))

    def check_let_go(self, before: dict[str, Any], fault: float) -> None:
        """The motion ends within LET_GO of the fault, s, monotonic; the lease is free, the loop went on."""
        after = until(lambda: status(self._here) if free(self._here) else None, LONG, "it is let go")
        until(lambda: self._ends, PATIENCE, "its end is told")
        self._client.cut()
        self._thread.join(PATIENCE)
        (ended_at, phase), (late, ticks) = self._ends[0], missed(before["loop"], after["loop"])
        print(
            f"{phase} after {ended_at - fault:.2f} s; {late} of {ticks} ticks missed, before: {self._quiet}"
        )
        assert phase == "aborted" and ended_at - fault < LET_GO
        assert after["motion"] == "holding"
        usual = self._quiet[0] / self._quiet[1]
        assert late <= (0.1 + 2.0 * usual) * ticks, "who waits for a second misses a hundred"


def missed(before: dict[str, Any], after: dict[str, Any]) -> tuple[int, int]:
    """Ticks missed between two looks at the loop, and ticks."""
    return after["missed"] - before["missed"], after["ticks"] - before["ticks"]


def moving(here: Site) -> dict[str, Any]:
    """A motion of LONG under way; the status that says so. Nobody renews its lease."""
    lease = until(lambda: here.far.lease().get("lease"), PATIENCE, "a lease")
    there = 0.6 if here.far.knee() < 0.3 else 0.0
    assert here.far.goal(f"g{time.monotonic_ns()}", lease, there, LONG)["phase"] == "accepted"
    found = status(here)
    assert found["motion"] == "active" and found["lease"] is not None
    return found


def alive_again(here: Site) -> None:
    """It is found again, and commanded."""
    until(here.far.there, PATIENCE, f"it is back: {here.uplink.output}")
    told = here.far.listen("goals", "*")
    with here.far.holding() as lease:
        name = f"again{time.monotonic_ns()}"
        asked = here.far.goal(name, lease, here.far.knee() + 0.05, 0.5)
        assert asked["phase"] == "accepted", asked
        until(lambda: phases(told)[-1:] == ["succeeded"], PATIENCE, f"it moves again: {told}")


def test_a_dead_router_ends_the_goal_and_the_next_router_finds_the_robot(
    here: Site, quiet: tuple[int, int]
) -> None:
    heard = here.far.listen("state", "10")
    until(lambda: heard, PATIENCE, "the state")
    watched = Watched(here, quiet)
    before = moving(here)
    fault = time.monotonic()
    here.router.kill()
    watched.check_let_go(before, fault)
    here.router.start()
    count = len(heard)
    alive_again(here)
    until(lambda: len(heard) > count + 3, PATIENCE, "the state is told again")


def test_a_link_that_freezes_holds_up_nothing_and_the_goal_lapses(here: Site, quiet: tuple[int, int]) -> None:
    heard = here.far.listen("state", "full")
    until(lambda: heard, PATIENCE, "the state")
    watched = Watched(here, quiet)
    before = moving(here)
    fault = time.monotonic()
    here.router.signal(signal.SIGSTOP)
    try:
        watched.check_let_go(before, fault)
    finally:
        here.router.signal(signal.SIGCONT)
    alive_again(here)


def test_a_killed_sender_releases_the_motion(here: Site, quiet: tuple[int, int]) -> None:
    watched = Watched(here, quiet)
    words = ["--remote", "robot", "move", f"{JOINT}={here.far.knee() + 0.5}", "--time", str(LONG)]
    sender = subprocess.Popen(
        [sys.executable, "-m", "twind.ctl.ctl_main", *words],
        env=os.environ | {"TWIND_ZENOH": here.router.endpoint},
    )
    try:
        before = until(
            lambda: found if (found := status(here))["motion"] == "active" else None, PATIENCE, "it moves"
        )
        time.sleep(1.5)
        assert status(here)["motion"] == "active", "longer than a lease that nobody renews"
    finally:
        fault = time.monotonic()
        sender.kill()
        sender.wait(PATIENCE)
    watched.check_let_go(before, fault)


def test_a_goal_that_waits_while_the_robot_is_stopped_does_not_begin_after_the_stop(here: Site) -> None:
    names = [each["name"] for each in here.far.ask("ask", "GetRobot")["robot"]["joints"]]
    small = [0.02 * math.sin(math.pi * i / 2000) ** 2 for i in range(1, 2001)]
    points = [
        {"positions": [each] * len(names), "time_from_start": 0.03 * number}
        for number, each in enumerate(small, 1)
    ]
    there = 0.6 if here.far.knee() < 0.3 else 0.0
    with here.far.holding() as lease, ThreadPoolExecutor() as senders:
        senders.submit(here.far.goal, "judged", lease, 0.0, 1.0, joint_names=names, points=points)
        time.sleep(0.1)  # that is long for a gate
        senders.submit(here.far.goal, "waits", lease, there, 6.0)
        time.sleep(0.2)
        assert here.far.ask("stop", "Cancel")["state"] == "disconnected"
        begun = time.monotonic()
        while time.monotonic() - begun < 2.0:
            assert status(here)["motion"] != "active", "nobody asked for anything after the stop"
            time.sleep(0.05)


def test_a_stopped_uplink_process_releases_the_motion(here: Site, quiet: tuple[int, int]) -> None:
    watched = Watched(here, quiet)
    before = moving(here)
    fault = time.monotonic()
    here.uplink.process.send_signal(signal.SIGSTOP)
    try:
        watched.check_let_go(before, fault)
    finally:
        here.uplink.process.send_signal(signal.SIGCONT)
    alive_again(here)


def test_a_lease_that_is_taken_beside_the_robot_is_gone_afar(here: Site) -> None:
    told = here.far.listen("goals", "mine")
    with here.far.holding() as lease:
        assert here.far.goal("mine", lease, here.far.knee() + 0.3, LONG)["phase"] == "accepted"
        with here.daemon.client() as client:
            client.call("AcquireLease", take=True)
            until(lambda: phases(told)[-1:] == ["aborted"], PATIENCE, f"it ends: {told}")
            refused = until(
                lambda: here.far.ask("lease", op="renew", lease=lease).get("error"), PATIENCE, "it is gone"
            )
            assert refused.endswith("Refused")


def test_a_daemon_that_restarts_is_waited_for_and_what_was_granted_before_is_void(here: Site) -> None:
    told = here.far.listen("goals", "before")
    lease = here.far.lease()["lease"]
    here.far.goal("before", lease, here.far.knee() + 0.4, LONG)
    here.daemon.end(signal.SIGKILL)
    gone = here.far.ask("ask", "GetStatus")
    assert gone["error"] == "io.twind.Uplink.NoDaemon" and "no daemon" in gone["parameters"]["message"]
    until(lambda: phases(told)[-1:] == ["aborted"], PATIENCE, f"nobody moves it any more: {told}")
    assert here.far.there(), "the uplink is alive, and says so"
    here.daemon = Daemon(here.daemon.sockets, "--mode", "sim")
    here.daemon.reach(mode="sim")
    assert here.far.goal("after", lease, 0.1, 1.0)["error"].endswith("Refused")
    alive_again(here)
    said = here.uplink.output
    assert said.count("waiting for the daemon") == said.count("the daemon is there again") == 1, said


def test_an_uplink_ends_on_sigterm_though_router_and_daemon_hang(here: Site, brief: Brief) -> None:
    other = brief(Uplink(here.daemon.sockets, "--connect", here.router.endpoint, "--name", "other"))
    elsewhere = Far(NetworkConfig(connect=(here.router.endpoint,)), "other")
    up(elsewhere, other)
    here.router.signal(signal.SIGSTOP)
    here.daemon.process.send_signal(signal.SIGSTOP)
    os.kill(here.daemon.front(), signal.SIGSTOP)
    try:
        begun = time.monotonic()
        code, out = other.end()
        took = time.monotonic() - begun
    finally:
        os.kill(here.daemon.front(), signal.SIGCONT)
        here.daemon.process.send_signal(signal.SIGCONT)
        here.router.signal(signal.SIGCONT)
    elsewhere.close()
    print(f"ended within {took:.2f} s")
    assert code == 0 and json.loads(out)["robot"] == "other"
    assert took < 10.0


def test_two_uplinks_of_one_name_leave_one_that_runs_and_one_that_exits(here: Site, brief: Brief) -> None:
    twins = [
        brief(Uplink(here.daemon.sockets, "--connect", here.router.endpoint, "--name", "twin"))
        for _ in range(2)
    ]
    over = until(
        lambda: next((twin for twin in twins if twin.process.poll() is not None), None), PATIENCE, "one ends"
    )
    assert over.process.returncode == 1
    out, _ = over.process.communicate()
    assert "'twin' is alive on this network already" in json.loads(out)["parameters"]["message"]
    other = twins[1 - twins.index(over)]
    elsewhere = Far(NetworkConfig(connect=(here.router.endpoint,)), "twin")
    up(elsewhere, other)
    time.sleep(1.0)
    assert other.process.poll() is None, "and one stays"
    elsewhere.close()
