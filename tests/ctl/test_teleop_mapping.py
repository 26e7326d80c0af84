"""Mapping files: the default one can be read, and an error names its place and what is allowed."""

from math import radians
from pathlib import Path

import pytest

from tests.support.viewer_messages import h24
from twind.config.yaml_tree import ConfigError
from twind.ctl.teleoperating.default_mapping import (
    STANDARD,
    default_gamepad,
    default_keys,
    help_lines,
    mapping_text,
)
from twind.ctl.teleoperating.teleop_mapping import FORMAT, JogBinding, StopBinding, load_mapping

ROBOT = h24()["robot"]
MOTIONS = ("squat", "wave")
KEYS = f"format: {FORMAT}\nkeyboard:\n"
PAD = f"format: {FORMAT}\ngamepad:\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "mapping.yaml"
    path.write_text(text)
    return path


def test_the_default_mapping_is_a_file_that_reads_as_the_same(tmp_path: Path) -> None:
    path = written(tmp_path, mapping_text(ROBOT, MOTIONS))
    assert load_mapping(path, ROBOT, MOTIONS, None) == default_keys(ROBOT, MOTIONS)
    assert load_mapping(path, ROBOT, MOTIONS, STANDARD) == default_gamepad(ROBOT, STANDARD)


def test_the_default_of_a_gamepad_binds_only_what_it_has() -> None:
    mapping = default_gamepad(ROBOT, ("ABS_X", "BTN_TRIGGER"))
    assert set(mapping.bindings) == {"ABS_X"} and mapping.dead_man == "BTN_TRIGGER"
    assert default_gamepad(ROBOT, ("ABS_X",)).dead_man == ""
    assert help_lines(mapping) == ["       ABS_X  {joint: $selected, speed_rad_s: 0.2}"]


def test_speeds_may_be_degrees(tmp_path: Path) -> None:
    path = written(tmp_path, KEYS + "  w: {joint: head_yaw, speed_deg_s: -5}\n  x: {stop: true}\n")
    bindings = load_mapping(path, ROBOT, MOTIONS, None).bindings
    assert bindings == {"w": JogBinding("head_yaw", pytest.approx(-radians(5))), "x": StopBinding()}


@pytest.mark.parametrize(
    ("text", "where", "why"),
    [
        (KEYS + "  w: {joint: tail, speed_rad_s: 0.1}\n", "3:14", "'tail' is none of $selected, "),
        (
            KEYS + "  w: {joint: head_yaw, speed_rad_s: 0.5}\n",
            "3:37",
            "0.5 rad/s: use up to 0.2 rad/s (head_yaw)",
        ),
        (KEYS + "  w: {joint: head_yaw, speed_rad_s: 0}\n", "3:37", "not 0"),
        (KEYS + "  w: {joint: head_yaw}\n", "3:6", "speed_rad_s: is required and missing: at most 0.2"),
        (KEYS + "  w: {joint: head_yaw, speed_rad_s: fast}\n", "3:37", "a number is expected"),
        (KEYS + "  w: {pose: rest, speed_rad_s: 0.1}\n", "3:32", "is of a joint only"),
        (KEYS + "  w: {pose: handstand}\n", "3:13", "'handstand' is none of rest, "),
        (KEYS + "  w: {motion: wawe}\n", "3:15", "nearest: wave"),
        (
            KEYS + "  w: {pose: rest, stop: true}\n",
            "3:6",
            "needs one of joint, pose, motion, select, stop; found pose",
        ),
        (KEYS + "  w: {}\n", "3:6", "found none"),
        (KEYS + "  w: {stop: false}\n", "3:13", ""),
        (KEYS + "  w: {select: up}\n", "3:15", "'up' is none of next, previous"),
        (KEYS + "  w: {jump: 1}\n", "3:7", "unknown key"),
        (KEYS + "  W: {stop: true}\n", "3:6", "'W' is no key: use one character in lower case, or enter"),
        (KEYS + "  ctrl: {stop: true}\n", "3:9", "'ctrl' is no key"),
        (KEYS + "  y: {stop: true}\n  y: {stop: true}\n", "4:3", "duplicate key"),
        (KEYS + "  1: {stop: true}\n", "3:3", "quote it"),
        (KEYS + "  w: stop\n", "3:6", "a mapping is expected"),
        (f"format: {FORMAT}\n", "1:1", "keyboard: binds no key"),
        (f"format: {FORMAT}\nmouse: {{}}\n", "2:1", "unknown key"),
        ("keyboard: {}\n", "1:1", "format: is required and missing"),
    ],
)
def test_a_wrong_mapping_of_keys_is_named_with_its_place(
    tmp_path: Path, text: str, where: str, why: str
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_mapping(path, ROBOT, MOTIONS, None)
    message = str(caught.value)
    assert message.startswith(f"{path}:{where}: ") and why in message and "\n" not in message


@pytest.mark.parametrize(
    ("text", "where", "why"),
    [
        (PAD + "  ABS_X: {joint: head_yaw, speed_rad_s: 0.1}\n", "3:3", "dead_man: is required and missing"),
        (PAD + "  dead_man: BTN_TR\n  ABS_X: {select: next}\n", "3:13", "'BTN_TR' is none of BTN_TL, "),
        (PAD + "  dead_man: ABS_X\n  ABS_X: {select: next}\n", "3:13", "'ABS_X' is none of BTN_TL, "),
        (PAD + "  dead_man: BTN_TL\n  BTN_TL: {stop: true}\n", "3:13", "is bound too"),
        (
            PAD + "  dead_man: BTN_TL\n  BTN_C: {stop: true}\n",
            "4:10",
            "'BTN_C' is none of dead_man, BTN_TL, ",
        ),
        (PAD + "  dead_man: BTN_TL\n", "3:3", "gamepad: binds no control"),
    ],
)
def test_a_wrong_mapping_of_a_gamepad_is_named_with_its_place(
    tmp_path: Path, text: str, where: str, why: str
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_mapping(path, ROBOT, MOTIONS, STANDARD)
    message = str(caught.value)
    assert message.startswith(f"{path}:{where}: ") and why in message and "\n" not in message
