"""The calibration file: bound to a robot, hashed, derived fields checked, exact round trip."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.h24_calibration import DEVICES, ROBOT, TEXT, made, rehashed
from twind.config.calibration_file import (
    dump_calibration,
    fitting,
    load_calibration,
    read_calibration,
    save_calibration,
    seam_margin,
    text_hash,
    turn_band,
)
from twind.config.config_reader import Plain
from twind.config.yaml_tree import ConfigError


def refused(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        read_calibration(text, "h24.yaml", ROBOT)
    return str(caught.value)


def test_a_saved_calibration_loads_unchanged(tmp_path: Path) -> None:
    path = save_calibration(made(), tmp_path, "h24")
    assert load_calibration(path, ROBOT) == made()
    assert made().by_name["head_pitch"].zero_ticks == 2049


words = st.text(st.characters(max_codepoint=0xD7FF), max_size=8)
numbers = st.integers(-(10**18) + 1, 10**18 - 1)
proofs = st.none() | st.dictionaries(words, numbers | st.booleans() | words | st.none(), max_size=3)


@examples(30)
@given(st.integers(-20_000, 20_000), st.floats(0, 50).map(lambda x: round(x, 6)), proofs)
def test_any_calibration_survives_the_file(zero: int, sigma: float, proof: Plain) -> None:
    calibration = made(zero)
    first = replace(calibration.joints[0], zero_sigma_ticks=sigma, proof=proof)
    calibration = replace(calibration, joints=(first, *calibration.joints[1:]))
    text = dump_calibration(calibration)
    assert read_calibration(text, "f", ROBOT) == replace(calibration, sha256=text_hash(text))


def test_the_hash_is_of_the_text_without_its_line_and_of_any_line_end() -> None:
    assert text_hash(TEXT) == made().sha256
    assert read_calibration(TEXT.replace("\n", "\r\n"), "f", ROBOT).joints == made().joints
    lines = TEXT.split("\n")
    moved = "\n".join([lines[-2], *lines[:-2], ""])  # the hash may stand anywhere
    assert read_calibration(moved, "f", ROBOT) == made()


@pytest.mark.parametrize("place", range(0, len(TEXT), 97))
def test_a_changed_byte_is_refused(place: int) -> None:
    other = "7" if TEXT[place] != "7" else "8"
    with pytest.raises(ConfigError):
        read_calibration(TEXT[:place] + other + TEXT[place + 1 :], "f", ROBOT)


@pytest.mark.parametrize("length", range(0, len(TEXT), 211))
def test_a_file_cut_short_is_refused(length: int) -> None:
    with pytest.raises(ConfigError):
        read_calibration(TEXT[:length], "f", ROBOT)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("twind-calibration/1", "twind-calibration/2", "is not twind-calibration/1"),
        ('robot: "h24"', 'robot: "kid20"', ":2:8: robot: made for robot 'kid20', not for 'h24'"),
        (
            ROBOT.description_sha256,
            "00",
            "joints, ids, signs or ratios changed since: undo that, or calibrate again",
        ),
        ('created: "2026-11-21T09:14:03Z"', 'created: "yesterday"', "write a time as 2026-11-21T09:14:03Z"),
        (
            'method_default: "import"',
            'method_default: "guess"',
            "none of jig, endstop, sweep, gravity, import",
        ),
        ('"head_yaw":', '"head_yow":', "joints.head_yow: unknown key; nearest: head_yaw"),
        ('bus: "main"', 'bus: "arms"', "joints.head_yaw.bus: arms is not the bus of the robot file, main"),
        ("id: 1\n", "id: 7\n", "joints.head_yaw.id: 7 is not the id of the robot file, 1"),
        ("sign: 1\n", "sign: -1\n", "joints.head_yaw.sign: -1 is not the sign of the robot file, 1"),
        ("captures: 1\n", "captures: 0\n", "0 is outside >= 1"),
        ("captures: 1\n", "capturs: 1\n", "capturs: unknown key; nearest: captures"),
        ("sweep_ticks: [1018, 3078]", "sweep_ticks: [3078, 1018]", "3078 is not below 1018"),
        (
            "sweep_ticks: [1018, 3078]",
            "sweep_ticks: [1020, 3078]",
            "does not follow from sweep_ticks, which give",
        ),
        (
            "seam_margin_ticks: 1018\n",
            "seam_margin_ticks: 1017\n",
            "1017 does not follow from sweep_ticks, which give 1018",
        ),
        (
            "turn_band_ticks: [0, 4096]",
            "turn_band_ticks: [1, 4097]",
            "(1, 4097) does not follow from sweep_ticks",
        ),
        ("zero_ticks: 2048\n", "zero_ticks: 2048.0\n", "a whole number is expected"),
        ("zero_ticks: 2048\n", "zero_ticks: true\n", "a whole number is expected"),
        ("zero_sigma_ticks: 0.000000", "zero_sigma_ticks: .nan", "not a finite number"),
        ("zero_sigma_ticks: 0.000000", "zero_sigma_ticks: 1e-05", "text in YAML"),
        ('"drive_mode": 0, ', "", "drive_mode: is required and missing"),
        ('"drive_mode": 0, ', '"drive_mode": 300, ', "drive_mode: 300 is outside >= 0 and <= 255"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_at_its_line(old: str, new: str, message: str) -> None:
    assert old in TEXT
    assert message in refused(rehashed(TEXT.replace(old, new, 1)))


def test_a_wrong_hash_is_refused_with_the_remedy() -> None:
    message = refused(TEXT.replace("zero_ticks: 2048", "zero_ticks: 2058", 1))
    assert "is not the hash of this file" in message
    assert "calibrate again, or put the earlier file back" in message
    assert "sha256: is required and missing" in refused(TEXT[: TEXT.index("sha256:", 200)])


def test_a_joint_that_is_missing_is_not_calibrated_and_the_rest_is_read() -> None:
    calibration = made()
    text = dump_calibration(replace(calibration, joints=calibration.joints[1:]))
    assert set(ROBOT.names) - set(read_calibration(text, "f", ROBOT).by_name) == {"head_yaw"}


def test_derived_fields_of_the_manuals_example() -> None:
    assert turn_band((1986, 3464), 4096) == (677, 4773)
    assert seam_margin((1986, 3464), 4096) == 632


@pytest.mark.parametrize(
    ("sweep", "margin"),
    [
        ((0, 4095), 0),
        ((1, 4095), 1),
        ((-5, 5), 0),
        ((4090, 4100), 0),
        ((4097, 8000), 1),
        ((-4000, -10), 10),
        ((0, 5000), 0),
    ],
)
def test_the_seam_margin_is_the_distance_to_a_whole_turn(sweep: tuple[int, int], margin: int) -> None:
    assert seam_margin(sweep, 4096) == margin


@given(st.integers(-9000, 9000), st.integers(1, 4095), st.integers(-9000, 9000))
def test_exactly_one_turn_of_any_count_is_in_the_band(low: int, width: int, count: int) -> None:
    first, last = turn_band((low, low + width), 4096)
    assert sum(first <= count + 4096 * k < last for k in range(-8, 9)) == 1
    assert first <= low < low + width <= last


def test_a_fitting_calibration_needs_every_joint() -> None:
    zeros = dict.fromkeys(ROBOT.names[1:], 2048)
    with pytest.raises(KeyError):
        fitting(ROBOT, zeros, DEVICES, created="2026-11-21T09:14:03Z", tool="twind")
