"""`Dds` by itself: what it asks its library for, what it carries, what it says where it cannot."""

import dataclasses
import importlib.metadata
import importlib.util
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
import tomllib
import xml.etree.ElementTree as xml
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import pytest
import ros_peer
from dds_domain import free_domain
from hypothesis import given
from hypothesis import strategies as st
from processes import until

from twind.bridge.ros.dds import Dds
from twind.bridge.ros.dds.config import configuration, participants
from twind.bridge.ros.dds.ends import BLOCKING
from twind.bridge.ros.dds.library import KNOWN
from twind.bridge.ros.dds.loopback import keep_here, sockets
from twind.bridge.ros.dds.names import GRAPH, dds_name, user_data
from twind.bridge.ros.discovery import Discovery, Range
from twind.bridge.ros.endpoints import SERVICES, Topic
from twind.bridge.ros.goal import LONGEST
from twind.bridge.ros.transport import TransportError
from twind.ctl.extras import how_to_add
from twind.ros import JOINT_STATE, STRING

OUT, INTO = Topic("/echo", STRING, out=True), Topic("/echo", STRING, out=False, depth=1000)
OWN = "<CycloneDDS><Domain><General/></Domain></CycloneDDS>"


def nothing(*_: object) -> tuple[bool, str]:
    return False, ""


def settings(discovery: Discovery, own: str = "") -> xml.Element:
    made = configuration(discovery, own)
    assert made is not None
    return xml.fromstring(made.partition(",")[0])


# ------------------------------------------------------------------------------------- where to look


@pytest.mark.parametrize("reach", [Range.OFF, Range.LOCALHOST])
def test_this_machine_alone_is_the_loopback_without_multicast(reach: Range) -> None:
    found = settings(Discovery(range=reach), OWN)
    (interface,) = found.iter("NetworkInterface")
    assert (interface.get("address"), interface.get("multicast")) == ("127.0.0.1", "false")
    assert found.findtext(".//AllowMulticast") == "false"
    peers = [each.get("address") for each in found.iter("Peer")]
    assert peers == ([] if reach is Range.OFF else ["127.0.0.1"])
    index = found.findtext(".//ParticipantIndex")
    assert index == ("none" if reach is Range.OFF else "auto")
    assert OWN not in str(configuration(Discovery(range=reach), OWN))  # it would name a network


def test_named_peers_are_asked_by_unicast() -> None:
    found = settings(Discovery(peers=("127.0.0.2", "127.0.0.3", "127.0.0.2")))
    assert found.findtext(".//AllowMulticast") == "false"
    assert [each.get("address") for each in found.iter("Peer")] == ["127.0.0.1", "127.0.0.2", "127.0.0.3"]
    assert not list(found.iter("NetworkInterface"))


def test_peers_are_never_given_up_and_this_machine_hears_of_us_each_second() -> None:
    far = settings(Discovery(peers=("127.0.0.2",)))
    for found, interval in ((settings(Discovery()), "1 s"), (far, None)):
        assert found.findtext(".//InitialLocatorPruneDelay") == "inf"
        assert found.findtext(".//SPDPInterval") == interval  # a network is not filled with questions


def test_a_subnet_is_searched_by_multicast_and_a_users_own_configuration_counts() -> None:
    found = settings(Discovery(range=Range.SUBNET))
    assert found.find(".//AllowMulticast") is None and not list(found.iter("NetworkInterface"))
    assert str(configuration(Discovery(range=Range.SUBNET), OWN)).endswith(f",{OWN}")
    assert configuration(Discovery(range=Range.SYSTEM_DEFAULT), OWN) == OWN
    assert configuration(Discovery(range=Range.SYSTEM_DEFAULT)) is None


def test_a_peer_without_an_address_is_told_and_ends_no_process() -> None:
    with pytest.raises(TransportError, match=r"ROS_STATIC_PEERS: no-such-host\.invalid"):
        configuration(Discovery(peers=("no-such-host.invalid",)))


@pytest.mark.parametrize("domain", [0, 1, 231, 232])
def test_all_participants_of_a_domain_have_ports_of_it(domain: int) -> None:
    last = 7400 + 250 * domain + 10 + 2 * (participants(domain) - 1) + 1
    assert last <= min(7400 + 250 * (domain + 1) - 1, 65535)


def test_names_on_dds_are_those_of_ros() -> None:
    assert dds_name(Topic("/hw/joint_states", JOINT_STATE, out=True)) == "rt/hw/joint_states"
    assert dds_name(GRAPH) == "ros_discovery_info"
    hashed = "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    assert user_data(Topic("/x", JOINT_STATE, out=True)) == f"typehash=RIHS01_{hashed};".encode()


# ------------------------------------------------------------------------------------- bytes


@pytest.fixture(scope="module")
def echo() -> Iterator[tuple[Dds, list[bytes]]]:
    """Hears what it says itself."""
    heard: list[bytes] = []
    with free_domain() as domain:
        node = Dds(Discovery(domain=domain), print)
        node.open((OUT, INTO), SERVICES, lambda _, data: heard.append(data), nothing)
        yield node, heard
        node.close()


@given(body=st.binary(min_size=1, max_size=4096))
def test_any_bytes_come_out_as_they_went_in(echo: tuple[Dds, list[bytes]], body: bytes) -> None:
    node, heard = echo
    heard.clear()
    node.publish(OUT, b"\x00\x01\x00\x00" + body)
    deadline = time.monotonic() + 10.0
    while not heard and time.monotonic() < deadline:
        time.sleep(0.0001)
    assert heard[0][4 : 4 + len(body)] == body
    assert len(heard[0]) - 4 - len(body) in range(4)  # filled up to a multiple of four


@pytest.mark.parametrize("data", [b"", b"\x00\x01", b"\x00\x01\x00\x00", b"\xff\xff\x00\x00body"])
def test_what_is_no_message_at_all_is_refused(echo: tuple[Dds, list[bytes]], data: bytes) -> None:
    with pytest.raises(TransportError, match=rf"/echo: {len(data)} bytes are no CDR"):
        echo[0].publish(OUT, data)


def test_a_topic_that_is_not_open_is_refused(echo: tuple[Dds, list[bytes]]) -> None:
    with pytest.raises(TransportError, match="/other: no such topic is open"):
        echo[0].publish(Topic("/other", STRING, out=True), b"\x00\x01\x00\x00abcd")


def test_what_is_too_long_comes_as_far_as_that_shows(echo: tuple[Dds, list[bytes]]) -> None:
    node, heard = echo
    for length in (LONGEST, LONGEST + 3, LONGEST + 4000):
        heard.clear()
        node.publish(OUT, (b"\x00\x01\x00\x00" + b"x" * length)[:length])
        until(lambda: heard, 10.0, "it comes")
        assert len(heard[0]) == min(length, LONGEST + 1)


# ------------------------------------------------------------------------------------- hearing

SLOW, STOP = Topic("/slow", STRING, out=True), Topic("/stop", STRING, out=True)
WORD = b"\x00\x01\x00\x00word"


def heard_by(heard: Callable[[Topic, bytes], None], told: list[str], domain: int) -> Dds:
    """A node that hears what it says on two topics."""
    node = Dds(Discovery(domain=domain), told.append)
    into = [dataclasses.replace(each, out=False) for each in (SLOW, STOP)]
    node.open((SLOW, STOP, *into), (), heard, nothing)
    return node


def test_a_stop_is_heard_while_another_message_is_still_looked_at() -> None:
    looking, looked, stopped = threading.Event(), threading.Event(), threading.Event()

    def heard(topic: Topic, data: bytes) -> None:
        if topic.name == STOP.name:
            stopped.set()
        else:
            looking.set()
            looked.wait(30.0)

    with free_domain() as domain:
        node = heard_by(heard, [], domain)
        node.publish(SLOW, WORD)
        assert looking.wait(10.0)
        node.publish(STOP, WORD)
        try:
            assert stopped.wait(10.0) and not looked.is_set()
        finally:
            looked.set()
            node.close()


def test_who_fails_at_one_message_hears_the_next_and_it_is_told() -> None:
    told: list[str] = []
    came: list[bytes] = []

    def heard(topic: Topic, data: bytes) -> None:
        came.append(data)
        if len(came) == 1:
            raise OSError("a fault of ours")

    with free_domain() as domain:
        node = heard_by(heard, told, domain)
        for count in (1, 2):
            node.publish(STOP, WORD)
            until(lambda count=count: len(came) == count, 10.0, "it comes")
        node.publish(STOP, WORD)
        node.close()
    assert told == ["dds: /stop: a message was lost: OSError: a fault of ours"]


def test_a_reader_that_can_read_no_more_is_a_graph_that_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> list[bytes]:
        raise MemoryError("no room")

    with free_domain() as domain:
        node = heard_by(lambda *_: None, [], domain)
        monkeypatch.setattr("twind.bridge.ros.dds.ends.Reader.take", full)
        node.publish(STOP, WORD)

        def lost() -> str:
            try:
                node.publish(SLOW, WORD)
            except TransportError as error:
                return str(error)
            return ""

        assert until(lost, 10.0, "it is told").startswith("dds: /s")
        node.close()


# ------------------------------------------------------------------------------------- who gets in


def bound(opened: Collection[int]) -> dict[int, bytes]:
    """Port -> device, of those sockets that speak UDP."""
    found = {}
    for descriptor in opened:
        with socket.socket(fileno=os.dup(descriptor)) as each:
            if each.type == socket.SOCK_DGRAM:
                device = each.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16)
                found[each.getsockname()[1]] = device.rstrip(b"\0")
    return found


@pytest.mark.parametrize("reach", [Range.OFF, Range.LOCALHOST])
def test_on_this_machine_alone_no_socket_hears_a_network(reach: Range) -> None:
    told: list[str] = []
    with free_domain() as domain:
        before, node = sockets(), Dds(Discovery(domain=domain, range=reach), told.append)
        node.open((OUT, INTO), (), nothing, nothing)
        devices = bound(sockets() - before)
        node.close()
    assert len(devices) >= 2 and set(devices.values()) == {b"lo"}
    if reach is Range.LOCALHOST:
        assert {7410 + 250 * domain, 7411 + 250 * domain} <= set(devices)
    assert told == []


def test_a_socket_that_cannot_be_closed_to_others_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr("twind.bridge.ros.dds.loopback._LOOPBACK", b"no-such\0")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one, socket.socket(socket.AF_UNIX) as other:
        keep_here([one.fileno(), other.fileno()], told.append)
    assert len(told) == 1 and "a firewall closes it" in told[0]


# ------------------------------------------------------------------------------------- coming, going


def test_it_may_be_left_twice_and_joined_again() -> None:
    with free_domain() as domain:
        heard: list[bytes] = []
        node = Dds(Discovery(domain=domain), print)
        node.close()
        for _ in range(3):
            node.open((OUT, INTO), (), lambda _, data: heard.append(data), nothing)
            node.publish(OUT, b"\x00\x01\x00\x00abcd")
            node.close()
            node.close()
        with pytest.raises(TransportError, match="no such topic is open"):
            node.publish(OUT, b"\x00\x01\x00\x00abcd")


def test_two_of_one_process_in_a_domain_are_refused_in_words_and_leave_the_first_alone() -> None:
    with free_domain() as domain:
        first, second = Dds(Discovery(domain=domain), print), Dds(Discovery(domain=domain), print)
        first.open((OUT,), (), nothing, nothing)
        with pytest.raises(TransportError, match=f"ROS_DOMAIN_ID={domain}: another of this process"):
            second.open((OUT,), (), nothing, nothing)
        first.publish(OUT, b"\x00\x01\x00\x00abcd")
        first.close()
        second.open((OUT,), (), nothing, nothing)
        second.close()


def test_messages_that_found_no_room_are_counted_and_told_ever_more_rarely(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[str] = []
    with free_domain() as domain:
        node = Dds(Discovery(domain=domain), told.append)
        node.open((OUT,), (), nothing, nothing)
        monkeypatch.setattr("twind.bridge.ros.dds.ends.Writer.write", lambda *_: False)
        for _ in range(120):
            node.publish(OUT, b"\x00\x01\x00\x00abcd")
        node.close()
    assert node.dropped == 120
    assert [line.split()[-3] for line in told] == ["1", "10", "100"]
    assert BLOCKING == 5_000_000


@pytest.mark.parametrize("version", ["11.0.2", "11.1.0", "12.0.0"])
def test_a_missing_or_unknown_library_is_told_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch, version: str
) -> None:
    node = Dds(Discovery(), print)
    with monkeypatch.context() as patch:
        patch.setattr(importlib.metadata, "version", lambda _: version)
        with pytest.raises(
            TransportError, match=rf"{version} is installed, must be {KNOWN}: {re.escape(how_to_add('dds'))}"
        ):
            node.open((OUT,), (), nothing, nothing)
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(TransportError, match=rf"cyclonedds is missing: {re.escape(how_to_add('dds'))}"):
        node.open((OUT,), (), nothing, nothing)


def test_what_is_installed_is_the_version_whose_layouts_are_known() -> None:
    project = tomllib.loads(Path(__file__).parents[1].joinpath("pyproject.toml").read_text())
    (wanted,) = project["project"]["optional-dependencies"]["dds"]
    assert wanted.partition(";")[0] == f"cyclonedds=={KNOWN}"


LEAVES = """
import sys, time
from pathlib import Path
from twind.bridge.ros.dds import Dds
from twind.bridge.ros.discovery import discovery
from twind.bridge.ros.endpoints import STATUS, TOPICS
from twind.ros import STRING, encode

def sent():
    lines = Path("/proc/net/dev").read_text().splitlines()
    (line,) = [line for line in lines if line.strip().startswith("d0:")]
    return int(line.split(":")[1].split()[9])

node, before = Dds(discovery({"ROS_AUTOMATIC_DISCOVERY_RANGE": sys.argv[1]}), print), sent()
node.open(TOPICS, (), lambda *_: None, lambda *_: (False, ""))
for _ in range(20):
    node.publish(STATUS, encode(STRING, {"data": "x"}))
    time.sleep(0.05)
node.close()
print(sent() - before)
"""
NETWORK = """
ip link set lo up && ip link add d0 type veth peer name d1 && ip addr add 10.9.9.1/24 dev d0 || exit 77
sysctl -qw net.ipv6.conf.all.disable_ipv6=1
ip link set d0 up && ip link set d1 up && exec "$@"
"""


@pytest.mark.realtime  # a second each, in processes of their own
@pytest.mark.parametrize(("reach", "leaves"), [("", False), ("OFF", False), ("SUBNET", True)])
def test_no_packet_leaves_this_machine_until_that_is_asked_for(reach: str, leaves: bool) -> None:
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip("needs unshare and ip: a network of its own")
    command = ["unshare", "-rn", "sh", "-c", NETWORK, "sh", sys.executable, "-c", LEAVES, reach]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
    if done.returncode and ("unshare" in done.stderr or done.returncode == 77):
        pytest.skip(f"this machine gives no network of its own: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    assert (int(done.stdout) > 0) is leaves


SPEAKS = """
import sys
import time
from twind.bridge.ros.dds import Dds
from twind.bridge.ros.discovery import discovery
from twind.bridge.ros.endpoints import STATUS, TOPICS
from twind.ros import STRING, encode

node = Dds(discovery({}), print)
node.open(TOPICS, (), lambda topic, _: print(topic.name, flush=True), lambda *_: (False, ""))
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
orders = node.create_publisher(String, "/bridge/set_mode_cmd", 10)
while not (heard and orders.get_subscription_count()) and time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
orders.publish(String(data="sim"))
time.sleep(1.0)
print(bool(heard), ("twind", "/") in node.get_node_names_and_namespaces(), flush=True)
"""
BOTH = """
ip route add default dev d0 || exit 77
"$1" -c "$2" >heard & speaks=$!
until grep -q open heard; do kill -0 $speaks || exit 1; sleep 0.1; done
sleep 1
ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET "$3" -c "$4"
kill $speaks; cat heard
"""


@pytest.mark.realtime  # two processes that have to find each other
def test_a_ros_terminal_with_the_range_that_ros_has_by_itself_is_met(tmp_path: Path) -> None:
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip("needs unshare and ip: a network of its own, with multicast")
    both = ["sh", "-c", BOTH, "sh", sys.executable, SPEAKS, ros_peer.python(), USUAL]
    environment = ros_peer.environment(tmp_path, 0)
    del environment["FASTDDS_DEFAULT_PROFILES_FILE"], environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]
    done = subprocess.run(
        ["unshare", "-rn", "sh", "-c", NETWORK, "sh", *both],
        capture_output=True,
        text=True,
        timeout=90.0,
        env=environment,
        cwd=tmp_path,
    )
    if done.returncode and ("unshare" in done.stderr or done.returncode == 77):
        pytest.skip(f"this machine gives no network of its own: {done.stderr.strip()}")
    words = done.stdout.split()
    assert words[:2] == ["True", "True"] and "/bridge/set_mode_cmd" in words, done.stdout + done.stderr
