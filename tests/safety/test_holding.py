"""No motion is accepted that the guard would hold at once for a reason that it knows."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.gate_rig import TH, condition, snapshot
from tests.support.guard_rig import LIMITS, PERIOD, N, facts, reading
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion
from twind.safety.admission import admit
from twind.safety.clearance_rules import ClearanceAhead
from twind.safety.guard import BusTraffic, Guard, GuardInput, Reaction

GOOD = BusTraffic(asked=True, answered=True)
BAD = BusTraffic(asked=True, bad=True, answered=True)
ALL = np.ones(N, np.bool_)
HOLDING = {"motion": Motion.HOLDING}
ages = st.sampled_from([0.0, 0.03, 0.09, 0.1, 0.1 + 1e-6, 0.3])


def admitted(guard: Guard, missed: int = 0, **over: object) -> set[ReasonCode]:
    """Codes for which a motion is refused."""
    usual = snapshot(N, condition=condition(N), holding=guard.holding(missed, PERIOD))
    return {finding.code for finding in admit(replace(usual, **over), ALL, TH).refusals}


def tick(now: float, **over: object) -> GuardInput:
    age = over.pop("age", 0.0)
    measured = reading(age=[float(age), 0.0, 0.0], time=now)  # type: ignore[arg-type]
    return facts(now=now, measured=measured, status_time=np.full(N, now), **over)


@given(
    st.lists(st.booleans(), max_size=110),
    ages,
    st.integers(0, 5),
    st.integers(0, 8),
    st.sampled_from(Mode),
    st.sampled_from([Motion.HOLDING, Motion.ACTIVE]),
)
def test_an_admitted_motion_is_not_held_by_what_was_known(
    bad: list[bool], age: float, jumps: int, missed: int, mode: Mode, motion: Motion
) -> None:
    guard = Guard(LIMITS, buses=("main",), support="gantry")
    jumped = np.array([jumps, 0, 0])
    now = 10.0
    latched = False
    for each in (*bad, False):
        now += PERIOD
        seen = tick(now, traffic=(BAD if each else GOOD,), age=age, jumps=jumped, mode=mode, motion=motion)
        latched |= guard.judge(seen).latches
    if latched or admitted(guard, missed, mode=mode):
        return
    begins = tick(now + PERIOD, traffic=(GOOD,), age=age, jumps=jumped, mode=mode, missed_in_a_row=missed)
    assert guard.judge(begins).reaction is Reaction.NONE


@pytest.mark.parametrize(
    ("over", "code"),
    [
        ({"age": 0.2}, ReasonCode.STATE_STALE),
        ({"jumps": np.array([3, 0, 0])}, ReasonCode.SENSE_JUMP),
        ({"measured": None}, ReasonCode.STATE_STALE),
    ],
)
def test_a_finding_that_holds_any_motion_refuses_the_next_one(
    over: dict[str, object], code: ReasonCode
) -> None:
    guard = Guard(LIMITS)
    given = tick(10.0, **{**HOLDING, **{key: each for key, each in over.items() if key != "measured"}})
    guard.judge(replace(given, measured=None) if "measured" in over else given)
    assert admitted(guard) == {code}
    guard.judge(tick(10.01, **HOLDING))
    assert admitted(guard) == set()


def test_errors_of_a_bus_that_hold_a_motion_refuse_the_next_one_until_they_are_over() -> None:
    guard = Guard(LIMITS, buses=("main",))
    for k in range(20):
        guard.judge(tick(10.0 + 0.02 * k, traffic=(BAD,), **HOLDING))
        guard.judge(tick(10.01 + 0.02 * k, traffic=(GOOD,), **HOLDING))
    assert admitted(guard) == {ReasonCode.BUS_ERRORS}
    for k in range(1, 110):
        guard.judge(tick(10.39 + 0.01 * k, traffic=(GOOD,), **HOLDING))
    assert admitted(guard) == set()


def test_errors_of_a_bus_refuse_no_motion_of_the_simulation() -> None:
    guard = Guard(LIMITS, buses=("main",))
    for k in range(10):
        guard.judge(tick(10.0 + 0.01 * k, traffic=(BAD,), mode=Mode.MIRROR, torque_expected=False, **HOLDING))
    assert guard.bars
    assert admitted(guard, mode=Mode.MIRROR) == set()


@pytest.mark.parametrize(("missed", "refused"), [(0, False), (4, False), (5, True), (50, True)])
def test_missed_ticks_just_before_a_motion_refuse_it_and_the_next_tick_accepts_it(
    missed: int, refused: bool
) -> None:
    guard = Guard(LIMITS)
    assert admitted(guard, missed) == ({ReasonCode.LOOP_LATE} if refused else set())
    guard.judge(tick(10.0, missed_in_a_row=missed, **HOLDING))
    assert admitted(guard, 0) == set()


@pytest.mark.parametrize(
    "over",
    [
        {"outlook": ClearanceAhead(0.0, 0.1, ("a", "b"), 0.002, 0.01)},
        {"lease_ok": False},
        {"motion": Motion.STREAMING, "setpoint_age": 1.0},
        {"goal": replace(facts().goal, position=np.full(N, 0.3))},  # type: ignore[type-var]
        {"goal": replace(facts().goal, position=np.full(N, np.nan))},  # type: ignore[type-var]
    ],
)
def test_what_ends_one_motion_alone_does_not_refuse_another(over: dict[str, object]) -> None:
    guard = Guard(LIMITS)
    assert guard.judge(tick(10.0, **over)).reaction is Reaction.HOLD
    assert admitted(guard) == set()
