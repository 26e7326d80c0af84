"""`twindctl tune gains` on virtual servos and a real daemon: what it leaves, and what its death leaves."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.body_rig import written_robot
from tests.support.processes import Daemon, Virtual, arm, daemon, until

pytestmark = pytest.mark.slow

SOFT = {"p": 200, "i": 0, "d": 0}


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Daemon]:
    """A soft pan-tilt in mode live, armed."""
    path = written_robot(tmp_path, "pan-tilt", ("gains: {p: 800, i: 0, d: 0}", "gains: {p: 200, i: 0, d: 0}"))
    virtual = Virtual(tmp_path, path)
    try:
        with daemon(virtual, tmp_path) as made:
            made.reach(state="connected")
            with made.client() as client:
                arm(client)
            yield made
    finally:
        virtual.close()


def command(running: Daemon, *words: str) -> list[str]:
    program = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(running.sockets)]
    return [*program, "--json", "tune", "gains", *words]


def gains(running: Daemon) -> dict[str, Any]:
    with running.client() as client:
        found: dict[str, Any] = client.call("GetRobot")["robot"]["joints"][0]["type"]["gains"]
    return found


def test_the_proposal_settles_sooner_and_is_written_only_when_asked(running: Daemon) -> None:
    path = running.sockets.parent / "pan-tilt.yaml"
    text = path.read_text()
    done = subprocess.run(
        command(running, "tilt", "--tries", "3"), capture_output=True, timeout=120.0, check=False
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    first, *_, last = answer["tries"]
    assert last["settling"] < first["settling"] and last["overshoot"] <= 0.1
    assert answer["proposal"]["p"] > SOFT["p"] and answer["written"] is None
    assert gains(running) == SOFT and path.read_text() == text
    assert running.status()["state"] == "connected"
    with running.client() as client:
        arm(client)
    done = subprocess.run(
        command(running, "tilt", "--tries", "2", "--write"), capture_output=True, timeout=120.0, check=False
    )
    assert done.returncode == 0, done.stderr
    assert gains(running) == json.loads(done.stdout)["proposal"] == {"p": 280, "i": 0, "d": 0}
    assert "gains: {p: 280, i: 0, d: 0}" in path.read_text()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupt_or_the_death_of_the_client_brings_the_old_gains_back(
    running: Daemon, number: signal.Signals
) -> None:
    tuning = subprocess.Popen(command(running, "tilt"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until(lambda: gains(running) != SOFT and running.status()["state"] == "armed", 60.0, "a second try")
    time.sleep(0.5)  # amidst its step
    tuning.send_signal(number)
    tuning.wait(30.0)
    if number is signal.SIGKILL:
        assert gains(running) != SOFT, "under torque they stay"
        with running.client() as client:
            client.call("Disarm")
    until(lambda: gains(running) == SOFT, 10.0, "the gains of the file")
    assert running.status()["state"] == "connected"


def test_a_lost_lease_ends_it_and_the_daemon_puts_the_old_gains_back(running: Daemon) -> None:
    tuning = subprocess.Popen(command(running, "tilt"), stdout=subprocess.PIPE)
    until(lambda: gains(running) != SOFT and running.status()["state"] == "armed", 60.0, "a second try")
    with running.client() as client:
        client.call("AcquireLease", take=True)
        said, _ = tuning.communicate(timeout=60.0)
        assert tuning.returncode == 1, said
        assert b"puts the gains of the robot file back" in said
        status = running.status()
        assert status["state"] == "armed" and gains(running) != SOFT, "the robot is the new holder's"
        client.call("Disarm")
        until(lambda: gains(running) == SOFT, 10.0, "the gains of the file")


def test_without_torque_with_unknown_joints_or_two_types_it_moves_nothing(running: Daemon) -> None:
    with running.client() as client:
        client.call("Disarm")
    for words in (["tilt"], ["tail"]):
        done = subprocess.run(command(running, *words), capture_output=True, timeout=60.0, check=False)
        assert done.returncode == 1
    assert running.status()["state"] == "connected" and gains(running) == SOFT
