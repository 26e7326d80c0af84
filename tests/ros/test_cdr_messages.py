"""The bytes of ROS messages, against a page of facts and against rosbags."""

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tests.support.control_message_types import add_control_types
from tests.support.examples import examples
from twind.exceptions import InvalidInput
from twind.ros import (
    DIAGNOSTIC_ARRAY,
    FLOAT,
    FLOATS,
    JOINT_STATE,
    JOINT_TRAJECTORY,
    PARTICIPANT_ENTITIES,
    SET_BOOL,
    STRING,
    TRANSFORMS,
    TRIGGER,
    JointStateBuffer,
    JointStateLayout,
    MessageBuffer,
    MessageDefinitions,
    decode,
    definition_text,
    encode,
    participant_entities,
    stamp,
)
from twind.ros.message_definitions import KNOWN

STORE: Typestore = add_control_types(get_typestore(Stores.ROS2_JAZZY))
# rosbags' own bytes of a small JointState, by hand annotated on the page of facts.
GOLDEN = bytes.fromhex(
    "00010000 01000000 02000000 05000000 62617365 00000000 02000000 02000000 61000000 04000000 62636400"
    "02000000 00000000 000000000000f03f 0000000000000040 00000000 00000000"
)
SMALL = {
    "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base"},
    "name": ["a", "bcd"],
    "position": [1.0, 2.0],
}

words = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
numbers = st.floats(allow_nan=False, width=64)
rows = st.lists(numbers, max_size=5)
moments = st.fixed_dictionaries(
    {"sec": st.integers(-(1 << 31), (1 << 31) - 1), "nanosec": st.integers(0, 999_999_999)}
)
headers = st.fixed_dictionaries({"stamp": moments, "frame_id": words})
points = st.fixed_dictionaries(
    {
        "positions": rows,
        "velocities": rows,
        "accelerations": rows,
        "effort": rows,
        "time_from_start": moments,
    }
)
values = st.lists(st.fixed_dictionaries({"key": words, "value": words}), max_size=3)
# To rosbags a `byte` has a sign, to ROS it has none: both have these.
statuses = st.fixed_dictionaries(
    {"level": st.integers(0, 127), "name": words, "message": words, "hardware_id": words, "values": values}
)
MESSAGES: dict[str, st.SearchStrategy[dict[str, Any]]] = {
    STRING: st.fixed_dictionaries({"data": words}),
    JOINT_STATE: st.fixed_dictionaries(
        {
            "header": headers,
            "name": st.lists(words, max_size=4),
            "position": rows,
            "velocity": rows,
            "effort": rows,
        }
    ),
    JOINT_TRAJECTORY: st.fixed_dictionaries(
        {
            "header": headers,
            "joint_names": st.lists(words, max_size=4),
            "points": st.lists(points, max_size=4),
        }
    ),
    DIAGNOSTIC_ARRAY: st.fixed_dictionaries({"header": headers, "status": st.lists(statuses, max_size=3)}),
}


def as_rosbags(kind: str, value: Any) -> Any:
    """The same message as an object of rosbags."""
    kinds = {"header": "std_msgs/msg/Header", "stamp": "builtin_interfaces/msg/Time"}
    kinds |= {"time_from_start": "builtin_interfaces/msg/Duration", "values": "diagnostic_msgs/msg/KeyValue"}
    kinds |= {
        "points": "trajectory_msgs/msg/JointTrajectoryPoint",
        "status": "diagnostic_msgs/msg/DiagnosticStatus",
    }
    fields = {}
    for name, each in value.items():
        if isinstance(each, dict):
            fields[name] = as_rosbags(kinds[name], each)
        elif isinstance(each, list) and name in kinds:
            fields[name] = [as_rosbags(kinds[name], item) for item in each]
        elif isinstance(each, list) and name not in ("name", "joint_names"):
            fields[name] = np.array(each, np.float64)
        else:
            fields[name] = each
    return STORE.types[kind](**fields)


def test_a_joint_state_has_the_bytes_of_the_page() -> None:
    assert encode(JOINT_STATE, SMALL) == GOLDEN
    assert decode(JOINT_STATE, GOLDEN) == SMALL | {"velocity": [], "effort": []}


@pytest.mark.parametrize("kind", MESSAGES)
def test_any_message_has_the_bytes_that_rosbags_gives_it_and_comes_back_as_it_was(kind: str) -> None:
    @examples(60)
    @given(MESSAGES[kind])
    def same(message: dict[str, Any]) -> None:
        data = encode(kind, message)
        assert data == bytes(STORE.serialize_cdr(as_rosbags(kind, message), kind))
        assert decode(kind, data) == message

    same()


@pytest.mark.parametrize("kind", [kind for kind in KNOWN if "/msg/" in kind])
def test_a_definition_means_to_rosbags_what_its_own_does(kind: str) -> None:
    parsed = get_types_from_msg(definition_text(kind), kind)
    for name, definition in parsed.items():
        assert definition == STORE.fielddefs[name]


def test_a_buffer_fills_every_stamp_and_number_of_a_message() -> None:
    def message(time: int, numbers: list[float]) -> dict[str, Any]:
        moves = [dict(zip("xyz", numbers[at : at + 3], strict=True)) for at in (0, 7)]
        turns = [dict(zip("xyzw", numbers[at : at + 4], strict=True)) for at in (3, 10)]
        rows = zip(("torso", "l_hip"), ("head_é", "knee"), moves, turns, strict=True)
        return {
            "transforms": [
                {
                    "header": {"stamp": stamp(time), "frame_id": parent},
                    "child_frame_id": child,
                    "transform": {"translation": move, "rotation": turn},
                }
                for parent, child, move, turn in rows
            ]
        }

    buffer = MessageBuffer(TRANSFORMS, message(0, [0.0] * 14))
    numbers = [float(each) for each in range(1, 15)]
    for time in (1, 1_795_000_000_123_456_789):
        assert buffer.fill(time, numbers) == encode(TRANSFORMS, message(time, numbers))
    assert buffer.size == 14


@given(st.lists(st.lists(st.floats(width=64), min_size=3, max_size=3), min_size=3, max_size=3), st.data())
def test_a_patched_message_is_the_encoded_one(columns: list[list[float]], data: st.DataObject) -> None:
    names = data.draw(st.lists(words, min_size=3, max_size=3))
    velocity = data.draw(st.booleans())
    effort = data.draw(st.booleans())
    time = data.draw(st.integers(-(10**18), 2 * 10**18))
    buffer = JointStateBuffer(names, velocity=velocity, effort=effort)
    buffer.fill(7, *[[9.0] * 3] * (1 + velocity + effort))
    position, speed, torque = columns
    given_columns = [position, *([speed] * velocity), *([torque] * effort)]
    message = {"header": {"stamp": stamp(time)}, "name": names, "position": position}
    message |= {"velocity": speed if velocity else [], "effort": torque if effort else []}
    assert buffer.fill(time, *given_columns) == encode(JOINT_STATE, message)
    packed = [struct.pack("<3d", *column) for column in given_columns]
    assert buffer.fill(time, *packed) == encode(JOINT_STATE, message)


def test_a_row_of_another_length_is_not_patched_in() -> None:
    buffer = JointStateBuffer(["a", "b"], velocity=False, effort=True)
    for wrong in ([1.0], [1.0, 2.0, 3.0], b"\0" * 8):
        with pytest.raises(ValueError):
            buffer.fill(0, wrong, [0.0, 0.0])
    with pytest.raises(ValueError, match="1 columns, must be 2"):
        buffer.fill(0, [0.0, 0.0])


@given(MESSAGES[JOINT_STATE], MESSAGES[JOINT_STATE])
def test_a_layout_fits_what_differs_in_stamp_and_numbers_alone(
    one: dict[str, Any], other: dict[str, Any]
) -> None:
    layout = JointStateLayout.from_message(encode(JOINT_STATE, one))
    for (first, count), column in zip(layout.columns, ("position", "velocity", "effort"), strict=True):
        found = struct.unpack_from(f"<{count}d", encode(JOINT_STATE, one), first)
        assert list(found) == one[column]
    alike = all(len(one[key]) == len(other[key]) for key in ("position", "velocity", "effort"))
    alike &= one["name"] == other["name"] and one["header"]["frame_id"] == other["header"]["frame_id"]
    assert layout.fits(encode(JOINT_STATE, other)) == alike


@given(MESSAGES[JOINT_TRAJECTORY], st.data())
def test_cut_bytes_are_refused_in_words(message: dict[str, Any], data: st.DataObject) -> None:
    whole = encode(JOINT_TRAJECTORY, message)
    cut = data.draw(st.integers(4, len(whole) - 1))
    with pytest.raises(InvalidInput, match="JointTrajectory"):
        decode(JOINT_TRAJECTORY, whole[:cut])


@given(st.binary(max_size=200))
def test_no_bytes_bring_the_decoder_down(data: bytes) -> None:
    for kind in (JOINT_STATE, JOINT_TRAJECTORY, DIAGNOSTIC_ARRAY):
        try:
            decode(kind, b"\0\1\0\0" + data)
        except InvalidInput:
            continue


def test_a_false_element_count_costs_no_memory() -> None:
    with pytest.raises(InvalidInput, match="more than"):
        decode(JOINT_STATE, GOLDEN[:24] + b"\xff\xff\xff\x7f" + GOLDEN[28:])


def test_a_message_that_does_not_fit_is_refused_by_its_field() -> None:
    with pytest.raises(InvalidInput, match="no field 'velocities'; known: header, name, position"):
        encode(JOINT_STATE, {"velocities": []})
    with pytest.raises(InvalidInput, match="position"):
        encode(JOINT_STATE, {"position": ["x"]})
    with pytest.raises(InvalidInput, match="little endian"):
        decode(JOINT_STATE, b"\0\0\0\0")
    with pytest.raises(InvalidInput, match="ends at byte 76, but there are 92"):
        decode(JOINT_STATE, GOLDEN + bytes(16))
    for behind in (3, 12):  # filled up; as rclpy serializes over Fast DDS
        assert decode(JOINT_STATE, GOLDEN + b"\xff" * behind)["name"] == ["a", "bcd"]
    with pytest.raises(InvalidInput, match="known: builtin_interfaces/msg/Time"):
        encode("sensor_msgs/msg/Range", {})


def test_the_definitions_of_others_are_read_too() -> None:
    text = (
        "# an array of the kind that cameras have\nint8 LEFT=-1 # a constant\nstring<=10 name 'a = b'\n"
        "float32[3] axis\nuint8[<=4] bits\nPart[] parts\n"
        + "=" * 80
        + "\nMSG: some_msgs/Part\nbool on true\n"
    )
    found = MessageDefinitions("some_msgs/msg/Whole", text)
    message = {"name": "x", "axis": [1.0, 2.0, 3.5], "bits": [1, 2], "parts": [{"on": True}, {"on": False}]}
    assert decode(found, encode(found, message)) == message
    assert decode(found, encode(found, {}))["axis"] == [0.0, 0.0, 0.0]
    with pytest.raises(InvalidInput, match="axis: 2 values, must be 3"):
        encode(found, {"axis": [1.0, 2.0]})
    with pytest.raises(InvalidInput, match="other_msgs/msg/Gone: not defined"):
        encode(MessageDefinitions("a/msg/B", "other_msgs/Gone x"), {})
    with pytest.raises(InvalidInput, match="has no fields"):
        encode(MessageDefinitions("std_msgs/msg/Empty", ""), {})


@pytest.mark.parametrize(("store", "width"), [(Stores.ROS2_HUMBLE, 24), (Stores.ROS2_JAZZY, 16)])
def test_participants_are_encoded_with_gids_of_the_width_of_the_distribution(
    store: Stores, width: int
) -> None:
    peer = get_typestore(store)
    gid = bytes(range(width))
    node = {"node_namespace": "/", "node_name": "twind", "writer_gid_seq": [{"data": gid}] * 2}
    kind = participant_entities(width)
    data = encode(kind, {"gid": {"data": gid}, "node_entities_info_seq": [node]})
    told: Any = peer.deserialize_cdr(data, PARTICIPANT_ENTITIES)
    assert bytes(told.gid.data) == gid
    (found,) = told.node_entities_info_seq
    assert (found.node_namespace, found.node_name, found.reader_gid_seq) == ("/", "twind", [])
    assert [bytes(each.data) for each in found.writer_gid_seq] == [gid, gid]
    assert bytes(peer.serialize_cdr(told, PARTICIPANT_ENTITIES)) == data


def test_a_request_without_fields_has_a_byte() -> None:
    assert encode(f"{TRIGGER}_Request", {}) == bytes.fromhex("00010000 00")
    assert encode(f"{SET_BOOL}_Request", {"data": True}) == bytes.fromhex("00010000 01")
    answer = {"success": True, "message": "live"}
    for service in (TRIGGER, SET_BOOL):
        data = encode(f"{service}_Response", answer)
        assert data == bytes.fromhex("00010000 01000000 05000000 6c69766500")
        assert decode(f"{service}_Response", data) == answer


def test_labelled_numbers_have_the_bytes_that_rosbags_gives_them() -> None:
    dims = [{"label": "hop", "size": 2, "stride": 6}, {"label": "ms", "size": 3, "stride": 3}]
    message = {"layout": {"dim": dims, "data_offset": 0}, "data": [1.0, 2.0, 3.5, 0.0, -1.0, 4.0]}
    data = encode(FLOATS, message)
    told: Any = STORE.deserialize_cdr(data, FLOATS)
    assert [(each.label, each.size, each.stride) for each in told.layout.dim] == [("hop", 2, 6), ("ms", 3, 3)]
    assert bytes(STORE.serialize_cdr(told, FLOATS)) == data and decode(FLOATS, data) == message
    assert decode(FLOAT, encode(FLOAT, {"data": 0.5})) == {"data": 0.5}


def test_nan_and_the_infinities_pass() -> None:
    found = decode(JOINT_STATE, encode(JOINT_STATE, {"position": [math.nan, math.inf, -math.inf]}))
    assert math.isnan(found["position"][0]) and found["position"][1:] == [math.inf, -math.inf]


def test_a_time_before_1970_has_negative_seconds_as_in_ros() -> None:
    assert stamp(-1) == {"sec": -1, "nanosec": 999_999_999}
    assert stamp(1_795_365_736_003_971_062) == {"sec": 1_795_365_736, "nanosec": 3_971_062}
