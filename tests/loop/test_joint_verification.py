"""Joints are verified and lose that; no turn is chosen under torque of this daemon."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.planar_arm import arm_in
from twind import link
from twind.loop.procedures.torque_readback import torque_inherited
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, RobotState
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth

ZEROS = {"single": 1500, "extended": 4000, "capped": 60}  # the last two have a seam in their travel
SINGLE, EXTENDED, CAPPED = range(3)


@pytest.fixture(scope="module")
def path() -> Iterator[str]:
    with TemporaryDirectory() as folder:
        yield arm_in(Path(folder))


def made(make_rig: MakeRig, path: str, turns: tuple[int, int, int] = (0, 0, 0), **more: object) -> Rig:
    """The arm, each servo so many turns off."""
    truth = {
        name: JointGroundTruth(zero_ticks=zero, turns=off)
        for (name, zero), off in zip(ZEROS.items(), turns, strict=True)
    }
    return make_rig(path, truth=RobotGroundTruth(truth), **more)  # type: ignore[arg-type]


@pytest.fixture
def arm(make_rig: MakeRig, path: str) -> Rig:
    return made(make_rig, path, (0, -2, 2))


def verified(rig: Rig) -> list[bool]:
    """As the front is told."""
    rig.ticks(12)
    overview = [news for news in rig.news if isinstance(news, link.Overview)][-1]
    return [each != 0 for each in overview.verified]


def stands_where_it_is(rig: Rig) -> bool:
    return bool(np.abs(rig.loop.robot.measured.position - rig.truth).max() < 0.01)


def servos(rig: Rig) -> Any:
    return rig.virtual["main"].servos


# ----------------------------------------------------------------------------------------------- verified


def test_no_joint_is_verified_before_every_device_is_identified(arm: Rig) -> None:
    arm.ticks(2)
    assert not arm.loop.identity.verified.joints.any()
    arm.connect()
    assert verified(arm) == [True] * 3


def test_joints_are_marked_verified_in_mirror_and_unmarked_in_sim(make_rig: MakeRig, path: str) -> None:
    rig = made(make_rig, path, (0, 1, 0), mode=Mode.MIRROR)
    rig.connect()
    assert verified(rig) == [True] * 3
    assert stands_where_it_is(rig)
    assert np.abs(rig.loop.robot.simulated.position - rig.truth).max() < 0.01  # it starts where the robot is
    rig = made(make_rig, path, mode=Mode.SIM)
    rig.ticks(20)
    assert [news for news in rig.news if isinstance(news, link.Overview)][-1].verified == b""


def test_a_register_that_differs_leaves_its_joint_unverified(arm: Rig) -> None:
    servos(arm).registers.put("max_position_limit", 4000, SINGLE)
    servos(arm).invalidate_cache()
    arm.connect()
    assert verified(arm) == [False, True, True]
    arm.lease()
    assert arm.call(link.Arm).error == "Refused"


def test_a_hardware_error_lasts_until_it_was_identified_without_it(arm: Rig) -> None:
    arm.connect()
    arm.virtual["main"].faults.damage(2, 0b100000)
    arm.seconds(0.2)
    assert verified(arm) == [True, False, True]
    servos(arm).reboot(EXTENDED, arm.clock.now())
    arm.seconds(3.0)
    assert verified(arm) == [True] * 3
    assert stands_where_it_is(arm)


def test_a_restart_loses_the_turns_and_finds_them(arm: Rig) -> None:
    arm.connect()
    before = arm.loop.hardware.readings.shift.copy()
    arm.virtual["main"].faults.brown_out(2)
    arm.seconds(3.0)
    assert arm.loop.hardware.readings.shift[EXTENDED] != before[EXTENDED]
    assert verified(arm) == [True] * 3
    assert stands_where_it_is(arm)
    arm.arm()
    assert stands_where_it_is(arm)


# ----------------------------------------------------------------------------------------------- limp


@pytest.mark.slow
def test_a_hand_across_the_seam_and_a_power_cut_there_change_no_angle(arm: Rig) -> None:
    faults = arm.virtual["main"].faults
    for pose in ({"extended": 0.6, "capped": -0.5}, {"extended": -0.6, "capped": 0.5, "single": -0.4}):
        arm.arm()
        assert stands_where_it_is(arm)
        assert arm.call(link.Disarm, ticks=900).error is None
        faults.hand(pose=pose, speed=1.0)
        for _ in range(150):
            arm.ticks(1)
            assert stands_where_it_is(arm)
        faults.hand(off=True)
        faults.power(False)
        arm.seconds(0.5)
        faults.power(True)
        arm.seconds(3.0)
        assert verified(arm) == [True] * 3
        assert stands_where_it_is(arm)
    arm.arm()
    assert stands_where_it_is(arm)


def test_out_of_its_travel_it_is_refused_and_in_it_again_it_is_not(make_rig: MakeRig, path: str) -> None:
    rig = make_rig(
        path, start={"capped": 1.4}
    )  # beyond its travel: the horn has slipped, or it is another arm
    rig.connect()
    rig.lease()
    [finding] = rig.call(link.Arm).parameters["findings"]
    assert (finding["code"], finding["joint"]) == (ReasonCode.CALIB_MISMATCH, CAPPED)
    assert verified(rig) == [True, True, False]
    assert len(rig.events(ReasonCode.CALIB_MISMATCH)) == 1  # said once, however long it is so
    servos(rig).muscles.position[CAPPED] = rig.zeros["capped"]
    rig.ticks(3)
    assert verified(rig) == [True] * 3
    assert rig.call(link.Arm).error is None


# ----------------------------------------------------------------------------------------------- torque


def test_torque_found_on_a_turn_off_is_known_where_it_is_and_lowered_from_there(
    make_rig: MakeRig, path: str
) -> None:
    rig = made(make_rig, path, (0, 2, -1))
    for row in range(3):
        servos(rig).torque(row, True)
        servos(rig).power.goal_is_present(row)
    servos(rig).invalidate_cache()
    before = rig.counts
    rig.connect()
    assert torque_inherited(rig.loop)
    assert verified(rig) == [True] * 3
    assert stands_where_it_is(rig)
    rig.lease()
    assert rig.call(link.Arm).error is None
    assert np.abs(rig.counts - before).max() < 3
    assert rig.call(link.Disarm, ticks=900).error is None


def test_position_mode_a_turn_off_gets_no_torque_until_it_has_restarted(make_rig: MakeRig, path: str) -> None:
    """A firmware may not fall back to one turn at torque-on; a goal could be a turn away."""
    rig = made(make_rig, path, (1, 0, 0))
    rig.connect()
    before = rig.counts
    rig.lease()
    [finding] = rig.call(link.Arm).parameters["findings"]
    assert (finding["code"], finding["joint"]) == (ReasonCode.CALIB_MISMATCH, SINGLE)
    assert "switch its power off and on" in finding["message"]
    assert not rig.register("torque_enable").any()
    rig.virtual["main"].faults.power(False)
    rig.seconds(0.5)
    rig.virtual["main"].faults.power(True)
    rig.seconds(3.0)
    assert verified(rig) == [True] * 3
    rig.lease()
    assert rig.call(link.Arm).error is None
    rig.seconds(0.3)
    assert (np.abs(rig.counts - before) % 4096 <= 3).all()


def test_a_restart_while_armed_changes_no_turn_until_torque_is_off(arm: Rig) -> None:
    arm.arm()
    before = arm.loop.hardware.readings.shift.copy()
    arm.virtual["main"].faults.brown_out(2)
    others = []
    for _ in range(300):
        arm.ticks(1)
        if arm.loop.torque.armed:
            assert arm.loop.hardware.readings.shift.tolist() == before.tolist()
            others.append(arm.loop.robot.measured.position[[SINGLE, CAPPED]])
    assert len(others) > 20
    assert np.abs(np.diff(np.array(others), axis=0)).max() < 0.05
    assert arm.loop.condition.state is RobotState.FAULT
    assert not verified(arm)[EXTENDED]
    arm.call(link.Disarm, ticks=900)
    arm.call(link.Reset)
    arm.seconds(3.0)
    assert verified(arm) == [True] * 3
    assert stands_where_it_is(arm)
    arm.lease()
    assert arm.call(link.Arm).error is None
    assert stands_where_it_is(arm)
