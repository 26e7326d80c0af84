"""Travel of more than a turn: a waist of ±1.57 rad through a gear of 1:2.5, on virtual servos with hands."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.calibration_rig import (
    hands,
    held,
    measured,
    off,
    restarted,
    sweep_all,
    uncalibrated,
)
from tests.support.daemon_rig import Rig
from tests.support.planar_arm import WAIST, waist_in
from twind import link
from twind.config.calibration_file import Calibration
from twind.config.robot_file import load_robot
from twind.config.robot_report import check_robot
from twind.robot.modes import Mode
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth

STOPS = JointGroundTruth(stops_rad=(-1.65, 1.65), turns=1)
OTHERS = JointGroundTruth(stops_rad=(-0.95, 1.05))
NEAR = 0.02  # rad
END = 1.4  # rad, where its counts are more than half a turn from the middle


@pytest.fixture
def waist(tmp_path: Path) -> Iterator[tuple[Rig, Calibration]]:
    """The robot in live, calibrated by hands that moved it from stop to stop."""
    truth = RobotGroundTruth({"single": OTHERS, WAIST: STOPS, "capped": OTHERS})
    rig = uncalibrated(waist_in(tmp_path), truth)
    try:
        middle = dict.fromkeys(rig.names, 0.0)
        travels = sweep_all(rig)
        found = measured(rig, travels, held(rig, middle), middle)
        let_go(rig)
        restarted(rig, found, Mode.LIVE)
        yield rig, found
    finally:
        rig.close()


def put(rig: Rig, angle: float) -> None:
    """Move the limp waist there by hand, the others to 0."""
    hands(rig, dict.fromkeys(rig.names, 0.0) | {WAIST: angle})
    rig.seconds(1.5)
    let_go(rig)


def let_go(rig: Rig) -> None:
    rig.virtual["main"].faults.hand(off=True)
    rig.seconds(0.3)


def place_of(rig: Rig) -> float:
    """Measured angle of the waist, rad."""
    return float(rig.loop.robot.measured.position[rig.names.index(WAIST)])


def true_place(rig: Rig) -> float:
    return float(rig.truth[rig.names.index(WAIST)])


def refusals(rig: Rig) -> list[dict[str, Any]]:
    """Findings of a refused arming."""
    rig.lease()
    reply = rig.call(link.Arm)
    assert reply.error is not None, "armed"
    assert not rig.register("torque_enable").any()
    return list(reply.parameters["findings"])


def refused_with_remedy(rig: Rig) -> bool:
    """Check that arming is refused for the waist, whose position is unknown."""
    found = refusals(rig)
    assert np.isnan(place_of(rig))
    row = rig.names.index(WAIST)
    return any(
        (each["code"], each["joint"]) == ("CALIB_MISMATCH", row)
        and "move it to its middle by hand with torque off" in each["message"]
        for each in found
    )


def go(rig: Rig, angle: float) -> None:
    rig.submit(rig.path(WAIST, [angle], [6.0]), more=True)
    rig.seconds(6.5)
    assert true_place(rig) == pytest.approx(angle, abs=NEAR)
    assert place_of(rig) == pytest.approx(angle, abs=NEAR)


def test_a_travel_of_one_and_a_half_turns_is_accepted_and_shown(tmp_path: Path) -> None:
    report = check_robot(load_robot(waist_in(tmp_path)))
    assert report.errors == ()
    assert "in the middle, else by `twindctl calibrate turn`: extended (1.25 turns)" in "\n".join(
        report.lines
    )


def test_it_is_calibrated_by_hands_and_moves_from_end_to_end(waist: tuple[Rig, Calibration]) -> None:
    rig, found = waist
    assert found.by_name[WAIST].sweep_ticks[1] - found.by_name[WAIST].sweep_ticks[0] > 4096
    assert abs(off(rig, found)[WAIST]) <= 3
    put(rig, 0.05)
    rig.arm()
    for angle in (END, -END, 0.0):
        go(rig, angle)
    assert rig.loop.condition.latches == {}


@pytest.mark.parametrize("angle", [END, -END])
def test_beyond_its_middle_a_power_cycle_or_a_new_daemon_is_refused_until_a_hand_moves_it(
    waist: tuple[Rig, Calibration], angle: float
) -> None:
    rig, found = waist
    put(rig, 0.05)
    put(rig, angle)  # the turn known in the middle stays known
    assert place_of(rig) == pytest.approx(true_place(rig), abs=NEAR)
    rig.virtual["main"].faults.brown_out(rig.robot.joints[rig.names.index(WAIST)].id)
    rig.seconds(1.5)
    assert refused_with_remedy(rig)
    restarted(rig, found, Mode.LIVE)
    assert refused_with_remedy(rig)
    put(rig, 0.1)
    assert place_of(rig) == pytest.approx(true_place(rig), abs=NEAR)
    rig.arm()
    go(rig, angle)


def test_a_silent_limp_waist_is_doubted_and_refused_beyond_its_middle(
    waist: tuple[Rig, Calibration],
) -> None:
    """Without a servo clock, silence is all that shows a restart."""
    rig, _ = waist
    put(rig, 0.05)
    put(rig, END)
    row = rig.names.index(WAIST)
    assert rig.loop.identity.verified.joints[row]
    rig.virtual["main"].faults.silence(rig.robot.joints[row].id)
    rig.seconds(0.3)
    rig.virtual["main"].faults.silence(rig.robot.joints[row].id, on=False)
    rig.seconds(1.5)
    assert refused_with_remedy(rig)
