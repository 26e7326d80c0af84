import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from twind_drivers.virtual.profile import ACCELERATION, VELOCITY, Profile


def run(velocity: float, acceleration: float, goal: float, seconds: float) -> list[float]:
    profile = Profile.at(np.zeros(1))
    profile.limit(np.array([velocity]), np.array([acceleration]))
    path = []
    for _ in range(int(seconds / 0.002)):
        profile.follow(np.array([goal]), 0.002)
        path.append(float(profile.reference[0]))
    return path


def test_without_profile_velocity_the_goal_is_a_step() -> None:
    assert run(0, 20, 1000.0, 0.002) == [1000.0]


@settings(max_examples=25)
@given(st.integers(50, 300), st.integers(0, 60), st.floats(-800, 800))
def test_the_reference_keeps_both_caps_and_arrives(velocity: int, acceleration: int, goal: float) -> None:
    path = run(velocity, acceleration, goal, 3.0)
    speed = np.diff([0.0, *path]) / 0.002
    assert np.abs(speed).max() <= velocity * VELOCITY + 1e-6
    if acceleration:  # the last step onto the goal may brake harder by what one step discretises
        reach = acceleration * ACCELERATION * 0.002
        assert np.abs(np.diff(speed)).max() <= 2.0 * reach + 1e-6
    assert abs(path[-1] - goal) < 1.0
