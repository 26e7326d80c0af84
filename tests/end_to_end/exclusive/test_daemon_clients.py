"""Clients and fronts that die, hang or run out of descriptors while the robot moves, as real processes."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

from tests.support.live_robot import LiveRobot, live_robot
from tests.support.processes import Daemon, arm, until
from twind.client import Client

PLACE = 1  # of head_pitch, which moves, among the servos

STREAM = """
import sys, time
from twind.client import Client
client = Client(sys.argv[1])
client.call("AcquireLease", take=True)
began = time.monotonic()
print("moving", flush=True)
while True:
    place = min(0.5, 0.2 * (time.monotonic() - began))
    client.call("Setpoint", joint_names=["head_pitch"], positions=[place], allow_clamp=True)
    time.sleep(0.02)
"""
FOLLOW = """
import sys, os, time
from twind.client import Client
client = Client(sys.argv[1])
client.call("AcquireLease", take=True)
path = {"joint_names": ["head_pitch"], "points": [{"positions": [0.6], "time_from_start": 6.0}]}
if sys.argv[2] == "follow":
    for answer in client.stream("SubmitTrajectory", trajectory=path):
        if answer["progress"] > 0.02:
            print("moving", flush=True)
else:
    client.call("SubmitTrajectory", trajectory=path)
    if sys.argv[2] == "copy" and os.fork() == 0:
        time.sleep(60.0)
    print("moving", flush=True)
    time.sleep(60.0)
"""


@pytest.fixture(scope="module")
def shared() -> Iterator[LiveRobot]:
    with live_robot() as made:
        yield made


@pytest.fixture
def armed(shared: LiveRobot) -> LiveRobot:
    """An armed robot whose lease is free."""
    shared.ready()
    with shared.running.client() as client:
        arm(client)
        client.call("ReleaseLease")
    return shared


def commanding(running: Daemon, code: str, *arguments: str) -> subprocess.Popen[bytes]:
    """A client in a process of its own, once it moves the robot; a busy machine may end a motion at once."""
    command = [sys.executable, "-c", code, str(running.sockets), *arguments]
    for _ in range(4):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
        assert process.stdout is not None
        said = process.stdout.readline()  # nothing, where it was refused or ended at once
        with suppress(AssertionError):
            assert said
            until(lambda: running.status()["motion"] in ("active", "streaming"), 1.0, "it moves")
            time.sleep(0.2)
            if running.status()["motion"] in ("active", "streaming"):
                return process
        end(process)
    raise AssertionError(running.log.read_text()[-2000:])


def end(process: subprocess.Popen[bytes]) -> None:
    os.killpg(process.pid, signal.SIGKILL)
    process.wait(5)
    assert process.stdout is not None
    process.stdout.close()


def held(running: Daemon) -> bool:
    """A stream that others keep from the processor may hold for a moment: the lease tells the difference."""
    status = running.status()
    return status["motion"] == "holding" and status["lease"] is None


def time_until(what: Callable[[], bool], seconds: float, message: str) -> float:
    began = time.monotonic()
    until(what, seconds, message)
    return time.monotonic() - began


@pytest.mark.parametrize(
    ("code", "kind", "number", "bound"),
    [
        (FOLLOW, "follow", signal.SIGKILL, 1.0),
        (FOLLOW, "submit", signal.SIGKILL, 1.0),
        (STREAM, "stream", signal.SIGKILL, 0.25),
        (STREAM, "stream", signal.SIGSTOP, 0.25),
        (FOLLOW, "submit", signal.SIGSTOP, 1.0),
        (FOLLOW, "copy", signal.SIGKILL, 1.0),  # a copy of its descriptor lives on: the lease must lapse
    ],
)
def test_a_client_that_dies_or_hangs_in_a_motion_leaves_the_robot_holding(
    armed: LiveRobot, code: str, kind: str, number: int, bound: float
) -> None:
    running = armed.running
    process = commanding(running, code, kind)
    try:
        os.kill(process.pid, number)
        took = time_until(lambda: held(running), bound + 2.0, "it holds, and the lease is free")
        print(f"{kind}, signal {number}: holds after {took:.3f} s")
        assert took < bound + 0.5  # braking and polling take the rest
        assert running.status()["armed"] is True
        assert armed.torque() == {True}
        with running.client() as client:
            client.call("AcquireLease")
    finally:
        end(process)


def test_a_front_that_hangs_costs_no_tick_and_is_replaced(armed: LiveRobot) -> None:
    running = armed.running
    before = running.status()["loop"]
    process = commanding(running, FOLLOW, "follow")
    try:
        front = running.front()
        os.kill(front, signal.SIGSTOP)
        began = time.monotonic()
        places = []
        for _ in range(20):  # the motion goes on while no client is answered; it begins slowly
            places.append(armed.places()[PLACE])
            time.sleep(0.1)
        assert places == sorted(places, reverse=places[-1] < places[0])
        assert abs(places[-1] - places[0]) > 10
        status = running.reach(seconds=15.0, motion="holding")
        took = time.monotonic() - began
        print(f"a front that hung: the next one answers after {took:.2f} s")
        assert not Path(f"/proc/{front}").exists()
        assert status["armed"] is True
        assert not any(servo["tripped"] for servo in armed.virtual.servos())
        after = running.status()["loop"]
        expected = (time.monotonic() - began) * before["rate_hz"]
        assert after["ticks"] - before["ticks"] > 0.8 * expected
    finally:
        end(process)


def limit(pid: int, free: int) -> None:
    """Leave so many descriptors."""
    used = {int(number) for number in os.listdir(f"/proc/{pid}/fd")}
    most = next(n for n in range(4096) if n - len([fd for fd in used if fd < n]) == free)
    _, hard = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (most, hard))


def test_a_daemon_without_descriptors_goes_on_moving_and_can_be_stopped(armed: LiveRobot) -> None:
    """The daemon keeps the limit, so it ends with the test."""
    process = commanding(armed.running, FOLLOW, "follow")
    with ExitStack() as stack:
        stack.callback(armed.running.kill)
        stack.callback(end, process)
        for pid in (armed.running.front(), armed.running.process.pid):
            limit(pid, 1)
        for _ in range(12):
            stack.enter_context(Client(str(armed.running.sockets), name="observe")).connect()
        place = armed.places()[PLACE]
        until(lambda: abs(armed.places()[PLACE] - place) > 5, 10.0, "the motion goes on")
        assert not any(servo["tripped"] for servo in armed.virtual.servos())
        with armed.running.client() as client:
            began = time.monotonic()
            answer = client.call("EStop", level="settle", reason="no descriptors")
            assert answer["state"] == "estop"
            assert time.monotonic() - began < 2.0
        until(lambda: armed.torque() == {False}, 8.0, "torque off")
