"""Mapping of a robot for which no file is given, and the same as a file to edit."""

from collections.abc import Mapping, Sequence
from string import ascii_lowercase
from typing import Any

from twind.ctl.teleoperating.teleop_mapping import (
    DEAD_MAN,
    FORMAT,
    SELECTED,
    STEPS,
    Binding,
    JogBinding,
    MotionBinding,
    PoseBinding,
    SelectBinding,
    StopBinding,
    TeleopMapping,
)
from twind.robot_client.jog_motion import SPEED

DEAD_MEN = ("BTN_TL", "BTN_TR", "BTN_THUMB", "BTN_TRIGGER")  # shoulder buttons, else those of a joystick
STANDARD = ("BTN_TL", "BTN_SOUTH", "BTN_EAST", "ABS_X", "ABS_HAT0Y-", "ABS_HAT0Y+")  # of most gamepads

_HEAD = f"""\
# Mapping of `twindctl teleop --mapping FILE`. A key moves the robot while it is held. The dead-man button of
# a gamepad must be held besides. Each control has one of:
#   {{joint: NAME, speed_rad_s: 0.1}}  or speed_deg_s; negative moves down; at most {SPEED:g} rad/s
#   {{joint: {SELECTED}, ...}}  the joint chosen by {{select: next}} and {{select: previous}}
#   {{pose: NAME}}, {{motion: NAME}}, {{stop: true}}
format: {FORMAT}
"""


def default_keys(robot: Mapping[str, Any], motions: Sequence[str]) -> TeleopMapping:
    """Return the keys of a robot: arrows select and move a joint, digits are poses, letters motions."""
    bindings: dict[str, Binding] = {
        "up": SelectBinding(-1),
        "down": SelectBinding(1),
        "left": JogBinding(SELECTED, -SPEED),
        "right": JogBinding(SELECTED, SPEED),
        "space": StopBinding(),
    }
    bindings |= {key: PoseBinding(str(name)) for key, name in zip("123456789", robot["poses"], strict=False)}
    bindings |= {key: MotionBinding(name) for key, name in zip(ascii_lowercase, motions, strict=False)}
    return TeleopMapping(bindings)


def default_gamepad(robot: Mapping[str, Any], controls: Sequence[str]) -> TeleopMapping:
    """Return the controls of a gamepad: the pad selects a joint, the left stick moves it.

    `dead_man` is "" where none of the usual buttons is there.
    """
    wanted: dict[str, Binding] = {
        "ABS_HAT0Y-": SelectBinding(-1),
        "ABS_HAT0Y+": SelectBinding(1),
        "ABS_X": JogBinding(SELECTED, SPEED),
        "BTN_EAST": StopBinding(),
    }
    wanted |= {key: PoseBinding(str(name)) for key, name in zip(["BTN_SOUTH"], robot["poses"], strict=False)}
    bindings = {control: binding for control, binding in wanted.items() if control in controls}
    return TeleopMapping(bindings, next((each for each in DEAD_MEN if each in controls), ""))


def mapping_text(robot: Mapping[str, Any], motions: Sequence[str]) -> str:
    """Return the default mapping as a file."""
    keys = default_keys(robot, motions)
    pad = default_gamepad(robot, STANDARD)
    return "".join(
        [
            _HEAD,
            "keyboard:\n",
            *(f"  {_quoted(control)}: {_words(binding)}\n" for control, binding in keys.bindings.items()),
            f"gamepad:\n  {DEAD_MAN}: {pad.dead_man}\n",
            *(f"  {control}: {_words(binding)}\n" for control, binding in pad.bindings.items()),
        ]
    )


def help_lines(mapping: TeleopMapping) -> list[str]:
    """Return a line for each control, for a terminal."""
    return [f"{control:>12}  {_words(binding)}" for control, binding in mapping.bindings.items()]


def _quoted(control: str) -> str:
    """Quote a key that YAML could take for a number, a truth value or nothing."""
    return f'"{control}"' if len(control) == 1 else control


def _words(binding: Binding) -> str:
    match binding:
        case JogBinding(joint, speed):
            return f"{{joint: {joint}, speed_rad_s: {speed}}}"
        case PoseBinding(name):
            return f"{{pose: {name}}}"
        case MotionBinding(name):
            return f"{{motion: {name}}}"
        case SelectBinding(step):
            return f"{{select: {next(word for word, each in STEPS.items() if each == step)}}}"
    return "{stop: true}"
