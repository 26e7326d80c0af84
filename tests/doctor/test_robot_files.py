"""Findings about settings, robot file, model and calibration."""

import re
from pathlib import Path

import pytest

from tests.support.doctor_rig import (
    found,
    look,
    plant,
    settings,
    spoil,
)
from twind.config.calibration_file import dump_calibration
from twind.config.robot_file import load_robot
from twind.virtual.virtual_robot_spec import calibration, make_spec


def test_a_healthy_robot_file_gives_no_alarm(tmp_path: Path, robot: Path) -> None:
    file = settings(tmp_path, robot)
    for code in ("FILE_REFUSED", "MODEL_NO_LIMITS"):
        assert found("--config", str(file), code=code) == []


def test_a_misspelt_key_of_the_settings_is_found_with_its_place_and_the_nearest(
    tmp_path: Path, robot: Path
) -> None:
    file = settings(tmp_path, robot, rate_hx=100)
    (finding,) = found("--config", str(file), code="FILE_REFUSED")
    assert finding.thing == f"{file}:4:1" and "rate_hz" in finding.measured


@pytest.mark.parametrize("option", ["--config", "--robot"])
def test_a_missing_file_is_found_with_the_folder_of_relative_paths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (finding,) = found(option, "missing/no.yaml", code="FILE_REFUSED")
    assert finding.thing == "missing/no.yaml"
    assert str(tmp_path) in finding.advice
    assert finding.caution == ""  # wrong zeros are of a file that is there


def test_a_wrong_value_in_the_robot_file_is_found_with_line_and_column(tmp_path: Path, robot: Path) -> None:
    spoil(robot, lambda text: text.replace("baud: 2000000", "baud: fast"))
    (finding,) = found("--robot", str(robot), code="FILE_REFUSED")
    assert re.fullmatch(re.escape(str(robot)) + r":9:\d+", finding.thing) and "baud" in finding.measured


def test_a_robot_of_an_unknown_name_is_found(tmp_path: Path) -> None:
    (finding,) = found("--robot", "h25", code="FILE_REFUSED")
    assert "no robot of that name; built in: h24" in finding.measured


def test_limits_beyond_the_models_range_are_found(robot: Path) -> None:
    model = robot.with_suffix(".xml")
    spoil(model, lambda text: re.sub(r'(name="head_yaw"[^>]*range=)"[^"]*"', r'\1"-0.1 0.1"', text))
    (finding,) = found("--robot", str(robot), code="FILE_REFUSED")
    assert "head_yaw" in finding.measured and "outside the model's range -0.1..0.1" in finding.measured


def test_a_model_without_limits_is_found_with_its_joints(robot: Path) -> None:
    model = robot.with_suffix(".xml")
    spoil(model, lambda text: re.sub(r'(name="(?:head_yaw|l_knee)"[^>]*?) range="[^"]*"', r"\1", text))
    spoil(model, lambda text: text.replace(' inheritrange="1"', ""))
    (finding,) = found("--robot", str(robot), code="MODEL_NO_LIMITS")
    assert finding.measured == "2 of 24 driven joints have no range: head_yaw, l_knee"
    assert 'range="LOWER UPPER"' in finding.advice and "head_yaw" in finding.advice


def test_rejected_robot_file_precedes_its_consequences(tmp_path: Path, robot: Path) -> None:
    spoil(robot, lambda text: text.replace("baud: 2000000", "baud: fast"))
    outcome = look("--robot", str(robot), socket=tmp_path, only=["FILE_REFUSED", "NO_DAEMON"])
    assert [each.code for each in outcome.found] == ["FILE_REFUSED", "NO_DAEMON"]
    assert outcome.because == {1: "FILE_REFUSED"}
    assert ("model", "the robot file cannot be read") in outcome.unseen


def calibrated(tmp_path: Path, robot: Path) -> Path:
    """A calibration of that robot where it is looked for."""
    described = load_robot(str(robot))
    text = dump_calibration(calibration(make_spec(described)))
    return plant(tmp_path / f"state/calibration/{described.name}.yaml", text)


def test_missing_calibration_is_reported_with_its_usual_path(tmp_path: Path, robot: Path) -> None:
    (finding,) = found("--config", str(settings(tmp_path, robot)), code="CALIBRATION_MISSING")
    assert str(tmp_path / "state/calibration/h24.yaml") in finding.expected
    page = Path(finding.advice.split()[1].rstrip(";"))
    assert page.read_text().startswith("# Calibration")


def test_a_robot_in_sim_needs_no_calibration_and_no_port(tmp_path: Path, robot: Path) -> None:
    file = settings(tmp_path, robot, mode="sim")
    for code in ("CALIBRATION_MISSING", "PORT_UNSET"):
        assert found("--config", str(file), code=code) == []


def test_a_calibrated_robot_gives_no_alarm(tmp_path: Path, robot: Path) -> None:
    calibrated(tmp_path, robot)
    file = settings(tmp_path, robot)
    for code in ("CALIBRATION_MISSING", "FILE_REFUSED"):
        assert found("--config", str(file), code=code) == []


def test_an_edited_calibration_is_found_and_not_called_missing(tmp_path: Path, robot: Path) -> None:
    spoil(
        calibrated(tmp_path, robot),
        lambda text: re.sub(r"zero_ticks: \d+", "zero_ticks: 2000", text, count=1),
    )
    file = settings(tmp_path, robot)
    (finding,) = found("--config", str(file), code="FILE_REFUSED")
    assert "is not the hash of this file" in finding.measured
    assert found("--config", str(file), code="CALIBRATION_MISSING") == []


def test_a_changed_sign_is_found_with_the_way_to_a_new_calibration(tmp_path: Path, robot: Path) -> None:
    place = calibrated(tmp_path, robot)
    spoil(robot, lambda text: text.replace("{id: 1,", "{id: 1, sign: -1,", 1))
    (finding,) = found("--config", str(settings(tmp_path, robot)), code="FILE_REFUSED")
    assert "signs or ratios changed since" in finding.measured
    assert f"`mv --backup=numbered {place} {place}.old`, start twind in mode mirror, " in finding.advice


def test_the_calibration_of_another_robot_is_found(tmp_path: Path, robot: Path) -> None:
    file = calibrated(tmp_path, robot)
    spoil(robot, lambda text: text.replace("name: h24", "name: other", 1))
    words = ("--robot", str(robot), "--calibration", str(file))
    (finding,) = found(*words, code="FILE_REFUSED")
    assert "made for robot 'h24', not for 'other'" in finding.measured


def test_joints_without_a_watchdog_are_noted(tmp_path: Path, robot: Path) -> None:
    (finding,) = found("--robot", "so101", code="WATCHDOG_NONE")
    assert finding.measured.startswith("6 joints: shoulder_pan, ")
    assert found("--robot", str(robot), code="WATCHDOG_NONE") == []
