"""Turns and seams: whatever a servo counts at a start, the joint's angle is the same, or nobody arms.

Rows 2, 3, 4 and 8 of what goes wrong with a calibration; the others are in test_calibration_failures.py.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.examples import fast_cases
from tests.support.miscalibrated_robots import KNEE, OPEN, PLAIN, TURN, floating, names_it, plant
from twind import link
from twind.config.robot_file import load_robot
from twind.robot.modes import RobotState
from twind.virtual.robot_ground_truth import JointGroundTruth
from twind.virtual.virtual_robot_spec import make_spec

__all__ = ["floating", "plant"]

# ------------------------------------------------------------------- 2: the jump at torque-on


def test_a_count_that_would_fall_a_turn_at_torque_on_gets_none_and_after_a_restart_it_is_right(
    plant: Any,
) -> None:
    """The forum's case: a goal of what is read without torque would be a full turn."""
    truth = JointGroundTruth(zero_ticks=700, homing_offset=-512, registers=OPEN)
    rig = plant(truth, replace(truth, turns=1))
    rig.connect()
    row = rig.names.index(KNEE)
    assert int(rig.loop.hardware.readings.raw.ticks[row]) == 700 - 512 + TURN, "beyond every goal it takes"
    said = rig.refused()
    assert names_it(said, "CALIB_MISMATCH", KNEE, "position mode covers one turn only".capitalize())
    rig.virtual["main"].faults.brown_out(rig.id_of(KNEE))
    rig.seconds(1.0)
    rig.arm()
    rig.seconds(0.5)
    assert rig.virtual["main"].servos["goal_position"][row] == 700 - 512
    assert int(rig.loop.hardware.readings.raw.ticks[row]) == 700 - 512
    assert rig.moved <= 2.0


def test_beyond_the_count_at_which_it_would_fall_a_joint_gets_no_torque(plant: Any) -> None:
    """Offset -512: from 3584 on, torque-on would take a turn off, and no goal goes there."""
    truth = JointGroundTruth(zero_ticks=TURN - 60, homing_offset=-512, registers=OPEN)
    rig = plant(truth, truth)
    rig.connect()
    rig.hand(l_knee=0.3)
    assert int(rig.loop.hardware.readings.raw.ticks[rig.names.index(KNEE)]) > 3584
    assert names_it(rig.refused(), "OUT_OF_LIMIT", KNEE, "move it inside by hand")


def test_a_count_that_jumps_at_torque_on_all_the_same_loses_it_again(
    plant: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A firmware that counts otherwise than the manual says."""
    rig = plant(PLAIN, PLAIN)
    power = rig.virtual["main"].servos.power
    row = rig.names.index(KNEE)
    collapse = power.collapse

    def odd(at: int, *, slip: int = 0) -> None:
        collapse(at, slip=slip)
        if at == row:
            power.wind(at, 1)

    rig.connect()
    monkeypatch.setattr(power, "collapse", odd)
    rig.lease()
    reply = rig.call(link.Arm)
    assert reply.error == "Refused"
    rig.seconds(0.5)
    assert names_it(
        rig.reported_findings(reply.parameters["findings"]), "ARM_FAILED", KNEE, "jumped at torque-on"
    )
    assert (rig.register("torque_enable") == 0).all()
    assert rig.loop.condition.state is RobotState.CONNECTED


# ------------------------------------------------------------------- 3, 4: turns that are lost or found


@pytest.mark.parametrize("turns", fast_cases([-2, -1, 0, 1, 2], {-2, 1}))
@pytest.mark.parametrize("zero", fast_cases([2048, 4090, 20], {2048, 4090}))
def test_a_joint_has_the_same_angle_on_whatever_turn_it_starts(
    plant: Any, floating: str, turns: int, zero: int
) -> None:
    """Extended mode; also where the travel crosses the encoder's seam."""
    rig = plant(JointGroundTruth(zero_ticks=zero), JointGroundTruth(zero_ticks=zero, turns=turns), floating)
    rig.connect()
    assert rig.loop.robot.measured.position == pytest.approx(rig.truth, abs=0.01)
    rig.arm()
    rig.seconds(0.3)
    assert rig.moved <= 2.0


def test_a_joint_that_is_on_no_turn_of_its_travel_is_refused(plant: Any, floating: str) -> None:
    rig = plant(PLAIN, JointGroundTruth(zero_ticks=make_spec(load_robot("h24")).zeros[KNEE] + 2000), floating)
    assert names_it(
        rig.refused(), "CALIB_MISMATCH", KNEE, "neither that nor a turn beside it is in its travel"
    )


def test_a_limp_joint_that_restarts_is_where_it_was_and_is_verified_anew(plant: Any, floating: str) -> None:
    """Its count begins at one turn again."""
    rig = plant(JointGroundTruth(zero_ticks=2048), JointGroundTruth(zero_ticks=2048, turns=1), floating)
    rig.connect()
    row = rig.names.index(KNEE)
    rig.virtual["main"].faults.brown_out(rig.id_of(KNEE))
    verified = []
    for _ in range(300):
        rig.ticks(1)
        verified.append(bool(rig.loop.identity.verified.joints[row]))
    assert verified[0] and not all(verified) and verified[-1]
    assert rig.loop.robot.measured.position == pytest.approx(rig.truth, abs=0.01)
    rig.arm()
    rig.seconds(0.3)
    assert rig.moved <= 2.0


def test_a_boot_one_tick_beside_the_seam_makes_no_turn(plant: Any, floating: str) -> None:
    """Near tick 0 the count comes back a turn away, or not, by the noise of each boot."""
    assert load_robot("h24").poses["rest"][KNEE] == 0.0
    truth = JointGroundTruth(zero_ticks=0, seam_seed=0)
    rig = plant(truth, truth, floating)
    rig.connect()
    row = rig.names.index(KNEE)
    seen = set()
    for _ in range(4):
        rig.virtual["main"].faults.brown_out(rig.id_of(KNEE))
        rig.seconds(0.7)
        assert rig.loop.condition.state is RobotState.CONNECTED
        seen.add(int(rig.loop.hardware.readings.raw.ticks[row]) // TURN)
        assert rig.loop.robot.measured.position == pytest.approx(rig.truth, abs=0.01)
    assert len(seen) == 2, "both sides of the seam were seen"
    rig.arm()
    rig.seconds(0.3)
    assert rig.moved <= 2.0


# ------------------------------------------------------------------- 8: travel across the seam


@pytest.mark.parametrize("turns", [0, 1])
def test_a_joint_moves_across_the_seam_of_its_encoder(plant: Any, floating: str, turns: int) -> None:
    truth = JointGroundTruth(zero_ticks=4000, turns=turns)
    rig = plant(truth, truth, floating)
    entry = rig.calibration.by_name[KNEE]
    assert entry.seam_margin_ticks == 0
    rig.arm()
    row = rig.names.index(KNEE)
    before = rig.loop.robot.measured.position[row]
    steps = []
    rig.submit(rig.path(KNEE, [0.6], [1.0]))
    for _ in range(160):
        rig.ticks(1)
        steps.append(float(rig.loop.robot.measured.position[row] - before))
        before = rig.loop.robot.measured.position[row]
    assert rig.truth[row] == pytest.approx(0.6, abs=0.01)
    assert np.abs(steps).max() < 0.05, "no step of a turn"
