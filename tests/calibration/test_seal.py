"""`twindctl calibrate seal`: a hand-written calibration gets what follows from robot file and travel."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.checksum_bench import robot_of
from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import dump_calibration, load_calibration
from twind.config.yaml_tree import ConfigError
from twind_calibration.calibrating.seal_command import sealed_calibration

DEVICE = DeviceRecord(777, 9, None, 0, 0, 0, 0, 4095)
HAND = "joints:\n  elbow: {zero_ticks: 2048, sweep_ticks: [1000, 3000]}\n"
CREATED = "2026-11-28T09:00:00Z"


def answering() -> Mapping[str, DeviceRecord]:
    return {"elbow": DEVICE}


def asked() -> Mapping[str, DeviceRecord]:
    raise AssertionError("the file states its devices")


def test_two_counts_a_joint_are_enough(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "feetech", "STS3215", {"elbow": 2})
    sealed = sealed_calibration(HAND, "arm.yaml", robot, answering, CREATED)
    (elbow,) = sealed.joints
    assert (elbow.zero_ticks, elbow.sweep_ticks, elbow.sign, elbow.device) == (2048, (1000, 3000), 1, DEVICE)
    assert elbow.method == "import"
    file = tmp_path / "arm.yaml"
    file.write_text(dump_calibration(sealed))
    assert load_calibration(file, robot) == sealed


def test_an_edited_file_is_sealed_without_asking_its_devices(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "feetech", "STS3215", {"elbow": 2})
    text = dump_calibration(sealed_calibration(HAND, "arm.yaml", robot, answering, CREATED))
    edited = text.replace("[1000, 3000]", "[900, 3000]")
    again = sealed_calibration(edited, "arm.yaml", robot, asked, CREATED)
    assert again.joints[0].sweep_ticks == (900, 3000)
    assert again.joints[0].turn_band_ticks == (1950 - 2048, 1950 + 2048)


def test_an_edited_file_loses_its_proofs_and_an_unchanged_one_keeps_them(tmp_path: Path) -> None:
    """They were measured with other numbers."""
    robot = robot_of(tmp_path, "feetech", "STS3215", {"elbow": 2})
    sealed = sealed_calibration(HAND, "arm.yaml", robot, answering, CREATED)
    proof = {"sign": "gravity"}
    text = dump_calibration(replace(sealed, joints=(replace(sealed.joints[0], proof=proof),)))
    assert sealed_calibration(text, "arm.yaml", robot, asked, CREATED).joints[0].proof == proof
    edited = text.replace("zero_ticks: 2048", "zero_ticks: 1024")
    assert sealed_calibration(edited, "arm.yaml", robot, asked, CREATED).joints[0].proof is None
    by_hand = HAND.replace("zero_ticks", "proof: {sign: gravity}, zero_ticks")
    assert sealed_calibration(by_hand, "arm.yaml", robot, answering, CREATED).joints[0].proof is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("joints:\n  knee: {zero_ticks: 1, sweep_ticks: [0, 2]}\n", "knee"),
        ("robot: other\n" + HAND, "made for robot 'other'"),
        (HAND.replace("zero_ticks: 2048, ", ""), "zero_ticks"),
        (HAND.replace("[1000, 3000]", "[3000, 1000]"), "3000 is not below 1000"),
        (HAND.replace("zero_ticks", "sign: -1, zero_ticks"), "is not the sign of the robot file"),
        (HAND.replace("zero_ticks", "spare: 1, zero_ticks"), "spare"),
    ],
)
def test_what_the_daemon_would_refuse_is_not_sealed(tmp_path: Path, text: str, message: str) -> None:
    robot = robot_of(tmp_path, "feetech", "STS3215", {"elbow": 2})
    with pytest.raises(ConfigError, match=message):
        sealed_calibration(text, "arm.yaml", robot, answering, CREATED)


def test_a_silent_device_is_named(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "feetech", "STS3215", {"elbow": 2})
    with pytest.raises(ConfigError, match=r"arm.yaml:2:.*elbow.device: no device answers"):
        sealed_calibration(HAND, "arm.yaml", robot, dict, CREATED)
