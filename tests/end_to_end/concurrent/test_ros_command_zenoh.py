"""`twindctl ros --backend zenoh` between a daemon in sim and a peer of ROS: every process is a real one."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import PATIENCE, Daemon, until
from tests.support.ros_zenoh_peer import Peer
from tests.support.zenoh_router import Router
from twind.bridge.ros.ros_endpoints import (
    GET_STATUS,
    RESULTS,
    SIM_JOINTS,
    STATUS,
    TO_E_STOP,
    TO_STOP,
    TRAJECTORY,
)
from twind.ros import JOINT_STATE, JOINT_TRAJECTORY, STRING, TRIGGER

pytest.importorskip("zenoh_ros2_sdk", reason="no zenoh-ros2-sdk here (it needs git)")
JOINT = "l_knee"
EMPTY = {"structure_needs_at_least_one_member": 0}


class Graph:
    """A daemon, its bridge, a router and a peer."""

    def __init__(self, daemon: Daemon, router: Router, peer: Peer, bridge: "subprocess.Popen[str]") -> None:
        self.daemon = daemon
        self.router = router
        self.peer = peer
        self.bridge = bridge
        self._stamp = 0

    def command(self, *positions: float, seconds: float = 0.5) -> dict[str, int]:
        """A trajectory of one joint, from the peer; its frame's number, by which results know it."""
        self._stamp += 1
        point = {
            "_": "trajectory_msgs/msg/JointTrajectoryPoint",
            "velocities": [],
            "accelerations": [],
            "effort": [],
        }
        points = [
            point | {"positions": [place], "time_from_start": duration(seconds * (number + 1))}
            for number, place in enumerate(positions)
        ]
        stamp = {"_": "builtin_interfaces/msg/Time", "sec": 0, "nanosec": 0}
        header = {"_": "std_msgs/msg/Header", "stamp": stamp, "frame_id": str(self._stamp)}
        message = {"header": header, "joint_names": [JOINT], "points": points}
        self.peer.ask("say", topic=TRAJECTORY.name, kind=JOINT_TRAJECTORY, message=message)
        return {"number": self._stamp}

    def results(self, number: int) -> list[dict[str, Any]]:
        """Results of a command so far."""
        told = [json.loads(each["data"]) for each in self.peer.ask("received", topic=RESULTS.name)]
        return [each for each in told if each.get("frame_id") == str(number)]

    def ended(self, number: int) -> dict[str, Any]:
        """Last result of a command."""

        def last() -> dict[str, Any] | None:
            return next((each for each in self.results(number) if each["phase"] not in ("accepted",)), None)

        return until(
            last, PATIENCE, f"command {number} ends: {self.peer.ask('received', topic=RESULTS.name)[-3:]}"
        )

    def place(self) -> float:
        """Position of the joint by the newest message, rad."""
        newest = self.peer.ask("received", topic=SIM_JOINTS.name)[-1]
        return float(newest["position"][newest["name"].index(JOINT)])


def duration(seconds: float) -> dict[str, Any]:
    sec, rest = divmod(round(seconds * 1e9), 10**9)
    return {"_": "builtin_interfaces/msg/Duration", "sec": sec, "nanosec": rest}


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory, blank_messages: None) -> Iterator[Graph]:
    folder: Path = tmp_path_factory.mktemp("run")
    daemon = Daemon(folder, "--mode", "sim")
    words = ["--socket", str(folder), "ros", "--backend", "zenoh", "--rate", "50", "--zenoh-connect"]
    try:
        daemon.reach(mode="sim")
        with Router(gossip=True) as router, Peer(router.endpoint) as peer:
            bridge = subprocess.Popen(
                [sys.executable, "-m", "twind.ctl.ctl_main", *words, router.endpoint],
                stderr=subprocess.PIPE,
                text=True,
            )
            try:
                peer.ask("hear", topic=SIM_JOINTS.name, kind=JOINT_STATE)
                peer.ask("hear", topic=RESULTS.name, kind=STRING)
                until(
                    lambda: peer.ask("counted", topic=SIM_JOINTS.name)["count"], PATIENCE, "joints are told"
                )
                yield Graph(daemon, router, peer, bridge)
            finally:
                begun = time.monotonic()
                bridge.send_signal(signal.SIGTERM)
                try:
                    code = bridge.wait(PATIENCE)
                finally:
                    bridge.kill()
                print(f"ended by {code} after {time.monotonic() - begun:.1f} s: {bridge.communicate()[1]}")
                assert code == 0
    finally:
        daemon.kill()


def test_a_trajectory_of_a_peer_moves_the_robot_and_its_end_is_published(graph: Graph) -> None:
    before = graph.place()
    command = graph.command(before + 0.1, seconds=1.0)
    end = graph.ended(**command)
    assert end["phase"] == "succeeded", end
    assert graph.results(**command)[0]["phase"] == "accepted"
    until(lambda: abs(graph.place() - before - 0.1) < 0.01, PATIENCE, "the joint is there")


def test_the_last_status_waits_for_who_comes_later_and_services_answer(graph: Graph) -> None:
    graph.peer.ask("hear_latched", topic=STATUS.name, kind=STRING)
    until(lambda: graph.peer.ask("received", topic=STATUS.name), PATIENCE, "a status comes")
    assert json.loads(graph.peer.ask("received", topic=STATUS.name)[0]["data"])["mode"] == "sim"
    told = graph.peer.ask("call", service=GET_STATUS.name, kind=TRIGGER, request=EMPTY)
    assert told["success"] and json.loads(told["message"])["mode"] == "sim"


def test_a_stop_by_service_ends_a_motion(graph: Graph) -> None:
    command = graph.command(graph.place() + 0.1, seconds=20.0)
    until(lambda: graph.results(**command), PATIENCE, "it is accepted")
    told = graph.peer.ask("call", service=TO_STOP.name, kind=TRIGGER, request=EMPTY)
    assert told["success"], told
    assert graph.ended(**command)["phase"] == "cancelled"


def test_an_e_stop_by_service_is_latched(graph: Graph) -> None:
    told = graph.peer.ask("call", service=TO_E_STOP.name, kind=TRIGGER, request=EMPTY)
    assert told["success"], told
    assert graph.ended(**graph.command(graph.place()))["phase"] == "refused"
