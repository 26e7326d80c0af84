"""`twindctl fleet`: a robot here, one elsewhere, a router between; who goes, who hangs, who comes back."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

from tests.support.processes import Daemon, simulated, until
from tests.support.pty_screen import Run
from tests.support.stream_rig import Process, ctl
from tests.support.zenoh_router import Router
from twind.bridge.zenoh.zenoh_session import NetworkConfig, open_now

PATIENCE = 30.0  # s that a busy machine may take
HERE = "h24-split"
FAR = "elsewhere"
OTHER = "another"


@dataclass
class World:
    """`here` is found by its sockets, `far` by its uplink alone."""

    folder: Path
    here: Daemon
    far: Daemon
    router: Router
    uplink: Process

    def words(self, *words: str) -> list[str]:
        return ["fleet", "--connect", self.router.endpoint, HERE, FAR, *words]

    def list(self, *words: str) -> subprocess.CompletedProcess[str]:
        """One list of both robots; of this machine's others none."""
        command = ctl(*self.words(*words))
        return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)

    def up(self) -> None:
        """The uplink, which outlives a test."""
        self.uplink = Process(
            "--socket", str(self.far.sockets), "uplink", "--name", FAR, "--connect", self.router.endpoint
        )
        Process.begun.remove(self.uplink)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "twind").mkdir()
    with contextlib.ExitStack() as stack:
        router = stack.enter_context(Router())
        here = stack.enter_context(simulated(folder / "twind" / "here", HERE))
        far = stack.enter_context(simulated(folder / "far"))
        stack.enter_context(pytest.MonkeyPatch.context()).setenv("XDG_RUNTIME_DIR", str(folder))
        made = World(folder, here, far, router, Process.__new__(Process))
        made.up()
        stack.callback(lambda: made.uplink.gone())
        until(lambda: FAR not in lost(made), PATIENCE, "the uplink is up")
        yield made


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    yield
    while Process.begun:
        Process.begun.pop().gone()


def robots(line: str) -> dict[str, dict[str, Any]]:
    """By name, of one list as JSON."""
    return {each["name"]: each for each in json.loads(line)["robots"]}


def lost(world: World) -> set[str]:
    return {name for name, each in robots(world.list("--json").stdout).items() if each["lost"]}


def test_local_and_remote_robots_are_in_one_list_as_text_and_as_json(world: World) -> None:
    told = robots(world.list("--json").stdout)
    assert [told[HERE]["where"], told[FAR]["where"]] == [str(world.here.sockets), "uplink"]
    for each in told.values():
        assert (each["lost"], each["mode"], each["heard"], each["joints"]) == (None, "sim", 24, 24)
        assert each["age_s"] < PATIENCE and each["way_ms"] > 0.0
    shown = world.list()
    head, far, here = shown.stdout.splitlines()
    assert shown.returncode == 0 and head.startswith("robot")
    assert far.split()[:3] == [FAR, "uplink", "sim"] and here.split()[:3] == [HERE, "here", "sim"]


def test_a_named_absent_robot_is_lost_and_an_absent_network_is_reported(world: World) -> None:
    done = world.list("nobody")
    assert done.returncode == 3 and "nobody: no robot of this name is present" in done.stdout
    elsewhere = ctl("fleet", HERE, "--connect", "tcp/127.0.0.1:1")
    done = subprocess.run(elsewhere, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 3 and HERE in done.stdout and "tcp/127.0.0.1:1" in done.stderr


def test_a_robot_that_disappears_stays_listed_as_lost_and_returns(world: World) -> None:
    watch = Process(*world.words("--watch"))

    def row_of(name: str) -> dict[str, Any]:
        return {each["name"]: each for each in watch.first()["robots"]}[name]

    until(lambda: not row_of(FAR)["lost"] and not row_of(HERE)["lost"], PATIENCE, "both are there")
    world.uplink.gone()
    until(lambda: row_of(FAR)["lost"], PATIENCE, "the one without an uplink is lost")
    was = row_of(FAR)
    assert (was["state"], was["mode"]) == ("disconnected", "sim") and was["age_s"] > 0.0
    assert not row_of(HERE)["lost"]
    world.up()
    until(lambda: not row_of(FAR)["lost"] and row_of(FAR)["age_s"] < 2.0, PATIENCE, "it is back")
    world.router.kill()
    until(lambda: row_of(FAR)["lost"], PATIENCE, "without a router nobody elsewhere is there")
    assert not row_of(HERE)["lost"]
    world.router.start()
    until(lambda: not row_of(FAR)["lost"], PATIENCE, "the way is found again")
    assert watch.end()[0] == 0


def test_a_hanging_robot_delays_no_list_and_its_age_grows(world: World) -> None:
    """Neither the one here nor another that is asked by the same question over the network."""
    words = ("uplink", "--name", OTHER, "--connect", world.router.endpoint)
    other = Process("--socket", str(world.here.sockets), *words)
    watch = Process(*world.words(OTHER, "--watch"))

    def ages() -> dict[str, float | None]:
        return {each["name"]: each["age_s"] for each in watch.first()["robots"]}

    until(lambda: all(age is not None for age in ages().values()), PATIENCE, "all are there")
    os.kill(world.uplink.pid, signal.SIGSTOP)
    try:
        until(lambda: (ages()[FAR] or 0.0) > 4.0, PATIENCE, "it says nothing")
        young = ages()
        assert (young[HERE] or 99.0) < 4.0 and (young[OTHER] or 99.0) < 4.0
        done = world.list(OTHER, "--json")  # one that is begun now
        now = robots(done.stdout)
        assert now[OTHER]["mode"] == "sim" and now[FAR]["age_s"] is None
        assert done.returncode == 3, "a robot that was named and does not answer is not well"
    finally:
        os.kill(world.uplink.pid, signal.SIGCONT)
    until(lambda: (ages()[FAR] or 99.0) < 2.0, PATIENCE, "it answers again")
    assert watch.end(signal.SIGINT)[0] == 0
    other.end()


def test_names_and_answers_that_no_robot_may_have_cost_the_others_nothing(world: World) -> None:
    with open_now(NetworkConfig(connect=(world.router.endpoint,)), PATIENCE) as session:
        for name, said in (("all robots", b"{}"), ("odd", b"[" * 100_000), ("odder", b'{"status": "well"}')):
            key = f"twind/{name}/ask/GetStatus"
            session.declare_queryable(key, partial(replied, key, said))
            session.liveliness().declare_token(f"twind/{name}/alive")
        done = subprocess.run(
            ctl("fleet", "--json", "--connect", world.router.endpoint),
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        told = robots(done.stdout)
    assert done.returncode == 0 and "left out" in done.stderr and "all robots" in done.stderr
    assert "all robots" not in told and told[FAR]["mode"] == "sim"
    assert "nested" in told["odd"]["odd"] and "status" in told["odder"]["odd"]


def replied(key: str, payload: bytes, query: zenoh.Query) -> None:
    query.reply(key, payload)


def test_on_a_terminal_it_is_drawn_over_and_a_key_ends_it(world: World) -> None:
    run = Run([sys.executable, "-m", "twind.ctl.ctl_main", *world.words("--watch")], 100, 12)
    run.until(lambda screen: any(line.startswith(FAR) and " sim " in line for line in screen.lines), PATIENCE)
    assert sum(line.startswith("robot") for line in run.screen.lines) == 1
    run.type("q")
    assert run.end() == 0
    assert run.screen.modes["1049"] is False and run.screen.modes["25"] is True


@pytest.mark.parametrize("words", [("--count", "3"), ("--watch", "--count", "0"), ("--port", "80")])
def test_incompatible_options_are_a_usage_error(words: tuple[str, ...]) -> None:
    done = subprocess.run(ctl("fleet", *words), capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 2 and words[-2] in done.stderr
