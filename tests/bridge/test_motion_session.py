"""The lease and the motions of a bridge: taken for a motion, kept while it runs, given back after it."""

from itertools import pairwise
from typing import Any

import pytest

from tests.support.scripted_line import ScriptedDaemon, ended, ended_in_words, moving
from twind.bridge.motion_session import (
    BROKEN,
    LATE,
    LINGER,
    LOST,
    RENEW,
    UNREADABLE,
    MotionEnd,
    MotionSession,
)
from twind.client import CallError, Disconnected, NoDaemon, Refused
from twind.safety.lease import TRAJECTORY

PATH = {"joint_names": ["l_knee"], "points": [{"positions": [0.5], "time_from_start": 1.0}]}
HELD: Any = ("LeaseHeld", {"lease": {"holder": "uid 7, pid 8", "uid": 7, "expires_in": 0.5}})


class Hand:
    """A driving whose time the test moves, and its daemon."""

    def __init__(self) -> None:
        self.time = 100.0
        self.daemon = ScriptedDaemon()
        self.driving = MotionSession(self.daemon.client, lambda: self.time)

    def after(self, seconds: float) -> list[MotionEnd]:
        """Return the motions that end within `seconds`, polled ten times a second."""
        over = []
        for _ in range(round(seconds / 0.1)):
            self.time += 0.1
            over += self.driving.keep()
        return over


@pytest.fixture
def hand() -> Hand:
    return Hand()


def test_a_motion_has_the_lease_until_it_ends_and_no_longer(hand: Hand) -> None:
    assert hand.driving.submit(PATH)["id"] == "m1"
    assert [method for method, _ in hand.daemon.calls] == ["AcquireLease", "SubmitTrajectory"]
    hand.driving.on_monitor_reply(moving("active"))
    kept = [hand.time]
    hand.daemon.meanwhile = lambda method: kept.append(hand.time)
    assert hand.after(3.0) == [] and hand.driving.driving == ("m1",)
    hand.daemon.meanwhile = lambda method: None
    assert max(after - before for before, after in pairwise([*kept, hand.time])) < TRAJECTORY / 2.0
    hand.driving.on_monitor_reply(ended("m1", "succeeded"))
    assert hand.after(LINGER + 0.3) == [MotionEnd("m1", "succeeded", [])]
    assert hand.daemon.calls[-1][0] == "ReleaseLease" and hand.daemon.open == 0


def test_a_newer_motion_goes_on_the_same_connection(hand: Hand) -> None:
    hand.driving.submit(PATH)
    hand.after(0.2)
    hand.driving.submit(PATH)
    hand.driving.on_monitor_reply(ended("m1", "replaced"))
    assert hand.after(0.2) == [MotionEnd("m1", "replaced", [])]
    assert hand.driving.driving == ("m2",) and len(hand.daemon.lines) == 1


def test_a_motion_end_received_before_the_submit_reply_counts(hand: Hand) -> None:
    hand.daemon.meanwhile = lambda method: (
        hand.driving.on_monitor_reply(ended("m1", "succeeded")) if method == "SubmitTrajectory" else None
    )
    hand.driving.submit(PATH)
    assert hand.after(0.1) == [MotionEnd("m1", "succeeded", [])]


def test_ends_of_foreign_motions_are_ignored_and_dropped(hand: Hand) -> None:
    for number in range(1000):
        hand.driving.on_monitor_reply(ended(f"x{number}", "succeeded"))
    assert hand.after(0.2) == [] and len(hand.driving.finished) <= 64


def test_a_lease_of_another_is_not_taken(hand: Hand) -> None:
    hand.daemon.refuse["AcquireLease"] = HELD
    with pytest.raises(CallError, match="held by uid 7, pid 8"):
        hand.driving.submit(PATH)
    assert hand.daemon.named("SubmitTrajectory") == [] and hand.driving.driving == ()
    hand.after(LINGER + 0.2)
    assert hand.daemon.open == 0


def test_a_refusal_leaves_what_runs_as_it_is(hand: Hand) -> None:
    hand.driving.submit(PATH)
    hand.daemon.refuse["SubmitTrajectory"] = (
        "Refused",
        {"findings": [{"code": "POS_LIMIT", "message": "far"}]},
    )
    with pytest.raises(Refused, match="POS_LIMIT: far"):
        hand.driving.submit(PATH)
    hand.driving.on_monitor_reply(moving("active"))
    assert hand.after(2.0) == [] and hand.driving.driving == ("m1",)


def test_a_refused_trajectory_does_not_keep_the_lease(hand: Hand) -> None:
    far: Any = ("Refused", {"findings": [{"code": "POS_LIMIT", "message": "far"}]})
    hand.daemon.refuse["SubmitTrajectory"] = far
    for _ in range(3):
        with pytest.raises(Refused):
            hand.driving.submit(PATH)
        assert hand.daemon.calls[-1][0] == "ReleaseLease" and hand.daemon.open == 0
        hand.after(0.3)


def test_a_lease_held_on_request_outlives_a_refusal(hand: Hand) -> None:
    hand.driving.hold()
    hand.daemon.refuse["SubmitTrajectory"] = ("Refused", {"findings": []})
    with pytest.raises(Refused):
        hand.driving.submit(PATH)
    assert hand.driving.held and not hand.daemon.named("ReleaseLease")


def test_a_motion_without_an_end_event_is_lost_once_the_robot_stays_at_rest(hand: Hand) -> None:
    hand.driving.submit(PATH)
    hand.driving.on_monitor_reply(moving("holding"))  # as it was when it was accepted
    assert hand.after(0.5) == []
    hand.driving.on_monitor_reply(moving("active"))
    assert hand.after(5.0) == []
    hand.driving.on_monitor_reply(moving("holding"))  # a status overtakes the end that goes with it
    assert hand.after(0.1) == []
    hand.driving.on_monitor_reply(ended("m1", "succeeded"))
    assert [each.phase for each in hand.after(0.2)] == ["succeeded"]
    hand.driving.submit(PATH)
    lost = []
    for _ in range(3):
        hand.driving.on_monitor_reply(moving("holding"))
        lost += hand.after(LATE)
    assert lost == [MotionEnd("m2", LOST)]


def test_a_motion_with_a_later_start_is_not_lost_before_its_start(hand: Hand) -> None:
    hand.driving.submit(PATH | {"start_in": 10.0})
    for _ in range(8):
        hand.driving.on_monitor_reply(moving("holding"))
        assert hand.after(1.0) == []


def test_a_motion_is_lost_with_its_connection_unless_its_end_arrives_soon(hand: Hand) -> None:
    hand.driving.submit(PATH)
    hand.driving.submit(PATH)
    hand.daemon.dead = True
    hand.after(RENEW + 0.2)
    hand.driving.on_monitor_reply(ended("m1", "aborted", {"code": "LEASE_LOST", "message": "gone"}))
    first, second = hand.after(LATE + 0.2)
    assert (first.id, first.phase) == ("m1", "aborted")
    assert second == MotionEnd("m2", LOST, BROKEN)  # and it is said why nobody knows


def test_without_a_daemon_nothing_is_under_way(hand: Hand) -> None:
    hand.daemon.absent = True
    with pytest.raises(NoDaemon):
        hand.driving.submit(PATH)
    hand.daemon.absent = False
    hand.daemon.dead = True
    with pytest.raises(Disconnected):
        hand.driving.submit(PATH)
    assert hand.driving.driving == () and hand.after(3.0) == []


def test_a_lost_lease_is_not_acquired_again(hand: Hand) -> None:
    hand.driving.submit(PATH)
    hand.daemon.refuse["RenewLease"] = ("Refused", {"findings": [{"code": "LEASE_MISSING", "message": "no"}]})
    hand.after(1.0)
    hand.driving.on_monitor_reply(ended("m1", "aborted", {"code": "LEASE_LOST", "message": "taken"}))
    assert [each.phase for each in hand.after(0.2)] == ["aborted"]
    assert len(hand.daemon.named("AcquireLease")) == 1


@pytest.mark.parametrize("text", ["", "x", "m1 aborted", "m2 succeeded", "the motion m1 has arrived"])
def test_a_motion_end_counts_by_its_fields_whatever_its_text(hand: Hand, text: str) -> None:
    hand.driving.submit(PATH)
    hand.driving.submit(PATH)
    end = ended("m1", "succeeded")
    end["event"]["message"] = text
    hand.driving.on_monitor_reply(end)
    assert hand.after(0.1) == [MotionEnd("m1", "succeeded", [])]
    assert hand.driving.driving == ("m2",)


def test_a_motion_end_without_fields_ends_every_motion_and_releases_the_lease(
    hand: Hand,
) -> None:
    hand.driving.hold()
    hand.driving.submit(PATH)
    hand.driving.submit(PATH)
    hand.driving.on_monitor_reply(ended_in_words("m1", "replaced"))
    assert hand.after(0.1) == [MotionEnd("m1", LOST, UNREADABLE), MotionEnd("m2", LOST, UNREADABLE)]
    assert hand.driving.driving == () and not hand.driving.held
    assert hand.daemon.calls[-1][0] == "ReleaseLease" and hand.daemon.open == 0


def test_after_an_end_that_cannot_be_read_a_new_motion_runs_as_the_first_did(hand: Hand) -> None:
    hand.driving.on_monitor_reply(ended_in_words("of_another", "succeeded"))
    hand.after(0.1)
    hand.driving.submit(PATH)
    assert hand.after(1.0) == [] and hand.driving.driving == ("m1",)


def test_a_phase_that_is_not_known_ends_its_own_motion_as_lost_and_no_other(hand: Hand) -> None:
    hand.driving.submit(PATH)
    hand.driving.submit(PATH)
    hand.driving.on_monitor_reply(ended("m1", "vanished"))
    assert hand.after(0.5) == [MotionEnd("m1", LOST, UNREADABLE)]
    assert hand.driving.driving == ("m2",) and not hand.daemon.named("ReleaseLease")
