"""`gate.contact.hold_nm` is refused without an identified model, and for a robot on its feet."""

from pathlib import Path

import pytest

from tests.support.built_in_copy import change, copy_built_in
from twind.config.config_files import ConfigSources, describe
from twind.config.robot_file import ConfigError, load_robot
from twind.exceptions import InvalidInput


def described(folder: Path, bounds: str) -> Path:
    path = copy_built_in("h24", folder)
    change(path, "gate: {", f"gate: {{contact: {{hold_nm: {{{bounds}}}}}, ")
    return path


def test_bounds_are_read_by_joint(tmp_path: Path) -> None:
    assert load_robot(str(described(tmp_path, "l_elbow: 2.5"))).gate.contact_hold_nm == {"l_elbow": 2.5}
    assert load_robot("h24").gate.contact_hold_nm == {}


@pytest.mark.parametrize("bounds", ["l_elbow: 0.0", "l_elbow: -1.0", "no_joint: 1.0"])
def test_wrong_bound_or_joint_is_refused(tmp_path: Path, bounds: str) -> None:
    with pytest.raises(ConfigError, match=bounds.split(":")[0]):
        load_robot(str(described(tmp_path, bounds)))


def test_robot_on_its_feet_is_refused(tmp_path: Path) -> None:
    path = described(tmp_path, "l_elbow: 2.5")
    change(path, "support: gantry", "support: free")
    with pytest.raises(ConfigError, match="fixed or gantry"):
        load_robot(str(path))


def test_robot_without_identified_model_is_refused(tmp_path: Path) -> None:
    path = described(tmp_path, "l_elbow: 2.5")
    with pytest.raises(InvalidInput, match="identified model"):
        describe(ConfigSources(mode="sim", robot=str(path)))
