import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind_drivers.virtual.servo_physics import IDLE, DriveState, FirstOrderPhysics

ONE = np.ones(1)
# An XM430-W350 at 12 V, raw (e-manual, "Specifications"): 46 rpm, 2.3 A
FREE = 46.0 / 0.229
STALL = 2.3 / 0.00269
TICKS = 0.229 / 60 * 4096  # ticks/s per raw velocity


def power(
    muscles: FirstOrderPhysics, mode: int = 3, p: float = 800.0, on: bool = True, **caps: float
) -> None:
    one = np.ones(muscles.position.size)
    muscles.drive(
        DriveState(
            on=one > 0 if on else one < 0,
            mode=np.full(one.size, mode),
            p=p * one,
            i=0 * one,
            d=0 * one,
            velocity_p=caps.get("vp", 100.0) * one,
            velocity_i=caps.get("vi", 1920.0) * one,
            pwm_cap=caps.get("pwm", 885.0) * one,
            current_cap=caps.get("current", 1193.0) * one,
            supply=caps.get("supply", 1.0) * one,
        )
    )


def powered(start: float = 0.0, **how: float) -> FirstOrderPhysics:
    muscles = FirstOrderPhysics(np.array([start]))
    power(muscles, **how)
    return muscles


@examples(60)
@given(
    st.sampled_from([0, 1, 3, 4, 5, 16]),
    st.floats(-3000, 3000),
    st.lists(st.floats(1e-4, 0.5), min_size=1, max_size=8),
)
def test_a_single_long_step_equals_many_short_ones(mode: int, goal: float, steps: list[float]) -> None:
    many = powered(mode=mode)
    once = powered(mode=mode)
    many.set_goals(np.array([goal]))
    once.set_goals(np.array([goal]))
    for end in np.cumsum(steps):
        many.advance(float(end))
    once.advance(float(np.cumsum(steps)[-1]))
    assert abs(many.position[0] - once.position[0]) < 1e-6 * (1 + abs(goal))
    assert abs(many.velocity[0] - once.velocity[0]) < 1e-6 * (1 + abs(goal))


@examples(60)
@given(st.floats(-3000, 3000), st.floats(1e-3, 1.0))
def test_the_physics_never_overshoots_the_goal_nor_exceeds_its_speed(goal: float, dt: float) -> None:
    muscles = powered()
    muscles.set_goals(np.array([goal]))
    muscles.advance(dt)
    moved = muscles.position[0]
    assert min(0.0, goal) <= moved <= max(0.0, goal)
    assert abs(moved) <= 201 * TICKS * dt + 1e-6
    assert abs(muscles.velocity[0]) <= 201 + 1e-9


@pytest.mark.parametrize("mode", [0, 1, 3, 16])
def test_a_joint_without_torque_stays_where_it_is(mode: int) -> None:
    muscles = powered(start=100.3, mode=mode, on=False)
    for now, goal in ((5.0, 900.0), (9.0, -1e9 / 7.0)):
        muscles.set_goals(np.array([goal]))
        muscles.advance(now)
        assert muscles.position[0] == 100.3, "not by the least bit"
    assert muscles.velocity[0] == muscles.current[0] == muscles.pwm[0] == 0.0


def test_a_gain_of_zero_pulls_at_nothing_and_half_the_gain_is_slower() -> None:
    reached = []
    for p in (0.0, 400.0, 800.0):
        muscles = powered(p=p)
        muscles.set_goals(np.array([30.0]))
        muscles.advance(0.04)
        reached.append(muscles.position[0])
    assert reached[0] == 0.0 < reached[1] < reached[2]


def test_time_that_has_passed_already_changes_nothing() -> None:
    muscles = powered()
    muscles.set_goals(np.array([500.0]))
    muscles.advance(0.1)
    before = muscles.position.copy()
    muscles.advance(0.05)
    assert muscles.position[0] == before[0]


@pytest.mark.parametrize(("goal", "speed"), [(100.0, 100.0), (-50.0, -50.0), (1000.0, FREE)])
def test_in_velocity_mode_it_turns_at_the_goal_for_ever(goal: float, speed: float) -> None:
    """e-manual, "Operating Mode" 1: endless; no faster than 46 rpm, "Specifications" of the XM430-W350."""
    muscles = powered(mode=1)
    muscles.set_goals(np.array([goal]))
    muscles.advance(1.0)
    before = muscles.position[0]
    muscles.advance(61.0)
    assert muscles.velocity[0] == pytest.approx(speed)
    assert muscles.position[0] - before == pytest.approx(speed * TICKS * 60, rel=1e-6)
    muscles.set_goals(np.array([0.0]))
    muscles.advance(62.0)
    assert abs(muscles.velocity[0]) < 1e-6


def test_smaller_velocity_gains_are_slower_and_none_turn_nothing() -> None:
    reached = []
    for vp, vi in ((0.0, 0.0), (50.0, 960.0), (100.0, 1920.0)):
        muscles = powered(mode=1, vp=vp, vi=vi)
        muscles.set_goals(np.array([100.0]))
        muscles.advance(0.02)
        reached.append(muscles.velocity[0])
    assert reached[0] == 0.0 < reached[1] < reached[2] < 100.0


def test_in_current_mode_the_current_is_the_goal_while_the_voltage_suffices() -> None:
    for goal in (10.0, -10.0):
        muscles = powered(mode=0)
        muscles.set_goals(np.array([goal]))
        for k in range(1, 20):
            muscles.advance(0.02 * k)
            assert muscles.current[0] == pytest.approx(goal)
            assert np.sign(muscles.velocity[0]) == np.sign(goal)
    muscles.set_goals(np.array([900.0]))
    muscles.advance(5.0)
    assert muscles.velocity[0] == pytest.approx(FREE), (
        "free speed; the rest of the current has nothing to push"
    )
    assert muscles.current[0] == pytest.approx(IDLE * STALL)


def test_in_pwm_mode_the_speed_is_in_proportion_to_output_and_supply() -> None:
    for goal, supply, speed in ((885.0, 1.0, FREE), (-442.5, 1.0, -0.5 * FREE), (885.0, 0.5, 0.5 * FREE)):
        muscles = powered(mode=16, supply=supply)
        muscles.set_goals(np.array([goal]))
        muscles.advance(2.0)
        assert muscles.velocity[0] == pytest.approx(speed)
        assert muscles.pwm[0] == goal


@pytest.mark.parametrize("mode", [1, 3, 5])
def test_less_output_or_less_current_is_less_speed_in_every_mode(mode: int) -> None:
    """e-manual, "Goal PWM": a cap in every mode; "Goal Current": a cap in mode 5."""
    for caps, fastest in (({"pwm": 88.5}, 0.1 * FREE), ({"current": 5.0}, 5.0 * FREE / (IDLE * STALL))):
        muscles = powered(mode=mode, **caps)
        muscles.set_goals(np.array([150_000.0]))
        muscles.advance(1.0)
        assert muscles.velocity[0] == pytest.approx(fastest)


def test_a_blocked_shaft_turns_its_output_into_current() -> None:
    for mode, goal, current in (
        (3, 3000.0, STALL),
        (5, 3000.0, 300),
        (0, 200.0, 200),
        (1, -50.0, -STALL),
        (16, 442.5, 0.5 * STALL),
    ):
        muscles = powered(mode=mode, current=300.0 if mode == 5 else 1193.0)
        muscles.block(np.array([True]))
        muscles.set_goals(np.array([goal]))
        muscles.advance(1.0)
        assert muscles.position[0] == muscles.velocity[0] == 0.0
        assert muscles.current[0] == pytest.approx(current)
        muscles.block(np.array([False]))
        muscles.advance(1.5)
        assert np.sign(muscles.position[0]) == np.sign(goal), "free again, it goes on"


@examples(80)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0, 1, 3, 4, 5, 16]),
            st.booleans(),
            st.floats(0, 885),
            st.floats(0, 1193),
            st.floats(0, 2),
            st.floats(-1e6, 1e6),
            st.floats(1e-4, 3),
            st.booleans(),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_any_command_keeps_the_physics_finite_and_inside_its_caps(changes: list[tuple]) -> None:
    muscles = FirstOrderPhysics(np.zeros(1))
    now = 0.0
    for mode, on, pwm, current, supply, goal, dt, held in changes:
        power(muscles, mode=mode, on=on, pwm=pwm, current=current, supply=supply)
        muscles.block(np.array([held]))
        muscles.set_goals(np.array([goal]))
        now += dt
        before = muscles.position[0]
        muscles.advance(now)
        assert np.isfinite([muscles.position, muscles.velocity, muscles.current, muscles.pwm]).all()
        assert abs(muscles.pwm[0]) <= pwm + 1e-6
        assert abs(muscles.current[0]) <= current + 1e-6
        if not on:
            assert muscles.position[0] == before
            assert muscles.velocity[0] == muscles.current[0] == muscles.pwm[0] == 0.0
