"""`check robot` shows the bound of FOLLOW_ERR of each joint, the lag expected, and why it is so."""

import json
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import pytest

from tests.support.daemon_rig import known_binding
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main
from twind.ctl.follow_report import FollowRow, follow_lines, follow_rows
from twind.twin.binding import bind

ARM = Path(__file__).parents[2] / "docs" / "examples" / "arm"


def edited(folder: Path, *edits: tuple[str, str]) -> Path:
    """The arm of the tutorial, edited."""
    copytree(ARM, folder, dirs_exist_ok=True)
    path = folder / "arm.yaml"
    text = path.read_text()
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return path


def first_row(folder: Path, *edits: tuple[str, str]) -> FollowRow:
    """Row of the shoulder of that arm."""
    return follow_rows(bind(load_robot(str(edited(folder, *edits))), None))[0]


def test_a_stiff_robot_has_the_default(tmp_path: Path) -> None:
    shoulder = first_row(tmp_path)
    assert (shoulder.rad, shoulder.seconds, shoulder.reason, shoulder.warning) == (0.2, 0.1, "default", "")
    assert 0.0 < shoulder.trail < shoulder.lag < 0.3


def test_a_soft_robot_has_a_wider_bound_up_to_the_largest_default(tmp_path: Path) -> None:
    shoulder = first_row(tmp_path, ("p: 800", "p: 400"))
    assert 0.2 < shoulder.rad < 0.5
    assert shoulder.reason == "1.5 times the lag" and not shoulder.warning
    soft = first_row(tmp_path, ("p: 800", "p: 50"))
    assert soft.rad == 0.5
    assert soft.reason.startswith("largest default; ")
    assert soft.warning.startswith("warning: shoulder_pitch: a lag of ") and "follow_rad: " in soft.warning


def test_what_the_owner_states_is_shown_and_too_little_is_warned_of(tmp_path: Path) -> None:
    shoulder = first_row(tmp_path, ("p: 800", "p: 50"), ("id: 1,", "id: 1, follow_rad: 0.4,"))
    assert (shoulder.rad, shoulder.reason) == (0.4, "robot file")
    assert "follow_rad is 0.4" in shoulder.warning


def test_a_joint_without_a_known_gain_says_which_default_stands(tmp_path: Path) -> None:
    shoulder = first_row(tmp_path, ("XM430-W350", "XW540-H260"))
    assert shoulder.rad == 0.2
    assert shoulder.reason == "default: the stall torque or gain of XW540-H260 is not known"
    assert shoulder.fields()["lag_rad"] is None


def test_a_robot_without_bodies_says_so() -> None:
    binding = known_binding("h24").binding
    gate = replace(binding.robot.gate, collision=replace(binding.robot.gate.collision, bodiless=True))
    found = follow_rows(replace(binding, robot=replace(binding.robot, gate=gate)))
    assert {row.reason for row in found} == {"default: the model has no bodies"}
    assert not any(row.warning for row in found)


def test_the_verb_prints_a_row_for_each_joint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = edited(tmp_path)
    assert main(["check", "robot", str(path), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [row["joint"] for row in answer["follow"]] == ["shoulder_pitch", "shoulder_roll", "elbow"]
    lines = follow_lines(follow_rows(bind(load_robot(str(path)), None)))
    assert lines and all(line in answer["lines"] for line in lines)
