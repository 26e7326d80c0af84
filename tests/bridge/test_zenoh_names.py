"""Keys, tokens and ids over Zenoh: against the builders of zenoh-ros2-sdk, which share no code with ours."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.ros.ros_endpoints import (
    HW_JOINTS,
    SERVICES,
    SET_LIVE,
    STATUS,
    TOPICS,
    TRAJECTORY,
    RosService,
    RosTopic,
)
from twind.bridge.ros.zenoh.zenoh_names import ZenohNames, gid
from twind.ros import type_hash

ZID = "fd92a319fe4fc447f778cdc2607d8327"
sdk = pytest.importorskip("zenoh_ros2_sdk", reason="no zenoh-ros2-sdk here (it needs git)")


def test_a_key_is_domain_topic_type_and_hash() -> None:
    assert ZenohNames(42, ZID).key(HW_JOINTS) == (
        "42/hw/joint_states/sensor_msgs::msg::dds_::JointState_/"
        "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )


def test_among_nodes_of_humble_a_word_stands_in_place_of_the_hash() -> None:
    names = ZenohNames(0, ZID, hashed=False)
    assert names.key(STATUS) == "0/bridge/status/std_msgs::msg::dds_::String_/TypeHashNotSupported"
    assert "/TypeHashNotSupported/1:" in names.token(3, STATUS)


@pytest.mark.parametrize("endpoint", [*TOPICS, *SERVICES], ids=lambda each: each.name)
def test_keys_and_tokens_are_those_that_the_peer_builds(endpoint: RosTopic | RosService) -> None:
    from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
    from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr, topic_keyexpr
    from zenoh_ros2_sdk.qos import QosDurability, QosProfile
    from zenoh_ros2_sdk.utils import ros2_to_dds_type

    names = ZenohNames(7, ZID)
    kind = ros2_to_dds_type(endpoint.kind)
    node = NodeEntity(7, ZID, 0, "twind")
    assert names.node_token() == node_liveliness_keyexpr(node)
    assert names.key(endpoint) == topic_keyexpr(7, endpoint.name, kind, type_hash(endpoint.kind))
    what = EntityKind.SERVICE
    latched = False
    depth = 10
    if isinstance(endpoint, RosTopic):
        what = EntityKind.PUBLISHER if endpoint.out else EntityKind.SUBSCRIPTION
        latched = endpoint.latched
        depth = endpoint.depth
    token = names.token(9, endpoint)
    *_, quality = token.split("/")
    entity = EndpointEntity(node, 9, what, endpoint.name, kind, type_hash(endpoint.kind), quality)
    assert token == endpoint_liveliness_keyexpr(entity)
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    assert QosProfile.decode(quality) == QosProfile(durability=durability, history_depth=depth)


def test_each_endpoint_token_contains_its_kind() -> None:
    names = ZenohNames(0, ZID)
    kinds = [names.token(1, each).split("/")[5] for each in (STATUS, TRAJECTORY, SET_LIVE)]
    assert kinds == ["MP", "MS", "SS"]


@given(st.integers(1, 10_000), st.integers(1, 10_000))
def test_ids_are_sixteen_bytes_and_as_unlike_as_the_tokens(one: int, other: int) -> None:
    names = ZenohNames(0, ZID)
    ids = [gid(names.token(number, STATUS)) for number in (one, other)]
    assert [len(each) for each in ids] == [16, 16]
    assert (ids[0] == ids[1]) == (one == other)


def test_an_id_is_the_low_half_first() -> None:
    # XXH3, 128 bits, of no bytes: 99aa06d3014798d8 6001c324468d497f, as its authors publish it.
    assert gid("").hex() == "7f498d4624c30160" + "d8984701d306aa99"
