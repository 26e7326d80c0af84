"""Messages as ROS 2 has them, without ROS: their definitions, and their bytes (CDR). Standard library only.

For whoever writes recordings or speaks to ROS: `encode` and `decode` know every message by its definition,
`JointStateBuffer` writes one kind of message at the loop's rate.
"""

from twind.ros.cdr import CdrError, decode, encode
from twind.ros.definitions import (
    DIAGNOSTIC_ARRAY,
    IMU,
    JOINT_STATE,
    JOINT_TRAJECTORY,
    STRING,
    Definitions,
    definition_text,
)
from twind.ros.imu import ImuBuffer
from twind.ros.joint_state import JointStateBuffer, JointStateLayout, stamp

__all__ = [
    "DIAGNOSTIC_ARRAY",
    "IMU",
    "JOINT_STATE",
    "JOINT_TRAJECTORY",
    "STRING",
    "CdrError",
    "Definitions",
    "ImuBuffer",
    "JointStateBuffer",
    "JointStateLayout",
    "decode",
    "definition_text",
    "encode",
    "stamp",
]
