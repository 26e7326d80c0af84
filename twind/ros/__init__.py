"""Messages as ROS 2 has them, without ROS: definitions, bytes (CDR), hashes. Standard library, Python 3.10.

For whoever writes recordings or speaks to ROS: `encode` and `decode` know every message by its definition,
`JointStateBuffer` writes one kind of message at the loop's rate.
"""

from twind.ros.cdr import decode, encode
from twind.ros.imu_message import ImuBuffer
from twind.ros.joint_state_message import JointStateBuffer, JointStateLayout, stamp
from twind.ros.message_buffer import MessageBuffer
from twind.ros.message_definitions import (
    CLOCK,
    DIAGNOSTIC_ARRAY,
    DYNAMIC_JOINT_STATE,
    FLOAT,
    FLOATS,
    IMU,
    JOINT_STATE,
    JOINT_TRAJECTORY,
    LOG,
    PARTICIPANT_ENTITIES,
    SET_BOOL,
    STRING,
    TRANSFORMS,
    TRIGGER,
    MessageDefinitions,
    definition_text,
    participant_entities,
)
from twind.ros.wire_type_names import dds_type, type_hash

__all__ = [
    "CLOCK",
    "DIAGNOSTIC_ARRAY",
    "DYNAMIC_JOINT_STATE",
    "FLOAT",
    "FLOATS",
    "IMU",
    "JOINT_STATE",
    "JOINT_TRAJECTORY",
    "LOG",
    "PARTICIPANT_ENTITIES",
    "SET_BOOL",
    "STRING",
    "TRANSFORMS",
    "TRIGGER",
    "ImuBuffer",
    "JointStateBuffer",
    "JointStateLayout",
    "MessageBuffer",
    "MessageDefinitions",
    "dds_type",
    "decode",
    "definition_text",
    "encode",
    "participant_entities",
    "stamp",
    "type_hash",
]
