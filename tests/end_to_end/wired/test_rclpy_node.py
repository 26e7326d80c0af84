"""The rclpy back end as a transport: what a node of another process sees of it, whatever stands behind it."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.processes import PATIENCE, until
from tests.support.ros_graphs import REAL, Graph, Peer, here

# Live waits for a daemon that hangs, mirror raises; a trajectory of 5 bytes is looked at for long.
# `again` on stdin: leaves and joins; else: what it heard.
HOST = """
import json, os, sys, threading, time
from twind.bridge.ros.discovery import discovery
from twind.bridge.ros.ros_endpoints import HW_JOINTS, SERVICES, STATUS, TO_MODE, TOPICS, TRAJECTORY
from twind.bridge.ros.rclpy_node import RclpyTransport
from twind.exceptions import OperationFailed
from twind.ros import JOINT_STATE, STRING, encode

heard, told = [], []

def hear(topic, data):
    heard.append([topic.name, data.hex()])
    if topic is TRAJECTORY and data.startswith(bytes.fromhex("0001000005")):
        time.sleep(5.0)
        heard.append("looked at")

def asked(service, data, reply):
    if service is TO_MODE["live"]:
        threading.Timer(3.0, reply, [True, service.name]).start()
        return
    if service is TO_MODE["mirror"]:
        raise ValueError("a fault of ours")
    reply(True, service.name)

def begin(node):
    node.open(TOPICS, SERVICES, hear, asked)
    node.publish(STATUS, encode(STRING, {"data": json.dumps({"mode": "sim"})}))

node = RclpyTransport(discovery(os.environ), told.append)
begin(node)
print("ready", flush=True)
for line in sys.stdin:
    if line == "again\\n":
        node.close()
        try:
            node.publish(HW_JOINTS, encode(JOINT_STATE, {}))
        except OperationFailed as error:
            print(json.dumps(str(error)), flush=True)
        begin(node)
    else:
        print(json.dumps({"heard": heard, "told": told}), flush=True)
node.close()
node.close()
os._exit(0)
"""


class Host:
    """The process with the transport, and a peer that meets it."""

    def __init__(self, graph: Graph) -> None:
        self.process = graph.run(HOST)
        assert self.process.stdout is not None and self.process.stdout.readline() == "ready\n"
        self.peer: Peer = graph.peer()

    def say(self, word: str) -> str:
        """The line that it answers."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(word + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline()


@pytest.fixture(scope="module", params=[here(), REAL])
def host(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    graph = Graph(request.param, tmp_path_factory.mktemp("graph"))
    try:
        yield Host(graph)
    finally:
        graph.close()


def test_an_e_stop_does_not_wait_for_a_mode_that_does_not_come(host: Host) -> None:
    slow, quick = host.peer.race(slow="/bridge/set_mode_live", quick="/bridge/estop")
    assert slow >= 2.5
    assert quick < slow - 1.0


def test_a_callback_that_raises_is_reported_answered_and_ends_nothing(host: Host) -> None:
    answer = host.peer.ask(service="/bridge/set_mode_mirror", kind="Trigger")
    assert answer == [False, "ValueError: a fault of ours"]
    assert host.peer.ask(service="/bridge/stop", kind="Trigger") == [True, "/bridge/stop"]
    assert "a fault of ours" in host.say("go")


def test_bytes_arrive_as_they_were_sent_malformed_ones_too(host: Host) -> None:
    for data in ("00010000ffffffff", "0001000000000000"):
        host.peer.say_bytes(topic="/cmd/joint_trajectory", data=data)
    host.peer.ask(service="/bridge/stop", kind="Trigger")
    heard = ""
    for _ in range(200):
        heard = host.say("go")
        if "0001000000000000" in heard:
            break
    assert '["/cmd/joint_trajectory", "00010000ffffffff"]' in heard


def test_a_stop_is_received_during_the_handling_of_a_trajectory(host: Host) -> None:
    host.peer.say_bytes(topic="/bridge/stop_cmd", kind="String", data="00010000" + "01000000" + "00")
    host.peer.say_bytes(topic="/cmd/joint_trajectory", data="0001000005")
    until(lambda: "0001000005" in host.say("go"), PATIENCE, "the trajectory is looked at")
    before = host.say("go").count("/bridge/stop_cmd")
    host.peer.say_bytes(topic="/bridge/stop_cmd", kind="String", data="00010000" + "01000000" + "00")
    until(lambda: host.say("go").count("/bridge/stop_cmd") > before, PATIENCE, "the stop is heard")
    assert "looked at" not in host.say("go")


FEEDBACK = """
import json, time
from types import SimpleNamespace
import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from twind.bridge.ros.rclpy_action_server import TrajectoryActionServer
rclpy.init()
follow = TrajectoryActionServer(rclpy.create_node("feedback"), FollowJointTrajectory, None, None)
told = []
goal = SimpleNamespace(trajectory=SimpleNamespace(joint_names=["a"]))
joints = [{"name": "a", "goal": 0.5, "simulated": 0.25}]
reading = time.monotonic()
wall = time.time()
state = {"time": reading - 30.0, "joints": joints, "mode": "sim"}
follow._publish(SimpleNamespace(request=goal, publish_feedback=told.append), state)
stamp = told[0].header.stamp
print(json.dumps({"late": wall - stamp.sec - stamp.nanosec / 1e9, "nanosec": stamp.nanosec,
                  "alone": type(follow._server._group) is MutuallyExclusiveCallbackGroup}), flush=True)
__import__("os")._exit(0)
"""


def test_feedback_has_the_time_of_its_reading_and_goals_are_asked_for_one_after_the_other(
    tmp_path: Path,
) -> None:
    graph = Graph(here(), tmp_path)
    try:
        process = graph.run(FEEDBACK)
        assert process.stdout is not None
        told = json.loads(process.stdout.readline())
    finally:
        graph.close()
    assert abs(told["late"] - 30.0) < 5.0 and 0 <= told["nanosec"] < 10**9
    assert told["alone"]


def test_a_node_that_left_the_graph_reports_it_and_rejoins(host: Host) -> None:
    assert "has left the graph" in host.say("again")
    host.peer.hear(topic="/bridge/status", kind="String", latched=True)
    assert host.peer.next(topic="/bridge/status") == '{"mode": "sim"}'
