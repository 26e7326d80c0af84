"""Open files: a daemon refuses to start below what it needs, and serves every client with exactly that."""

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from tests.support.processes import Virtual, arm, go, robot, until
from twind.client import Client, NoDaemon
from twind.exceptions import InvalidInput
from twind.front import reserved_descriptors
from twind.loop.ipc import descriptors
from twind.loop.ipc.descriptors import ensure, needed

NEEDED = needed(1, reserved_descriptors.NEEDED)


class Limits:
    """Requests to setrlimit(2), recorded instead of changing this process."""

    def __init__(self, soft: int, hard: int) -> None:
        self.limits = (soft, hard)

    def getrlimit(self, _what: int) -> tuple[int, int]:
        return self.limits

    def setrlimit(self, _what: int, limits: tuple[int, int]) -> None:
        self.limits = limits


@pytest.mark.parametrize(
    ("before", "after"),
    [((70, 70), (70, 70)), ((1024, 4096), (1024, 4096)), ((69, 4096), (4096, 4096)), ((-1, -1), (-1, -1))],
)
def test_a_soft_limit_that_is_too_low_is_raised_to_the_hard_limit_and_reported(
    monkeypatch: pytest.MonkeyPatch, before: tuple[int, int], after: tuple[int, int]
) -> None:
    limits = Limits(*before)
    monkeypatch.setattr(descriptors.resource, "getrlimit", limits.getrlimit)
    monkeypatch.setattr(descriptors.resource, "setrlimit", limits.setrlimit)
    said = ensure(70)
    assert limits.limits == after
    assert ("soft limit was 69" in said and "4096" in said) if before != after else said == ""


def test_a_hard_limit_that_is_too_low_is_refused_with_both_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = Limits(64, 69)
    monkeypatch.setattr(descriptors.resource, "getrlimit", limits.getrlimit)
    with pytest.raises(InvalidInput, match=r"70 are needed, and the hard limit is 69; .*ulimit -n 70"):
        ensure(70)
    assert limits.limits == (64, 69)


def test_more_buses_need_more_and_the_larger_of_both_processes_counts() -> None:
    assert needed(40, 0) > needed(1, 0)
    assert needed(1, 500) == 500


# ------------------------------------------------------------------------------- real processes


def start(folder: Path, limit: str, *options: str) -> "subprocess.Popen[bytes]":
    """A daemon under `ulimit limit`, its log in `folder`."""
    command = [sys.executable, "-m", "twind.cli", "--socket", str(folder / "run"), *options]
    with (folder / "log").open("wb") as log:
        return subprocess.Popen(["sh", "-c", f'ulimit {limit}; exec "$@"', "sh", *command], stderr=log)


@pytest.mark.parametrize("limit", [64, NEEDED - 1])
def test_under_too_few_it_refuses_to_start_with_exit_code_2(tmp_path: Path, limit: int) -> None:
    process = start(tmp_path, f"-n {limit}", "--mode", "sim")
    try:
        assert process.wait(30.0) == 2
    finally:
        process.kill()
    said = (tmp_path / "log").read_text()
    assert f"open files: {NEEDED} are needed, and the hard limit is {limit}" in said
    assert not (tmp_path / "run").exists()


def test_a_soft_limit_alone_is_raised_for_loop_and_front(tmp_path: Path) -> None:
    process = start(tmp_path, "-Sn 64", "--mode", "sim")
    try:
        until(lambda: answers(tmp_path / "run"), 30.0, (tmp_path / "log").read_text)
        assert "the soft limit was 64" in (tmp_path / "log").read_text()
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        assert resource.prlimit(process.pid, resource.RLIMIT_NOFILE) == (hard, hard)
        process.send_signal(signal.SIGTERM)
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.wait()


def answers(folder: Path) -> bool:
    try:
        with Client(str(folder)) as client:
            return bool(client.call("GetStatus"))
    except NoDaemon:
        return False


@contextmanager
def live(virtual: Virtual, folder: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """A daemon of that robot with exactly as many descriptors as it says it needs."""
    options = ["--mode", "live", "--calibration", str(virtual.calibration)]
    options += [part for bus, path in virtual.ports.items() for part in ("--port", f"{bus}={path}")]
    process = start(folder, f"-n {NEEDED}", *options)
    try:
        until(lambda: answers(folder / "run"), 30.0, (folder / "log").read_text)
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        try:
            process.wait(30.0)
        finally:
            process.kill()


def test_with_exactly_as_many_every_place_is_served_and_the_robot_moves_and_stops() -> None:
    with robot() as (virtual, folder), live(virtual, folder) as process, ExitStack() as stack:
        run = str(folder / "run")
        operators = [stack.enter_context(Client(run)) for _ in range(reserved_descriptors.PLACES["operator"])]
        observers = [
            stack.enter_context(Client(run, name="observe"))
            for _ in range(reserved_descriptors.PLACES["observer"])
        ]
        for client in (*operators, *observers):
            assert client.call("GetStatus")["status"]["mode"] == "live"
        names = ["control", "observe"] * reserved_descriptors.RESERVED
        reserved = [stack.enter_context(Client(run, name=name)) for name in names]
        for client in reserved:
            client.connect()
        streams = [client.stream("Monitor", topics=["state"]) for client in observers]
        assert all(next(stream)["topic"] == "state" for stream in streams)
        until(lambda: connected(operators[0]), 30.0, (folder / "log").read_text)
        arm(operators[0])
        path = {"joint_names": ["head_yaw"], "points": [{"positions": [0.2], "time_from_start": 1.0}]}
        assert go(operators[0], path)["phase"] == "succeeded"
        assert Path(operators[1].call("DumpRecorder")["path"]).is_file()
        operators[1].call("Reload")
        opened = [len(os.listdir(f"/proc/{pid}/fd")) for pid in (process.pid, front_of(process.pid))]
        assert opened[1] >= len(operators) + len(observers) + len(reserved)
        print(f"open in loop and front: {opened} of {NEEDED}")
        assert reserved[-1].call("EStop", level="cut")["torque_off"] is True
        text = (folder / "log").read_text()
        assert "DESCRIPTORS" not in text and "Errno" not in text and "CALL_BROKE" not in text, text


def connected(client: Client) -> bool:
    return bool(client.call("GetStatus")["status"]["state"] == "connected")


def front_of(pid: int) -> int:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    (found,) = [
        int(each) for each in children if b"twind.front" in Path(f"/proc/{each}/cmdline").read_bytes()
    ]
    return found
