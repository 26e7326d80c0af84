"""The gap tells a robot half as heavy again from the one that was identified, on real bytes and a body."""

import pytest

from tests.support.gap_rig import FORWARD, PERIOD, GapRig, identified_arm, stretched_arm
from twind.gap.gap_figures import total_gap
from twind.gap.gap_replay import GapReplay
from twind.gap.motion_samples import MotionSamples
from twind.twin.binding import Binding, bind


def gap(binding: Binding, motion: MotionSamples) -> tuple[float, float]:
    """Return both norms of the positions of all joints."""
    found = total_gap(GapReplay(binding, PERIOD).gaps(motion))
    assert found is not None and found.unexplained is not None and found.nrmse_spread is not None
    print(f"{found.nrmse_spread:.1%} of the spread, {found.unexplained:.1%} unexplained")
    return found.nrmse_spread, found.unexplained


def test_an_elbow_that_lifts_more_than_the_model_says_shows_without_identification() -> None:
    shares = []
    for factor in (1.0, 1.5):
        rig = stretched_arm(factor)
        for way in (0.3, -0.3, 0.0):
            rig.move_to({"elbow_flex": FORWARD["elbow_flex"] + way}, 1.0)
        rig.close()
        found = GapReplay(bind(rig.robot, None), PERIOD).gaps(rig.samples())
        (elbow,) = [each.position for each in found if each.joint == "elbow_flex"]
        assert elbow is not None and elbow.unexplained is not None
        shares.append(elbow.unexplained)
    print(shares)
    assert shares[1] > 1.5 * shares[0] and shares[1] > 0.2


@pytest.mark.slow
def test_after_identification_a_heavier_robot_shows_in_the_second_norm() -> None:
    arm = identified_arm(("shoulder_lift", "elbow_flex"))
    _, before = gap(arm.plain, arm.same)
    spread, after = gap(arm.known, arm.same)
    _, grown = gap(arm.known, arm.heavier)
    assert after < 0.1 < 0.2 < grown
    assert after < 0.7 * before
    assert spread < 0.05


@pytest.mark.slow
def test_the_effort_of_a_stiff_and_light_robot_shows_masses_that_encoder_steps_hide() -> None:
    shares = []
    for factor in (1.0, 1.5):
        rig = GapRig("h24", factor)
        rig.arm()
        rig.samples()
        for motion in ("wave", "squat", "reach"):
            rig.play(motion)
        known = rig.known_servos()
        rig.close()
        gaps = GapReplay(known, PERIOD).gaps(rig.samples())
        found = total_gap(gaps, "effort")
        assert found is not None and found.unexplained is not None
        shares.append(found.unexplained)
        print(found, total_gap(gaps))
    assert shares[1] > 1.5 * shares[0]
    assert shares[0] < 0.2 < shares[1]
