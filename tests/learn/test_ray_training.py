"""`train --ray`: errors in one line; a worker that dies costs time, no steps."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.support.trainer_rig import TINY

if find_spec("stable_baselines3") is None:
    pytest.skip("make extras EXTRAS=learn", allow_module_level=True)

from twind.ctl.ctl_main import main
from twind.exceptions import OperationFailed
from twind.learn.training import train_command
from twind.learn.training.ray_cluster import ray_workers
from twind.learn.training.training_settings import TrainingSettings


def test_without_ray_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = train_command.find_spec
    monkeypatch.setattr(train_command, "find_spec", lambda name: None if name == "ray" else found(name))
    assert main(["train", "stand", "--ray", "local", "--out", str(tmp_path / "run")]) == 2
    assert "--ray needs ray: " in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_number_of_workers_needs_a_cluster(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "stand", "--ray-workers", "2"]) == 2
    assert "--ray-workers: name a cluster with --ray" in capsys.readouterr().err


def test_an_address_where_no_cluster_answers_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    for address, said in (
        ("here", "local, auto or HOST:PORT is needed"),
        ("127.0.0.1:", "local, auto or HOST:PORT is needed"),
        (f"127.0.0.1:{port}", f"is `ray start --head --port {port}` running on 127.0.0.1"),
    ):
        with (
            pytest.raises(OperationFailed, match=said),
            ray_workers(address, None, TrainingSettings("Stand")),
        ):
            pass


@pytest.mark.campaign
def test_a_worker_that_is_killed_costs_no_steps(tmp_path: Path) -> None:
    """On a cluster of two processes here: the rollout that died with it is collected again."""
    if find_spec("ray") is None:
        pytest.skip("make extras EXTRAS=ray")
    out = tmp_path / "run"
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "train", "--json", "stand", *TINY]
    command += ["--steps", "512", "--ray", "local", "--ray-workers", "2", "--out", str(out)]
    events = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        bound = threading.Timer(600.0, process.terminate)
        bound.start()
        for line in process.stdout:
            events.append(json.loads(line))
            if [each["event"] for each in events].count("progress") == 1 and events[-1][
                "event"
            ] == "progress":
                os.kill(events[0]["workers"][0][1], signal.SIGKILL)
        bound.cancel()
    assert process.returncode == 0
    steps = [each["steps"] for each in events if each["event"] == "progress"]
    assert steps == list(range(64, 513, 64))
    assert events[-1]["event"] == "workers"
    assert events[-1]["restarts"] == 1
    assert json.loads((out / "run.json").read_text())["ended"] == "done"
