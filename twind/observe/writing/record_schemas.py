"""What the channels of a recording hold: types of ROS, and JSON schemas of the interface's own types. Pure.

A JSON channel has no schema record: rosbags opens no file with one that is not of ROS. Its JSON schema is in
the channel's metadata.
"""

import json
from typing import Any

from twind.observe.recording.recording_topics import (
    COMMANDS,
    EVENTS,
    INERTIAL,
    JOINTS,
    LATENCY,
    MEASURED,
    NOTES,
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


def _schema(kind: IdlType) -> dict[str, Any]:
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
