"""The capture point of a moving mass is that of its inverted pendulum."""

from math import nan, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.robot.arrays import Floats
from twind.robot.attitude import G
from twind.robot.joint_state import Imu
from twind.safety.capture_point import CapturePoint, SupportPoints

HEIGHT = 0.3  # m
FOOT = np.array([[x, y, 0.0] for x in (-0.1, 0.1) for y in (-0.05, 0.05)])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
TICK = 0.01


def forward_room(corners: Floats, place: Floats) -> float:
    """Distance from the place to the front edge, m."""
    return float(corners[:, 0].max() - place[0])


def after(seconds: float, speed: float, place: float = 0.0) -> float:
    """Margin of a mass that moves forward at `speed` for a time and is at `place` then."""
    time = 0.0

    def geometry(position: Floats, quaternion: Floats) -> SupportPoints:
        mass = np.array([place + speed * (time - seconds), 0.0, HEIGHT])
        return SupportPoints(mass, FOOT)

    capture = CapturePoint(geometry, forward_room)
    margin = nan
    while time <= seconds + TICK / 2:
        margin = capture.margin(np.zeros(1), Imu(time, np.zeros(3), np.zeros(3), UPRIGHT))
        time += TICK
    return margin


@given(st.floats(-1.0, 1.0), st.floats(-0.2, 0.2))
def test_the_margin_is_that_of_the_pendulum(speed: float, place: float) -> None:
    wanted = 0.1 - (place + speed * sqrt(HEIGHT / G))
    assert after(0.3, speed, place) == pytest.approx(wanted, abs=2e-3)


class Walk:
    """A robot that the test places anew for each reading, a hundredth of a second after the one before."""

    def __init__(self, *, foot: Floats = FOOT) -> None:
        self.mass = np.array([0.0, 0.0, HEIGHT])
        self.foot = foot
        self.time = 0.0
        self.seen = np.zeros(2)  # m, the last capture point
        self.capture = CapturePoint(lambda *_: SupportPoints(self.mass.copy(), self.foot), self._inside)

    def _inside(self, corners: Floats, place: Floats) -> float:
        assert corners.tolist() == self.foot[:, :2].tolist()
        assert place.shape == (2,)
        self.seen = place
        return 0.0

    def read(self, *mass: float) -> list[float]:
        """The capture point with the mass there."""
        self.mass[:] = mass
        self.time += TICK
        self.capture.margin(np.zeros(1), Imu(self.time, np.zeros(3), np.zeros(3), UPRIGHT))
        found: list[float] = self.seen.tolist()
        return found


def test_a_third_of_a_new_velocity_counts_with_the_first_reading_of_it() -> None:
    """A hundredth of a second against a time constant of two."""
    walk = Walk()
    walk.read(0.0, 0.0, HEIGHT)
    reach = sqrt(HEIGHT / G) / 3.0
    assert walk.read(0.01, -0.02, HEIGHT) == pytest.approx([0.01 + reach, -0.02 - 2.0 * reach])


def test_a_mass_near_the_floor_is_taken_for_one_at_five_centimetres() -> None:
    walk = Walk()
    walk.read(0.0, 0.0, 0.01)
    assert walk.read(0.01, 0.0, 0.01)[0] == pytest.approx(0.01 + sqrt(0.05 / G) / 3.0)


def test_height_and_velocity_are_those_above_the_lowest_corner() -> None:
    """The other corners move with a foot in the air."""
    foot = np.array([[0.1, 0.3, -0.1], [-0.1, 0.2, -0.2], [0.2, -0.1, 0.1]])
    walk = Walk(foot=foot)
    walk.read(0.0, 0.0, HEIGHT - 0.2)
    foot[[0, 2]] += (0.05, 0.07, 0.01)
    assert walk.read(0.01, 0.0, HEIGHT - 0.2) == pytest.approx([0.01 + sqrt(HEIGHT / G) / 3.0, 0.0])


def test_a_foot_that_goes_back_beneath_the_body_is_a_body_that_goes_forward() -> None:
    foot = FOOT.copy()
    walk = Walk(foot=foot)
    walk.read(0.0, 0.0, HEIGHT)
    foot += (-0.01, 0.02, 0.0)
    reach = sqrt(HEIGHT / G) / 3.0
    assert walk.read(0.0, 0.0, HEIGHT) == pytest.approx([reach, -2.0 * reach])


def test_a_velocity_that_is_forgotten_begins_anew() -> None:
    walk = Walk()
    walk.read(0.0, 0.0, HEIGHT)
    walk.read(0.01, 0.0, HEIGHT)
    walk.capture.forget()
    assert walk.read(0.02, 0.01, HEIGHT) == [0.02, 0.01]


def test_the_first_reading_has_no_velocity() -> None:
    assert after(0.0, 5.0) == pytest.approx(0.1)


def test_an_unknown_place_is_an_unknown_margin_and_is_forgotten() -> None:
    mass = np.array([nan, 0.0, HEIGHT])
    capture = CapturePoint(lambda position, quaternion: SupportPoints(mass, FOOT), forward_room)
    assert np.isnan(capture.margin(np.zeros(1), Imu(0.0, np.zeros(3), np.zeros(3), UPRIGHT)))
    mass[0] = 0.0
    found = capture.margin(np.zeros(1), Imu(TICK, np.zeros(3), np.zeros(3), UPRIGHT))
    assert found == pytest.approx(0.1)
