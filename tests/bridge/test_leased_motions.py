"""Motions from elsewhere: the lease lasts while they move, none begins after a stop, each has its end."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.support.scripted_line import Answer, ScriptedDaemon, ended, ended_in_words, moving
from twind.bridge.commands.leased_motions import EARLY, LATE, LINGER, LeasedMotions, MotionRequest, refusal
from twind.bridge.commands.motion_end import BROKEN, LOST, UNREADABLE, UNREPORTED
from twind.client import CallError, ClientError

PATH = {"joint_names": ["l_knee"], "points": [{"positions": [0.5], "time_from_start": 1.0}]}
FAR: Any = ("Refused", {"findings": [{"code": "POS_LIMIT", "message": "l_knee: 9 rad"}]})
HELD: Any = ("LeaseHeld", {"lease": {"holder": "uid 7, pid 8", "uid": 7, "expires_in": 0.5}})
DROPPED: Any = ("Refused", {"findings": [{"code": "BUSY", "message": "the robot was stopped"}]})


class Hand:
    """Motions whose time the test moves, and its daemon. `reports`: phase and fields, without `running`."""

    def __init__(self) -> None:
        self.time = 100.0
        self.daemon = ScriptedDaemon()
        self.motions = LeasedMotions(self.daemon.client, lambda: self.time)
        self.reports = list[tuple[str, Answer]]()
        self.running = 0

    def request(self, **more: Any) -> MotionRequest:
        return MotionRequest(lambda: PATH | more, self._report, self.time)

    def take(self, **more: Any) -> MotionRequest:
        """A request that arrives and is taken at once."""
        request = self.request(**more)
        self.motions.take(request)
        return request

    def after(self, seconds: float) -> list[str]:
        """Phases reported within `seconds`, at ten looks a second."""
        before = len(self.reports)
        for _ in range(round(seconds / 0.1)):
            self.time += 0.1
            self.motions.keep()
        return [phase for phase, _ in self.reports[before:]]

    def during_submit(self, do: Callable[[], object]) -> None:
        self.daemon.meanwhile = lambda method: do() and None if method == "SubmitTrajectory" else None

    @property
    def phases(self) -> list[str]:
        return [phase for phase, _ in self.reports]

    def codes(self) -> list[str]:
        """Codes of the last refusal."""
        error = self.reports[-1][1]["error"]
        return [each["code"] for each in error.findings]

    def _report(self, phase: str, fields: Any) -> None:
        if phase == "running":
            self.running += 1
        else:
            self.reports.append((phase, dict(fields)))


@pytest.fixture
def hand() -> Hand:
    return Hand()


def methods(hand: Hand) -> list[str]:
    return [method for method, _ in hand.daemon.calls]


def test_a_motion_has_the_lease_until_it_ends_and_no_longer(hand: Hand) -> None:
    hand.take()
    assert methods(hand) == ["AcquireLease", "SubmitTrajectory"]
    hand.motions.on_monitor_reply(moving("active"))
    assert hand.after(3.0) == [] and hand.motions.moving == ("m1",) and hand.motions.held
    assert 10 < hand.running <= 20
    hand.motions.on_monitor_reply(ended("m1", "succeeded"))
    assert hand.after(LINGER + 0.3) == ["succeeded"]
    assert methods(hand)[-1] == "ReleaseLease" and hand.daemon.open == 0


def test_a_newer_motion_goes_on_the_same_connection(hand: Hand) -> None:
    hand.take()
    hand.take()
    hand.motions.on_monitor_reply(ended("m1", "replaced"))
    assert hand.after(0.2) == ["replaced"]
    assert hand.motions.moving == ("m2",) and hand.daemon.open == len(hand.daemon.lines) == 1


def test_a_motion_end_received_before_the_verdict_counts(hand: Hand) -> None:
    hand.during_submit(lambda: hand.motions.on_monitor_reply(ended("m1", "succeeded")))
    hand.take()
    assert hand.after(0.1) == ["succeeded"]


def test_a_motion_that_failed_before_its_verdict_arrived_is_reported_with_its_own_cause(hand: Hand) -> None:
    behind = hand.request()
    hand.during_submit(lambda: hand.motions.on_monitor_reply(ended("m1", "aborted", time=hand.time)))
    hand.take()
    hand.motions.take(behind)
    assert hand.codes() == ["BUSY"], "what waited behind it does not begin"
    hand.after(0.1)
    assert hand.phases == ["accepted", "refused", "aborted"]
    assert not hand.daemon.named("Cancel"), "another motion may run by now"


def test_ends_of_foreign_motions_are_ignored_and_a_bounded_number_is_kept(hand: Hand) -> None:
    hand.motions.on_monitor_reply(ended("m1", "succeeded"))
    for number in range(EARLY):
        hand.motions.on_monitor_reply(ended(f"x{number}", "succeeded"))
    hand.take()
    assert hand.after(0.2) == [] and hand.motions.moving == ("m1",)


@pytest.mark.parametrize(
    ("refuse", "word"), [({"AcquireLease": HELD}, "pid 8"), ({"SubmitTrajectory": FAR}, "9 rad")]
)
def test_a_refused_request_is_reported_and_keeps_no_lease(hand: Hand, refuse: Any, word: str) -> None:
    hand.daemon.refuse = refuse
    hand.take()
    assert hand.phases == ["refused"] and word in str(hand.reports[0][1]["error"])
    assert hand.daemon.open == 0 and hand.motions.moving == ()


def test_a_refusal_leaves_what_runs_and_a_lease_held_on_request(hand: Hand) -> None:
    hand.motions.hold()
    hand.take()
    hand.daemon.refuse["SubmitTrajectory"] = FAR
    hand.take()
    hand.motions.on_monitor_reply(moving("active"))
    assert hand.after(2.0) == [] and hand.motions.moving == ("m1",)
    hand.motions.on_monitor_reply(ended("m1", "succeeded"))
    assert hand.after(2.0) == ["succeeded"] and hand.motions.held and not hand.daemon.named("ReleaseLease")


def test_without_a_daemon_a_request_is_refused_and_not_kept_for_later(hand: Hand) -> None:
    hand.daemon.absent = True
    hand.take()
    hand.daemon.absent = False
    assert hand.after(2.0) == [] and hand.phases == ["refused"]
    hand.daemon.absent = True
    with pytest.raises(ClientError, match="nobody listens"):
        hand.motions.hold()


def test_a_verdict_that_cannot_be_read_releases_the_motion_that_may_run(
    hand: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ScriptedDaemon, "_submitted", lambda daemon: {"phase": "accepted"})
    hand.take()
    assert "KeyError" in str(hand.reports[0][1]["error"]) and hand.daemon.open == 0


def test_what_arrived_before_a_stop_does_not_begin_after_it(hand: Hand) -> None:
    waited = hand.request()
    hand.motions.stopped(hand.time)
    hand.motions.take(waited)
    assert hand.codes() == ["BUSY"] and not hand.daemon.named("SubmitTrajectory")
    hand.time += 0.1
    hand.take()
    assert hand.phases[-1] == "accepted"


def test_a_motion_that_was_stopped_while_it_was_judged_is_cancelled_and_reported_as_refused(
    hand: Hand,
) -> None:
    hand.during_submit(lambda: hand.motions.stopped(hand.time))
    hand.take()
    assert hand.codes() == ["BUSY"] and methods(hand)[-1] == "Cancel" and hand.motions.moving == ()
    hand.daemon.refuse["Cancel"] = ("Busy", {"what": "the loop"})
    hand.time += 0.1
    hand.take()
    assert methods(hand)[-1] == "ReleaseLease" and hand.daemon.open == 0


def test_a_request_with_an_objection_does_not_begin_or_is_cancelled(hand: Hand) -> None:
    objections: list[CallError | None] = [None, refusal("LEASE_MISSING", "lapsed")]
    request = hand.request()
    request.objection = lambda: objections.pop(0)
    hand.motions.take(request)
    assert hand.codes() == ["LEASE_MISSING"] and methods(hand)[-1] == "Cancel"
    request = hand.request()
    request.objection = lambda: refusal("LEASE_MISSING", "lapsed")
    hand.motions.take(request)
    assert len(hand.daemon.named("SubmitTrajectory")) == 1


def test_a_path_that_the_gate_drops_as_at_a_stop_voids_what_waits_behind_it(hand: Hand) -> None:
    first = hand.request()
    second = hand.request()
    hand.daemon.refuse["SubmitTrajectory"] = DROPPED
    hand.motions.take(first)
    del hand.daemon.refuse["SubmitTrajectory"]
    hand.motions.take(second)
    assert hand.phases == ["refused", "refused"] and len(hand.daemon.named("SubmitTrajectory")) == 1


LEASE_TAKEN = {"topic": "events", "event": {"code": "LEASE_LOST", "message": "lease taken"}}


@pytest.mark.parametrize(
    "stop",
    [
        ended("m1", "cancelled"),
        ended("of_another", "aborted"),
        ended("", "aborted"),
        ended("of_another", "a phase of later versions"),
        LEASE_TAKEN,
    ],
)
def test_a_stop_by_another_client_voids_what_arrived_before_it(hand: Hand, stop: Answer) -> None:
    hand.take()
    waiting = hand.request()
    hand.motions.on_monitor_reply(stop | {"time": hand.time})
    hand.motions.take(waiting)
    assert hand.codes() == ["BUSY"]
    hand.time += 0.1
    hand.take()
    assert hand.phases[-1] == "accepted"


@pytest.mark.parametrize("phase", ["replaced", "succeeded"])
def test_a_foreign_motion_that_is_replaced_or_succeeds_voids_nothing(hand: Hand, phase: str) -> None:
    waiting = hand.request()
    hand.motions.on_monitor_reply(ended("x1", phase, time=hand.time))
    hand.motions.take(waiting)
    assert hand.phases == ["accepted"]


def test_a_motion_accepted_between_a_stop_and_its_event_is_cancelled_once(hand: Hand) -> None:
    waiting = hand.request()
    hand.take()
    stopped = hand.time
    hand.time += 0.1
    hand.motions.take(waiting)
    hand.motions.on_monitor_reply(ended("m1", "cancelled", time=stopped))
    hand.after(1.0)
    assert len(hand.daemon.named("Cancel")) == 1
    after = hand.request()
    hand.motions.on_monitor_reply(ended("m2", "cancelled", time=hand.time))
    hand.motions.take(after)
    assert hand.phases[-1] == "accepted", "a cancel of its own is no stop"


def test_a_request_for_one_mode_does_not_begin_in_another(hand: Hand) -> None:
    waiting = hand.request()
    hand.motions.on_monitor_reply(moving("holding", "sim", hand.time))
    hand.time += 0.1
    hand.motions.on_monitor_reply(moving("holding", "live", hand.time))
    hand.motions.take(waiting)
    hand.take()
    assert hand.phases == ["refused", "accepted"]


def test_a_withdrawn_request_does_not_begin_and_one_that_runs_is_cancelled_at_once(hand: Hand) -> None:
    waiting = hand.request()
    hand.motions.withdraw(waiting)
    hand.motions.take(waiting)
    assert hand.phases == ["cancelled"] and not hand.daemon.calls
    running = hand.take()
    open_then = list[int]()
    hand.during_submit(lambda: (hand.motions.withdraw(running), open_then.append(hand.daemon.open)))
    hand.take()
    assert methods(hand)[-1] == "Cancel" and hand.daemon.open == 1
    hand.daemon.refuse["Cancel"] = ("Busy", {"what": "the loop"})
    hand.motions.withdraw(running)
    hand.after(0.1)
    assert hand.daemon.open == 0, "a cancel that fails ends the lease"


def test_a_motion_that_has_ended_is_not_cancelled_in_place_of_another(hand: Hand) -> None:
    first = hand.take()
    hand.take()
    hand.motions.on_monitor_reply(ended("m1", "replaced"))
    hand.after(0.1)
    hand.motions.withdraw(first)
    hand.after(0.3)
    assert not hand.daemon.named("Cancel")


def test_a_released_lease_voids_nothing_that_waits(hand: Hand) -> None:
    hand.take()
    waiting = hand.request()
    hand.motions.release()
    hand.motions.on_monitor_reply(ended("m1", "aborted", time=hand.time))
    hand.motions.take(waiting)
    assert hand.phases[-1] == "accepted"


def test_a_lease_taken_by_another_client_is_given_up_and_a_loss_before_it_was_ours_is_none(
    hand: Hand,
) -> None:
    hand.motions.on_monitor_reply(LEASE_TAKEN | {"time": hand.time})
    hand.time += 0.1
    hand.motions.hold()
    hand.motions.on_monitor_reply(LEASE_TAKEN | {"time": hand.time - 0.05})
    hand.after(0.1)
    assert hand.motions.held
    hand.motions.on_monitor_reply(LEASE_TAKEN | {"time": hand.time})
    assert not hand.motions.held
    hand.after(0.1)
    assert hand.daemon.open == 0


def test_a_motion_without_an_end_event_is_lost_once_the_robot_stays_at_rest(hand: Hand) -> None:
    hand.take()
    hand.motions.on_monitor_reply(moving("holding"))  # as it was when it was accepted
    assert hand.after(0.5) == []
    hand.motions.on_monitor_reply(moving("active"))
    assert hand.after(5.0) == []
    hand.motions.on_monitor_reply(moving("holding"))  # a status overtakes the end that goes with it
    assert hand.after(0.1) == []
    hand.motions.on_monitor_reply(ended("m1", "succeeded"))
    assert hand.after(0.2) == ["succeeded"]
    hand.take(start_in=5.0)
    for _ in range(4):
        hand.motions.on_monitor_reply(moving("holding"))
        assert hand.after(1.0) == [], "before its start"
    for _ in range(4):
        hand.motions.on_monitor_reply(moving("holding"))
        hand.after(LATE)
    assert hand.reports[-1] == (LOST, {"id": "m2", "findings": UNREPORTED})


def test_motions_are_lost_with_their_connection_unless_their_ends_arrive_soon(hand: Hand) -> None:
    hand.take()
    hand.take()
    hand.daemon.lines[0].close()  # as after a restart of the daemon
    hand.after(0.2)
    hand.motions.on_monitor_reply(ended("m1", "aborted", {"code": "LEASE_LOST", "message": "gone"}))
    assert hand.after(LATE + 0.2) == ["aborted", LOST]
    assert hand.reports[-1][1]["findings"] is BROKEN
    assert hand.motions.moving == ()


def test_a_lease_found_lost_is_acquired_again_by_the_next_request_alone(hand: Hand) -> None:
    hand.take()
    missing: Any = ("Refused", {"findings": [{"code": "LEASE_MISSING", "message": "no"}]})
    hand.daemon.refuse["SubmitTrajectory"] = missing
    hand.take()
    hand.after(1.0)
    assert not hand.motions.held and len(hand.daemon.named("AcquireLease")) == 1
    del hand.daemon.refuse["SubmitTrajectory"]
    hand.take()
    assert hand.phases[-1] == "accepted" and len(hand.daemon.named("AcquireLease")) == 2


@pytest.mark.parametrize("text", ["", "m1 aborted", "m2 succeeded"])
def test_a_motion_end_counts_by_its_fields_whatever_its_text(hand: Hand, text: str) -> None:
    hand.take()
    hand.take()
    end = ended("m1", "succeeded")
    end["event"]["message"] = text
    hand.motions.on_monitor_reply(end)
    assert hand.after(0.1) == ["succeeded"] and hand.motions.moving == ("m2",)


def test_an_end_without_fields_ends_every_motion_and_the_lease(hand: Hand) -> None:
    hand.motions.hold()
    hand.take()
    waiting = hand.request()
    hand.motions.on_monitor_reply(ended_in_words("of_another", "succeeded", time=hand.time))
    hand.motions.take(waiting)
    assert hand.after(0.1) == [LOST]
    assert hand.reports[-1] == (LOST, {"id": "m1", "findings": UNREADABLE})
    assert hand.motions.moving == () and not hand.motions.held and hand.daemon.open == 0
    hand.take()
    assert hand.after(1.0) == [] and hand.motions.moving == ("m2",)


def test_an_unknown_phase_ends_its_own_motion_as_lost_and_no_other(hand: Hand) -> None:
    hand.take()
    hand.take()
    hand.motions.on_monitor_reply(ended("m1", "vanished"))
    assert hand.after(0.3) == [LOST] and hand.motions.moving == ("m2",)


def test_closed_motions_are_reported_as_cancelled(hand: Hand) -> None:
    hand.take()
    hand.motions.close()
    assert hand.phases == ["accepted", "cancelled"] and hand.daemon.open == 0
