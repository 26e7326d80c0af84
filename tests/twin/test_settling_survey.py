"""Joints that vibrate in the simulation are named by `check robot`, with values that settle them."""

from pathlib import Path

import pytest

from tests.support.clearance_rig import arm_file
from tests.support.daemon_rig import known_robot
from twind.ctl.ctl_main import main
from twind.twin.binding import bind
from twind.twin.settling_survey import survey_settling


def test_a_joint_that_vibrates_is_named_with_values_that_settle_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm_file(tmp_path)
    robot = known_robot(str(tmp_path / "arm.yaml"))
    found = survey_settling(bind(robot, None))
    assert "elbow" in {each.name for each in found}
    assert all(each.swing > 0.002 and each.armature for each in found)
    path = str(tmp_path / "arm.yaml")
    main(["check", "robot", path])
    said = capsys.readouterr().out
    assert f"warning: {found[0]}" in said
    model = (tmp_path / "arm.xml").read_text()
    for each in found:
        values = f'armature="{each.armature:g}" damping="{each.damping:.2g}"'
        assert values in str(each)
        model = model.replace(f'<joint name="{each.name}"', f'<joint name="{each.name}" {values}')
    (tmp_path / "arm.xml").write_text(model)
    main(["check", "robot", path])
    assert "vibrates" not in capsys.readouterr().out


def test_a_simulation_that_breaks_down_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm_file(tmp_path)
    model = (tmp_path / "arm.xml").read_text()
    (tmp_path / "arm.xml").write_text(model.replace('kp="9"', 'kp="9000000"'))
    assert main(["check", "robot", str(tmp_path / "arm.yaml")]) == 1
    assert "breaks down" in capsys.readouterr().out
