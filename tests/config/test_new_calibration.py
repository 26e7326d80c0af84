"""A calibration that the daemon refuses: its message names a way to a new one that works."""

import subprocess
from pathlib import Path

import pytest

from twind.config.config_files import ConfigSources, describe
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.virtual.virtual_robot_spec import make_spec, save


def a_calibrated_arm(tmp_path: Path) -> tuple[Path, Path]:
    """Robot file, and its calibration where it is looked for."""
    arm = Path(__file__).parents[2] / "docs" / "examples" / "arm" / "arm.yaml"
    robot = tmp_path / "arm.yaml"
    robot.write_text(arm.read_text().replace("mjcf: arm.xml", f"mjcf: {arm.with_suffix('.xml')}"))
    place = tmp_path / "state of arms" / "calibration" / "arm.yaml"
    place.parent.mkdir(parents=True)
    save(make_spec(load_robot(str(robot))), place)
    return robot, place


def commands(message: str) -> list[str]:
    """Return the texts in backquotes."""
    return message.split("`")[1::2]


def test_the_way_out_of_a_calibration_whose_robot_file_changed_is_in_the_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, place = a_calibrated_arm(tmp_path)
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state of arms"))
    sources = ConfigSources(mode="mirror", robot=str(robot))
    assert describe(sources).calibration is not None
    robot.write_text(robot.read_text().replace("{id: 3, ", "{id: 3, sign: -1, "))
    kept = place.read_text()
    for again in ("", ".~1~"):
        with pytest.raises(
            ConfigError, match="signs or ratios changed since: undo that, or calibrate"
        ) as told:
            describe(sources)
        away, sweep = commands(str(told.value))
        assert sweep == "twindctl calibrate sweep" and "start twind in mode mirror, " in str(told.value)
        subprocess.run(away, shell=True, check=True)
        assert describe(sources).calibration is None
        assert Path(f"{place}.old{again}").read_text() == kept  # never overwritten
        place.write_text(kept)
    place.unlink()
    with pytest.raises(InvalidInput, match="mode live needs a calibration"):
        describe(ConfigSources(mode="live", robot=str(robot), ports=("/dev/null",)))


def test_a_calibration_that_is_named_and_refused_or_absent_tells_how_to_make_it(tmp_path: Path) -> None:
    robot, place = a_calibrated_arm(tmp_path)
    absent = tmp_path / "new.yaml"
    with pytest.raises(ConfigError, match="No such file") as told:
        describe(ConfigSources(mode="mirror", robot=str(robot), calibration=str(absent)))
    assert commands(str(told.value)) == [f"twindctl calibrate sweep --calibration {absent}"]
    assert "start twind in mode mirror without --calibration, " in str(told.value)
    assert told.value.absent
    robot.write_text(robot.read_text().replace("{id: 3, ", "{id: 3, sign: -1, "))
    settings_file = tmp_path / "twind.yaml"
    settings_file.write_text(f"robot: {robot}\ncalibration: '{place}'\nmode: mirror\n")
    with pytest.raises(
        ConfigError, match=f"in mode mirror without `calibration:` in {settings_file}, "
    ) as told:
        describe(ConfigSources(config=str(settings_file)))
    assert commands(str(told.value))[0] == f"mv --backup=numbered '{place}' '{place}'.old"
