"""The rclpy back end as a transport: what a node of another process sees of it, whatever stands behind it."""

from collections.abc import Iterator

import pytest
from ros_graphs import REAL, Graph, Peer, here

pytestmark = pytest.mark.realtime

# Live waits for a daemon that hangs, mirror raises. `again` on stdin: leaves and joins; else: what it heard.
HOST = """
import json, os, sys, time
from twind.bridge.ros.discovery import discovery
from twind.bridge.ros.endpoints import HW_JOINTS, SERVICES, STATUS, TO_MODE, TOPICS, TRAJECTORY
from twind.bridge.ros.rclpy_node import Rclpy
from twind.bridge.ros.transport import TransportError
from twind.ros import JOINT_STATE, STRING, encode

heard, told = [], []

def asked(service, data):
    if service is TO_MODE["live"]:
        time.sleep(3.0)
    if service is TO_MODE["mirror"]:
        raise ValueError("a fault of ours")
    return True, service.name

def begin(node):
    node.open(TOPICS, SERVICES, lambda topic, data: heard.append([topic.name, data.hex()]), asked)
    node.publish(STATUS, encode(STRING, {"data": json.dumps({"mode": "sim"})}))

node = Rclpy(discovery(os.environ), told.append)
begin(node)
print("ready", flush=True)
for line in sys.stdin:
    if line == "again\\n":
        node.close()
        try:
            node.publish(HW_JOINTS, encode(JOINT_STATE, {}))
        except TransportError as error:
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


def test_a_callback_that_fails_is_told_and_answered_and_ends_nothing(host: Host) -> None:
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


def test_a_node_that_left_says_so_and_comes_again(host: Host) -> None:
    assert "has left the graph" in host.say("again")
    host.peer.hear(topic="/bridge/status", kind="String", latched=True)
    assert host.peer.next(topic="/bridge/status") == '{"mode": "sim"}'
