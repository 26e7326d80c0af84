"""Sweep, zero, live on specimens whose truth is hidden: each zero found, on every turn, over every seam."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support import transmission_robot_file as linked
from tests.support.calibration_rig import (
    QUICK,
    WELL,
    encoder_samples,
    hands,
    held,
    many_turns,
    measured,
    moved,
    off,
    restarted,
    sweep_all,
    uncalibrated,
)
from tests.support.daemon_rig import Rig
from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import Calibration
from twind.config.robot_file import load_robot
from twind.robot.modes import Mode
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth, random_truth
from twind_calibration.calibrating.calibration_actuators import slots
from twind_calibration.calibrating.encoder_unwrap import framed
from twind_calibration.calibrating.sweep_tracker import SweepTracker
from twind_calibration.calibrating.zero_placement import by_pose, misfits

pytestmark = pytest.mark.slow

MOVED = 0.3  # rad
NEAR = 0.02  # rad: counts, play and the bend under load


def nothing(rig: Rig) -> None: ...


def calibrated(
    robot: str,
    truth: RobotGroundTruth,
    then: Callable[[Rig], None] = nothing,
    pose: Mapping[str, float] | None = None,
) -> tuple[Rig, Calibration]:
    """A specimen and the file that was measured of it; `then`: what happens between sweep and zero."""
    rig = uncalibrated(robot, truth)
    travels = sweep_all(rig)
    then(rig)
    held_in = dict.fromkeys(rig.robot.names, 0.0) | dict(pose or {})
    return rig, measured(rig, travels, held(rig, held_in), held_in)


def arms_and_moves(rig: Rig, calibration: Calibration) -> None:
    """With that file in live: everybody is believed, arms, and goes where it is sent."""
    hands(rig, dict.fromkeys(rig.robot.names, 0.05))
    rig.seconds(0.5)
    for bus in rig.robot.buses:
        rig.virtual[bus.name].faults.hand(off=True)
    restarted(rig, calibration, Mode.LIVE)
    rig.arm()
    before = rig.truth
    assert np.abs(before - rig.loop.robot.measured.position).max() < NEAR
    rig.lease()
    rig.submit(rig.path("l_knee", [MOVED + 0.05], [1.0]), more=True)
    rig.seconds(2.0)
    moved = rig.truth - before
    knee = rig.names.index("l_knee")
    assert moved[knee] == pytest.approx(MOVED, abs=NEAR)
    assert np.abs(np.delete(moved, knee)).max() < NEAR


def test_a_virtual_robot_in_position_mode_is_calibrated_arms_and_moves() -> None:
    rig, found = calibrated("h24", random_truth(load_robot("h24"), 1))
    try:
        assert max(map(abs, off(rig, found).values())) <= WELL
        arms_and_moves(rig, found)
    finally:
        rig.close()


def test_travels_over_the_seam_are_found_whatever_turn_they_start_on(tmp_path: Path) -> None:
    robot = many_turns(tmp_path)
    truth = random_truth(load_robot(robot), 7)
    files = []
    for shift in (0, 1):  # every joint on another turn than before
        wound = {
            name: replace(each, turns=(place + 3 * shift) % 5 - 2)
            for place, (name, each) in enumerate(truth.joints.items())
        }
        rig, found = calibrated(robot, RobotGroundTruth(wound))
        try:
            assert sum(joint.seam_margin_ticks == 0 for joint in found.joints) > 6
            assert max(map(abs, off(rig, found).values())) <= WELL
            arms_and_moves(rig, found)
        finally:
            rig.close()
        files.append(found)
    for one, other in zip(*(each.joints for each in files), strict=True):
        assert abs(one.zero_ticks - other.zero_ticks) <= WELL, "one frame, whatever the turn"


def test_turns_that_are_lost_between_sweep_and_zero_change_nothing(tmp_path: Path) -> None:
    robot = many_turns(tmp_path)

    def power_cut(rig: Rig) -> None:
        rig.virtual["main"].faults.power(on=False)
        rig.seconds(0.5)
        rig.virtual["main"].faults.power(on=True)
        rig.seconds(1.0)

    truth = random_truth(load_robot(robot), 3)
    rig, found = calibrated(robot, truth, power_cut, {"l_knee": 1.2, "r_elbow": -0.7, "head_yaw": -0.4})
    try:
        assert max(map(abs, off(rig, found).values())) <= WELL
    finally:
        rig.close()


def test_swapped_ids_are_named_while_one_joint_is_moved_and_a_flipped_sign_by_its_zero() -> None:
    truth = RobotGroundTruth(
        {
            "l_elbow": JointGroundTruth(swapped_with="l_hip_roll"),
            "r_hip_pitch": JointGroundTruth(sign=1, zero_ticks=2000),
        }
    )
    rig = uncalibrated("h24", truth)
    try:
        travels = SweepTracker(slots(rig.robot), ["l_elbow"])
        news = []
        rig.virtual["main"].faults.hand(pose={"l_elbow": -2.0}, speed=QUICK)
        for _ in range(80):
            rig.ticks(1)
            news += travels.take(encoder_samples(rig))
        assert [each.text.split(",")[0] for each in news] == ["l_hip_roll moved while l_elbow"]
        rig.virtual["main"].faults.hand(off=True)
        hip = next(slot for slot in slots(rig.robot) if slot.name == "r_hip_pitch")
        whole = SweepTracker(slots(rig.robot), rig.robot.names)
        told = {each.name: each for each in moved(rig, whole)}
        assert told["l_hip_roll"].what == "wrong"
        assert "the wrong joint: it goes as far as" in told["l_hip_roll"].text
        track = whole.travel("r_hip_pitch")
        assert track is not None
        [read] = [
            each for name, each in held(rig, dict.fromkeys(rig.robot.names, 0.0)).items() if name == hip.name
        ]
        sweep = framed(*track, 0, 4096)
        zero = by_pose(hip, sweep, read.mean, read.sigma, read.count, 0.0)
        record = DeviceRecord(1020, 47, None, 0, 0, 3, 0, 4095)
        [wrong] = misfits(hip, record, sweep, zero.ticks)
        assert "with sign 1 they would fit: is its sign wrong" in wrong
    finally:
        rig.close()


def test_motors_of_a_transmission_are_calibrated_by_their_own_names(tmp_path: Path) -> None:
    path = linked.write(tmp_path)
    rig = uncalibrated(str(path), random_truth(load_robot(str(path)), 1))
    try:
        travels = sweep_all(rig, 0.05)  # a slot alone feels no stop: those are of the joints
        pose = dict.fromkeys(rig.robot.names, 0.0) | {"waist_roll": 0.1, "ankle_pitch": -0.2}
        found = measured(rig, travels, held(rig, pose), pose)
        assert set(found.by_name) == {"waist_a", "waist_b", "ank_in", "ank_out", "knee"}
        assert max(map(abs, off(rig, found).values())) <= WELL
    finally:
        rig.close()


def test_serial_and_can_actuators_are_calibrated_alike() -> None:
    rig, found = calibrated("h24-mixed", random_truth(load_robot("h24-mixed"), 5))
    try:
        apart = off(rig, found)
        for slot in slots(rig.robot):
            assert abs(apart[slot.name]) <= WELL * max(1, slot.joint.type.ticks_per_turn // 4096), slot.name
    finally:
        rig.close()
