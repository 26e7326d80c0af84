"""Fields of messages: of the types that twind uses, and of others by their `ros2msg` text.

A type is named as ROS 2 names it, `sensor_msgs/msg/JointState`. Standard library only.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from twind.exceptions import InvalidInput

TIME = "builtin_interfaces/msg/Time"
DURATION = "builtin_interfaces/msg/Duration"
HEADER = "std_msgs/msg/Header"
STRING = "std_msgs/msg/String"
FLOAT = "std_msgs/msg/Float64"
DIMENSION = "std_msgs/msg/MultiArrayDimension"
LAYOUT = "std_msgs/msg/MultiArrayLayout"
FLOATS = "std_msgs/msg/Float64MultiArray"
JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY_POINT = "trajectory_msgs/msg/JointTrajectoryPoint"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
VECTOR3 = "geometry_msgs/msg/Vector3"
QUATERNION = "geometry_msgs/msg/Quaternion"
IMU = "sensor_msgs/msg/Imu"
CLOCK = "rosgraph_msgs/msg/Clock"
TRANSFORM = "geometry_msgs/msg/Transform"
TRANSFORM_STAMPED = "geometry_msgs/msg/TransformStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
INTERFACE_VALUE = "control_msgs/msg/InterfaceValue"
DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
KEY_VALUE = "diagnostic_msgs/msg/KeyValue"
DIAGNOSTIC_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
GID = "rmw_dds_common/msg/Gid"
NODE_ENTITIES = "rmw_dds_common/msg/NodeEntitiesInfo"
PARTICIPANT_ENTITIES = "rmw_dds_common/msg/ParticipantEntitiesInfo"
EVENT_INFO = "service_msgs/msg/ServiceEventInfo"
LOG = "rcl_interfaces/msg/Log"
TRIGGER = "std_srvs/srv/Trigger"
SET_BOOL = "std_srvs/srv/SetBool"


def _service(name: str, request: str, response: str) -> Mapping[str, str]:
    """A service is a message of three, as its type hash has it. Without fields it has a byte all the same."""
    sent = f"{name}_Request"
    reply = f"{name}_Response"
    event = f"{name}_Event"
    return {
        name: f"{sent} request_message\n{reply} response_message\n{event} event_message",
        sent: request or "uint8 structure_needs_at_least_one_member",
        reply: response,
        event: f"service_msgs/ServiceEventInfo info\n{sent}[<=1] request\n{reply}[<=1] response",
    }


# Field lists, in the notation of ROS: the order is that of the bytes.
KNOWN: Mapping[str, str] = {
    TIME: "int32 sec\nuint32 nanosec",
    DURATION: "int32 sec\nuint32 nanosec",
    HEADER: "builtin_interfaces/Time stamp\nstring frame_id",
    STRING: "string data",
    FLOAT: "float64 data",
    DIMENSION: "string label\nuint32 size\nuint32 stride",
    LAYOUT: "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    FLOATS: "std_msgs/MultiArrayLayout layout\nfloat64[] data",
    JOINT_STATE: (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    TRAJECTORY_POINT: (
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start"
    ),
    JOINT_TRAJECTORY: (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint[] points"
    ),
    VECTOR3: "float64 x\nfloat64 y\nfloat64 z",
    QUATERNION: "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    IMU: (
        "std_msgs/Header header\n"
        "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
    ),
    CLOCK: "builtin_interfaces/Time clock",
    TRANSFORM: "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    TRANSFORM_STAMPED: "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
    TRANSFORMS: "geometry_msgs/TransformStamped[] transforms",
    INTERFACE_VALUE: "string[] interface_names\nfloat64[] values",
    DYNAMIC_JOINT_STATE: (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values"
    ),
    KEY_VALUE: "string key\nstring value",
    DIAGNOSTIC_STATUS: (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values"
    ),
    DIAGNOSTIC_ARRAY: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
    LOG: (
        "uint8 DEBUG=10\nuint8 INFO=20\nuint8 WARN=30\nuint8 ERROR=40\nuint8 FATAL=50\n"
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\n"
        "string file\nstring function\nuint32 line"
    ),
    GID: "char[16] data",
    NODE_ENTITIES: (
        "string<=256 node_namespace\nstring<=256 node_name\n"
        "rmw_dds_common/Gid[] reader_gid_seq\nrmw_dds_common/Gid[] writer_gid_seq"
    ),
    PARTICIPANT_ENTITIES: "rmw_dds_common/Gid gid\nrmw_dds_common/NodeEntitiesInfo[] node_entities_info_seq",
    EVENT_INFO: (
        "uint8 REQUEST_SENT=0\nuint8 REQUEST_RECEIVED=1\nuint8 RESPONSE_SENT=2\nuint8 RESPONSE_RECEIVED=3\n"
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number"
    ),
    **_service(TRIGGER, "", "bool success\nstring message"),
    **_service(SET_BOOL, "bool data", "bool success\nstring message"),
}
# name in a definition -> (struct's letter, bytes); a string has no letter
PRIMITIVES: Mapping[str, tuple[str, int]] = {
    "bool": ("?", 1),
    "byte": ("B", 1),
    "char": ("B", 1),
    "int8": ("b", 1),
    "uint8": ("B", 1),
    "int16": ("h", 2),
    "uint16": ("H", 2),
    "int32": ("i", 4),
    "uint32": ("I", 4),
    "float32": ("f", 4),
    "int64": ("q", 8),
    "uint64": ("Q", 8),
    "float64": ("d", 8),
}
TEXT = "string"
_BETWEEN = "=" * 80
_CONSTANT = re.compile(r"\s*\S+\s+\w+\s*=")
_TYPE = re.compile(r"([\w/]+)(?:<=(\d+))?(?:(\[)(<=)?(\d*)\])?$")


@dataclass(frozen=True, slots=True)
class MessageField:
    """One field. `kind`: a primitive, `string`, or a full type name.

    `many`: a row of them; `count`: of that many always, None: as many as the bytes say.
    `most`, `longest`: bounds of such a row and of a string that the type hash knows; 0: none.
    """

    name: str
    kind: str
    many: bool = False
    count: int | None = None
    most: int = 0
    longest: int = 0


class MessageDefinitions:
    """The fields of each type of one `ros2msg` text: the type's own lines, then those of what it contains."""

    def __init__(self, name: str, text: str) -> None:
        """`name` is the type that `text` begins with. Raises InvalidInput."""
        self.name = _full(name, name)
        self._fields = {each: tuple(_fields(each, lines)) for each, lines in _sections(self.name, text)}

    def fields(self, name: str) -> tuple[MessageField, ...]:
        """Fields of a type, in the order of the bytes. Raises InvalidInput where it is not defined."""
        try:
            found = self._fields[name]
        except KeyError:
            known = ", ".join(sorted(self._fields))
            raise InvalidInput(f"{name}: not defined beside {self.name}; there are {known}") from None
        if not found:
            raise InvalidInput(f"{name}: has no fields; such messages are not supported")
        return found


def definition_text(name: str) -> str:
    """The definition of a known type with all that it contains, as schemas of recordings carry it."""
    names = list(dict.fromkeys(_contained(name)))
    parts = [KNOWN[name] + "\n"]
    parts += [f"{_BETWEEN}\nMSG: {each.replace('/msg/', '/')}\n{KNOWN[each]}\n" for each in names[1:]]
    return "".join(parts)


def definitions_of(kind: str | MessageDefinitions) -> MessageDefinitions:
    """The fields of a known type, or those that are given. Raises InvalidInput."""
    if isinstance(kind, MessageDefinitions):
        return kind
    if kind not in KNOWN:
        raise InvalidInput(f"no message {kind!r}; known: {', '.join(KNOWN)}")
    return MessageDefinitions(kind, definition_text(kind))


def participant_entities(gid_bytes: int) -> MessageDefinitions:
    """Return the type of `ros_discovery_info`. A gid has 24 bytes in Humble and 16 since Iron."""
    text = definition_text(PARTICIPANT_ENTITIES)
    return MessageDefinitions(PARTICIPANT_ENTITIES, text.replace(KNOWN[GID], f"char[{gid_bytes}] data"))


def _contained(name: str) -> Iterator[str]:
    """The type and whatever it contains, outer before inner."""
    yield name
    for field in _fields(name, KNOWN[name]):
        if field.kind not in PRIMITIVES and field.kind != TEXT:
            yield from _contained(field.kind)


def _sections(name: str, text: str) -> Iterator[tuple[str, str]]:
    first, *others = re.split(r"^=+[ \t]*\n", text, flags=re.MULTILINE)
    yield name, first
    for other in others:
        head, _, lines = other.partition("\n")
        if not head.startswith("MSG:"):
            raise InvalidInput(f"{name}: expected `MSG: package/Type`, got {head[:60]!r}")
        yield _full(head[4:].strip(), name), lines


def _fields(name: str, lines: str) -> Iterator[MessageField]:
    for line in lines.splitlines():
        words = line.partition("#")[0].split(maxsplit=2)
        if not words or _CONSTANT.match(line):
            continue  # a comment or nothing; a constant, which is not in the bytes
        found = _TYPE.match(words[0])
        if found is None or len(words) < 2:
            raise InvalidInput(f"{name}: no field: {line.strip()[:60]!r}")
        kind, longest, row, at_most, count = found.groups()
        kind = kind if kind in PRIMITIVES or kind == TEXT else _full(kind, name)
        fixed = int(count) if count and not at_most else None
        most = int(count) if count and at_most else 0
        yield MessageField(words[1], kind, row is not None, fixed, most, int(longest or 0))


def _full(kind: str, beside: str) -> str:
    """`std_msgs/Header` and `std_msgs/msg/Header` are one; a name alone is of the package it stands in."""
    parts = kind.split("/")
    package = parts[0] if len(parts) > 1 else beside.split("/")[0]
    folder = parts[1] if len(parts) == 3 else "msg"
    return f"{package}/{folder}/{parts[-1]}"
