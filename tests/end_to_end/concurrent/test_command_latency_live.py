"""Latency and verdict of a command as a subscriber receives them, from a real daemon in mode sim."""

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.processes import Daemon, simulated, until
from tests.support.raw_connection import CONTRACT
from twind.client import Client, Refused
from twind.telemetry.timing_monitor import COMMAND

JOINT = "l_elbow"
FAST = {
    "joint_names": [JOINT],
    "points": [{"positions": [-0.4], "velocities": [0.0], "time_from_start": 0.05}],
    "policy": "retime",
}


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with simulated(tmp_path_factory.mktemp("latency")) as daemon:
        until(lambda: "LOOKAHEAD" in daemon.log.read_text(), 30.0, "the model is loaded")
        yield daemon
        assert daemon.end() == 0


def next_of(stream: Iterator[dict[str, Any]], topic: str) -> dict[str, Any]:
    message = next(message for message in stream if message["topic"] == topic)
    CONTRACT.methods["Monitor"].results.check(message, "")
    return message


def hops(running: Daemon) -> dict[str, dict[str, Any]]:
    with running.client() as client:
        message = client.call("Monitor", topics=["latency"])
    return {hop["hop"]: hop for hop in message["latency"]}


def test_a_motion_is_published_as_verdict_trajectory_and_latency_per_hop(running: Daemon) -> None:
    with running.client() as watcher, running.client() as client:
        news = watcher.stream("Monitor", topics=["verdicts", "trajectories", "state"], rate=10.0)
        next_of(news, "state")
        client.call("AcquireLease")
        name = client.call("SubmitTrajectory", trajectory=FAST)["id"]
        verdict = next_of(news, "verdicts")
        accepted = next_of(news, "trajectories")
    assert verdict["id"] == accepted["accepted"]["id"] == name
    (change,) = verdict["verdict"]["changes"]
    (point,) = accepted["accepted"]["trajectory"]["points"]
    assert change["code"] == "RETIMED"
    assert point["time_from_start"] == pytest.approx(0.05 * change["value"])
    told = until(lambda: whole(running), 5.0, "the joint has moved, and histograms came since")
    parts = sum(told[hop]["now_ms"] for hop in ("received", "gated", "written"))
    assert told["command"]["now_ms"] == pytest.approx(parts, abs=0.5)
    assert all(told[hop]["violations"] == 0 for hop in ("received", "gated", "command"))


def whole(running: Daemon) -> dict[str, dict[str, Any]] | None:
    """The hops, once each of a command's has one value."""
    told = hops(running)
    counts = [sum(bucket["count"] for bucket in told[hop]["histogram"]) for hop in COMMAND]
    return told if counts == [1] * len(COMMAND) else None


def test_a_stream_of_setpoints_has_its_figures_and_a_refused_one_is_a_verdict(running: Daemon) -> None:
    before = sum(bucket["count"] for bucket in hops(running)["command"]["histogram"])
    with running.client() as watcher, running.client() as client:
        news = watcher.stream("Monitor", topics=["verdicts", "state"], rate=10.0)
        next_of(news, "state")
        client.call("AcquireLease")
        for step in range(30):
            client.call("Setpoint", joint_names=[JOINT], positions=[-0.4 + 0.005 * step])
        with pytest.raises(Refused):
            client.call("Setpoint", joint_names=[JOINT], positions=[9.0])
        verdict = next_of(news, "verdicts")
    assert (verdict["id"], verdict["verdict"]["refusals"][0]["code"]) == (None, "POS_LIMIT")
    after = until(lambda: counted(running, before), 5.0, "the setpoints are counted")
    assert after - before <= 30


def counted(running: Daemon, before: int) -> int | None:
    """Number of written commands, once the histogram counts most of the stream."""
    count = sum(bucket["count"] for bucket in hops(running)["command"]["histogram"])
    return count if count > before + 20 else None


def test_a_mark_is_published_to_subscribers_and_logged(running: Daemon) -> None:
    def mark(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(running.sockets), "mark"]
        return subprocess.run([*command, *words], capture_output=True, text=True, timeout=20.0, check=False)

    with Client(str(running.sockets), name="observe") as watcher:
        news = watcher.stream("Monitor", topics=["events", "state"], rate=10.0)
        next_of(news, "state")
        assert mark("begin", "pick the cube").stdout == "marked: begin\n"
        assert mark("end", "--failure").returncode == 0
        begin = next_of(news, "events")["event"]
        end = next_of(news, "events")["event"]
    assert (begin["code"], begin["annotation"]["task"]) == ("EPISODE_BEGIN", "pick the cube")
    assert (end["code"], end["annotation"]["success"]) == ("EPISODE_END", False)
    refused = mark("note", "two\nlines")
    assert (refused.returncode, "text" in refused.stderr) == (1, True)
    until(lambda: "EPISODE_BEGIN: pick the cube" in running.log.read_text(), 5.0, "the log has it")
