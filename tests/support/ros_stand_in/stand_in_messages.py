"""The stand-in's own: classes of messages from their definitions, and their bytes."""

from functools import cache

from twind.ros import MessageDefinitions, decode, encode
from twind.ros.message_definitions import KNOWN, PRIMITIVES

TEXTS = dict(KNOWN) | {
    "rcl_interfaces/msg/SetParametersResult": "bool successful\nstring reason",
    "rcl_interfaces/msg/ParameterDescriptor": "string description",
    "rcl_interfaces/msg/ParameterValue": "uint8 type\nfloat64 double_value\nstring string_value",
    "rcl_interfaces/msg/Parameter": "string name\nrcl_interfaces/ParameterValue value",
    "rcl_interfaces/srv/SetParameters_Request": "rcl_interfaces/Parameter[] parameters",
    "rcl_interfaces/srv/SetParameters_Response": "rcl_interfaces/SetParametersResult[] results",
    "rcl_interfaces/srv/GetParameters_Request": "string[] names",
    "rcl_interfaces/srv/GetParameters_Response": "rcl_interfaces/ParameterValue[] values",
    "control_msgs/msg/JointTolerance": (
        "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration"
    ),
    "control_msgs/action/FollowJointTrajectory_Goal": (
        "trajectory_msgs/JointTrajectory trajectory\n"
        "control_msgs/JointTolerance[] path_tolerance\ncontrol_msgs/JointTolerance[] goal_tolerance\n"
        "builtin_interfaces/Duration goal_time_tolerance"
    ),
    "control_msgs/action/FollowJointTrajectory_Result": "int32 error_code\nstring error_string",
    "control_msgs/action/FollowJointTrajectory_Feedback": (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint desired\n"
        "trajectory_msgs/JointTrajectoryPoint actual\ntrajectory_msgs/JointTrajectoryPoint error"
    ),
}


@cache
def definitions(kind):
    """Meaning of the bytes of `kind`."""
    found = {}
    waiting = [kind]
    while waiting:
        each = waiting.pop()
        if each not in found:
            found[each] = TEXTS[each]
            fields = MessageDefinitions(each, TEXTS[each]).fields(each)
            waiting += [field.kind for field in fields if field.kind in TEXTS]
    text, *others = found.values()
    names = list(found)[1:]
    sections = [f"{'=' * 80}\nMSG: {name}\n{lines}\n" for name, lines in zip(names, others, strict=True)]
    return MessageDefinitions(kind, "\n".join([text, *sections]))


class Message:
    """Base of all. As the real ones it has its fields and no others."""

    kind = ""

    def __init__(self, **fields):
        for field in self.layout():
            setattr(self, field.name, fields.pop(field.name) if field.name in fields else _nothing(field))
        if fields:
            raise AssertionError(f"{self.kind}: invalid arguments {sorted(fields)}")

    @classmethod
    def layout(cls):
        found = definitions(cls.kind)
        return found.fields(found.name)

    def plain(self):
        return {field.name: _plain(getattr(self, field.name)) for field in self.layout()}

    def bytes(self):
        return encode(definitions(self.kind), self.plain())

    @classmethod
    def of(cls, data):
        return cls.made(decode(definitions(cls.kind), data))

    @classmethod
    def made(cls, plain):
        return cls(**{field.name: _made(field, plain[field.name]) for field in cls.layout()})


@cache
def message(kind):
    """The class of `package/msg/Name`."""
    return type(kind.rpartition("/")[2], (Message,), {"kind": kind})


def service(kind):
    """The class of `package/srv/Name`."""
    parts = {part: message(f"{kind}_{part}") for part in ("Request", "Response")}
    return type(kind.rpartition("/")[2], (), {"kind": kind, **parts})


def action(kind):
    """The class of `package/action/Name`."""
    parts = {part: message(f"{kind}_{part}") for part in ("Goal", "Result", "Feedback")}
    return type(kind.rpartition("/")[2], (), {"kind": kind, **parts})


def _nothing(field):
    if field.many:
        return [0.0] * field.count if field.count else []
    if field.kind in PRIMITIVES:
        return 0.0 if field.kind.startswith("float") else field.kind == "bool" and False
    return "" if field.kind == "string" else message(field.kind)()


def _plain(value):
    if isinstance(value, Message):
        return value.plain()
    return [_plain(each) for each in value] if isinstance(value, (list, tuple)) else value


def _made(field, value):
    if field.kind in PRIMITIVES or field.kind == "string":
        return value
    kind = message(field.kind)
    return [kind.made(each) for each in value] if field.many else kind.made(value)
