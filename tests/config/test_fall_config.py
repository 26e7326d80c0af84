"""Section `fall` of a robot file."""

from pathlib import Path

import pytest

from tests.support.free_standing_h24 import free_h24
from tests.support.small_robot_file import SMALL, read
from twind.config.robot_file import built_in_robots, load_robot, read_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.robot.fall_settings import FallReaction, FallSettings


def standing(folder: Path, fall: str) -> RobotFile:
    """The built-in standing robot with this section."""
    source = load_robot("h24-standing")
    (folder / "h24.xml").write_text(source.mjcf)
    path = folder / "standing.yaml"
    path.write_text(f"{source.path.read_text()}\nfall: {fall}\n")
    return read_robot(path)


def test_a_robot_without_the_section_detects_no_fall() -> None:
    assert [name for name in built_in_robots() if load_robot(name).fall] == []


def test_the_keys_become_settings(tmp_path: Path) -> None:
    robot = standing(tmp_path, "{reaction: fold, pose: stand, outside_m: 0.05, after_ms: 50, tilt_deg: 90}")
    assert robot.fall == FallSettings(FallReaction.FOLD, "stand", 0.05, 0.05, pytest.approx(1.5708, abs=1e-4))


@pytest.mark.parametrize(
    ("text", "where", "why"),
    [
        ("{reaction: jump}", "fall.reaction", "hold, soft, fold"),
        ("{}", "fall.reaction", "required"),
        ("{reaction: fold}", "fall.pose", "no pose 'fold'; there are rest"),
        ("{reaction: hold, tilt_rad: 0.2}", "fall.upright_rad", "not below tilt_rad"),
        ("{reaction: hold, outside_m: -0.1}", "fall.outside_m", "0"),
    ],
)
def test_keys_that_do_not_fit_are_refused_by_name(tmp_path: Path, text: str, where: str, why: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        standing(tmp_path, text)
    assert where in str(refusal.value)
    assert why in str(refusal.value)


def test_a_robot_that_is_carried_is_refused_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"support is fixed.*`support: free`, or leave `fall` out"):
        read(tmp_path, SMALL + "fall: {reaction: hold}\n")


def test_a_robot_without_an_imu_is_refused_with_the_remedy(tmp_path: Path) -> None:
    path = free_h24(tmp_path, was="poses:", now="fall: {reaction: hold}\nposes:")
    text = path.read_text()
    if "sensors:" in text:
        path.write_text(text[: text.index("sensors:")])
    with pytest.raises(ConfigError, match=r"sensors\.imu.*or leave `fall` out"):
        read_robot(path)
