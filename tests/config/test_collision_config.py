"""`collision:` of the robot file: distances that fit each other, pairs of names, and what is refused."""

from pathlib import Path

import pytest

from twind.config.collision_config import Clearance, clearance
from twind.config.config_reader import ConfigReader
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError, parse


def read(text: str, support: str = "gantry") -> Clearance:
    return clearance(ConfigReader("robot.yaml", parse(text, "robot.yaml")), support)


def test_an_omitted_collision_setting_has_its_default() -> None:
    assert read("{}") == Clearance(0.002, 0.010, 0.020, False, (), None)


def test_everything_can_be_given() -> None:
    found = read(
        "{block_m: 0, warn_m: 0.02, world_m: 0.1, world: true, allow: [[a, b]], pairs: [[c, d], [e, f]]}"
    )
    assert found == Clearance(0.0, 0.02, 0.1, True, (("a", "b"),), (("c", "d"), ("e", "f")))
    assert found.band == pytest.approx(0.02)


def test_only_a_base_with_a_known_place_has_a_world() -> None:
    assert read("{}", "fixed").judge_world
    assert not read("{world: false}", "fixed").judge_world
    assert not read("{}", "gantry").judge_world
    assert not read("{}", "free").judge_world
    with pytest.raises(ConfigError, match="no known place"):
        read("{world: true}", "free")


def test_a_larger_block_takes_the_default_warning_with_it() -> None:
    assert read("{block_m: 0.05}").warn == pytest.approx(0.058)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{block_m: 0.01, warn_m: 0.01}", "0.01 is not above block_m, 0.01"),
        ("{block_m: -0.001}", "is outside >= 0"),
        ("{block_m: 0.6}", "is outside >= 0 and <= 0.5"),
        ("{allow: torso}", "write pairs of names, as [[l_hand, torso]"),
        ("{allow: null}", "found nothing; write pairs of names"),
        ("{allow: [torso, l_hand]}", "allow[0]: a list is expected"),
        ("{allow: [[a, b, c]]}", "allow[0]: needs 2 values, found 3"),
        ("{allow: [[a, a]]}", "no distance from itself"),
        ("{allow: [[a, b], [b, a]]}", "stands there twice"),
        ("{pairs: []}", "judges nothing"),
    ],
)
def test_an_invalid_value_is_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read(text)
    assert message in str(caught.value)


def test_the_built_in_robots_have_a_section(tmp_path: Path) -> None:
    for name in ("h24", "h24-split"):
        gate = load_robot(name).gate
        assert (gate.collision.block, gate.collision.warn, gate.on_torque) == (0.002, 0.010, "warn")
