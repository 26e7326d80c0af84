"""The robot file `twind-robot/1`: what the robot is, reviewed and by hand. Read once, checked, frozen.

Knows the file alone: not the compiled model (`twin/binding.py` maps joints to it), not the specimen (zero and
identity stand in the calibration file). Refuses by name what this version cannot do.
"""

import hashlib
import re
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import resources
from pathlib import Path

from twind.config.actuator_types import GainSettings, TypeSpec
from twind.config.bus_config import buses
from twind.config.collision_config import clearance
from twind.config.config_section import ConfigSection, file_error
from twind.config.imu_config import imu_of
from twind.config.joint_config import described_joints
from twind.config.model_numbers import MAX_MJCF, require_sane_numbers
from twind.config.robot_spec import BusSpec, GateSettings, JointSpec, RobotFile
from twind.config.yaml_tree import ConfigError, parse, read_text
from twind.exceptions import InvalidInput
from twind.protocol.plain_file import read_plain

FORMAT = "twind-robot/1"
SUPPORTS = ("fixed", "gantry", "free")

_NAME = re.compile(r"[a-z0-9_-]{1,64}")


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
    """The robot file at `path`, and the MJCF it names. Raises ConfigError."""
    text = read_text(path)
    top = ConfigSection(str(path), parse(text, str(path)))
    if top.text("format") != FORMAT:
        raise top.refuse("format", f"{top.text('format')!r} is not {FORMAT}")
    name = top.text("name")
    if not _NAME.fullmatch(name):
        raise top.refuse("name", f"{name!r}: use 1 to 64 of a-z, 0-9, _ and -")
    mjcf_path, mjcf, base = _model(top.section("model"), path)
    rate, timeout = _loop(top.section("loop"))
    wires = buses(top.section("buses"))
    joints, driven = described_joints(top, wires, path.parent)
    support = top.text("support", "free", SUPPORTS)
    robot = RobotFile(
        name=name,
        path=path,
        text_sha256=hashlib.sha256(text.encode()).hexdigest(),
        mjcf_path=mjcf_path,
        mjcf=mjcf,
        base=base,
        support=support,
        rate_hz=rate,
        command_timeout_ms=timeout,
        buses=wires,
        joints=joints,
        passive=_passive(top, joints),
        legs=_legs(top, joints),
        poses=_poses(top.section("poses"), joints),
        gate=_gate(top, support),
        motions=path.parent / top.text("motions", "motions"),
        transmissions=driven,
        imu=imu_of(top, wires, joints),
    )
    top.close()
    return robot


def _built_in() -> Path:
    return Path(str(resources.files("twind.robots")))


def _model(section: ConfigSection, path: Path) -> tuple[Path, str, str]:
    mjcf = path.parent / section.text("mjcf")
    base = section.text("base")
    section.close()
    try:
        text = read_plain(mjcf, MAX_MJCF).decode("utf-8")
    except InvalidInput as error:
        raise section.refuse("mjcf", f"{mjcf}: {error.reason}") from None
    except (OSError, ValueError) as error:
        raise section.refuse("mjcf", f"{mjcf} cannot be read: {error}") from None
    require_sane_numbers(mjcf)
    return mjcf, text, base


def _loop(section: ConfigSection) -> tuple[float, float]:
    rate = section.number("rate_hz", 100.0, least=10.0, most=1000.0)
    timeout = section.number("command_timeout_ms", 100.0, least=20.0, most=100.0)
    section.close()
    return rate, timeout


def _passive(top: ConfigSection, joints: Sequence[JointSpec]) -> tuple[str, ...]:
    passive = top.texts("passive")
    for joint in joints:
        if joint.model_joint in passive:
            raise top.refuse("passive", f"{joint.model_joint} is driven by joint {joint.name}")
    if len(set(passive)) != len(passive):
        raise top.refuse("passive", "a name stands there twice")
    return passive


def _legs(top: ConfigSection, joints: Sequence[JointSpec]) -> tuple[str, ...]:
    """Joints that carry the robot; all of them where the file does not say."""
    names = tuple(joint.name for joint in joints)
    legs = top.texts("legs") if top.has("legs") else names
    for name in legs:
        if name not in names:
            near = get_close_matches(name, names, 1)
            raise top.refuse("legs", f"no joint {name!r}" + (f"; nearest: {near[0]}" if near else ""))
    if len(set(legs)) != len(legs):
        raise top.refuse("legs", "a name stands there twice")
    return legs


def _poses(section: ConfigSection, joints: Sequence[JointSpec]) -> dict[str, dict[str, float]]:
    if not section.has("rest"):
        raise section.refuse(
            "rest", "is required and missing: the pose in which torque may go off; {} is all 0"
        )
    poses = {}
    for name in section:
        pose = section.section(name)
        poses[name] = {joint.name: _angle(pose, joint) for joint in joints}
        pose.close()
    section.close()
    return poses


def _angle(pose: ConfigSection, joint: JointSpec) -> float:
    angle = pose.number(joint.name, 0.0)
    if not joint.lower <= angle <= joint.upper:
        why = "" if pose.has(joint.name) else " (not given, so 0)"
        bounds = f"{joint.lower:g}..{joint.upper:g}"
        raise pose.refuse(joint.name, f"{angle:g} rad{why} is outside the limits {bounds} of {joint.name}")
    return angle


def _gate(top: ConfigSection, support: str) -> GateSettings:
    section = top.section("gate")
    policies = ("reject", "retime")
    on_velocity = section.text("on_velocity", "reject", policies)
    if section.text("on_position", "reject", policies) != "reject":
        raise section.refuse("on_position", "a position outside the limits cannot be retimed: only reject")
    on_torque = section.text("on_torque", "warn", ("warn", "reject"))
    section.close()
    return GateSettings(on_velocity, clearance(top.section("collision"), support), on_torque)


__all__ = [
    "BusSpec",
    "ConfigError",
    "GainSettings",
    "GateSettings",
    "JointSpec",
    "RobotFile",
    "TypeSpec",
    "built_in_robots",
    "load_robot",
    "read_robot",
]
