"""What fields a message has: the types that we use, and what a `ros2msg` text says of others.

A type is named as ROS 2 names it, `sensor_msgs/msg/JointState`. Standard library only.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

TIME = "builtin_interfaces/msg/Time"
DURATION = "builtin_interfaces/msg/Duration"
HEADER = "std_msgs/msg/Header"
STRING = "std_msgs/msg/String"
JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY_POINT = "trajectory_msgs/msg/JointTrajectoryPoint"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
VECTOR3 = "geometry_msgs/msg/Vector3"
QUATERNION = "geometry_msgs/msg/Quaternion"
IMU = "sensor_msgs/msg/Imu"
KEY_VALUE = "diagnostic_msgs/msg/KeyValue"
DIAGNOSTIC_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"

# Field lists, in the notation of ROS: the order is that of the bytes.
KNOWN: Mapping[str, str] = {
    TIME: "int32 sec\nuint32 nanosec",
    DURATION: "int32 sec\nuint32 nanosec",
    HEADER: "builtin_interfaces/Time stamp\nstring frame_id",
    STRING: "string data",
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
    KEY_VALUE: "string key\nstring value",
    DIAGNOSTIC_STATUS: (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values"
    ),
    DIAGNOSTIC_ARRAY: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
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
_TYPE = re.compile(r"([\w/]+)(?:<=\d+)?(\[(?:<=)?(\d*)\])?$")


class DefinitionError(ValueError):
    """A definition that says nothing usable. The text names the type and the line."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field. `kind`: a primitive, `string`, or a full type name.

    `many`: a row of them; `count`: of that many always, None: as many as the bytes say.
    """

    name: str
    kind: str
    many: bool = False
    count: int | None = None


class Definitions:
    """The fields of each type of one `ros2msg` text: the type's own lines, then those of what it contains."""

    def __init__(self, name: str, text: str) -> None:
        """`name` is the type that `text` begins with. Raises DefinitionError."""
        self.name = _full(name, name)
        self._fields = {each: tuple(_fields(each, lines)) for each, lines in _sections(self.name, text)}

    def fields(self, name: str) -> tuple[Field, ...]:
        """Fields of a type, in the order of the bytes. Raises DefinitionError where it is not defined."""
        try:
            found = self._fields[name]
        except KeyError:
            known = ", ".join(sorted(self._fields))
            raise DefinitionError(f"{name}: not defined beside {self.name}; there are {known}") from None
        if not found:
            raise DefinitionError(f"{name}: has no fields; such messages are not supported")
        return found


def definition_text(name: str) -> str:
    """The definition of a known type with all that it contains, as schemas of recordings carry it."""
    names = list(dict.fromkeys(_contained(name)))
    parts = [KNOWN[name] + "\n"]
    parts += [f"{_BETWEEN}\nMSG: {each.replace('/msg/', '/')}\n{KNOWN[each]}\n" for each in names[1:]]
    return "".join(parts)


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
            raise DefinitionError(f"{name}: expected `MSG: package/Type`, got {head[:60]!r}")
        yield _full(head[4:].strip(), name), lines


def _fields(name: str, lines: str) -> Iterator[Field]:
    for line in lines.splitlines():
        words = line.partition("#")[0].split(maxsplit=2)
        if not words or _CONSTANT.match(line):
            continue  # a comment or nothing; a constant, which is not in the bytes
        found = _TYPE.match(words[0])
        if found is None or len(words) < 2:
            raise DefinitionError(f"{name}: no field: {line.strip()[:60]!r}")
        kind, row, count = found.groups()
        kind = kind if kind in PRIMITIVES or kind == TEXT else _full(kind, name)
        fixed = int(count) if count and "<=" not in row else None
        yield Field(words[1], kind, row is not None, fixed)


def _full(kind: str, beside: str) -> str:
    """`std_msgs/Header` and `std_msgs/msg/Header` are one; a name alone is of the package it stands in."""
    parts = kind.split("/")
    package = parts[0] if len(parts) > 1 else beside.split("/")[0]
    return f"{package}/msg/{parts[-1]}"
