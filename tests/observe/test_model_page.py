"""Facts of a joint on the page of a robot file, and the angles that it shows."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.viewer_messages import h24
from twind.ctl.ctl_main import main
from twind.observe.viewing.model_page import AHEAD, facts, state_message
from twind.observe.viewing.robot_model import RobotModel

JOINTS = list(h24()["robot"]["joints"])
UP = np.array([0.0, 0.0, 1.0])


def test_facts_name_device_limits_axis_sign_and_angle() -> None:
    text = facts(JOINTS[0], 0.5, UP, ())
    for part in (
        "bus main, id 1, XM430-W350",
        "-1.5 to 1.5 rad (-86° to 86°)",
        "0.00 0.00 1.00 in the world",
        "+1: its counts grow with the angle",
        "0.500 rad (29°)",
    ):
        assert part in text
    assert "-1: its counts shrink" in facts(JOINTS[0] | {"sign": -1}, 0.5, UP, ())
    assert "not known" in facts(JOINTS[0], np.nan, UP, ())


@pytest.mark.parametrize(("name", "words"), [("nosuch", "no robot of that name"), ("a.xml", "a mapping")])
def test_a_wrong_file_or_name_is_refused_in_one_line(
    name: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.xml").write_text("<robot/>")
    assert main(["robot", "show", str(Path(name).absolute()) if "." in name else name]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_open_items_of_the_joint_are_shown_and_those_of_others_not() -> None:
    text = facts(JOINTS[0], 0.0, UP, ("joints.head_yaw.sign", "joints.head_yaw_2.sign", "support"))
    assert "joints.head_yaw.sign" in text
    assert "head_yaw_2" not in text and "support" not in text


def test_the_chosen_joint_alone_has_a_goal_in_the_positive_direction() -> None:
    angles: list[float | None] = [0.1] * len(JOINTS)
    rows = state_message(angles, 3, JOINTS)["joints"]
    assert rows[3]["goal"] == 0.1 + AHEAD
    assert [row["goal"] for row in rows if row is not rows[3]] == [None] * (len(JOINTS) - 1)
    assert state_message([None] * len(JOINTS), 3, JOINTS)["joints"][3]["goal"] is None


def test_the_axis_turns_with_the_limb_that_carries_it() -> None:
    model = RobotModel(h24())
    pitch = model.joints.index("head_pitch")
    straight = np.zeros(len(JOINTS))
    turned = straight.copy()
    turned[model.joints.index("head_yaw")] = np.pi / 2
    assert np.allclose(np.abs(model.axis(straight, pitch)[1]), [0, 1, 0], atol=1e-9)
    assert np.allclose(np.abs(model.axis(turned, pitch)[1]), [1, 0, 0], atol=1e-9)
