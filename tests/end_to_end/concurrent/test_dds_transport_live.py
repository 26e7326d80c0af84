"""Real-time tests of ros dds."""

import sys
from pathlib import Path

import pytest

from tests.support import own_network
from tests.support import rclpy_environment as ros_peer

LEAVES = """
import sys, time
from pathlib import Path
from twind.bridge.ros.dds import DdsTransport
from twind.bridge.ros.discovery import discovery
from twind.bridge.ros.ros_endpoints import STATUS, TOPICS
from twind.ros import STRING, encode

def sent():
    lines = Path("/proc/net/dev").read_text().splitlines()
    (line,) = [line for line in lines if line.strip().startswith("d0:")]
    return int(line.split(":")[1].split()[9])

node, before = DdsTransport(discovery({"ROS_AUTOMATIC_DISCOVERY_RANGE": sys.argv[1]}), print), sent()
node.open(TOPICS, (), lambda *_: None, lambda *_: (False, ""))
for _ in range(20):
    node.publish(STATUS, encode(STRING, {"data": "x"}))
    time.sleep(0.05)
node.close()
print(sent() - before)
"""


@pytest.mark.parametrize(("reach", "leaves"), [("", False), ("OFF", False), ("SUBNET", True)])
def test_no_packet_leaves_this_machine_until_that_is_asked_for(reach: str, leaves: bool) -> None:
    done = own_network.run(sys.executable, "-c", LEAVES, reach, seconds=60.0)
    assert done.returncode == 0, done.stderr
    assert (int(done.stdout) > 0) is leaves


SPEAKS = """
import sys
import time
from twind.bridge.ros.dds import DdsTransport
from twind.bridge.ros.discovery import discovery
from twind.bridge.ros.ros_endpoints import STATUS, TOPICS
from twind.ros import STRING, encode

node = DdsTransport(discovery({}), print)
node.open(TOPICS, (), lambda *_: None, lambda *_: (False, ""))
print("open", flush=True)
for _ in range(400):
    node.publish(STATUS, encode(STRING, {"data": "x"}))
    time.sleep(0.05)
node.close()
"""
USUAL = """
import time
import rclpy
from std_msgs.msg import String

rclpy.init()
node, heard, end = rclpy.create_node("usual"), [], time.monotonic() + 15.0
node.create_subscription(String, "/bridge/status", heard.append, 10)
listed = lambda: ("twind", "/") in node.get_node_names_and_namespaces()
while not (heard and listed()) and time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
print(bool(heard), listed(), flush=True)
"""
BOTH = """
"$1" -c "$2" >log & speaks=$!
until grep -q open log; do kill -0 $speaks || exit 1; sleep 0.1; done
sleep 1
ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET "$3" -c "$4"
kill $speaks
"""


def test_a_ros_terminal_with_the_range_that_ros_has_by_itself_is_met(tmp_path: Path) -> None:
    environment = ros_peer.environment(tmp_path, 0)
    del environment["FASTDDS_DEFAULT_PROFILES_FILE"], environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]
    words = ["sh", "-c", BOTH, "sh", sys.executable, SPEAKS, ros_peer.python(), USUAL]
    done = own_network.run(*words, seconds=90.0, environment=environment, folder=tmp_path)
    assert done.stdout.split() == ["True", "True"], done.stdout + done.stderr
