"""The gap tells a robot half as heavy again from the one that was identified, on real bytes and a body."""

from dataclasses import replace

import pytest

from tests.support.gap_rig import GapRig
from twind.config.robot_file import load_robot
from twind.gap.gap_figures import GapFigure, total_gap
from twind.gap.gap_replay import GapReplay, resample
from twind.gap.motion_samples import MotionSamples
from twind.identification.identified_robot import DataOrigin, identify_robot
from twind.twin.binding import Binding, bind

ROBOT = load_robot("koch")
PLAIN = bind(ROBOT, None)
FORWARD = {"shoulder_lift": -0.5, "elbow_flex": 0.5}
LIFTING = ("shoulder_lift", "elbow_flex", "wrist_flex")
ORIGIN = DataOrigin("2026-11-29T04:00:00Z", "test", "virtual")
PERIOD = 0.01


def stretched(factor: float) -> GapRig:
    """The arm stretched forward, with links `factor` times as heavy as its model says."""
    rig = GapRig("koch", factor)
    rig.arm()
    rig.move_to(FORWARD, 2.5)
    rig.samples()
    return rig


def swinging(rig: GapRig) -> MotionSamples:
    """Return a motion of the three joints that lift, other than those that identify them."""
    rig.excite(LIFTING, 0.2, 0.37)
    return rig.samples()


def gap(binding: Binding, motion: MotionSamples) -> GapFigure:
    found = total_gap(GapReplay(binding, PERIOD).gaps(motion))
    assert found is not None and found.unexplained is not None and found.nrmse_spread is not None
    print(f"{found.nrmse_spread:.1%} of the spread, {found.unexplained:.1%} unexplained")
    return found


@pytest.mark.slow
def test_after_identification_a_heavier_robot_shows_in_the_second_norm() -> None:
    same = stretched(1.0)
    for joint in LIFTING:
        same.excite([joint], 0.4)
    same.excite(LIFTING, 0.25)
    motion = resample(same.samples(), PERIOD)
    judged = swinging(same)
    same.close()
    heavy = stretched(1.5)
    heavier = swinging(heavy)
    heavy.close()
    found = identify_robot(
        PLAIN, [motion], ORIGIN, lambda model: bind(replace(ROBOT, identified=model), None), LIFTING
    )
    known = bind(replace(ROBOT, identified=found.model), None)
    before = gap(PLAIN, judged)
    after = gap(known, judged)
    grown = gap(known, heavier)
    assert after.unexplained < 0.1 < 0.2 < grown.unexplained
    assert after.unexplained < 0.7 * before.unexplained
    assert after.nrmse_spread < 0.05
