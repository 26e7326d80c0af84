"""Names and hashes of types, against rosbags, against a table and against what ROS itself gives services."""

import json
import sys
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.support.control_message_types import add_control_types
from twind.bridge.ros.ros_endpoints import SERVICES, TOPICS
from twind.exceptions import InvalidInput
from twind.ros import PARTICIPANT_ENTITIES, MessageDefinitions, dds_type, participant_entities
from twind.ros.message_definitions import EVENT_INFO, GID, KNOWN, NODE_ENTITIES
from twind.ros.wire_type_names import type_hash

STORE = add_control_types(get_typestore(Stores.ROS2_JAZZY))
# Of bytes of the type `char`, which rosbags hashes as another one.
OTHERWISE = {GID, NODE_ENTITIES, PARTICIPANT_ENTITIES, EVENT_INFO}
ODD = """byte LEFT=1
bool on
byte[] flags
char[5] letters
int8 a
uint8[<=7] b
int16[3] c
uint16 d
int32[] e
uint32 f
int64 g
uint64[<=2] h
float32 i
float64[9] j
string k
string<=10 l
string[] m
string<=10[<=4] n
std_msgs/Header[2] o
Part[<=3] p
================================================================================
MSG: some_msgs/Part
bool on
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


@pytest.mark.parametrize("kind", sorted({kind for kind in KNOWN if "/msg/" in kind} - OTHERWISE))
def test_a_message_has_the_hash_that_rosbags_gives_it(kind: str) -> None:
    assert type_hash(kind) == STORE.hash_rihs01(kind)


def test_every_kind_of_field_is_hashed_as_rosbags_does() -> None:
    text = ODD.replace("char[5] letters\n", "")
    peer = get_typestore(Stores.EMPTY)
    peer.register(get_types_from_msg(text, "some_msgs/msg/Whole"))
    assert type_hash(MessageDefinitions("some_msgs/msg/Whole", text)) == peer.hash_rihs01(
        "some_msgs/msg/Whole"
    )


def test_a_char_is_hashed_as_the_uint8_that_it_is() -> None:
    with_char, with_number = (
        MessageDefinitions("some_msgs/msg/Whole", text) for text in (ODD, ODD.replace("char", "uint8"))
    )
    assert type_hash(with_char) == type_hash(with_number)


# Hashes that ROS 2 itself gives: of services, which contain rows of `char`, and of what tells the graph.
@pytest.mark.parametrize(
    ("kind", "known"),
    [
        ("std_srvs/srv/Trigger", "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"),
        ("std_srvs/srv/SetBool", "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"),
        ("std_srvs/srv/SetBool_Event", "3c4c20015afb4303eafd347b1d6a786f171a89c814726961a9593ef10df878cf"),
        (PARTICIPANT_ENTITIES, "91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"),
        ("sensor_msgs/msg/JointState", "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"),
        ("std_msgs/msg/String", "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
        (
            "trajectory_msgs/msg/JointTrajectory",
            "179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
        ),
    ],
)
def test_the_hashes_are_those_of_ros(kind: str, known: str) -> None:
    assert type_hash(kind) == f"RIHS01_{known}"


def test_every_type_that_a_real_ros_has_here_is_hashed_as_its_build_did() -> None:
    share = Path(sys.prefix) / "ros" / "share"  # of the real rclpy: tests/support/rclpy_environment.py
    told = {file: json.loads(file.read_text()) for kind in KNOWN if (file := share / f"{kind}.json").exists()}
    if not told:
        pytest.skip("no real ROS here: `make ros` (needs Python 3.12)")
    theirs = {
        each["type_name"]: each["hash_string"] for file in told.values() for each in file["type_hashes"]
    }
    ours = {kind: type_hash(kind) for kind in KNOWN if kind in theirs}
    assert len(ours) >= len(told)
    assert ours == {kind: theirs[kind] for kind in ours}


def test_wider_gids_are_another_type() -> None:
    assert type_hash(participant_entities(16)) == type_hash(PARTICIPANT_ENTITIES)
    assert type_hash(participant_entities(24)) != type_hash(PARTICIPANT_ENTITIES)


def test_every_endpoint_type_has_a_wire_name_and_a_hash() -> None:
    assert dds_type("sensor_msgs/msg/JointState") == "sensor_msgs::msg::dds_::JointState_"
    assert dds_type("std_srvs/srv/Trigger") == "std_srvs::srv::dds_::Trigger_"
    for each in (*TOPICS, *SERVICES):
        assert len(type_hash(each.kind)) == len("RIHS01_") + 64
        assert dds_type(each.kind).endswith("_")


def test_a_name_that_is_none_is_refused() -> None:
    with pytest.raises(InvalidInput, match="package/msg/Name"):
        dds_type("JointState")
    with pytest.raises(InvalidInput, match="known: builtin_interfaces"):
        type_hash("sensor_msgs/msg/Range")
