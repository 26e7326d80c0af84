"""`twindctl wiggle` through a real daemon on virtual servos: what it says, and that it leaves no trace."""

import io
import json
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from math import radians
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import BUSY, Daemon, Virtual, arm, daemon, robot, until
from tests.support.processes import go as sent
from twind.ctl.ctl_main import main
from twind_calibration.wiggling.joint_move import MoveResult, back, go, goal_of
from twind_drivers.clock import FakeClock, MonotonicClock

Words = list[str]
Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def running() -> Iterator[tuple[Virtual, Daemon]]:
    with robot("h24", "--muscles", "first-order") as (virtual, folder), daemon(virtual, folder) as one:
        one.reach(state="connected")
        yield virtual, one


def output_of(running: Daemon, words: Words, capsys: Captured, code: int) -> tuple[str, str]:
    """Output of `twindctl wiggle`; repeated where the machine had no time for the servos."""
    capsys.readouterr()
    deadline = time.monotonic() + 30.0
    while True:
        found = main(["--socket", str(running.sockets), "wiggle", *words])
        said = capsys.readouterr()
        if found == code or not any(each in said.out + said.err for each in BUSY):
            assert found == code, said
            return said.out, said.err
        assert time.monotonic() < deadline, said
        time.sleep(1.0)
        with running.client() as client:
            if running.status()["mode"] == "live" and not running.status()["armed"]:
                client.call("Reset")
                arm(client)


def json_of(running: Daemon, words: Words, capsys: Captured, code: int) -> dict[str, Any]:
    """The one line of JSON."""
    return dict(json.loads(output_of(running, ["--json", *words], capsys, code)[0]))


def test_a_robot_that_is_not_armed_is_not_moved(running: tuple[Virtual, Daemon], capsys: Captured) -> None:
    virtual, one = running
    before = [servo["position"] for servo in virtual.servos()]
    assert main(["--socket", str(one.sockets), "wiggle", "l_knee"]) == 1
    assert (
        f"the robot is not armed: `twindctl --socket {one.sockets} arm`, or --arm" in capsys.readouterr().err
    )
    assert main(["--socket", str(one.sockets), "wiggle", "l_kne", "--arm"]) == 1
    assert "h24 has no joint 'l_kne'; nearest: l_knee" in capsys.readouterr().err
    assert [servo["position"] for servo in virtual.servos()] == before
    assert not any(servo["torque"] for servo in virtual.servos())


def test_a_free_joint_moves_and_returns_and_a_blocked_one_is_reported(
    running: tuple[Virtual, Daemon], capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    virtual, one = running
    with one.client() as client:
        arm(client)
    before = [servo["position"] for servo in virtual.servos()]
    monkeypatch.setattr(sys, "stdin", Terminal("y\n" * 100))
    out, err = output_of(one, ["l_knee"], capsys, 0)
    assert "l_knee: watch: l_foot moves backward, and back" in err
    assert "l_foot moves backward, and back: was it so? [y/n, else unknown]" in err
    assert out.startswith("ok   l_knee (main id 16): follows: went +")
    assert "by eye: l_foot moves backward, and back: confirmed" in out
    assert "an encoder cannot tell sign, gear ratio and which joint it sits at" in out
    virtual.order(fault="lock", id=10)
    held = json_of(one, ["r_elbow"], capsys, 1)
    while held["motion"] == "ended" and any(each.startswith(tuple(BUSY)) for each in held["ended"]):
        held = json_of(one, ["r_elbow"], capsys, 1)
    virtual.order(fault="free", id=10)
    assert (held["motion"], held["good"], held["confirmed"]) == ("still", False, None)
    assert max(abs(n["position"] - b) for n, b in zip(virtual.servos(), before, strict=True)) <= 2


def test_in_sim_and_mirror_only_the_gate_is_asked_near_a_limit_it_goes_the_other_way(
    running: tuple[Virtual, Daemon], capsys: Captured
) -> None:
    virtual, one = running
    with one.client() as client:
        client.call("Disarm")
        client.call("SetMode", mode="sim")
    before = [servo["position"] for servo in virtual.servos()]
    assert main(["--socket", str(one.sockets), "move", "l_elbow=0.095", "--time", "1"]) == 0
    out, err = output_of(one, ["l_elbow"], capsys, 0)
    assert "mode sim: only the simulation is moved" in err
    assert "ok   l_elbow (main id 6): the gate takes -2.00° and back" in out  # its limit is 0.1
    assert "follows" not in out and "by eye" not in out
    with one.client() as client:
        client.call("SetMode", mode="mirror")
    stop = threading.Timer(0.8, lambda: main(["--socket", str(one.sockets), "stop"]))
    stop.start()
    assert main(["--socket", str(one.sockets), "wiggle", "l_elbow"]) == 1
    stop.join()
    said = capsys.readouterr()
    assert "mode mirror: only the simulation is moved" in said.err
    assert "it was ended on the way: cancelled" in said.out
    again = f"`twindctl --socket {one.sockets} move` brings it back"
    assert f"from where it was: {again}" in said.out  # who says stop is obeyed
    assert [servo["position"] for servo in virtual.servos()] == before


JOINT = "l_knee"
WAY = radians(2.0)


def to(place: float, seconds: float = 0.5) -> dict[str, Any]:
    """A way of the joint there."""
    point = {"positions": [place], "velocities": [0.0], "time_from_start": seconds}
    return {"joint_names": [JOINT], "points": [point]}


@pytest.fixture
def simulated(running: tuple[Virtual, Daemon]) -> Daemon:
    """Nothing of a robot moves: only the simulation, by the same gate, executor and lease."""
    with running[1].client() as client:
        client.call("Disarm")
        client.call("SetMode", mode="sim")
    return running[1]


def test_a_client_that_takes_the_lease_keeps_the_position_it_commands(simulated: Daemon) -> None:
    def wiggled(home: float) -> MoveResult:
        with simulated.client() as client:
            return go(client, MonotonicClock(), JOINT, home, WAY, take=False)

    with simulated.client() as client, ThreadPoolExecutor(1) as other:
        home = goal_of(client, JOINT)
        assert home is not None
        gone = other.submit(wiggled, home)
        until(lambda: abs((goal_of(client, JOINT) or 0.0) - home) > 0.3 * WAY, 20.0, "it moves")
        client.call("AcquireLease", take=True)
        sent(client, to(home + 0.3))
        client.call("ReleaseLease")  # from now on nobody would hinder it
        result = gone.result(20.0)
        time.sleep(1.5)  # a way home takes a second
        assert goal_of(client, JOINT) == pytest.approx(home + 0.3, abs=1e-6)
    assert result.ended and result.ended[0].startswith("LEASE_LOST")
    assert 0.0 < abs(result.left) < 0.31


@pytest.mark.parametrize(
    ("away", "rest", "returns"),
    [
        (0.02, 0.0, True),  # something ended it on the way: it is brought home
        (0.02, 1.3, False),  # suspended, or too slow: the lease has lapsed
        (0.3, 0.0, False),  # it never went there
    ],
)
def test_a_wiggle_returns_only_from_its_own_move(
    simulated: Daemon, away: float, rest: float, returns: bool
) -> None:
    with simulated.client() as client:
        client.call("AcquireLease")
        home = goal_of(client, JOINT)
        assert home is not None
        sent(client, to(home + away))
        time.sleep(rest)
        left = back(client, FakeClock(), JOINT, home, WAY)
        assert left == pytest.approx(0.0 if returns else away, abs=1e-6)
        assert goal_of(client, JOINT) == pytest.approx(home + left, abs=1e-6)


class Terminal(io.StringIO):
    """Standard input that a person types on."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "name JOINTs, or --all of them"),
        (["l_knee", "--all"], "name JOINTs, or --all of them"),
        (["l_knee", "--degrees", "11"], "--degrees 11 is outside 0.5 to 10"),
        (["l_knee", "--degrees", "nan"], "--degrees nan is outside"),
        (["l_knee", "--friction", "-1"], "--friction -1 is outside 0 to 100 N·m"),
    ],
)
def test_an_invalid_option_is_a_usage_error(
    words: Words, message: str, tmp_path: Path, capsys: Captured
) -> None:
    assert main(["--socket", str(tmp_path), "wiggle", *words]) == 2
    assert message in capsys.readouterr().err
