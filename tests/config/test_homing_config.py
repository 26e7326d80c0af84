"""`stop_rad` and `homing` of a robot file: outside the limits, on their side, and only what is known."""

from pathlib import Path

import pytest

from tests.support.small_robot_file import read
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError

TEXT = """\
format: twind-robot/1
name: one
model: {mjcf: one.xml, base: torso}
buses: {main: {kind: dynamixel2}}
types: {xm: {device: XM430-W350, gains: {p: 1, i: 0, d: 0}}}
defaults: {type: xm, bus: main}
joints:
  knee: {id: 1, limits_rad: [-0.1, 2.2], MORE}
poses: {rest: {}}
"""


def knee(folder: Path, more: str):  # type: ignore[no-untyped-def]
    (folder / "one.xml").write_text("<mujoco/>")
    return read(folder, TEXT.replace("MORE", more)).joints[0]


def test_stops_and_homing_are_read_in_either_unit(tmp_path: Path) -> None:
    one = knee(tmp_path, "stop_rad: {lower: -0.15, upper: 2.3}, homing: {side: lower, current_a: 0.25}")
    assert (one.stops.lower, one.stops.upper) == (-0.15, 2.3)
    assert one.stops.endstop_of_side("upper") == 2.3 and dict(one.stops.endstops_by_side) == {
        "lower": -0.15,
        "upper": 2.3,
    }
    assert (one.homing.side, one.homing.current_a, one.homing.speed) == ("lower", 0.25, None)
    degrees = knee(tmp_path, "stop_deg: {lower: -10.0}, homing: {side: lower, speed_deg_s: 5.0}")
    assert degrees.stops.lower == pytest.approx(-0.17453, abs=1e-5) and degrees.stops.upper is None
    assert degrees.homing.speed == pytest.approx(0.08727, abs=1e-5)


def test_endstops_are_not_part_of_the_calibration_hash(tmp_path: Path) -> None:
    (tmp_path / "one.xml").write_text("<mujoco/>")
    with_stops = read(tmp_path, TEXT.replace("MORE", "stop_rad: {lower: -0.15}"))
    assert with_stops.description_sha256 == read(tmp_path, TEXT.replace(", MORE", "")).description_sha256


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("stop_rad: {lower: -0.05}", "lies inside the limits, which end at -0.1"),
        ("stop_rad: {upper: 2.1}", "lies inside the limits, which end at 2.2"),
        ("stop_rad: {upper: 130.0}", "degrees by mistake"),
        ("stop_rad: {}", "names no stop"),
        ("homing: {side: lower}", "it is not known where that stop is"),
        ("stop_rad: {lower: -0.2}, homing: {side: upper}", "it is not known where that stop is"),
        ("stop_rad: {lower: -0.2}, homing: {side: left}", "none of lower, upper"),
        ("stop_rad: {lower: -0.2}, homing: {side: lower, method: jig}", "none of endstop"),
        ("stop_rad: {lower: -0.2}, homing: {side: lower, current_a: 0.0}", "outside > 0"),
        ("stop_rad: {lower: -0.2}, homing: {side: lower, speed_rad_s: 3.0}", "<= 1"),
    ],
)
def test_an_invalid_stop_or_homing_setting_is_refused_with_its_reason(
    tmp_path: Path, more: str, message: str
) -> None:
    with pytest.raises(ConfigError) as told:
        knee(tmp_path, more)
    assert message in str(told.value)


def test_every_joint_of_the_built_in_robot_has_both_endstops() -> None:
    for joint in load_robot("h24").joints:
        assert joint.stops.lower is not None and joint.stops.upper is not None
        assert joint.stops.lower < joint.lower and joint.stops.upper > joint.upper
