import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from twind_drivers.virtual.muscles import FirstOrder

ONE = np.ones(1)


def powered(start: float = 0.0, p: float = 800.0, on: bool = True) -> FirstOrder:
    muscles = FirstOrder(np.array([start]))
    muscles.drive(
        on=np.array([on]), p=p * ONE, i=0 * ONE, d=0 * ONE, pwm_cap=885 * ONE, current_cap=1193 * ONE
    )
    return muscles


@settings(max_examples=60)
@given(st.floats(-3000, 3000), st.lists(st.floats(1e-4, 0.5), min_size=1, max_size=8))
def test_one_long_step_is_the_same_as_many_short_ones(goal: float, steps: list[float]) -> None:
    many, once = powered(), powered()
    many.aim(np.array([goal]))
    once.aim(np.array([goal]))
    for end in np.cumsum(steps):
        many.advance(float(end))
    once.advance(float(np.cumsum(steps)[-1]))
    assert abs(many.position[0] - once.position[0]) < 1e-6 * (1 + abs(goal))
    assert abs(many.velocity[0] - once.velocity[0]) < 1e-6 * (1 + abs(goal))


@settings(max_examples=60)
@given(st.floats(-3000, 3000), st.floats(1e-3, 1.0))
def test_it_never_overshoots_and_never_exceeds_its_speed(goal: float, dt: float) -> None:
    muscles = powered()
    muscles.aim(np.array([goal]))
    muscles.advance(dt)
    moved = muscles.position[0]
    assert min(0.0, goal) <= moved <= max(0.0, goal)
    assert abs(moved) <= 201 * 0.229 / 60 * 4096 * dt + 1e-6
    assert abs(muscles.velocity[0]) <= 201 + 1e-9


def test_a_joint_without_torque_stays_where_it_is() -> None:
    muscles = powered(start=100.0, on=False)
    muscles.aim(np.array([900.0]))
    muscles.advance(5.0)
    assert muscles.position[0] == 100.0
    assert muscles.velocity[0] == 0.0


def test_a_gain_of_zero_pulls_at_nothing_and_half_the_gain_is_slower() -> None:
    reached = []
    for p in (0.0, 400.0, 800.0):
        muscles = powered(p=p)
        muscles.aim(np.array([30.0]))
        muscles.advance(0.04)
        reached.append(muscles.position[0])
    assert reached[0] == 0.0 < reached[1] < reached[2]


def test_time_that_has_passed_already_changes_nothing() -> None:
    muscles = powered()
    muscles.aim(np.array([500.0]))
    muscles.advance(0.1)
    before = muscles.position.copy()
    muscles.advance(0.05)
    assert muscles.position[0] == before[0]
