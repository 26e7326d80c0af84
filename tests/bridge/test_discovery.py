"""twind/bridge/ros/discovery.py: the variables of ROS users, and what is made of them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.ros.discovery import LAST_DOMAIN, DiscoveryRange, DiscoverySettings, discovery
from twind.exceptions import InvalidInput

TEXTS = st.text(st.characters(exclude_characters="\0"), max_size=12)


def test_without_a_variable_nothing_leaves_this_machine() -> None:
    assert discovery({}) == DiscoverySettings(0, DiscoveryRange.LOCALHOST, (), "jazzy")
    assert discovery({}).local


def test_the_variables_of_ros_are_taken_as_ros_takes_them() -> None:
    found = discovery(
        {
            "ROS_DOMAIN_ID": "42",
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "ROS_STATIC_PEERS": "192.168.0.1; robot.local;;192.168.0.1",
            "ROS_DISTRO": "humble",
        }
    )
    assert found == DiscoverySettings(42, DiscoveryRange.SUBNET, ("192.168.0.1", "robot.local"), "humble")
    assert found.humble and not found.local


def test_localhost_only_comes_before_range_and_peers() -> None:
    said = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": "10.0.0.1"}
    assert discovery({**said, "ROS_LOCALHOST_ONLY": "1"}).local
    assert not discovery({**said, "ROS_LOCALHOST_ONLY": "0"}).local


def test_peers_are_reached_beside_this_machine() -> None:
    found = discovery({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.1"})
    assert found.peers == ("10.0.0.1",) and not found.local


def test_options_come_before_the_environment() -> None:
    found = discovery({"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "humble"}, domain=3, distro="kilted")
    assert (found.domain, found.distro) == (3, "kilted")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ROS_DOMAIN_ID", "-1"),
        ("ROS_DOMAIN_ID", str(LAST_DOMAIN + 1)),
        ("ROS_DOMAIN_ID", "1e2"),
        ("ROS_DOMAIN_ID", "٣"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "subnet"),
        ("ROS_LOCALHOST_ONLY", "yes"),
        ("ROS_STATIC_PEERS", '10.0.0.1"/><Peer'),
        ("ROS_DISTRO", "../jazzy"),
    ],
)
def test_an_unusable_variable_value_is_refused_by_name(name: str, value: str) -> None:
    with pytest.raises(InvalidInput, match=name if name != "ROS_DOMAIN_ID" else "ROS_DOMAIN_ID|domain"):
        discovery({name: value})


@given(domain=TEXTS, reach=TEXTS, peers=TEXTS)
def test_any_environment_gives_valid_discovery_settings_or_an_error(
    domain: str, reach: str, peers: str
) -> None:
    said = {"ROS_DOMAIN_ID": domain, "ROS_AUTOMATIC_DISCOVERY_RANGE": reach, "ROS_STATIC_PEERS": peers}
    try:
        found = discovery(said)
    except InvalidInput:
        return
    assert 0 <= found.domain <= LAST_DOMAIN
    assert not any(set('"<>& ;') & set(peer) for peer in found.peers)
