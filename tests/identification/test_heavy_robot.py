"""The gap tells a robot half as heavy again from the one that was identified, on real bytes and a body."""

import pytest

from tests.support.gap_rig import PERIOD, identified_arm
from twind.gap.gap_figures import total_gap
from twind.gap.gap_replay import GapReplay
from twind.gap.motion_samples import MotionSamples
from twind.twin.binding import Binding


def gap(binding: Binding, motion: MotionSamples) -> tuple[float, float]:
    """Return both norms of the positions of all joints."""
    found = total_gap(GapReplay(binding, PERIOD).gaps(motion))
    assert found is not None and found.unexplained is not None and found.nrmse_spread is not None
    print(f"{found.nrmse_spread:.1%} of the spread, {found.unexplained:.1%} unexplained")
    return found.nrmse_spread, found.unexplained


@pytest.mark.slow
def test_after_identification_a_heavier_robot_shows_in_the_second_norm() -> None:
    arm = identified_arm()
    _, before = gap(arm.plain, arm.same)
    spread, after = gap(arm.known, arm.same)
    _, grown = gap(arm.known, arm.heavier)
    assert after < 0.1 < 0.2 < grown
    assert after < 0.7 * before
    assert spread < 0.05
