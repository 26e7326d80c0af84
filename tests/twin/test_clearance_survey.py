"""Clearances that `check robot` finds, and its proposal for `allow`."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.clearance_rig import FILE, arm, arm_file
from twind.config.robot_file import load_robot, read_robot
from twind.ctl.ctl_main import main
from twind.ctl.offline_check import motions_of
from twind.exceptions import OperationFailed
from twind.robot.trajectory import Trajectory
from twind.twin import mujoco_physics
from twind.twin.binding import bind
from twind.twin.clearance_survey import survey

ALL = np.ones(3, np.bool_)


@pytest.mark.parametrize("name", ["h24", "h24-split"])
def test_nothing_of_the_built_in_robots_comes_near_itself(name: str) -> None:
    robot = load_robot(name)
    motions, wrong = motions_of(robot)
    assert set(motions) == {"wave", "squat", "reach"}
    found = survey(bind(robot, None), motions)
    assert (found.near, found.error, found.proposed, wrong) == ((), None, (), [])
    assert found.judged > 50


def test_a_pose_and_a_motion_that_come_near_are_named_and_proposed(tmp_path: Path) -> None:
    robot = arm_file(tmp_path)
    text = FILE.format(support="gantry", collision="{}").replace(
        "rest: {}", "rest: {}, bent: {elbow: 2.5, wrist: 2.0}"
    )
    (tmp_path / "arm.yaml").write_text(text)
    robot = read_robot(tmp_path / "arm.yaml")
    motion = Trajectory(np.array([1.0]), np.array([[0.0, 2.85, 0.0]]), ALL)
    found = survey(bind(robot, None), {"fold": motion})
    by_pair = {near.bodies: near for near in found.near}
    assert by_pair["base", "middle"].clearance < 0.0
    assert by_pair["base", "middle"].where.startswith("motion fold at ")
    lines = found.lines()
    assert any(line.startswith("too close: base and middle") for line in lines)
    assert found.proposed
    for near in found.near:
        (line,) = [line for line in lines if line.startswith(f"too close: {' and '.join(near.bodies)}")]
        if near.bodies in found.proposed:
            assert line.endswith(
                f"neighbours; if they are built so close: collision: {{allow: [[{', '.join(near.bodies)}]]}})"
            )
    allow = ", ".join(f"[{a}, {b}]" for a, b in found.proposed)
    (tmp_path / "arm.yaml").write_text(text.replace("collision: {}", f"collision: {{allow: [{allow}]}}"))
    left = survey(bind(read_robot(tmp_path / "arm.yaml"), None), {"fold": motion})
    assert left.proposed == ()
    assert {near.bodies for near in left.near} == set(by_pair) - set(found.proposed)


def test_bodies_far_apart_in_the_tree_are_never_proposed(tmp_path: Path) -> None:
    robot = arm_file(tmp_path)
    motion = Trajectory(np.array([1.0]), np.array([[0.0, 2.85, 0.0]]), ALL)
    found = survey(bind(robot, None), {"curl": motion})
    (near,) = [each for each in found.near if set(each.bodies) == {"base", "tip"}]
    assert near.refused
    assert near.joints == 3
    assert near.bodies not in found.proposed
    assert any("3 joints apart, so they collide" in line for line in found.lines())


def test_a_pair_that_is_only_near_is_named_and_not_proposed(tmp_path: Path) -> None:
    robot = arm_file(tmp_path, "{warn_m: 0.06}")
    found = survey(bind(robot, None), {})
    assert found.near
    assert not any(near.refused for near in found.near)
    assert found.proposed == ()


def test_a_robot_in_which_nothing_can_collide_is_an_error(tmp_path: Path) -> None:
    robot = arm_file(tmp_path)
    xml = (tmp_path / "arm.xml").read_text()
    (tmp_path / "arm.xml").write_text(xml.replace("<geom ", '<geom contype="0" conaffinity="0" '))
    found = survey(bind(robot, None), {})
    assert (found.judged, found.possible) == (0, 0)
    assert "contype and conaffinity" in str(found.error)
    (tmp_path / "arm.xml").write_text(xml)
    allow = "{allow: [[base, upper], [base, middle], [base, tip], [upper, tip]]}"
    assert "collision.allow" in str(survey(arm(tmp_path, allow), {}).error)


def test_the_verb_prints_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "robot", "h24"]) == 0
    assert "clearance: 89 pairs of geoms are judged, of 103 that can collide" in capsys.readouterr().out
    arm_file(tmp_path, "{allow: [[tipp, base]]}")
    assert main(["check", "robot", str(tmp_path / "arm.yaml")]) == 1
    assert "nearest: tip" in capsys.readouterr().out


def test_the_verb_refuses_a_body_that_breaks_down_at_rest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise OperationFailed("virtual body at -19.000 s: Nan, Inf or huge value in QACC")

    monkeypatch.setattr(mujoco_physics, "body_of", broken)
    assert main(["check", "robot", "h24"]) == 1
    assert "error: virtual body at -19.000 s: Nan" in capsys.readouterr().out


def test_a_motion_of_another_robot_is_reported_and_left_out(tmp_path: Path) -> None:
    robot = arm_file(tmp_path)
    (tmp_path / "motions").mkdir()
    (tmp_path / "motions" / "wave.json").write_text('{"joint_names": ["l_knee"], "points": []}')
    paths, wrong = motions_of(robot)
    assert paths == {}
    assert wrong
    assert wrong[0].startswith("motion wave: ")
