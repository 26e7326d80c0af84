"""The robot file `twind-robot/1`: what the robot is, reviewed and by hand. Read once, checked, frozen.

Knows the file alone: not the compiled model (`twin/binding.py` maps joints to it), not the specimen (zero and
identity stand in the calibration file). Refuses by name what this version cannot do.
"""

import hashlib
import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from twind.config.actuator_types import TypeSpec
from twind.config.bus_config import buses
from twind.config.collision_config import clearance
from twind.config.config_reader import ConfigReader, ConfigStruct, Name, Text, file_error
from twind.config.fall_config import FallKeys, fall_of
from twind.config.imu_config import imu_of
from twind.config.joint_config import described_joints
from twind.config.model_numbers import MAX_MJCF, require_sane_numbers
from twind.config.model_trial import require_readable_model
from twind.config.power_config import PowerKeys, StopButtonKeys, button_of, relay_of
from twind.config.robot_spec import BusSpec, GateSettings, JointSpec, RobotFile
from twind.config.yaml_tree import ConfigError, parse, read_text
from twind.exceptions import InvalidInput
from twind.plain_file import read_plain

FORMAT = "twind-robot/1"

_NAME = re.compile(r"[a-z0-9_-]{1,64}")


class ModelKeys(ConfigStruct):
    """Section `model`."""

    mjcf: Text
    """file, ≤8 MiB | | MuJoCo model: `<compiler angle="radian"/>`, a free joint on the base, one
    `<position>` actuator per driven joint; [bounds](#numbers-of-the-model)"""
    base: Text
    """body | | body with the free joint"""


class LoopKeys(ConfigStruct):
    """Section `loop`."""

    rate_hz: Annotated[float, Meta(ge=10.0, le=1000.0)] = 100.0
    """ticks per second"""
    command_timeout_ms: Annotated[float, Meta(ge=20.0, le=100.0)] = 100.0
    """oldest setpoint of a stream"""
    compensate_gravity: bool = False
    """`true` | | goals get an [offset against gravity](safety.md#gravity); support fixed or gantry"""


class ContactKeys(ConfigStruct):
    """Section `gate.contact`."""

    hold_nm: dict[str, Annotated[float, Meta(gt=0.0, le=1000.0)]] = msgspec.field(default_factory=dict)
    """N·m by joint | none | torque from outside that [holds the robot](contact.md); needs an identified
    model, support fixed or gantry"""


class GateKeys(ConfigStruct, kw_only=True):
    """Section `gate`."""

    on_velocity: Literal["", "reject", "retime"] = ""
    """`reject`, `retime` | `reject`, and a request may choose | too fast: refuse, or slow down"""
    on_position: Annotated[
        Literal["reject"], Meta(description="a position outside the limits cannot be retimed")
    ] = "reject"
    on_torque: Literal["warn", "reject"] = "warn"
    """a path beyond a joint's torque"""
    contact: ContactKeys


class RobotKeys(ConfigStruct, kw_only=True):
    """Keys of a robot file. Files are named relative to it."""

    format: Text
    """`twind-robot/1` |  |"""
    name: Name
    model: ModelKeys
    support: Literal["fixed", "gantry", "free"] = "free"
    """what carries the robot; decides how a fault ends, see [safety](safety.md#reactions). Unless `free`, the
    base's free joint is removed"""
    loop: LoopKeys
    buses: ConfigReader
    types: ConfigReader
    defaults: ConfigReader
    """as of a joint | none | for joints without their own value"""
    joints: ConfigReader
    actuators: ConfigReader
    """as of a joint | as of a joint | actuator of a [transmission](#transmissions). `ratio`: motor turns per
    turn of the input shaft"""
    transmissions: ConfigReader
    passive: tuple[str, ...] = ()
    """joints of the model | | joints without a motor"""
    legs: tuple[str, ...] | None = None
    """joints | all | joints that carry a `free` robot: it falls where one loses torque"""
    poses: ConfigReader
    """rad, within the limits | 0 | named poses. `poses.rest`, where torque may go off, is required"""
    gate: GateKeys
    collision: ConfigReader
    motions: Text = "motions"
    """folder | | folder of `twindctl play NAME`"""
    sensors: ConfigReader
    fall: FallKeys | None = None
    power: PowerKeys
    stop_button: StopButtonKeys | None = None
    todo: tuple[str, ...] = ()
    """keys, such as `joints.elbow.sign` | none | unsettled: no mode live; `twindctl robot finish`"""


def built_in_robots() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return tuple(sorted(path.stem for path in _built_in().glob("*.yaml")))


def load_robot(name_or_path: str, folders: Sequence[Path] = ()) -> RobotFile:
    """A robot by NAME (first found in `folders`, then built in) or by the path of its file.

    Raises ConfigError: no such robot (the known ones are listed), or a file that is refused.
    """
    if not _NAME.fullmatch(name_or_path):
        return read_robot(Path(name_or_path))
    for folder in (*folders, _built_in()):
        path = folder / f"{name_or_path}.yaml"
        if _is_file(path):
            return read_robot(path)
    known = ", ".join(built_in_robots())
    raise file_error(name_or_path, f"no robot of that name; built in: {known}; else give the path of a file")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError as error:  # a folder that we may not enter is no folder without robots
        raise file_error(str(path), f"cannot be looked for: {error.strerror}; give us access") from None


def read_robot(path: Path) -> RobotFile:
    """The robot file at `path`, and the MJCF it names; paths in it are absolute. Raises ConfigError."""
    text = read_text(path)
    top = ConfigReader(str(path), parse(text, str(path)))
    top.require_format(FORMAT)
    given = top.read(RobotKeys)
    mjcf_path, mjcf = _model(top.section("model"), given.model, path)
    wires = buses(given.buses)
    joints, driven = described_joints(top, wires, path.parent)
    names = tuple(joint.name for joint in joints)
    legs = names if given.legs is None else given.legs
    _require_passive(top, given.passive, joints)
    _require_legs(top, legs, names)
    if given.loop.compensate_gravity and given.support == "free":
        reason = "a robot on its feet has contact forces that the offset does not know: fixed or gantry only"
        raise top.section("loop").refuse("compensate_gravity", reason)
    gate = given.gate
    _require_contact(top, gate.contact.hold_nm, given.support, names)
    poses = _poses(given.poses, joints)
    imu = imu_of(top, wires, joints)
    return RobotFile(
        name=given.name,
        path=path.absolute(),
        text_sha256=hashlib.sha256(text.encode()).hexdigest(),
        mjcf_path=mjcf_path.absolute(),
        mjcf=mjcf,
        base=given.model.base,
        support=given.support,
        rate_hz=given.loop.rate_hz,
        command_timeout_ms=given.loop.command_timeout_ms,
        compensate_gravity=given.loop.compensate_gravity,
        buses=wires,
        joints=joints,
        passive=given.passive,
        legs=legs,
        poses=poses,
        gate=GateSettings(
            gate.on_velocity or "reject",
            clearance(given.collision, given.support),
            gate.on_torque,
            contact_hold_nm=gate.contact.hold_nm,
            request_may_retime=not gate.on_velocity,
        ),
        motions=path.absolute().parent / given.motions,
        transmissions=driven,
        imu=imu,
        fall=fall_of(top, given.fall, given.support, inertial=imu is not None, poses=poses),
        relay=relay_of(top, given.power.relay, given.loop.rate_hz),
        stop_button=button_of(top, given.stop_button),
        todo=given.todo,
    )


def _built_in() -> Path:
    return Path(str(resources.files("twind.robots")))


def _model(section: ConfigReader, given: ModelKeys, path: Path) -> tuple[Path, str]:
    mjcf = path.parent / given.mjcf
    try:
        text = read_plain(mjcf, MAX_MJCF).decode("utf-8")
    except InvalidInput as error:
        raise section.refuse("mjcf", f"{mjcf}: {error.reason}") from None
    except (OSError, ValueError) as error:
        raise section.refuse("mjcf", f"{mjcf} cannot be read: {error}") from None
    require_readable_model(mjcf, require_sane_numbers(mjcf))
    return mjcf, text


def _require_passive(top: ConfigReader, passive: tuple[str, ...], joints: Sequence[JointSpec]) -> None:
    for joint in joints:
        if joint.model_joint in passive:
            raise top.refuse("passive", f"{joint.model_joint} is driven by joint {joint.name}")
    if len(set(passive)) != len(passive):
        raise top.refuse("passive", "a name stands there twice")


def _require_legs(top: ConfigReader, legs: tuple[str, ...], names: tuple[str, ...]) -> None:
    for name in legs:
        if name not in names:
            near = get_close_matches(name, names, 1)
            raise top.refuse("legs", f"no joint {name!r}" + (f"; nearest: {near[0]}" if near else ""))
    if len(set(legs)) != len(legs):
        raise top.refuse("legs", "a name stands there twice")


def _require_contact(
    top: ConfigReader, hold: Mapping[str, float], support: str, names: Sequence[str]
) -> None:
    section = top.section("gate").section("contact")
    section.section("hold_nm").require_known(names)
    if hold and support == "free":
        reason = "the forces at the feet of a free robot are unknown to the observer: fixed or gantry only"
        raise section.refuse("hold_nm", reason)


def _poses(section: ConfigReader, joints: Sequence[JointSpec]) -> dict[str, dict[str, float]]:
    if not section.has("rest"):
        raise section.refuse(
            "rest", "is required and missing: the pose in which torque may go off; {} is all 0"
        )
    poses = {}
    for name, pose in section.sections().items():
        pose.require_known(joint.name for joint in joints)
        poses[name] = {joint.name: _angle(pose, joint) for joint in joints}
    return poses


def _angle(pose: ConfigReader, joint: JointSpec) -> float:
    given = pose.has(joint.name)
    angle: float = pose.value(joint.name, float) if given else 0.0
    if not joint.lower <= angle <= joint.upper:
        why = "" if given else " (not given, so 0)"
        bounds = f"{joint.lower:g}..{joint.upper:g}"
        raise pose.refuse(joint.name, f"{angle:g} rad{why} is outside the limits {bounds} of {joint.name}")
    return angle


__all__ = [
    "BusSpec",
    "ConfigError",
    "GateSettings",
    "JointSpec",
    "RobotFile",
    "TypeSpec",
    "built_in_robots",
    "load_robot",
    "read_robot",
]
