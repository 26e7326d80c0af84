"""A robot file is edited key by key; everything else stays as it is."""

import os
import shutil
from pathlib import Path

import pytest

from twind.command_line.verb import Rejected
from twind.config.robot_file import read_robot
from twind.ctl.robot_file_edit import TODO_COMMENT, RobotFileEdit

TEXT = f"""\
# mine
format: twind-robot/1
name: arm
model: {{mjcf: pantilt.xml, base: base}}
support: fixed
loop: {{rate_hz: 50}}
{TODO_COMMENT}
todo:
  - types.a.watchdog
  - poses.rest
buses: {{main: {{kind: feetech}}}}
types:
  a:
    device: STS3215
    supply:
      warn_v: 6.5   # sags
  b:
    device: STS3215
joints:
  pan: {{id: 1, bus: main, type: a, sign: 1, limits_rad: [-1, 1]}}   # left
  tilt: {{id: 2, bus: main, type: b, limits_rad: [-0.5, 0.5]}}
poses:
  rest: {{}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    shutil.copy(Path(__file__).parents[1] / "data" / "models" / "pantilt.xml", tmp_path)
    actuators = '<actuator><position joint="pan" kp="5"/><position joint="tilt" kp="5"/></actuator></mujoco>'
    model = tmp_path / "pantilt.xml"
    model.write_text(model.read_text().replace("</mujoco>", actuators))
    path = tmp_path / "arm.yaml"
    path.write_text(TEXT)
    return path


def test_a_key_of_a_section_that_ends_in_a_section_is_added_to_the_right_one(file: Path) -> None:
    edit = RobotFileEdit(file)
    edit.put("types.a.watchdog", "none")
    edit.settle("types.a.watchdog")
    edit.save()
    robot = read_robot(file)
    assert [joint.type.watchdog for joint in robot.joints] == ["none", ""]  # type: ignore[attr-defined]
    assert robot.todo == ("poses.rest",)
    kept = file.read_text()
    assert all(comment in kept for comment in ("# mine", "# sags", "# left"))


def test_values_are_replaced_and_added_in_flow_sections(file: Path) -> None:
    edit = RobotFileEdit(file)
    edit.put("joints.pan.sign", "-1")
    edit.put("joints.tilt.sign", "-1")
    edit.put("poses.rest", "{pan: 0.25}")
    for item in ("types.a.watchdog", "poses.rest"):
        edit.settle(item)
    edit.save()
    robot = read_robot(file)
    assert [joint.sign for joint in robot.joints] == [-1, -1]
    assert robot.poses["rest"]["pan"] == 0.25
    assert robot.todo == ()
    assert "todo" not in file.read_text() and "What no source" not in file.read_text()


def test_a_value_that_is_refused_leaves_the_file_as_it_was(file: Path) -> None:
    edit = RobotFileEdit(file)
    edit.put("joints.pan.sign", "2")
    with pytest.raises(Rejected, match=r"arm\.yaml.*sign"):
        edit.save()
    assert file.read_text() == TEXT
    assert sorted(os.listdir(file.parent)) == ["arm.yaml", "pantilt.xml"]


def test_a_link_stays_a_link_and_the_mode_stays(file: Path, tmp_path: Path) -> None:
    file.chmod(0o640)
    link = tmp_path / "link.yaml"
    link.symlink_to(file)
    edit = RobotFileEdit(link)
    edit.put("support", "gantry")
    edit.save()
    assert link.is_symlink()
    assert file.stat().st_mode & 0o777 == 0o640
    assert read_robot(file).support == "gantry"


def test_a_file_that_was_changed_meanwhile_is_left_as_it_is(file: Path) -> None:
    """A question of `robot finish` may wait for long, and may ask for a change of the file itself."""
    edit = RobotFileEdit(file)
    edit.put("support", "gantry")
    edit.save()
    changed = file.read_text().replace("limits_rad: [-1, 1]", "limits_rad: [-0.4, 0.4]")
    file.write_text(changed)
    edit.put("joints.tilt.sign", "-1")
    with pytest.raises(Rejected, match="was changed since it was read"):
        edit.save()
    assert file.read_text() == changed
    assert sorted(os.listdir(file.parent)) == ["arm.yaml", "pantilt.xml"]


def test_the_new_text_is_on_the_disk_before_it_gets_the_name(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a power cut may leave an empty file in the place of both."""
    done: list[str] = []
    replace, fsync = os.replace, os.fsync

    def replaced(source: Path, target: Path) -> None:
        done.append("replace")
        replace(source, target)

    def synced(fd: int) -> None:
        done.append(Path(f"/proc/self/fd/{fd}").resolve().name)
        fsync(fd)

    monkeypatch.setattr(os, "replace", replaced)
    monkeypatch.setattr(os, "fsync", synced)
    edit = RobotFileEdit(file)
    edit.put("support", "gantry")
    edit.save()
    assert done == [".arm.new.yaml", "replace", file.parent.name]
