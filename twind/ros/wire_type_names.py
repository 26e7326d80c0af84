"""Name of a type on the wire: its DDS name, and its hash by REP-2016 (RIHS01).

Over Zenoh both are part of the key, so that a wrong one is silence. Standard library only.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping

from twind.exceptions import InvalidInput
from twind.ros.message_definitions import PRIMITIVES, TEXT, MessageDefinitions, MessageField, definitions_of

# type_description_interfaces/msg/FieldType. A `char` of ROS 2 is hashed as the uint8 it becomes in IDL: only
# so have services the hashes that ROS gives them (rosbags 0.11.9 takes 13, which is a character of IDL).
_NESTED = 1
_BOUNDED_TEXT = 21
_IDS: Mapping[str, int] = {
    **{"int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9},
    **{"float32": 10, "float64": 11, "char": 3, "bool": 15, "byte": 16, TEXT: 17},
}
# added for a row: of fixed length, of a bounded one, of any
_ARRAY = 48
_BOUNDED_ROW = 96
_ROW = 144


def dds_type(kind: str) -> str:
    """`sensor_msgs/msg/JointState` as DDS and Zenoh call it: `sensor_msgs::msg::dds_::JointState_`."""
    try:
        package, folder, name = kind.split("/")
    except ValueError:
        raise InvalidInput(f"type {kind!r}: must be package/msg/Name or package/srv/Name") from None
    return f"{package}::{folder}::dds_::{name}_"


def type_hash(kind: str | MessageDefinitions) -> str:
    """`RIHS01_` and 64 hexadecimal digits, of a message or a service. Raises InvalidInput."""
    definitions = definitions_of(kind)
    name = definitions.name
    others = sorted(set(_contained(definitions, name)) - {name})
    described = {
        "type_description": _described(definitions, name),
        "referenced_type_descriptions": [_described(definitions, each) for each in others],
    }
    return "RIHS01_" + hashlib.sha256(json.dumps(described).encode()).hexdigest()


def _contained(definitions: MessageDefinitions, name: str) -> Iterator[str]:
    yield name
    for field in definitions.fields(name):
        if field.kind not in PRIMITIVES and field.kind != TEXT:
            yield from _contained(definitions, field.kind)


def _described(definitions: MessageDefinitions, name: str) -> Mapping[str, object]:
    fields = [{"name": field.name, "type": _type(field)} for field in definitions.fields(name)]
    return {"type_name": name, "fields": fields}


def _type(field: MessageField) -> Mapping[str, object]:
    known = _IDS.get(field.kind)
    one = _BOUNDED_TEXT if field.longest else known or _NESTED
    row = 0
    if field.many:
        row = _ARRAY if field.count is not None else _BOUNDED_ROW if field.most else _ROW
    return {
        "type_id": one + row,
        "capacity": field.count or field.most,
        "string_capacity": field.longest,
        "nested_type_name": "" if known else field.kind,
    }
