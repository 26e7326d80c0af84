"""`twindctl policy run` and the environment on real processes: a daemon in mode sim, a client of its own."""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.policy_files import Run, looping, plain
from tests.support.processes import Daemon, simulated, until
from tests.support.standing_policy import CARD, bending
from twind.client import Client
from twind.learn.policy.onnx_session import MEMORY
from twind.learn.policy.policy_file import save, save_model

FASTEST = 4.0  # rad/s, of h24's joints


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with simulated(tmp_path_factory.mktemp("run"), "h24-standing") as running:
        yield running


@pytest.fixture(scope="module")
def bends(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that bends its knees for ever."""
    path = tmp_path_factory.mktemp("policy") / "bends.onnx"
    save(path, bending(), *plain(CARD), CARD)
    return path


@pytest.fixture
def runs(daemon: Daemon) -> Iterator[Any]:
    """Makes runs, and ends them."""
    made: list[Run] = []

    def run(file: Path, *options: str) -> Run:
        made.append(Run(daemon, file, *options))
        return made[-1]

    yield run
    for each in made:
        each.kill()


def rest(client: Client, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and goals (k, n) of the ticks from now on."""
    times = []
    rows = []
    for answer in client.stream("Monitor", topics=["state"], rate=100.0):
        times.append(answer["time"])
        rows.append([each["goal"] for each in answer["joints"]])
        if times[-1] - times[0] > seconds:
            return np.array(times), np.array(rows)
    raise AssertionError("the stream ended")


def goals(client: Client) -> np.ndarray:
    """Goals that the loop commands now, rad."""
    return np.array([each["goal"] for each in client.call("GetStatus", joints=True)["joints"]])


def test_a_policy_drives_the_simulation_and_gives_the_lease_back(
    daemon: Daemon, runs: Any, bends: Path
) -> None:
    code, told, _ = runs(bends, "--seconds", "2").end()
    assert code == 0 and told["as_asked"] and told["why"] == "2 s are over"
    assert told["refused"] == 0 and told["steps"] > 20 and told["most_tilt_deg"] < 20.0
    assert told["steps"] + told["missed"] <= 101
    assert daemon.status()["lease"] is None and daemon.status()["motion"] in ("holding", "idle")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_policy_that_is_killed_or_stopped_leaves_a_robot_that_holds(
    daemon: Daemon, runs: Any, bends: Path, number: int
) -> None:
    run = runs(bends)
    run.drives()
    with daemon.client() as client:
        os.kill(run.process.pid, number)
        times, rows = rest(client, 1.5)
    speed = np.diff(rows, axis=0) / np.diff(times)[:, None]
    assert np.abs(speed).max() < FASTEST  # nothing jumps
    assert np.ptp(rows[times - times[0] > 0.6], axis=0).max() < 1e-9  # and then it holds
    until(lambda: daemon.status()["lease"] is None, 2.0, "the lease lapses")
    if number == signal.SIGSTOP:
        os.kill(run.process.pid, signal.SIGCONT)
        code, told, _ = run.end()
        assert code == 1 and not told["as_asked"] and daemon.status()["lease"] is None, told


def test_a_run_has_a_memory_limit_and_ctrl_c_ends_it_as_asked(daemon: Daemon, runs: Any, bends: Path) -> None:
    run = runs(bends)
    run.drives()
    limits = Path(f"/proc/{run.process.pid}/limits").read_text()
    assert MEMORY < int(limits.split("Max data size")[1].split()[0]) < 4 * MEMORY
    run.process.send_signal(signal.SIGINT)
    code, told, _ = run.end()
    assert code == 0 and told["why"] == "stopped" and daemon.status()["lease"] is None


def test_a_policy_that_loses_the_lease_leaves_the_new_holders_motion_alone(
    daemon: Daemon, runs: Any, bends: Path
) -> None:
    run = runs(bends)
    run.drives()
    with daemon.client() as client:
        client.call("AcquireLease", take=True)
        names = [row["name"] for row in client.call("GetStatus", joints=True)["joints"]]
        point = {"positions": [0.3], "time_from_start": 3.0}
        path = {"joint_names": [names[0]], "points": [point], "policy": "retime"}
        *_, last = client.stream("SubmitTrajectory", trajectory=path)
        code, told, _ = run.end()
    assert code == 1 and "LEASE" in told["why"], told
    assert last["phase"] == "succeeded", last


def test_an_inference_that_does_not_end_ends_the_run_and_moves_nothing(
    daemon: Daemon, runs: Any, tmp_path: Path
) -> None:
    save_model(tmp_path / "loops.onnx", looping(CARD), CARD)
    code, told, _ = runs(tmp_path / "loops.onnx").end()
    assert code == 1 and "its inference took more than 1 s" in told["why"]
    assert told["steps"] == 0 and daemon.status()["lease"] is None


def test_the_environment_with_the_daemon_as_its_body(daemon: Daemon) -> None:
    gymnasium = pytest.importorskip("gymnasium", reason="make extras EXTRAS=learn")
    env = gymnasium.make(
        "twind.learn.envs:twind/Stand-v0",
        robot="h24-standing",
        backend="daemon",
        socket=str(daemon.sockets),
        disable_env_checker=True,
    )
    seen, _ = env.reset(seed=0)
    began = time.monotonic()
    infos = []
    for _ in range(50):
        seen, reward, terminated, truncated, info = env.step(np.zeros(24, np.float32))
        infos.append(info)
        assert np.isfinite(seen).all() and not terminated and not truncated and reward > 0.0
    assert time.monotonic() - began >= 0.98  # real time: 50 steps of 20 ms
    assert infos[-1]["refused"] == 0
    assert env.observation_space.contains(seen)
    with daemon.client() as client:
        before = goals(client)
        with pytest.raises(ValueError, match="not all numbers"):
            env.step(np.full(24, np.nan, np.float32))
        assert np.abs(goals(client) - before).max() < 1e-9
    env.close()
    env.close()
    assert daemon.status()["lease"] is None
