"""`twindctl --remote`: a simulated robot, its uplink and a router as processes; verbs as beside the robot."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import twind.robots
from tests.support.processes import Daemon, simulated, until
from tests.support.stream_rig import Process, ctl
from tests.support.zenoh_router import Router
from twind.bridge.fleet.remote_client import remote
from twind.client import Client, ClientError
from twind.command_line.extras import how_to_add

PATIENCE = 30.0  # s that a busy machine may take
NAME = "afar"
WAVE = Path(twind.robots.__path__[0]) / "motions" / "wave.json"


@dataclass
class World:
    """A robot, its uplink and the router between it and us."""

    daemon: Daemon
    router: Router
    uplink: Process

    @property
    def robot(self) -> str:
        return f"{NAME}@{self.router.endpoint}"

    def client(self) -> Client:
        return remote(self.robot)

    def joint(self, name: str) -> float:
        """rad, as the simulation has it, asked beside the robot."""
        with self.daemon.client() as client:
            joints = client.call("GetStatus", joints=True)["joints"]
        return next(float(each["position"]) for each in joints if each["name"] == name)

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ctl("--remote", self.robot, *words), capture_output=True, text=True, timeout=PATIENCE
        )


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    with simulated(tmp_path_factory.mktemp("run")) as daemon, Router() as router:
        made = World(daemon, router, up(daemon, router))
        until(lambda: there(made), PATIENCE, "the robot is up")
        yield made
        made.uplink.gone()


def up(daemon: Daemon, router: Router) -> Process:
    words = ("--socket", str(daemon.sockets), "uplink", "--name", NAME, "--connect", router.endpoint)
    uplink = Process(*words)
    Process.begun.remove(uplink)  # it outlives a test
    return uplink


def there(world: World) -> bool:
    try:
        with world.client() as client:
            client.call("GetStatus")
    except ClientError:
        return False
    return True


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    yield
    while Process.begun:
        Process.begun.pop().gone()


def test_questions_have_the_answers_that_they_have_beside_the_robot(world: World) -> None:
    status = json.loads(world.run("--json", "status", "--joints").stdout)
    with world.daemon.client() as client:
        beside: dict[str, Any] = client.call("GetStatus", joints=True)
        robot = client.call("GetRobot")
    assert status["status"].keys() == beside["status"].keys()
    assert [each["name"] for each in status["joints"]] == [each["name"] for each in beside["joints"]]
    assert world.run("mode").stdout == "sim\n"
    with world.client() as far:
        assert far.call("GetRobot") == robot
    checked = world.run("check", "trajectory", str(WAVE))
    assert checked.stdout.splitlines()[-1] in ("accepted", "refused")


@pytest.mark.parametrize("words", [("play", "wave"), ("check", "trajectory", "wave")])
def test_the_name_of_a_motion_of_another_disk_plays_nothing_of_ours(
    world: World, words: tuple[str, ...]
) -> None:
    done = world.run(*words)
    assert done.returncode == 2 and "with --remote a file, as ./wave.json" in done.stderr
    assert world.daemon.status()["motion"] == "holding"


def test_the_monitor_and_the_watch_show_news_from_afar(world: World) -> None:
    lines = world.run("--json", "monitor", "--rate", "10", "--count", "8").stdout.splitlines()
    states = [json.loads(line) for line in lines]
    steps = [later["sequence"] - earlier["sequence"] for earlier, later in pairwise(states)]
    assert {each["topic"] for each in states} == {"state"} and len(states[0]["joints"]) == 24
    assert all(step >= 8 for step in steps), steps
    picture = world.run("monitor", "--count", "2").stdout
    assert "SIM" in picture and "l_knee" in picture and "loop " in picture
    watch = Process("--remote", world.robot, "watch", "--count", "1")
    # A subscription takes its time to get there: marks are made until one was heard.
    deadline = time.monotonic() + PATIENCE
    while watch.running and time.monotonic() < deadline:
        with world.daemon.client() as client:
            client.call("Mark", kind="note", text="seen from afar")
        time.sleep(0.1)
    code, said, _ = watch.end()
    told = [json.loads(line) for line in said.splitlines()]
    assert code == 0 and told[0]["event"]["code"] == "NOTE"


def test_a_goal_moves_the_robot_and_a_refusal_has_its_findings(world: World) -> None:
    done = world.run("--json", "move", "l_knee=0.3", "--time", "1.0")
    reports = [json.loads(line) for line in done.stdout.splitlines()]
    assert (done.returncode, reports[0]["phase"], reports[-1]["phase"]) == (0, "accepted", "succeeded")
    shares = [each["progress"] for each in reports]
    assert shares == sorted(shares) and len(shares) > 3
    assert abs(world.joint("l_knee") - 0.3) < 0.05
    refused = world.run("move", "l_knee=9")
    assert refused.returncode == 1 and "POS_LIMIT: l_knee" in refused.stderr
    assert abs(world.joint("l_knee") - 0.3) < 0.05


def test_commands_not_allowed_remotely_are_refused_and_a_mode_query_works(world: World) -> None:
    for words, said in (
        (("arm",), "arm: not with --remote"),
        (("doctor",), "doctor: not with --remote"),
        (("mode", "mirror"), "SetMode: not for remote clients"),
        (("parameters", "log_level=debug"), "SetParameters: not for remote clients"),
        (("check", "robot", "h24"), "leave out --remote"),
        (("status", "--socket", "/tmp"), "one robot at a time"),
    ):
        done = world.run(*words)
        assert done.returncode == 2 and said in done.stderr, (words, done.stderr)
    assert world.run("mode").stdout == "sim\n"


def test_an_absent_robot_and_an_absent_network_exit_as_no_daemon() -> None:
    for robot, said in (("afar@tcp/127.0.0.1:1", "named by --remote"), ("a b", "must be 1 to 64")):
        done = subprocess.run(
            ctl("--remote", robot, "status"), capture_output=True, text=True, timeout=PATIENCE
        )
        assert (done.returncode, said in done.stderr) == (3 if "@" in robot else 2, True), done.stderr


@pytest.mark.parametrize("words", [("--remote", "afar", "status"), ("--remote", "afar@", "status")])
def test_without_zenoh_or_an_address_the_error_gives_the_remedy(words: tuple[str, ...]) -> None:
    code = (
        "import sys; sys.modules['zenoh'] = None; from twind.ctl.ctl_main import main; "
        f"sys.exit(main({words!r}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE)
    said = "ROBOT@tcp/HOST:PORT" if words[1].endswith("@") else how_to_add("zenoh")
    assert done.returncode == 2 and said in done.stderr, done.stderr


def moving(world: World, *words: str) -> Process:
    """A long motion from afar that runs."""
    far = 1.2 if world.joint("l_knee") < 0.6 else 0.1
    mover = Process("--remote", world.robot, "move", f"l_knee={far}", "--time", "8", *words)
    while mover.first()["phase"] != "running":
        pass
    return mover


def holds(world: World) -> bool:
    return bool(world.daemon.status()["motion"] == "holding")


def test_ctrl_c_cancels_and_the_robot_holds(world: World) -> None:
    mover = moving(world)
    code, said, _ = mover.end(signal.SIGINT)
    assert code == 130 and json.loads(said.splitlines()[-1])["phase"] == "cancelled"
    until(lambda: holds(world), PATIENCE, "it holds")


def test_a_stop_from_anywhere_ends_what_was_sent_from_afar(world: World) -> None:
    mover = moving(world)
    assert world.run("stop").returncode == 0
    code, said, _ = mover.end(0)
    assert code == 1 and json.loads(said.splitlines()[-1])["phase"] == "cancelled"


def test_a_second_sender_waits_or_takes_the_lease_and_the_first_receives_the_end(world: World) -> None:
    mover = moving(world)
    refused = world.run("move", "l_knee=0.4")
    assert refused.returncode == 1 and "the lease is held by" in refused.stderr
    taken = world.run("--json", "move", "r_knee=0.2", "--time", "1", "--take")
    assert taken.returncode == 0, taken.stderr
    code, said, _ = mover.end(0)
    assert code == 1 and json.loads(said.splitlines()[-1])["phase"] in ("aborted", "cancelled", "replaced")


def test_a_remote_e_stop_latches_until_a_local_reset(world: World) -> None:
    done = world.run("--json", "estop", "--reason", "seen from afar")
    assert done.returncode == 0 and json.loads(done.stdout)["state"] == "estop"
    assert world.daemon.status()["state"] == "estop"
    assert world.run("move", "l_knee=0.3").returncode == 1
    with world.daemon.client() as client:
        client.call("Reset")


def test_a_monitor_outlives_the_uplink(world: World) -> None:
    monitor = Process("--remote", world.robot, "monitor", "--rate", "10")
    first = monitor.first()["sequence"]
    world.uplink.gone()
    time.sleep(0.5)
    world.uplink = up(world.daemon, world.router)
    until(lambda: monitor.first()["sequence"] > first + 100, PATIENCE, "it goes on")
    code, _, said = monitor.end(signal.SIGINT)
    assert code == 130 and "it went away" in said and "waiting for the next daemon" in said
