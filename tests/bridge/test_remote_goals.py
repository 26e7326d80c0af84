"""Keeper of a remote lease: no goal begins after a stop, none runs without its lease.

The daemon is a scripted one (`scripted_line.py`); the live tests use a real one.
"""

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from msgspec import convert

from tests.support.scripted_line import ScriptedDaemon, ended
from twind.bridge.commands.leased_motions import LeasedMotions
from twind.bridge.uplink.remote_contract import GoalQuery, LeaseQuery
from twind.bridge.uplink.remote_goals import MOST_SHARE, RemoteGoals
from twind.bridge.zenoh.zenoh_keys import LEASE_S
from twind.client import CallError, Refused

PATH = {"joint_names": ["l_knee"], "points": [{"positions": [0.5], "time_from_start": 9.0}]}
BESIDE: Any = ("LeaseHeld", {"lease": {"holder": "uid 7, pid 8", "uid": 7, "expires_in": 0.5}})
PATIENCE = 10.0  # s


class Hand:
    """Remote goals whose time the test moves, and their daemon."""

    def __init__(self) -> None:
        self.time = 1000.0
        self.daemon = ScriptedDaemon()
        self.said = list[str]()
        self.published = list[tuple[str, dict[str, Any]]]()
        self.motions = LeasedMotions(self.daemon.client)
        publish = lambda name, answer: self.published.append((name, answer))  # noqa: E731
        self.goals = RemoteGoals(self.motions, publish, self.said.append, lambda: self.time)

    def acquire(self, holder: str, **more: Any) -> str:
        return str(self.goals.lease(LeaseQuery("acquire", holder, **more))["lease"])

    def goal(self, name: str, lease: str, came: float | None = None) -> dict[str, Any]:
        asked = {"goal": name, "lease": lease, "deadline": self.time + 20.0, "trajectory": PATH}
        return self.goals.goal(convert(asked, GoalQuery), time.monotonic() if came is None else came)

    def holds(self, lease: str) -> bool:
        """The lease can be renewed."""
        try:
            self.goals.renew(LeaseQuery("renew", lease=lease))
        except Refused:
            return False
        return True

    @property
    def sent(self) -> int:
        return len(self.daemon.named("SubmitTrajectory"))

    @property
    def given_back(self) -> bool:
        """Nothing moves any more: no connection that holds the daemon's lease."""
        return self.daemon.open == 0


@pytest.fixture
def hand() -> Hand:
    return Hand()


def code_of(call: Callable[[], object]) -> str:
    with pytest.raises(Refused) as caught:
        call()
    return str(caught.value.findings[0]["code"])


def test_a_goal_that_was_here_before_a_stop_does_not_begin_after_it_nor_when_it_is_asked_again(
    hand: Hand,
) -> None:
    lease = hand.acquire("desk")
    came = time.monotonic()
    hand.motions.stopped(time.monotonic())
    assert code_of(lambda: hand.goal("waited", lease, came)) == "BUSY"
    assert code_of(lambda: hand.goal("waited", lease)) == "BUSY", "its repetition came after the stop"
    assert hand.sent == 0
    assert hand.goal("new", lease)["phase"] == "accepted"


def test_a_lease_that_lapses_during_the_check_of_a_goal_is_released_at_once(hand: Hand) -> None:
    lease = hand.acquire("desk")
    judged = threading.Event()
    answer = threading.Event()

    def judge(method: str) -> None:
        if method == "SubmitTrajectory":
            judged.set()
            assert answer.wait(PATIENCE)

    hand.daemon.meanwhile = judge
    refusals: list[str] = []
    queue = threading.Thread(target=lambda: refusals.append(code_of(lambda: hand.goal("long", lease))))
    queue.start()
    assert judged.wait(PATIENCE)
    hand.goals.watch()
    assert not hand.daemon.dead, "it is renewed yet"
    hand.time += LEASE_S + 0.1
    hand.goals.watch()
    assert hand.daemon.dead, "hung up, though the answer is still waited for"
    answer.set()
    queue.join(PATIENCE)
    assert refusals == ["LEASE_MISSING"]
    hand.goals.keep()
    assert hand.given_back


def test_a_goal_that_is_accepted_after_its_lease_lapsed_is_let_go(hand: Hand) -> None:
    lease = hand.acquire("desk")

    def lapse(method: str) -> None:
        if method == "SubmitTrajectory":
            hand.time += LEASE_S + 0.1

    hand.daemon.meanwhile = lapse
    assert code_of(lambda: hand.goal("late", lease)) == "LEASE_MISSING"
    assert hand.daemon.named("Cancel")
    hand.goals.keep()
    assert hand.given_back


def test_a_remote_lease_refusal_names_holder_and_time_and_a_late_take_is_ignored(hand: Hand) -> None:
    first = hand.acquire("first")
    with pytest.raises(CallError, match="first") as held:
        hand.acquire("second")
    now = held.value.parameters["now"]
    with pytest.raises(CallError, match="deadline"):
        hand.acquire("second", take=True)
    hand.time += 0.9
    assert code_of(lambda: hand.acquire("second", take=True, deadline=now + 0.5)) == "CMD_EXPIRED"
    assert hand.holds(first)
    second = hand.acquire("second", take=True, deadline=now + 1.0)
    assert hand.holds(second) and not hand.holds(first)


def test_a_remote_client_does_not_take_the_lease_of_a_local_holder(hand: Hand) -> None:
    hand.daemon.refuse["AcquireLease"] = BESIDE
    with pytest.raises(CallError, match="uid 7, pid 8") as held:
        hand.acquire("far", take=True, deadline=hand.time + 1.0)
    assert held.value.parameters["now"] == hand.time
    assert hand.daemon.named("AcquireLease") == [{}], "it is not even asked for with take"


def test_a_goal_is_asked_after_by_its_name(hand: Hand) -> None:
    lease = hand.acquire("desk")
    accepted = hand.goal("wave", lease)
    assert hand.goals.goal(GoalQuery("wave", lease), time.monotonic()) == accepted
    with pytest.raises(CallError, match="not known"):
        hand.goals.goal(GoalQuery("bow", lease), time.monotonic())
    assert hand.sent == 1


def test_the_remote_clock_includes_the_time_of_suspend() -> None:
    """As where a machine slept for 5,000 s: its clock since it was booted is that much ahead."""
    asleep = ["unshare", "--time", "--boottime", "5000"]
    if subprocess.run([*asleep, "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("no namespace of times here")
    said = (
        "import time; from twind.bridge.uplink.remote_goals import clock; print(clock() - time.monotonic())"
    )
    done = subprocess.run([*asleep, sys.executable, "-c", said], capture_output=True, check=True, text=True)
    assert float(done.stdout) > 4999.0


def test_a_goal_is_published_with_its_share_until_its_end(hand: Hand) -> None:
    lease = hand.acquire("desk")
    name = hand.goal("wave", lease)["id"]
    begun = time.monotonic() - 4.5
    hand.goals.on_monitor_reply(
        {"topic": "trajectories", "time": begun, "accepted": {"id": name, "trajectory": PATH}}
    )
    hand.goals.keep()
    goal, running = hand.published[-1]
    assert (goal, running["phase"]) == ("wave", "running") and 0.5 <= running["progress"] <= MOST_SHARE
    hand.goals.on_monitor_reply(ended(name, "succeeded", time=time.monotonic()))
    hand.goals.keep()
    end = {"id": name, "phase": "succeeded", "progress": 1.0, "findings": []}
    assert hand.published[-1] == ("wave", end) and hand.goal("wave", lease) == end


def test_a_lease_that_the_daemon_took_is_given_up(hand: Hand) -> None:
    lease = hand.acquire("desk")
    taken = {"topic": "events", "event": {"code": "LEASE_LOST", "message": "x"}, "time": time.monotonic()}
    hand.goals.on_monitor_reply(taken)
    hand.goals.keep()
    assert not hand.holds(lease) and hand.given_back and "the daemon took" in hand.said[-1]
