"""What may be written: a step no further than the velocity limit, and a number at all (R21, NaN)."""

from itertools import product
from math import inf, nan

import numpy as np
import pytest
from gate_world import at_rest
from guard_world import FINE, LIMITS, STEP, TINY, N, facts, joints, judge

from twind.robot.finding import Code
from twind.robot.modes import Mode, Motion
from twind.safety.guard import Guard, Reaction, Traffic


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("step", "fits"), [(STEP - TINY, True), (STEP, True), (STEP + TINY, False), (1.0, False)]
)
def test_r21_a_goal_steps_no_further_than_the_velocity_limit(side: float, step: float, fits: bool) -> None:
    for mode, motion in product(Mode, Motion):
        judgement = judge(mode=mode, motion=motion, setpoint_age=0.0, goal=at_rest([0.0, side * step, 0.0]))
        if fits:
            assert judgement == FINE
        else:
            assert (judgement.reaction, judgement.goal_refused) == (Reaction.HOLD, True)
            (finding,) = judgement.findings
            assert (finding.code, finding.joint, finding.value) == (Code.STEP_LIMIT, 1, pytest.approx(step))
            assert finding.bound == pytest.approx(STEP)


@pytest.mark.parametrize(("full", "cause"), [(0, "a bug of ours"), (1, "the port was full")])
def test_r21_a_goal_that_the_port_had_no_room_for_is_no_bug(full: int, cause: str) -> None:
    guard = Guard(LIMITS, buses=("left", "right"))
    traffic = (Traffic(), Traffic(full=full))
    judgement = guard.judge(facts(goal=at_rest([0.0, 2 * STEP, 0.0]), traffic=traffic))
    assert judgement.goal_refused
    assert cause in judgement.findings[0].message


def test_r21_the_bound_follows_the_period() -> None:
    guard, goal = Guard(LIMITS), at_rest([0.0, STEP, 0.0])
    assert guard.judge(facts(goal=goal)) == FINE
    assert guard.judge(facts(goal=goal, period=0.005)).goal_refused


def test_r21_a_first_goal_has_nothing_to_step_from() -> None:
    assert judge(previous=None, goal=at_rest([1.0, 1.0, 1.0])) == FINE


def test_r21_a_last_goal_that_is_no_number_refuses_the_next() -> None:
    assert judge(previous=joints(0.0, 0.0, nan)).goal_refused


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_a_goal_that_is_no_number_is_refused_in_every_mode(bad: float) -> None:
    for mode, previous in product(Mode, [np.zeros(N), None]):
        judgement = judge(mode=mode, goal=at_rest([0.0, 0.0, bad]), previous=previous)
        assert (judgement.reaction, judgement.goal_refused) == (Reaction.HOLD, True)
        assert [(finding.code, finding.joint) for finding in judgement.findings] == [(Code.NONFINITE, 2)]
