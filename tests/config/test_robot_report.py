"""`check robot` as a value: the table a person reads, and the errors a script counts."""

from dataclasses import replace
from pathlib import Path

import pytest

from twind.config.calibration_file import Calibration, fitting, seam_margin
from twind.config.counts import turn_start
from twind.config.robot_file import load_robot
from twind.config.robot_report import check_robot
from twind.exceptions import InvalidInput
from twind.twin.binding import bind
from twind.virtual.virtual_robot_spec import calibration, make_spec
from twind_drivers.bus import IdentifiedDevice

ROBOT = load_robot("h24")
SETTINGS = {
    "homing_offset": 0,
    "drive_mode": 0,
    "operating_mode": 3,
    "min_position_limit": 0,
    "max_position_limit": 4095,
}
DEVICES = {
    (joint.bus, joint.id): IdentifiedDevice(joint.id, 1020, "XM430-W350", 46, SETTINGS)
    for joint in ROBOT.joints
}


def calibrated(zero: int) -> Calibration:
    zeros = dict.fromkeys(ROBOT.names, zero)
    return fitting(ROBOT, zeros, DEVICES, created="2026-11-21T09:14:03Z", tool="twind")


def test_every_joint_has_a_row_with_its_limits_and_counts() -> None:
    report = check_robot(ROBOT)
    rows = {line.split()[0]: line for line in report.lines if line.split()[0] in ROBOT.names}
    assert set(rows) == set(ROBOT.names)
    assert "-0.1 .. 2.2" in rows["l_knee"]
    assert "1983 .. 3482" in rows["l_knee"]
    assert "2113 .. 614" in rows["r_knee"]  # turns the other way
    assert any("no calibration is read" in line for line in report.lines)


def test_open_items_are_listed() -> None:
    report = check_robot(replace(ROBOT, todo=("joints.l_knee.sign", "poses.rest")))
    (line,) = [each for each in report.lines if each.startswith("open: ")]
    assert "joints.l_knee.sign, poses.rest: mode live is refused" in line
    assert report.errors == ()
    assert not any(each.startswith("open: ") for each in check_robot(ROBOT).lines)


def test_a_type_without_a_watchdog_that_the_file_does_not_accept_is_a_warning() -> None:
    arm = load_robot("so101")
    assert not any("watchdog" in line for line in check_robot(arm).lines)
    kinds = {joint.type.name: replace(joint.type, watchdog="") for joint in arm.joints}
    report = check_robot(replace(arm, joints=tuple(replace(j, type=kinds[j.type.name]) for j in arm.joints)))
    found = [line for line in report.lines if "watchdog" in line]
    assert len(found) == len(kinds) and report.errors == ()
    assert found[0].startswith("warning: a STS3215 has no watchdog") and "`watchdog: none`" in found[0]


def test_counts_follow_the_calibration() -> None:
    report = check_robot(ROBOT, calibration=calibrated(2000))
    assert any(
        line.startswith("l_knee") and line.split()[-4:] == ["1935", "..", "3434", "2000"]
        for line in report.lines
    )
    assert report.errors == ()


def test_a_zero_that_pushes_the_limits_over_the_seam_is_an_error() -> None:
    errors = check_robot(ROBOT, calibration=calibrated(1000)).errors
    assert any(
        each.startswith("joints.l_shoulder_pitch: counts -760..2760 leave the servo's turn")
        for each in errors
    )


def test_an_impossible_rate_is_an_error_with_its_arithmetic() -> None:
    [error] = check_robot(ROBOT, 900.0).errors
    assert "900 Hz leaves 1111 us a cycle" in error


def test_the_rate_of_the_file_is_checked_when_none_is_given() -> None:
    assert check_robot(replace(ROBOT, rate_hz=900.0)).errors


def test_modes_without_limits_of_the_servos_own_are_warned_of_by_name() -> None:
    joints = tuple(
        replace(joint, mode="extended_position") if joint.name == "l_knee" else joint
        for joint in ROBOT.joints
    )
    report = check_robot(replace(ROBOT, joints=joints), calibration=calibrated(0))
    (warning,) = (line for line in report.lines if line.startswith("warning:"))
    assert warning.endswith("the daemon's clamp is the only fence: l_knee")
    assert not any(each.startswith("joints.l_knee:") for each in report.errors)  # no turn to leave
    assert any(each.startswith("joints.r_knee:") for each in report.errors)
    assert not any(line.startswith("warning:") for line in check_robot(ROBOT).lines)


def test_the_turn_of_a_p_series_begins_at_a_negative_count(tmp_path: Path) -> None:
    """E-manual, PH54-200-S500-R, "Goal Position (564)": -501,923 .. 501,923 in position mode."""
    text = ROBOT.path.read_text().replace("mjcf: h24.xml", f"mjcf: {ROBOT.mjcf_path}")
    path = tmp_path / "p.yaml"
    text = text.replace("XM430-W350", "PH54-200-S500-R").replace("ticks_per_turn: 4096", "")
    path.write_text(text)
    robot = load_robot(str(path))
    kind = robot.joints[0].type
    assert (kind.centre, turn_start(kind)) == (0, -501_923)
    assert (ROBOT.joints[0].type.centre, turn_start(ROBOT.joints[0].type)) == (2048, 0)
    made = make_spec(robot)
    known = calibration(made)
    assert any(joint.sweep_ticks[0] < 0 < joint.sweep_ticks[1] for joint in known.joints)
    assert all(joint.seam_margin_ticks > 0 for joint in known.joints)
    assert not any(each.startswith("joints.") for each in check_robot(robot, calibration=known).errors)
    assert bind(robot, known).joint_map.names == robot.names
    assert bind(robot, None).joint_map.names == robot.names
    beyond = replace(
        known, joints=tuple(replace(joint, zero_ticks=joint.zero_ticks + 501_923) for joint in known.joints)
    )
    errors = check_robot(robot, calibration=beyond).errors
    assert any("leave the servo's turn -501923..501922: remount the horn" in each for each in errors)


def test_the_seam_of_a_p_series_is_half_a_turn_from_its_centre() -> None:
    turn = 1_003_846
    assert seam_margin((-1000, 1000), turn, -501_923) == 500_923
    assert seam_margin((501_000, 502_000), turn, -501_923) == 0
    assert seam_margin((-1000, 1000), turn) == 0


def test_a_travel_that_no_mounting_fits_into_one_turn_is_an_error() -> None:
    wide = replace(ROBOT.joints[0], ratio=2.0, lower=-1.57, upper=1.57)
    [error] = check_robot(replace(ROBOT, joints=(wide, *ROBOT.joints[1:]))).errors
    assert error.startswith("joints.head_yaw: travel of 4302 ticks does not fit one turn of 4096 (0.08 rad")
    with pytest.raises(InvalidInput, match="travel of 4302 ticks"):
        make_spec(replace(ROBOT, joints=(wide, *ROBOT.joints[1:])))


def test_a_register_content_that_no_servo_can_hold_is_an_error() -> None:
    negative = replace(ROBOT.joints[0], registers={"drive_mode": -1})
    robot = replace(ROBOT, joints=(negative, *ROBOT.joints[1:]))
    assert "registers.drive_mode: -1 is outside 0..15" in check_robot(robot).errors[0]
    with pytest.raises(InvalidInput, match="negative"):
        make_spec(robot)
    odd = replace(ROBOT.joints[0], registers={"homing_offset": 2_000_000, "temperature_limit": 80})
    [error] = check_robot(replace(ROBOT, joints=(odd, *ROBOT.joints[1:]))).errors
    assert error.startswith("joints.head_yaw: registers.homing_offset: 2000000 is outside -1044479..1044479")


def test_one_bus_is_counted_as_one() -> None:
    head = check_robot(load_robot("pan-tilt")).lines[0]
    assert head.startswith("pan-tilt: 2 joints, 1 bus, support ")
