"""`DdsTransport` by itself: settings of its library, refusals of what it cannot send, joining and leaving."""

import importlib.metadata
import importlib.util
import os
import re
import socket
import tomllib
import xml.etree.ElementTree as xml
from collections.abc import Collection, Iterator
from pathlib import Path

import pytest

from tests.support.dds_domain import free_domain
from twind.bridge.ros.dds import DdsTransport
from twind.bridge.ros.dds.dds_config import configuration, participants
from twind.bridge.ros.dds.dds_library import KNOWN
from twind.bridge.ros.dds.dds_names import GRAPH, dds_name, user_data
from twind.bridge.ros.dds.loopback_only import keep_here, sockets
from twind.bridge.ros.discovery import DiscoveryRange, DiscoverySettings
from twind.bridge.ros.ros_endpoints import DIAGNOSTICS, SERVICES, RosTopic
from twind.bridge.ros.ros_names import ROOT_NODE, NodeName
from twind.command_line.extras import how_to_add
from twind.exceptions import OperationFailed
from twind.ros import JOINT_STATE, STRING

OUT = RosTopic("/out", STRING, out=True)
INTO = RosTopic("/into", STRING, out=False)
OWN = "<CycloneDDS><Domain><General/></Domain></CycloneDDS>"


def nothing(*_: object) -> tuple[bool, str]:
    return False, ""


def settings(discovery: DiscoverySettings, own: str = "") -> xml.Element:
    made = configuration(discovery, own)
    assert made is not None
    return xml.fromstring(made.partition(",")[0])


# ------------------------------------------------------------------------------------- where to look


@pytest.mark.parametrize("reach", [DiscoveryRange.OFF, DiscoveryRange.LOCALHOST])
def test_this_machine_alone_is_the_loopback_without_multicast(reach: DiscoveryRange) -> None:
    found = settings(DiscoverySettings(range=reach), OWN)
    (interface,) = found.iter("NetworkInterface")
    assert (interface.get("address"), interface.get("multicast")) == ("127.0.0.1", "false")
    assert found.findtext(".//AllowMulticast") == "false"
    peers = [each.get("address") for each in found.iter("Peer")]
    assert peers == ([] if reach is DiscoveryRange.OFF else ["127.0.0.1"])
    index = found.findtext(".//ParticipantIndex")
    assert index == ("none" if reach is DiscoveryRange.OFF else "auto")
    assert OWN not in str(configuration(DiscoverySettings(range=reach), OWN))  # it would name a network


def test_named_peers_are_asked_by_unicast() -> None:
    found = settings(DiscoverySettings(peers=("127.0.0.2", "127.0.0.3", "127.0.0.2")))
    assert found.findtext(".//AllowMulticast") == "false"
    assert [each.get("address") for each in found.iter("Peer")] == ["127.0.0.1", "127.0.0.2", "127.0.0.3"]
    assert not list(found.iter("NetworkInterface"))


def test_peer_locators_are_never_pruned_and_local_discovery_repeats_each_second() -> None:
    far = settings(DiscoverySettings(peers=("127.0.0.2",)))
    for found, interval in ((settings(DiscoverySettings()), "1 s"), (far, None)):
        assert found.findtext(".//InitialLocatorPruneDelay") == "inf"
        assert found.findtext(".//SPDPInterval") == interval  # a network is not filled with questions


def test_a_subnet_is_searched_by_multicast_and_a_users_own_configuration_counts() -> None:
    found = settings(DiscoverySettings(range=DiscoveryRange.SUBNET))
    assert found.find(".//AllowMulticast") is None and not list(found.iter("NetworkInterface"))
    assert str(configuration(DiscoverySettings(range=DiscoveryRange.SUBNET), OWN)).endswith(f",{OWN}")
    assert configuration(DiscoverySettings(range=DiscoveryRange.SYSTEM_DEFAULT), OWN) == OWN
    assert configuration(DiscoverySettings(range=DiscoveryRange.SYSTEM_DEFAULT)) is None


def test_a_peer_without_an_address_raises_a_transport_error() -> None:
    with pytest.raises(OperationFailed, match=r"ROS_STATIC_PEERS: no-such-host\.invalid"):
        configuration(DiscoverySettings(peers=("no-such-host.invalid",)))


@pytest.mark.parametrize("domain", [0, 1, 231, 232])
def test_all_participants_of_a_domain_have_ports_of_it(domain: int) -> None:
    last = 7400 + 250 * domain + 10 + 2 * (participants(domain) - 1) + 1
    assert last <= min(7400 + 250 * (domain + 1) - 1, 65535)


def test_names_on_dds_are_those_of_ros() -> None:
    joints = RosTopic("/hw/joint_states", JOINT_STATE, out=True)
    assert dds_name(joints, ROOT_NODE) == "rt/hw/joint_states"
    left = NodeName(namespace="/left")
    assert dds_name(joints, left) == "rt/left/hw/joint_states"
    assert dds_name(DIAGNOSTICS, left) == "rt/diagnostics"
    assert dds_name(GRAPH, left) == "ros_discovery_info"
    hashed = "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    assert user_data(RosTopic("/x", JOINT_STATE, out=True)) == f"typehash=RIHS01_{hashed};".encode()


# ------------------------------------------------------------------------------------- refusals


@pytest.fixture(scope="module")
def node() -> Iterator[DdsTransport]:
    """Writes one topic."""
    with free_domain() as domain:
        node = DdsTransport(DiscoverySettings(domain=domain), print)
        node.open((OUT, INTO), SERVICES, nothing, nothing)
        yield node
        node.close()


@pytest.mark.parametrize("data", [b"", b"\x00\x01", b"\x00\x01\x00\x00", b"\xff\xff\x00\x00body"])
def test_a_payload_that_is_no_cdr_message_is_refused(node: DdsTransport, data: bytes) -> None:
    with pytest.raises(OperationFailed, match=rf"/out: {len(data)} bytes are no CDR"):
        node.publish(OUT, data)


def test_a_topic_that_is_not_open_or_not_outbound_is_refused(node: DdsTransport) -> None:
    for topic in (RosTopic("/other", STRING, out=True), INTO):
        with pytest.raises(OperationFailed, match=f"{topic.name}: no such topic is open"):
            node.publish(topic, b"\x00\x01\x00\x00abcd")


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


@pytest.mark.parametrize("reach", [DiscoveryRange.OFF, DiscoveryRange.LOCALHOST])
def test_with_localhost_range_no_socket_listens_on_a_network_device(reach: DiscoveryRange) -> None:
    told: list[str] = []
    with free_domain() as domain:
        before = sockets()
        node = DdsTransport(DiscoverySettings(domain=domain, range=reach), told.append)
        node.open((OUT, INTO), (), nothing, nothing)
        devices = bound(sockets() - before)
        node.close()
    assert len(devices) >= 2 and set(devices.values()) == {b"lo"}
    if reach is DiscoveryRange.LOCALHOST:
        assert {7410 + 250 * domain, 7411 + 250 * domain} <= set(devices)
    assert told == []


def test_a_socket_that_cannot_be_restricted_to_loopback_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr("twind.bridge.ros.dds.loopback_only._LOOPBACK", b"no-such\0")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one, socket.socket(socket.AF_UNIX) as other:
        keep_here([one.fileno(), other.fileno()], told.append)
    assert len(told) == 1 and "a firewall closes it" in told[0]


# ------------------------------------------------------------------------------------- coming, going


def test_a_transport_can_be_closed_twice_and_opened_again() -> None:
    with free_domain() as domain:
        node = DdsTransport(DiscoverySettings(domain=domain), print)
        node.close()
        for _ in range(3):
            node.open((OUT, INTO), (), nothing, nothing)
            node.publish(OUT, b"\x00\x01\x00\x00abcd")
            node.close()
            node.close()
        with pytest.raises(OperationFailed, match="no such topic is open"):
            node.publish(OUT, b"\x00\x01\x00\x00abcd")


def test_two_of_one_process_in_a_domain_are_refused_in_words_and_leave_the_first_alone() -> None:
    with free_domain() as domain:
        first = DdsTransport(DiscoverySettings(domain=domain), print)
        second = DdsTransport(DiscoverySettings(domain=domain), print)
        first.open((OUT,), (), nothing, nothing)
        with pytest.raises(OperationFailed, match=f"ROS_DOMAIN_ID={domain}: another of this process"):
            second.open((OUT,), (), nothing, nothing)
        first.publish(OUT, b"\x00\x01\x00\x00abcd")
        first.close()
        second.open((OUT,), (), nothing, nothing)
        second.close()


def test_messages_dropped_for_lack_of_room_are_counted_and_reported_at_powers_of_ten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[str] = []
    with free_domain() as domain:
        node = DdsTransport(DiscoverySettings(domain=domain), told.append)
        node.open((OUT,), (), nothing, nothing)
        monkeypatch.setattr("twind.bridge.ros.dds.dds_endpoints.DdsWriter.write", lambda *_: False)
        for _ in range(120):
            node.publish(OUT, b"\x00\x01\x00\x00abcd")
        node.close()
    assert node.dropped == 120
    assert [line.split()[-3] for line in told] == ["1", "10", "100"]


def test_a_missing_or_unknown_library_is_reported_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    node = DdsTransport(DiscoverySettings(), print)
    unknown = rf"11\.0\.2 is installed, must be {KNOWN}: {re.escape(how_to_add('dds'))}"
    with monkeypatch.context() as patch:
        patch.setattr(importlib.metadata, "version", lambda _: "11.0.2")
        with pytest.raises(OperationFailed, match=unknown):
            node.open((OUT,), (), nothing, nothing)
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(OperationFailed, match=rf"cyclonedds is missing: {re.escape(how_to_add('dds'))}"):
        node.open((OUT,), (), nothing, nothing)


def test_the_required_dds_version_is_the_version_with_known_layouts() -> None:
    project = tomllib.loads(Path(__file__).parents[2].joinpath("pyproject.toml").read_text())
    (wanted,) = project["project"]["optional-dependencies"]["dds"]
    assert wanted.partition(";")[0] == f"cyclonedds=={KNOWN}"
