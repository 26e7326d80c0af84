import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind_drivers.virtual.servo_profile import NONE, RECTANGLE, TRAPEZOID, TRIANGLE, ServoProfile

STEP = 0.002  # s
# ticks/s, ticks/s² per raw value
VELOCITY = 0.229 / 60 * 4096
ACCELERATION = 214.577 / 3600 * 4096


def made(velocity: float, acceleration: float, *, timed: bool = False, spins: bool = False) -> ServoProfile:
    profile = ServoProfile(np.zeros(1))
    profile.limit(np.array([velocity]), np.array([acceleration]), np.array([timed]), np.array([spins]))
    return profile


def run(
    profile: ServoProfile, goal: float, seconds: float, begin: float = 0.0
) -> tuple[list[float], list[float]]:
    """Places and speeds every 2 ms."""
    profile.set_targets(np.array([goal]), begin)
    places = []
    speeds = []
    for k in range(1, round(seconds / STEP) + 1):
        profile.follow(begin + k * STEP)
        places.append(float(profile.reference[0]))
        speeds.append(float(profile.speed[0]))
    return places, speeds


def test_without_profile_velocity_the_goal_is_a_step() -> None:
    """e-manual, table under "Profile Velocity": 112 = 0 is a step, whatever 108 says."""
    profile = made(0, 20)
    assert not profile.shaped
    assert run(profile, 1000.0, 0.002)[0] == [1000.0]
    assert profile.kind[0] == NONE


@examples(40)
@given(st.integers(20, 300), st.integers(0, 60), st.floats(-800, 800))
def test_the_reference_keeps_both_caps_and_arrives(velocity: int, acceleration: int, goal: float) -> None:
    profile = made(velocity, acceleration)
    path, _ = run(profile, goal, 5.0)
    speed = np.diff([0.0, *path]) / STEP
    assert np.abs(speed).max() <= velocity * VELOCITY * (1 + 1e-6) + 1e-6
    if acceleration:
        assert np.abs(np.diff(speed)).max() <= acceleration * ACCELERATION * STEP * (1 + 1e-6) + 1e-6
    assert path[-1] == goal
    assert not profile.running[0]


@examples(60)
@given(
    st.integers(20, 300),
    st.integers(1, 60),
    st.booleans(),
    st.lists(st.tuples(st.floats(-2000, 2000), st.floats(0.004, 0.6)), min_size=2, max_size=5),
)
def test_a_new_goal_on_the_way_keeps_place_and_speed_continuous(
    velocity: int, acceleration: int, timed: bool, goals: list[tuple[float, float]]
) -> None:
    """e-manual, "Velocity Override"."""
    profile = made(velocity * 5 if timed else velocity, acceleration, timed=timed)
    now = 0.0
    for goal, seconds in goals:
        place = float(profile.reference[0])
        speed = float(profile.speed[0])
        profile.set_targets(np.array([goal]), now)
        profile.follow(now + 1e-7)
        assert profile.reference[0] == pytest.approx(place, abs=0.01 + abs(speed) * 1e-6)
        assert profile.speed[0] == pytest.approx(speed, abs=0.02 * (1 + abs(goal) + abs(place) + abs(speed)))
        profile.follow(now + seconds)
        now += seconds
    profile.follow(now + 60.0)
    assert profile.reference[0] == goals[-1][0]
    assert profile.speed[0] == 0.0


def test_the_ramp_takes_64_v_over_a_milliseconds() -> None:
    """e-manual, "Profile Velocity": t1 = 64 x V / A."""
    _, speeds = run(made(100, 20), 5000.0, 0.4)
    full = next(k for k, speed in enumerate(speeds, 1) if speed >= 100 * VELOCITY * 0.9999)
    assert full * STEP == pytest.approx(0.064 * 100 / 20, abs=0.003)


@pytest.mark.parametrize(
    ("velocity", "acceleration", "goal", "kind"),
    [(0, 20, 900, NONE), (50, 0, 900, RECTANGLE), (50, 20, 900, TRAPEZOID), (300, 5, 900, TRIANGLE)],
)
def test_the_type_of_the_profile_is_reported(
    velocity: int, acceleration: int, goal: float, kind: int
) -> None:
    """e-manual, "Moving Status": bits 4 and 5."""
    profile = made(velocity, acceleration)
    profile.set_targets(np.array([float(goal)]), 0.0)
    assert profile.kind[0] == kind
    assert profile.running[0] == (kind != NONE)


@examples(30)
@given(st.integers(10, 3000), st.integers(0, 3000), st.floats(-3000, 3000).filter(lambda goal: abs(goal) > 1))
def test_a_time_based_profile_takes_its_time_and_ramps_for_half_of_it_at_most(
    whole: int, ramp: int, goal: float
) -> None:
    """e-manual, "Drive Mode" bit 2 and "Profile Velocity": 112 is t3, 108 is t1, no more than half of t3."""
    profile = made(whole, ramp, timed=True)
    profile.set_targets(np.array([goal]), 0.0)
    profile.follow(whole * 1e-3 * 0.999 - 1e-6)
    assert profile.running[0]
    profile.follow(whole * 1e-3 + 1e-6)
    assert not profile.running[0]
    assert profile.reference[0] == goal
    half = made(whole, ramp, timed=True)
    half.set_targets(np.array([goal]), 0.0)
    half.follow(whole * 0.5e-3)
    assert half.reference[0] == pytest.approx(goal / 2, rel=1e-6), "it is symmetric"


def test_in_velocity_mode_the_velocity_ramps_and_112_counts_for_nothing() -> None:
    """e-manual, "Profile Acceleration": used in velocity mode; t1 = 64 x goal velocity / 108."""
    for velocity in (0, 3):
        profile = made(velocity, 10, spins=True)
        places, _ = run(profile, 100.0, 0.7)
        assert np.diff([0.0, *places]).max() == pytest.approx(100 / 0.64 * STEP, rel=0.01)
        assert places[-1] == 100.0
        back, _ = run(profile, -100.0, 1.3, begin=1.0)
        assert back[0] == pytest.approx(100 - 100 / 0.64 * STEP, rel=0.01)
        assert back[-1] == -100.0
    timed = made(0, 500, timed=True, spins=True)
    places, _ = run(timed, 80.0, 0.6)
    assert places[124] == pytest.approx(40.0, rel=0.01), "half of it after half of 500 ms"


def test_a_servo_that_was_stopped_stays_and_a_goal_written_again_begins_anew() -> None:
    profile = made(50, 10)
    run(profile, 1000.0, 0.1)
    profile.hold(np.array([True]), np.array([33.0]))
    profile.follow(9.0)
    assert (profile.reference[0], profile.speed[0], profile.running[0]) == (33.0, 0.0, False)
    places, _ = run(profile, 1000.0, 5.0, begin=10.0)
    assert places[0] == pytest.approx(33.0, abs=0.1)
    assert places[-1] == 1000.0


def test_the_same_goal_again_does_not_begin_anew() -> None:
    profile = made(1000, 200, timed=True)
    profile.set_targets(np.array([700.0]), 0.0)
    profile.follow(0.5)
    profile.set_targets(np.array([700.0]), 0.5)
    profile.follow(1.0001)
    assert profile.reference[0] == 700.0


def test_a_p_series_profile_is_in_its_own_units() -> None:
    """e-manual PH54: 1,003,846 ticks a turn, 0.01 rev/min."""
    profile = ServoProfile(np.zeros(1), turn=1_003_846.0, rpm=0.01)
    off = np.zeros(1, np.bool_)
    profile.limit(np.array([1000.0]), np.array([0.0]), off, off)
    profile.set_targets(np.array([1e6]), 0.0)
    profile.follow(1.0)
    assert profile.reference[0] == pytest.approx(10.0 / 60.0 * 1_003_846)


@pytest.mark.parametrize(("velocity", "acceleration", "timed"), [(600, 200, True), (100, 8, False)])
def test_a_plan_that_began_in_motion_arrives_without_a_jump(
    velocity: int, acceleration: int, timed: bool
) -> None:
    profile = made(velocity, acceleration, timed=timed)
    run(profile, 1000.0, 0.3)
    assert profile.speed[0] > 500
    places, speeds = run(profile, -400.0, 3.0, begin=0.3)
    assert np.abs(np.diff(places)).max() <= np.abs(speeds).max() * STEP * 1.002, (
        "the peak is between two looks"
    )
    assert abs(speeds[-1]) == 0.0
    assert places[-1] == -400.0
