"""`twindctl ros` with a real daemon in sim and peers over Zenoh, each in a process of its own."""

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import Daemon, until
from tests.support.zenoh_router import Router
from twind.bridge.ros.ros_commands import PACE

pytest.importorskip("zenoh", reason="the extra `zenoh` is not installed")
from tests.support.ros_bytes_peer import Peer
from tests.support.zenoh_bridge_graph import COMMAND, STATUS, Graph

DAY = 86_400  # s
# A bridge on whose machine somebody set the clock: the rest of the process is as it is.
SHIFTED = f"""
import sys, time
right = time.time_ns
time.time_ns = lambda: right() - {DAY} * 10**9
from twind.ctl.ctl_main import main
sys.exit(main())
"""
PASSED = "/hw/joint_trajectory"


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    folder = tmp_path_factory.mktemp("ros")
    daemon = Daemon(folder / "run", "--mode", "sim", "--robot", "h24")
    try:
        daemon.reach(mode="sim")
        with Router(gossip=True) as router, Graph(folder, router, daemon) as graph:
            yield graph
            daemon = graph.daemon  # the last of them
    finally:
        daemon.kill()


def test_a_subscriber_receives_every_current_joint_and_no_measured_state_in_sim(graph: Graph) -> None:
    time.sleep(0.5)
    states = graph.states()
    wall = time.time()
    latest = states[-1]["header"]["stamp"]
    assert abs(wall - latest["sec"] - latest["nanosec"] / 1e9) < 5.0
    assert len(states[-1]["name"]) == 24 == len(states[-1]["position"])
    stamps = [(each["header"]["stamp"]["sec"], each["header"]["stamp"]["nanosec"]) for each in states]
    assert stamps == sorted(stamps) and len(set(stamps)) == len(stamps)
    assert graph.states("/sim/joint_states")
    assert graph.peer.ask("received", topic="/hw/joint_states") == []
    assert "may move the robot" in graph.log()


def test_a_trajectory_moves_the_robot_and_its_result_is_published(graph: Graph) -> None:
    graph.command(0.3, 1, "first")
    accepted = graph.result(frame_id="first", phase="accepted")
    assert graph.result(frame_id="first", phase="succeeded")["id"] == accepted["id"]
    until(lambda: abs(graph.knee() - 0.3) < 0.05, 10.0, "the knee there")
    heard_of = {each["header"]["frame_id"]: each for each in graph.peer.ask("received", topic=PASSED)}
    assert heard_of[accepted["id"]]["joint_names"] == ["l_knee"]
    until(lambda: graph.daemon.status()["lease"] is None, 10.0, "the lease given back")


def test_nothing_that_is_refused_disturbs_what_runs(graph: Graph) -> None:
    graph.command(0.0, 1, "back")
    graph.result(frame_id="back", phase="succeeded")
    before = graph.loop("before")
    graph.command(0.4, 3, "long")
    graph.result(frame_id="long", phase="accepted")
    now = int(time.time())
    graph.command(9.0, 2, "far")
    graph.command(0.1, 1, "tomorrow", stamp={"sec": now + 86_400, "nanosec": 0})
    graph.command(0.1, 1, "yesterday", stamp={"sec": now - 86_400, "nanosec": 5})
    graph.command(float("nan"), 1, "none")
    graph.peer.ask("send_bytes", topic=COMMAND, data="00010000" + "ff" * 40)
    assert "malformed" in graph.result(phase="refused", frame_id="")["message"]
    assert graph.result(frame_id="far", phase="refused")["findings"][0]["code"] == "POS_LIMIT"
    assert graph.result(frame_id="yesterday")["stamp"] == {"sec": now - 86_400, "nanosec": 5}
    codes = {"tomorrow": "TOO_DISTANT", "yesterday": "CMD_EXPIRED", "none": "NONFINITE"}
    for frame, code in codes.items():
        assert graph.result(frame_id=frame)["phase"] == "refused"
        assert graph.result(frame_id=frame)["findings"][0]["code"] == code
    graph.result(frame_id="long", phase="succeeded")
    until(lambda: abs(graph.knee() - 0.4) < 0.05, 10.0, "the knee there")
    graph.undisturbed(before)


def test_a_flood_from_a_peer_that_dies_or_hangs_does_not_disturb_the_loop(
    graph: Graph,
) -> None:
    before = graph.loop("before")
    begun = time.monotonic()
    with Peer(graph.router.endpoint) as mad, Peer(graph.router.endpoint) as hung:
        until(
            lambda: hung.ask("received", topic="/joint_states"),
            30.0,
            "joint states at the peer that will hang",
        )
        hung.signal(signal.SIGSTOP)
        point = {"positions": [0.2], "velocities": [0.0], "time_from_start": {"sec": 1}}
        message = {"header": {"frame_id": "mad"}, "joint_names": ["l_knee"], "points": [point]}

        def found() -> list[dict[str, Any]]:
            """Accepted: each side has found the other."""
            mad.ask("send", topic=COMMAND, message=message)
            return graph.results(frame_id="mad", phase="accepted")

        until(found, 30.0, "an answer to the peer that will flood")
        for _ in range(20):
            mad.ask("send", topic=COMMAND, message=message, times=100)
        mad.signal(signal.SIGKILL)
        asked = graph.result(phase="dropped")
        assert asked["count"] > 0
        graph.loop("flooded")
        graph.states()
    until(lambda: graph.motion() == "holding", 30.0, "the last of them at its end")
    accepted = graph.results(frame_id="mad", phase="accepted")
    lasted = time.monotonic() - begun
    assert (
        len(accepted) <= 1 + lasted / PACE
    )  # of 2000 and more: the daemon was not asked more often than it wants
    graph.command(0.1, 1, "sane")
    graph.result(frame_id="sane", phase="succeeded")
    graph.undisturbed(before)
    assert graph.bridge.poll() is None


def test_a_client_without_the_lease_receives_the_name_of_its_holder(graph: Graph) -> None:
    until(lambda: graph.daemon.status()["lease"] is None, 10.0, "the lease given back")
    with graph.daemon.client() as holder:
        holder.call("AcquireLease")
        graph.command(0.3, 1, "late")

        def outcomes() -> list[dict[str, Any]]:
            holder.call("RenewLease")
            return graph.results(frame_id="late")

        refused = until(outcomes, 30.0, "an outcome")[0]
        holder.call("ReleaseLease")
    assert refused["phase"] == "refused" and f"pid {os.getpid()}" in refused["message"]


def test_a_stop_and_an_e_stop_are_executed_and_a_late_subscriber_receives_the_state(graph: Graph) -> None:
    graph.command(1.2, 8, "slow")
    graph.result(frame_id="slow", phase="accepted")
    graph.peer.ask("send", topic="/bridge/stop_cmd", message={"data": ""})
    assert graph.result(topic="/bridge/stop_cmd")["phase"] == "done"
    assert graph.result(frame_id="slow", phase="cancelled")
    graph.peer.ask("send", topic="/bridge/estop_cmd", message={"data": "cut"})
    assert graph.result(topic="/bridge/estop_cmd")["phase"] == "done"
    with Peer(graph.router.endpoint) as late:

        def latest() -> dict[str, Any]:
            found = late.ask("received", topic=STATUS)
            return json.loads(found[-1]["data"]) if found else {}

        status = until(latest, 30.0, "a status")
    assert [each["code"] for each in status["faults"]] == ["ESTOP"] and status["mode"] == "sim"
    graph.command(0.1, 1, "latched")
    assert graph.result(frame_id="latched")["phase"] == "refused"
    with graph.daemon.client() as client:
        client.call("Reset")


def test_the_mode_is_changed_by_a_topic_and_what_is_simulated_is_called_otherwise(graph: Graph) -> None:
    graph.peer.ask("send", topic="/bridge/set_mode_cmd", message={"data": "mirror"})
    assert graph.result(topic="/bridge/set_mode_cmd", asked="mirror")["phase"] == "done"
    graph.states("/sim/joint_states_mirrored")
    graph.peer.ask("received", topic="/sim/joint_states")
    graph.states("/sim/joint_states_mirrored")
    assert graph.peer.ask("received", topic="/sim/joint_states") == []
    graph.peer.ask("send", topic="/bridge/set_mode_cmd", message={"data": "sim"})
    assert graph.result(topic="/bridge/set_mode_cmd", asked="sim")["phase"] == "done"
    graph.states("/sim/joint_states")


def test_a_bridge_that_ends_or_dies_releases_the_motion(graph: Graph) -> None:
    for number in (signal.SIGTERM, signal.SIGKILL):
        graph.command(0.1, 1, f"there {number}")
        graph.result(frame_id=f"there {number}", phase="succeeded")
        graph.command(1.4, 20, f"way {number}")
        graph.result(frame_id=f"way {number}", phase="accepted")
        until(lambda: graph.motion() == "active", 10.0, "on its way")
        graph.bridge.send_signal(number)
        assert graph.bridge.wait(10) == (0 if number == signal.SIGTERM else -number)
        if number == signal.SIGTERM:
            graph.result(frame_id=f"way {number}", phase="cancelled")
            last = graph.status()
            assert list(last) == ["bridge"] and last["bridge"]["error"] == "the bridge has ended", last
            assert not (last["bridge"]["daemon"] or last["bridge"]["commands"] or last["bridge"]["driving"])
        until(lambda: graph.motion() == "holding", 10.0, "the robot holds")
        assert graph.daemon.status()["lease"] is None
        graph.bridge = graph.begin()
        graph.peer.__exit__(None, None, None)
        graph.peer = graph.make_peer()
    assert "Traceback" not in graph.log()


def test_a_clock_a_day_off_shows_in_stamps_and_in_refusals_and_in_nothing_else(
    graph: Graph, tmp_path: Path
) -> None:
    with Router(gossip=True) as router, Graph(tmp_path, router, graph.daemon, "-c", SHIFTED) as other:
        stamp = other.states()[-1]["header"]["stamp"]
        assert abs(time.time() - DAY - stamp["sec"]) < 10.0
        other.command(0.2, 1, "ours", stamp={"sec": int(time.time()), "nanosec": 0})
        assert "ahead of the robot's clock" in other.result(frame_id="ours")["message"]
        other.command(0.2, 1, "now")
        assert other.result(frame_id="now", phase="succeeded")


def test_a_dead_daemon_is_reported_as_absent_and_the_next_one_is_found(graph: Graph) -> None:
    graph.daemon.kill()
    until(lambda: graph.status().get("bridge", {}).get("daemon") is False, 30.0, "it is told")
    graph.command(0.1, 1, "nobody")
    assert "no daemon" in graph.result(frame_id="nobody", phase="refused")["message"]
    graph.daemon = Daemon(graph.folder / "run", "--mode", "sim", "--robot", "h24")
    graph.peer.ask("received", topic="/joint_states")
    graph.states()
    graph.command(0.2, 1, "again")
    graph.result(frame_id="again", phase="succeeded")


def test_two_bridges_in_one_domain_move_nothing_until_one_is_alone(graph: Graph) -> None:
    second = graph.begin()
    try:
        until(lambda: graph.log().count("another bridge takes commands") == 2, 30.0, "both say so")
        graph.command(0.3, 1, "both")
        until(lambda: len(graph.results(frame_id="both")) == 2, 30.0, "two answers")
        told = graph.results(frame_id="both")
        assert {each["phase"] for each in told} == {"refused"} and len({each["bridge"] for each in told}) == 2
    finally:
        second.send_signal(signal.SIGTERM)
        second.wait(10)
    until(lambda: "the other bridge is gone" in graph.log(), 30.0, "one is alone")
    graph.command(0.3, 1, "one")
    graph.result(frame_id="one", phase="succeeded")
