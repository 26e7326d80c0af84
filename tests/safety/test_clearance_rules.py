"""LOOKAHEAD_COLLISION slows a motion near an obstacle, then holds it, and affects no other joint."""

from itertools import product
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.guard_rig import FINE, LIMITS, PERIOD, codes, facts, judge
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard import MOVING, REACTING, Guard, Reaction
from twind.safety.guard_types import ClearanceAhead

BLOCK = 0.002
WARN = 0.010
TINY = 1e-9


def outlook(clearance: float, ahead: float = 0.2) -> ClearanceAhead:
    return ClearanceAhead(clearance, ahead, ("l_hand", "l_thigh"), BLOCK, WARN)


@pytest.mark.parametrize(
    ("clearance", "reaction", "pace"),
    [
        (inf, Reaction.NONE, 1.0),
        (WARN + TINY, Reaction.NONE, 1.0),
        (WARN, Reaction.NONE, 1.0),
        (0.006, Reaction.NONE, 0.5),
        (0.0044, Reaction.NONE, 0.3),
        (0.0028, Reaction.NONE, 0.1),
        (BLOCK + TINY, Reaction.NONE, 0.1),  # never slower than that: it must get somewhere
        (BLOCK, Reaction.HOLD, 1.0),
        (0.0, Reaction.HOLD, 1.0),
        (-0.05, Reaction.HOLD, 1.0),
        (-inf, Reaction.HOLD, 1.0),
        (nan, Reaction.HOLD, 1.0),
    ],
)
@pytest.mark.parametrize("ahead", [PERIOD, 0.3])
def test_lookahead_collision_nearer_is_slower_then_held(
    clearance: float, reaction: Reaction, pace: float, ahead: float
) -> None:
    judgement = judge(outlook=outlook(clearance, ahead))
    assert (judgement.reaction, judgement.latches, judgement.goal_refused) == (reaction, False, False)
    assert judgement.pace == pytest.approx(pace)
    assert codes(judgement) == ([] if clearance > WARN else [ReasonCode.LOOKAHEAD_COLLISION])
    if reaction:
        (finding,) = judgement.findings
        assert (finding.time, finding.bound) == (ahead, BLOCK)
        assert "l_hand" in finding.message and "l_thigh" in finding.message
        assert f"{ahead:.2f} s" in finding.message


@pytest.mark.parametrize("clearance", [nan, -inf, -0.05, 0.001])
@pytest.mark.parametrize("ahead", [0.0, -0.1, nan])
def test_lookahead_collision_too_close_is_too_close_whenever_that_is(clearance: float, ahead: float) -> None:
    """The look-ahead does not report motion that leads out of a bad place."""
    assert judge(outlook=outlook(clearance, ahead)).reaction is Reaction.HOLD


@pytest.mark.parametrize("clearance", [0.006, 0.0, nan])
@pytest.mark.parametrize(("state", "motion"), list(product(RobotState, Motion)))
def test_lookahead_collision_no_hold_no_stop_and_no_way_down_is_touched(
    clearance: float, state: RobotState, motion: Motion
) -> None:
    over = {"state": state, "motion": motion, "mode": Mode.SIM, "setpoint_age": 0.0}
    without = judge(**over)
    found = judge(**over, outlook=outlook(clearance))
    if motion in MOVING and state not in REACTING:
        assert ReasonCode.LOOKAHEAD_COLLISION in codes(found)
    else:
        assert found == without


def test_lookahead_collision_without_bounds_only_what_touches_is_held_and_now() -> None:
    assert judge(outlook=ClearanceAhead(0.0005)) == FINE
    found = judge(outlook=ClearanceAhead(-0.01))
    assert found.reaction is Reaction.HOLD
    assert [(one.time, one.bound) for one in found.findings] == [(0.0, 0.0)]


def test_lookahead_collision_a_hold_of_one_motion_prevents_no_other() -> None:
    guard = Guard(LIMITS)
    assert guard.judge(facts(outlook=outlook(BLOCK))).reaction is Reaction.HOLD
    assert guard.holding(0, PERIOD) == ()


def test_lookahead_collision_without_a_look_ahead_gives_no_finding() -> None:
    assert judge(outlook=None) == FINE


@given(st.floats(0.0, 0.05), st.floats(1e-6, 0.05), st.floats(-0.1, 0.2))
def test_lookahead_collision_the_pace_is_a_share_and_falls_with_the_clearance(
    block: float, room: float, clearance: float
) -> None:
    def at(value: float) -> tuple[int, float]:
        seen = judge(outlook=ClearanceAhead(value, 0.1, ("a", "b"), block, block + room))
        return seen.reaction, seen.pace

    (reaction, pace), (nearer, slower) = at(clearance), at(clearance - 0.001)
    assert 0.1 <= pace <= 1.0
    assert nearer >= reaction
    assert nearer or slower <= pace
