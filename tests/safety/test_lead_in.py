"""Way to a first point at t = 0: within the limits, and refused where its run-up would leave them."""

from math import nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.gate_rig import ask, at_rest, codes, limits, path
from twind.robot.finding import ReasonCode
from twind.robot.splines import interpolate
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.gate import TrajectoryRequest
from twind.safety.lead_in import led_in

PERIOD = 0.01
LIMITS = limits(1)


def test_a_path_that_begins_later_or_where_the_robot_is_stays_as_it_is() -> None:
    later = path([0.1, 1.0], [0.5, 1.0])
    here = path([0.0, 1.0], [0.5, 1.0])
    assert led_in(later, at_rest([0.0]), limits(1), PERIOD) is later
    assert led_in(here, at_rest([0.5]), limits(1), PERIOD) is here


def test_a_jump_of_a_joint_that_is_not_commanded_is_no_jump() -> None:
    both = path([0.0, 1.0], [[0.5, 9.0], [1.0, 9.0]])
    one = Trajectory(both.time, both.position, np.array([True, False]))
    assert led_in(one, at_rest([0.5, 0.0]), limits(2), PERIOD) is one


@given(
    jump=st.floats(-0.05, 0.05),
    before=st.floats(-1.5, 1.5),
    after=st.floats(-1.5, 1.5),
    shape=st.sampled_from([0, 1, 2]),
)
def test_a_jump_is_led_in_within_the_limits(jump: float, before: float, after: float, shape: int) -> None:
    velocity = None if shape == 0 else [after, 0.0]
    acceleration = [0.0, 0.0] if shape == 2 else None
    given_ = path([0.0, 1.0], [jump, jump], velocity, acceleration)
    limit = limits(1)
    start = Reference(np.zeros(1), np.array([before]), np.zeros(1))
    found = led_in(given_, start, limit, PERIOD)
    lead = found.time[0]
    if abs(jump) <= 1e-9:
        assert lead == 0.0
        return
    assert lead >= PERIOD - 1e-12
    assert lead / PERIOD == pytest.approx(round(lead / PERIOD), abs=1e-6)
    assert found.time[1] - lead == pytest.approx(1.0)
    curve = interpolate(found, start)
    track = [curve.sample(t) for t in np.linspace(0.0, lead, 100, endpoint=False)]
    assert max(abs(reference.velocity[0]) for reference in track) <= limit.velocity[0]
    assert max(abs(reference.acceleration[0]) for reference in track) <= limit.acceleration[0] * 1.001


# ----------------------------------------------------------------------------------------- in the gate


def starting_fast(place: float, speed: float) -> Trajectory:
    """From `place` at `speed`, at rest half a second later."""
    return path([0.0, 0.5], [place, place + 0.25 * speed], [speed, 0.0])


def test_a_run_up_that_leaves_the_limits_is_refused_at_the_first_point() -> None:
    judged = ask(starting_fast(-1.999, 1.0), LIMITS, at_rest([-2.0]))
    assert codes(judged) == {ReasonCode.POS_LIMIT, ReasonCode.BRAKE_DISTANCE}
    found = next(each for each in judged.verdict.refusals if each.code is ReasonCode.POS_LIMIT)
    assert (found.joint, found.point, found.time, found.bound) == (0, 0, 0.0, -2.0)
    assert found.value == pytest.approx(-2.073, abs=0.001)
    assert not codes(ask(starting_fast(-2.0, 1.0), LIMITS, at_rest([-2.0])))  # no jump, so no run-up
    assert not codes(ask(starting_fast(0.001, 1.0), LIMITS, at_rest([0.0])))  # room for it


def test_joints_that_are_not_commanded_need_no_room() -> None:
    both = path([0.0, 0.5], [[0.001, nan], [0.2, nan]], [[0.0, nan], [0.0, nan]])
    one = Trajectory(both.time, both.position, np.array([True, False]), both.velocity)
    assert not codes(ask(one, limits(2), at_rest([0.0, 3.0])))


@pytest.mark.parametrize("wild", [1e308, -1e308])
def test_a_first_point_of_any_size_is_refused_and_raises_nothing(wild: float) -> None:
    for given_ in (path([0.0, 0.5], [wild, wild]), path([0.0, 0.5], [0.01, 0.01], [wild, 0.0])):
        assert codes(ask(given_, LIMITS, at_rest([-0.9 * wild if given_.velocity is None else 0.0])))


@given(
    start=st.floats(-2.0, 2.0),
    jump=st.floats(-0.05, 0.05),
    speed=st.floats(-4.0, 4.0),
    moving=st.floats(-2.0, 2.0),
    policy=st.sampled_from(["reject", "retime"]),
)
def test_no_accepted_first_point_leads_out_of_the_limits(
    start: float, jump: float, speed: float, moving: float, policy: str
) -> None:
    before = Reference(np.array([start]), np.array([moving if abs(start) < 1.5 else 0.0]), np.zeros(1))
    judged = ask(starting_fast(start + jump, speed), LIMITS, before, TrajectoryRequest(policy))
    if judged.verdict.refusals:
        return
    curve = interpolate(led_in(judged.path, before, LIMITS, PERIOD), before)
    track = [curve.sample(t) for t in np.linspace(0.0, curve.duration, 300)]
    places = np.array([reference.position[0] for reference in track if reference is not None])
    assert np.abs(places).max() <= 2.0 + 1e-9


# ----------------------------------------------------------------------------------------- exact durations


@pytest.mark.parametrize(
    ("jump", "velocity", "before", "limit", "acceleration", "lead"),
    [
        (0.04, None, 0.0, 0.5, 1e4, 0.30),  # quintic: 1.875 x jump in the time, at half of the limit
        (0.02, 0.4, 0.0, 0.5, 1e4, 0.38),  # what the path's own velocity leaves of the limit
        (0.02, 0.49, 0.0, 0.5, 1e4, 1.50),  # a twentieth of it at least
        (0.03, None, 0.0, 100.0, 1.0, 0.68),  # acceleration: 6 x jump over the square of the time, at 40 %
        (0.001, None, 0.1, 100.0, 2.0, 0.50),  # ten times the time in which the velocity could end
        (1e-9, None, 0.0, 4.0, 20.0, 0.0),  # rounding
        (1.05e-9, None, 0.0, 4.0, 20.0, 0.01),
    ],
)
def test_the_way_to_a_first_point_lasts_as_long_as_its_tightest_rule_asks(
    jump: float, velocity: float | None, before: float, limit: float, acceleration: float, lead: float
) -> None:
    bounds = limits(2, velocity=[limit, 100.0], acceleration=[acceleration, 1e4])
    speeds = None if velocity is None else [[velocity, 0.0], [0.0, 0.0]]
    given_ = path([0.0, 1.0], [[jump, 0.5], [jump, 0.5]], speeds)
    start = Reference(np.array([0.0, 0.5]), np.array([before, 0.0]), np.zeros(2))
    assert led_in(given_, start, bounds, PERIOD).time[0] == pytest.approx(lead)


def test_the_speed_of_a_joint_that_is_not_commanded_does_not_lengthen_the_way() -> None:
    both = path([0.0, 1.0], [[0.04, 9.0], [0.04, 9.0]])
    one = Trajectory(both.time, both.position, np.array([True, False]))
    bounds = limits(2, velocity=0.5, acceleration=[1e4, 2.0])
    start = Reference(np.zeros(2), np.array([0.0, 0.4]), np.zeros(2))
    assert led_in(one, start, bounds, PERIOD).time[0] == pytest.approx(0.30)
