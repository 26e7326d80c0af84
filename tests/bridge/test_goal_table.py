"""Remote goals: each once, none too late, and a bounded number of them."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.commands.leased_motions import refusal
from twind.bridge.uplink.goal_table import AHEAD, MOST, RemoteGoalTable
from twind.client import CallError, Refused


@given(st.floats(allow_nan=True), st.floats(allow_nan=True))
def test_a_goal_begins_only_within_its_deadline_and_that_is_near(deadline: float, now: float) -> None:
    goals = RemoteGoalTable()
    with suppress(CallError):
        goals.begin("a", "lease", deadline, now)
    begun = goals.find_repeated("a", "lease") is not None
    assert begun == (now <= deadline and deadline - now <= AHEAD)


def test_the_same_goal_again_is_the_first_one_and_of_another_lease_none() -> None:
    goals = RemoteGoalTable()
    first = goals.begin("wave", "mine", 11.0, 10.0)
    first.id = "d1"
    first.answer = {"phase": "accepted"}
    assert goals.find_repeated("wave", "mine") is first
    assert first.latest_reply() == {"phase": "accepted"}
    with pytest.raises(CallError, match="used once"):
        goals.find_repeated("wave", "another's")
    assert goals.find_repeated("bow", "mine") is None


def test_a_refusal_is_the_answer_however_often_it_is_asked() -> None:
    goals = RemoteGoalTable()
    goals.begin("wave", "mine", 11.0, 10.0).refusal = refusal("POS_LIMIT", "no")
    for _ in range(2):
        known = goals.find_repeated("wave", "mine")
        assert known is not None
        with pytest.raises(Refused):
            known.latest_reply()


def test_a_dropped_goal_is_past_its_deadline_and_cannot_begin_again() -> None:
    goals = RemoteGoalTable()
    now = 10.0
    for number in range(MOST):
        goals.begin(f"g{number}", "mine", now + 1.0, now)
    with pytest.raises(CallError, match="busy"):
        goals.begin("more", "mine", now + 1.0, now)
    running = goals.find_repeated("g0", "mine")
    assert running is not None
    running.id = "d0"
    now += 2.0
    goals.begin("more", "mine", now + 1.0, now)
    assert goals.find_repeated("g1", "mine") is None
    assert goals.find_repeated("g0", "mine") is running, "one that runs is not forgotten"
    with pytest.raises(Refused):
        goals.begin("g1", "mine", 11.0, now)
