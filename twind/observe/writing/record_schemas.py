"""Fixed contents of a recording: metadata of its clocks, attached files, schemas of its channels. Pure.

A JSON channel has no schema record: rosbags opens no file with one that is not of ROS. Its JSON schema is in
the channel's metadata.
"""

import json
from collections.abc import Mapping
from typing import Any

from twind.client.clock_pair import ClockPair
from twind.observe.recording.recording_topics import (
    CALIBRATION,
    COMMANDS,
    EVENTS,
    INERTIAL,
    JOINTS,
    LATENCY,
    MEASURED,
    MJCF,
    NOTES,
    ROBOT,
    SIMULATED,
    STATUS,
    TRAJECTORY,
    VERDICTS,
    WIRE,
)
from twind.protocol import CONTROL, IdlInterface, load
from twind.protocol.idl import (
    EnumType,
    IdlType,
    ListType,
    MapType,
    NamedType,
    OptionalType,
    ScalarType,
    StructType,
)
from twind.ros import IMU, JOINT_STATE, JOINT_TRAJECTORY

# topic -> type of its CDR messages
ROS = {
    MEASURED: JOINT_STATE,
    SIMULATED: JOINT_STATE,
    COMMANDS: JOINT_STATE,
    TRAJECTORY: JOINT_TRAJECTORY,
    INERTIAL: IMU,
}
_WORDS = {"bool": "boolean", "int": "integer", "float": "number", "string": "string", "object": "object"}
_NOTE = {
    "kind": {"type": "string"},  # dropped, clock_step, episode
    "count": {"type": "integer"},
    "monotonic": {"type": "number"},
    "wall_ns": {"type": "integer"},
    "expected_ns": {"type": "integer"},
    "text": {"type": "string"},
}
_WIRE = {
    "bus": {"type": "string"},
    "kind": {"type": "string"},  # out, in, port
    "hex": {"type": "string"},
    "text": {"type": "string"},  # of kind port, in place of hex
}


def json_schemas() -> dict[str, str]:
    """The schema of every topic of JSON messages, as text."""
    interface = load(CONTROL)
    types = interface.types
    hops = ListType(types["Latency"])
    joints = ListType(types["Joint"])
    verdict = _members(interface, "Verdict")
    found = {
        STATUS: _schema(types["Status"]),
        EVENTS: _schema(types["Event"]),
        VERDICTS: _schema(StructType({"id": ScalarType("string"), **verdict})),
        LATENCY: _schema(StructType({"hops": hops})),
        JOINTS: _schema(StructType({"joints": joints})),
        NOTES: {"type": "object", "properties": _NOTE | {"annotation": _schema(types["Annotation"])}},
        WIRE: {"type": "object", "properties": _WIRE},
    }
    return {topic: json.dumps(schema) for topic, schema in found.items()}


def _members(interface: IdlInterface, name: str) -> dict[str, IdlType]:
    kind = interface.types[name]
    assert isinstance(kind, StructType)
    return dict(kind.fields)


def _schema(kind: IdlType) -> dict[str, object]:
    if isinstance(kind, NamedType):
        return _schema(kind.types[kind.name])
    if isinstance(kind, OptionalType):
        return _schema(kind.of)  # readers draw by `type`, and a list of two types they do not know
    if isinstance(kind, ListType):
        return {"type": "array", "items": _schema(kind.of)}
    if isinstance(kind, MapType):
        return {"type": "object", "additionalProperties": _schema(kind.of)}
    if isinstance(kind, StructType):
        members = {name: _schema(member) for name, member in kind.fields.items()}
        return {"type": "object", "properties": members}
    if isinstance(kind, EnumType):
        return {"type": "string", "enum": list(kind.words)}
    assert isinstance(kind, ScalarType)
    return {"type": _WORDS[kind.name]}


def clock_words(clocks: ClockPair) -> dict[str, str]:
    """Build the clock entries of the metadata: both clocks at one moment, and how they give log times."""
    return {
        "monotonic": repr(clocks.monotonic),
        "wall_ns": str(clocks.wall_ns),
        "clock": "log times are wall clock, ns since 1970: wall_ns + (CLOCK_MONOTONIC - monotonic)",
    }


def attachments(
    robot: Mapping[str, object], calibration: Mapping[str, object] | None, mjcf: str | None
) -> dict[str, tuple[str, bytes]]:
    """Media type and bytes by name; what a robot has not is left out."""

    def text(value: Any) -> bytes:
        return json.dumps(value, ensure_ascii=False).encode()

    found = {ROBOT: ("application/json", text(robot))}
    if calibration:
        found[CALIBRATION] = ("application/json", text(calibration))
    if mjcf:
        found[MJCF] = ("application/xml", mjcf.encode())
    return found
