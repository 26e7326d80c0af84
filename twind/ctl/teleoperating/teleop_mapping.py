"""Mapping of keys, axes and buttons to what they do, from a YAML file. Errors name file, line and column."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from twind.config.config_reader import ConfigReader, ConfigStruct, Text, none_of
from twind.config.yaml_tree import parse, read_text
from twind.ctl.teleoperating.terminal_codes import KEY_NAMES
from twind.robot_client.jog_motion import SPEED, jog_speed, joints_of

FORMAT = "twind-teleop/1"
SELECTED = "$selected"  # in place of a joint: the one that `select` chose
STEPS = {"next": 1, "previous": -1}
DEAD_MAN = "dead_man"


@dataclass(frozen=True, slots=True)
class JogBinding:
    """Move a joint, or the selected one, at a speed, rad/s; at most as fast as it may be jogged."""

    joint: str
    speed: float


@dataclass(frozen=True, slots=True)
class PoseBinding:
    """Move slowly to a pose."""

    name: str


@dataclass(frozen=True, slots=True)
class MotionBinding:
    """Play a motion."""

    name: str


@dataclass(frozen=True, slots=True)
class SelectBinding:
    """Select another joint: `step` joints further, in the robot's order."""

    step: int


@dataclass(frozen=True, slots=True)
class StopBinding:
    """Stop; needs no dead-man."""


Binding = JogBinding | PoseBinding | MotionBinding | SelectBinding | StopBinding


@dataclass(frozen=True, slots=True)
class TeleopMapping:
    """Bindings by control. `dead_man`: the button that must be held besides; "": each key is its own."""

    bindings: Mapping[str, Binding]
    dead_man: str = ""


class MappingFile(ConfigStruct):
    """Keys of a mapping file."""

    format: Text
    keyboard: ConfigReader | None = None
    gamepad: ConfigReader | None = None


class BindingKeys(ConfigStruct):
    """Keys of one control."""

    joint: Text | None = None
    speed_rad_s: float | None = None
    pose: Text | None = None
    motion: Text | None = None
    select: Literal["next", "previous"] | None = None
    stop: Literal[True] | None = None


def load_mapping(
    path: Path, robot: Mapping[str, Any], motions: Sequence[str], controls: Sequence[str] | None
) -> TeleopMapping:
    """Read the part of a file for the keyboard, or for a gamepad with these `controls`.

    `robot`: as in the answer of `GetRobot`; `motions`: the names of its motions. Raises ConfigError.
    """
    reader = ConfigReader(str(path), parse(read_text(path), str(path)))
    reader.require_format(FORMAT)
    reader.read(MappingFile)
    key = "keyboard" if controls is None else "gamepad"
    section = reader.section(key)
    bindings = {}
    for control in section:
        if controls is not None and control == DEAD_MAN:
            continue
        _require_control(section, control, controls)
        bindings[control] = _binding(section.section(control), robot, motions)
    if not bindings:
        raise reader.refuse(key, f"binds no {'key' if controls is None else 'control'}")
    if controls is None:
        return TeleopMapping(bindings)
    dead_man = section.choice(DEAD_MAN, [each for each in controls if each.startswith(("BTN_", "KEY_"))])
    if dead_man in bindings:
        raise section.refuse(DEAD_MAN, f"{dead_man} is bound too: the dead-man button does nothing else")
    return TeleopMapping(bindings, dead_man)


def _require_control(section: ConfigReader, control: str, controls: Sequence[str] | None) -> None:
    if controls is not None:
        if control not in controls:
            raise section.refuse(control, none_of(control, [DEAD_MAN, *controls]))
    elif control not in KEY_NAMES and not (
        len(control) == 1 and control.isprintable() and control == control.lower() and control != " "
    ):
        names = ", ".join(KEY_NAMES)
        raise section.refuse(control, f"{control!r} is no key: use one character in lower case, or {names}")


def _binding(keys: ConfigReader, robot: Mapping[str, Any], motions: Sequence[str]) -> Binding:
    given = keys.read(BindingKeys)
    actions = ("joint", "pose", "motion", "select", "stop")
    named = [each for each in actions if getattr(given, each) is not None]
    if len(named) != 1:
        raise keys.refuse("", f"needs one of {', '.join(actions)}; found {' and '.join(named) or 'none'}")
    if named != ["joint"] and given.speed_rad_s is not None:
        raise keys.refuse("speed_rad_s", "is of a joint only")
    if given.joint is not None:
        return _jog(keys, given.joint, given.speed_rad_s, joints_of(robot))
    if given.pose is not None:
        return PoseBinding(keys.choice("pose", robot["poses"]))
    if given.motion is not None:
        return MotionBinding(keys.choice("motion", motions))
    return StopBinding() if given.select is None else SelectBinding(STEPS[given.select])


def _jog(
    keys: ConfigReader, joint: str, speed: float | None, joints: Mapping[str, Mapping[str, Any]]
) -> JogBinding:
    keys.choice("joint", [SELECTED, *joints])
    bound = SPEED if joint == SELECTED else jog_speed(joints[joint])
    if speed is None:
        raise keys.refuse("speed_rad_s", f"is required and missing: at most {bound:.3g}; negative moves down")
    if not 0.0 < abs(speed) <= bound * 1.001:  # of degrees that were rounded
        raise keys.refuse(
            "speed_rad_s", f"{speed:.3g} rad/s: use up to {bound:.3g} rad/s ({joint}), and not 0"
        )
    return JogBinding(joint, speed)
