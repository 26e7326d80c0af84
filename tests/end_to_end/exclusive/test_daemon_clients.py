"""What clients and a front do to a moving robot when they die, hang or run out: real processes and ports."""

import fcntl
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import Daemon, arm, daemon, robot, until
from twind.client import Client, NoDaemon, Refused
from twind.client.errors import CallError

JOINT = "head_pitch"
PLACE = 1
LONG = {"joint_names": [JOINT], "points": [{"positions": [0.6], "time_from_start": 6.0}]}

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


def armed(running: Daemon) -> None:
    running.reach(state="connected")
    with running.client() as client:
        arm(client)
        client.call("ReleaseLease")


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


def time_until(what: Callable[[], bool], seconds: float, said: str) -> float:
    began = time.monotonic()
    until(what, seconds, said)
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
    code: str, kind: str, number: int, bound: float
) -> None:
    with robot() as (virtual, folder), daemon(virtual, folder) as running:
        armed(running)
        process = commanding(running, code, kind)
        try:
            os.kill(process.pid, number)
            took = time_until(lambda: held(running), bound + 2.0, "it holds, and nobody has the lease")
            print(f"{kind}, signal {number}: holds after {took:.3f} s")
            assert took < bound + 0.5  # what braking takes, and asking
            assert running.status()["armed"] is True
            assert all(servo["torque"] for servo in virtual.servos())
            with running.client() as client:
                client.call("AcquireLease")
        finally:
            end(process)


def test_a_front_that_hangs_costs_no_tick_and_is_replaced() -> None:
    with robot() as (virtual, folder), daemon(virtual, folder) as running:
        armed(running)
        before = running.status()["loop"]
        process = commanding(running, FOLLOW, "follow")
        try:
            front = running.front()
            os.kill(front, signal.SIGSTOP)
            began = time.monotonic()
            places = []
            for _ in range(10):  # the motion goes on while nobody can be asked
                places.append(virtual.servos()[PLACE]["position"])
                time.sleep(0.1)
            assert places == sorted(places, reverse=places[-1] < places[0])
            assert abs(places[-1] - places[0]) > 10
            status = running.reach(seconds=15.0, motion="holding")
            took = time.monotonic() - began
            print(f"a front that hung: the next one answers after {took:.2f} s")
            assert not Path(f"/proc/{front}").exists()
            assert status["armed"] is True
            assert not any(servo["tripped"] for servo in virtual.servos())
            after = running.status()["loop"]
            expected = (time.monotonic() - began) * before["rate_hz"]
            assert after["ticks"] - before["ticks"] > 0.8 * expected
        finally:
            end(process)


def limit(pid: int, free: int) -> tuple[int, int]:
    """Leave so many descriptors; the limits of before."""
    used = {int(number) for number in os.listdir(f"/proc/{pid}/fd")}
    most = next(n for n in range(4096) if n - len([fd for fd in used if fd < n]) == free)
    soft, hard = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (most, hard))
    return soft, hard


def test_a_daemon_without_descriptors_goes_on_moving_and_can_be_stopped() -> None:
    with robot() as (virtual, folder), daemon(virtual, folder) as running:
        armed(running)
        process = commanding(running, FOLLOW, "follow")
        crowd: list[Client] = []
        try:
            for pid in (running.front(), running.process.pid):
                limit(pid, 1)
            for _ in range(12):
                crowd.append(Client(str(running.sockets), name="observe"))
                crowd[-1].connect()
            place = virtual.servos()[PLACE]["position"]
            time.sleep(0.5)
            assert abs(virtual.servos()[PLACE]["position"] - place) > 5
            assert not any(servo["tripped"] for servo in virtual.servos())
            with running.client() as client:
                began = time.monotonic()
                answer = client.call("EStop", level="settle", reason="no descriptors")
                assert answer["state"] == "estop"
                assert time.monotonic() - began < 2.0
            until(lambda: not any(servo["torque"] for servo in virtual.servos()), 8.0, "torque off")
        finally:
            for client in crowd:
                client.close()
            end(process)


def test_an_unread_log_pipe_delays_no_tick() -> None:
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    with robot() as (virtual, folder):
        options = ["--mode", "live", "--robot", virtual.robot, "--calibration", str(virtual.calibration)]
        for bus in virtual.ports:
            options += ["--port", f"{bus}={virtual.folder / 'ports' / bus}"]
        folder = folder / "run"
        folder.mkdir()
        command = [sys.executable, "-m", "twind.cli", "--socket", str(folder), *options]
        process = subprocess.Popen(command, stderr=writer, stdin=subprocess.DEVNULL)
        os.close(writer)

        def status() -> dict[str, Any] | None:
            try:
                with Client(str(folder)) as client:
                    found: dict[str, Any] = client.call("GetStatus")["status"]
                    return found
            except (NoDaemon, CallError):
                return None

        try:
            until(lambda: (status() or {}).get("state") == "connected", 30.0, "connected")
            began = time.monotonic()
            before = status()
            assert before is not None
            with Client(str(folder)) as client:
                refused = 0
                while (
                    time.monotonic() < began + 4.0
                ):  # some lines a second: more than a pipe takes in a while
                    for _ in range(20):
                        try:
                            client.call("RenewLease")
                        except Refused:
                            refused += 1
                        client.call("EStop", reason="x" * 200)
                        client.call("Reset")
            after = status()
            assert after is not None
            rate = (after["loop"]["ticks"] - before["loop"]["ticks"]) / (time.monotonic() - began)
            print(f"{refused} refusals, {rate:.1f} Hz")
            assert rate > 80.0
        finally:
            process.kill()
            process.wait(10)
            os.close(reader)
