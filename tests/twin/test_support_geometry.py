"""Mass and soles of a tilted robot, as fall detection uses them."""

from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.daemon_rig import known_binding
from twind.exceptions import InvalidInput
from twind.twin.standing_feet import inside
from twind.twin.support_geometry import SupportGeometry

BINDING = known_binding("h24-standing").binding
GEOMETRY = SupportGeometry(BINDING)
STANCE = np.array(BINDING.rest)
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def test_a_stance_has_its_mass_above_two_soles_of_four_corners() -> None:
    points = GEOMETRY.place(STANCE, UPRIGHT)
    assert points.corners.shape == (8, 3)
    assert np.ptp(points.corners[:, 2]) < 1e-3
    assert inside(points.corners[:, :2], points.mass[:2]) > 0.02
    assert 0.2 < points.mass[2] - points.corners[0, 2] < 0.5


@settings(max_examples=30)
@given(st.floats(-1.5, 1.5))
def test_a_tilt_turns_all_places_about_the_base(tilt: float) -> None:
    points = GEOMETRY.place(STANCE, UPRIGHT)
    turned = GEOMETRY.place(STANCE, np.array([cos(tilt / 2), 0.0, sin(tilt / 2), 0.0]))
    rotation = np.array([[cos(tilt), 0.0, sin(tilt)], [0.0, 1.0, 0.0], [-sin(tilt), 0.0, cos(tilt)]])
    assert turned.mass == pytest.approx(rotation @ points.mass, abs=1e-9)
    assert turned.corners == pytest.approx(points.corners @ rotation.T, abs=1e-9)


def test_a_held_base_is_refused() -> None:
    with pytest.raises(InvalidInput, match="support: free"):
        SupportGeometry(replace(BINDING, floating=False))
