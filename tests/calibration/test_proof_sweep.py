"""Sweep of a joint through its places. Pure."""

from math import radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind_calibration.proving.proof_sweep import LEAST, OVER, mean_loads, sweeps
from twind_calibration.wiggling.state_trace import HoldMean

ANGLES = st.floats(-2.0, 2.0)


@given(ANGLES, ANGLES, ANGLES, st.floats(radians(3), radians(45)))
def test_every_place_is_come_to_from_both_sides_and_inside_the_limits(
    a: float, b: float, home: float, size: float
) -> None:
    lower = min(a, b)
    upper = max(a, b)
    for way in sweeps(home, lower, upper, size):
        visits = np.array(way.visits)
        assert visits[0] == home and abs(visits[-1] - home) < 1e-3
        inside = visits[1:-1]
        assert (inside >= lower).all() and (inside <= upper).all()
        assert np.ptp(way.places) >= LEAST - 1e-9
        for at in way.places:
            came = {np.sign(at - visits[k - 1]) for k in range(1, len(visits)) if visits[k] == at}
            assert {1.0, -1.0} <= came
        assert abs(way.farthest) == pytest.approx(np.abs(visits - home).max())
        assert np.abs(way.places - home).max() <= 2.0 * size + 1e-9 or not lower <= home <= upper


def test_a_joint_without_room_has_no_way() -> None:
    assert sweeps(0.0, -0.05, 0.05, 0.2) == []
    assert [way.places[0] for way in sweeps(0.0, -0.1, 2.0, 0.2)] == pytest.approx([-0.06, 0.0, -0.06])


def test_the_means_are_of_both_directions() -> None:
    way = sweeps(0.1, -1.0, 1.0, 0.2)[0]
    stays = [
        HoldMean(np.array([at]), np.array([at]), np.array([10.0 * at + (1.0 if up else -1.0)]))
        for up, at in zip([True] * 6 + [False] * 6, way.visits, strict=True)
    ]
    shown = mean_loads(way, stays)
    assert shown.poses[:, 0] == pytest.approx(way.places)
    assert shown.effort[:, 0] == pytest.approx(10.0 * way.places)
    assert (shown.up - shown.down)[:, 0] == pytest.approx(2.0)
    assert shown.ends.out.position[0] == pytest.approx(0.1 + way.farthest)
    assert way.farthest == pytest.approx(0.2 + OVER) or way.farthest == pytest.approx(-0.2 - OVER)
