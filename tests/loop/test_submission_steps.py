"""Trajectories on their way through the gate, each step alone: verdict, slices, what may change meanwhile."""

from dataclasses import asdict
from math import inf
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import path
from tests.support.procedure_rig import PLACE, WHY
from tests.support.submission_rig import (
    CLIENT,
    DRIFT_FOR,
    FOLLOW,
    OTHER,
    RECEIVED,
    SubmissionRig,
    codes,
    hold_path,
    to,
)
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion
from twind.robot.trajectory import Trajectory
from twind.safety.lease import Lease

SHAPE = Finding(ReasonCode.SELF_COLLISION, 1, message="ordered by the test")
STALE = 0.5  # s
SLICED = 600  # points: three ticks
PRESENT = """LEASE_MISSING ESTOP_LATCHED FAULT_LATCHED SOCKETS_GONE NOT_ARMED JOINT_LIMP CALIB_MISSING
CALIB_MISMATCH DEVICE_MISSING DEVICE_MISMATCH HW_DISCONNECTED LATENCY_BLOCK THERMAL_HEADROOM VOLTAGE_LOW
BUSY"""


@pytest.fixture
def rig() -> SubmissionRig:
    return SubmissionRig()


# ------------------------------------------------------------------------------------------- the verdict


def test_an_accepted_trajectory_is_replied_published_traced_and_begun(rig: SubmissionRig) -> None:
    now = rig.clock.now()
    before = rig.executor.reference
    ticket = rig.submit(warned=[SHAPE])
    reply = rig.only(ticket)
    verdict = {"refusals": [], "warnings": [asdict(SHAPE)], "changes": []}
    wanted = {"id": "t1", "phase": "accepted", "progress": 0.0, "verdict": verdict}
    assert (reply.error, reply.continues, reply.parameters) == (None, False, wanted)
    [report] = rig.verdicts()
    assert (report.id, report.time, report.lead, report.verdict) == ("t1", now, 0.0, verdict)
    assert rig.logged() == [] and rig.reports.urgent and not rig.robot.untouched
    assert rig.submissions.epoch == rig.lease.epoch
    assert rig.executor.motion is Motion.ACTIVE
    assert rig.traced("take") == [[RECEIVED, now, inf]]
    assert rig.traced("judge") == [["taken", now]]
    [[taken, id, joints, reference, at]] = rig.traced("accept")
    assert (taken, id, joints.tolist(), at) == ("taken", "t1", [True] * 3, now)
    assert reference is before


def test_a_refused_trajectory_is_replied_published_and_logged_with_each_code_once(rig: SubmissionRig) -> None:
    far = [Finding(ReasonCode.UNSTABLE_POSE, message=f"{place}") for place in range(9)]
    ticket = rig.submit(to(rig, 1.7, seconds=20.0), refused=[SHAPE, *far])
    reply = rig.only(ticket)
    wrong = ["POS_LIMIT", "POS_LIMIT", "BRAKE_DISTANCE", "BRAKE_DISTANCE"]
    assert codes(reply) == [*wrong, "SELF_COLLISION", *["UNSTABLE_POSE"] * 9]
    [report] = rig.verdicts()
    assert (report.id, report.time, report.lead) == ("t1", rig.clock.now(), 0.0)
    assert report.verdict["refusals"] == [asdict(each) for each in reply.parameters["findings"]]
    [event] = rig.logged()
    text = "refused t1: POS_LIMIT, BRAKE_DISTANCE, SELF_COLLISION, UNSTABLE_POSE"
    assert (event.level, event.code, event.message, event.id) == ("warning", "POS_LIMIT", text, "t1")
    assert event.findings == reply.parameters["findings"][:8]
    assert rig.traced("judge") == [["taken", rig.clock.now()]] and rig.traced("accept") == []
    assert rig.executor.motion is Motion.HOLDING and rig.robot.untouched


def test_a_check_replies_the_verdict_alone(rig: SubmissionRig) -> None:
    reply = rig.only(rig.submit(check_only=True, warned=[SHAPE]))
    assert reply.parameters == {"verdict": {"refusals": [], "warnings": [asdict(SHAPE)], "changes": []}}
    reply = rig.only(rig.submit(check_only=True, data=b""))
    assert codes(reply) == ["BAD_SHAPE"]
    assert rig.book.events == [] and rig.way.notes == []
    assert rig.executor.motion is Motion.HOLDING and rig.robot.untouched


def test_a_check_warns_of_what_concerns_the_client_or_the_present_state(rig: SubmissionRig) -> None:
    rig.seen = {"holding": (WHY,)}
    reply = rig.only(rig.submit(check_only=True, client=OTHER, refused=[SHAPE], warned=[SHAPE]))
    verdict = reply.parameters["verdict"]
    assert verdict["refusals"] == [asdict(SHAPE)]
    assert verdict["warnings"][0] == asdict(SHAPE)
    assert [each["code"] for each in verdict["warnings"]] == ["SELF_COLLISION", "LEASE_MISSING", "FOLLOW_ERR"]


@pytest.mark.parametrize("code", PRESENT.split())
def test_a_finding_that_does_not_concern_the_path_is_a_warning_of_its_check(
    rig: SubmissionRig, code: str
) -> None:
    found = Finding(ReasonCode(code), message="ordered by the test")
    reply = rig.only(rig.submit(check_only=True, refused=[found]))
    assert reply.parameters["verdict"] == {"refusals": [], "warnings": [asdict(found)], "changes": []}


def test_a_path_that_does_not_fit_its_message_is_refused(rig: SubmissionRig) -> None:
    reply = rig.only(rig.submit(points=2))
    assert codes(reply) == ["BAD_SHAPE"]
    assert reply.parameters["findings"][0].message == "trajectory of 2 points x 3 joints: got 4 numbers"


def test_a_path_of_older_limits_is_refused(rig: SubmissionRig) -> None:
    rig.gate_input.judged_since = 3
    assert codes(rig.only(rig.submit(generation=2))) == ["CMD_EXPIRED"]
    assert rig.only(rig.submit(generation=3)).error is None


def test_the_options_of_the_request_reach_the_gate(rig: SubmissionRig) -> None:
    fast = to(rig, 0.5, seconds=0.1)
    assert "VEL_LIMIT" in codes(rig.only(rig.submit(fast)))
    reply = rig.only(rig.submit(fast, policy="retime"))
    assert [each["code"] for each in reply.parameters["verdict"]["changes"]] == ["RETIMED"]
    rig.executor.begin(PLACE)
    moving = path([1.0], [PLACE + 0.1], [np.full(3, 0.2)])
    assert codes(rig.only(rig.submit(moving, velocity=True))) == ["END_NOT_AT_REST"] * 3
    assert rig.only(rig.submit(moving, velocity=True, append_stop=True)).error is None


def test_before_the_first_motion_no_lease_counts_as_its_own(rig: SubmissionRig) -> None:
    assert rig.submissions.epoch < Lease().epoch


# ------------------------------------------------------------------------------------------- one at a time


def test_while_one_is_judged_another_is_refused(rig: SubmissionRig) -> None:
    first = rig.submit(hold_path(rig, SLICED))
    assert rig.gate_input.busy and rig.replies(first) == []
    for check_only in (False, True):
        reply = rig.only(rig.submit(check_only=check_only))
        assert codes(reply) == ["BUSY"]
        assert reply.parameters["findings"][0].message == (
            "another trajectory is being judged: try again, or cancel"
        )
    rig.ticks(3)
    assert rig.only(first).error is None and not rig.gate_input.busy


def test_one_that_waits_for_its_start_bars_another_later_one_but_no_check_and_no_present_one(
    rig: SubmissionRig,
) -> None:
    assert rig.only(rig.submit(start_in=1.0)).error is None
    reply = rig.only(rig.submit(start_in=0.5))
    assert codes(reply) == ["BUSY"]
    assert reply.parameters["findings"][0].message == (
        "one already waits for its start: try again, or cancel"
    )
    assert rig.only(rig.submit(start_in=0.5, check_only=True)).error is None
    assert rig.only(rig.submit()).error is None
    assert rig.executor.waiting == 1


def test_a_gate_that_fails_inside_bars_no_later_trajectory(
    rig: SubmissionRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twind.safety.gate.checking", lambda *_: _broken())
    with pytest.raises(ZeroDivisionError):
        rig.submit()
    assert not rig.gate_input.busy


def _broken() -> Any:
    yield 1 / 0


# ------------------------------------------------------------------------------------------- in slices


def test_a_path_of_250_points_is_judged_at_once_and_one_of_more_in_slices(rig: SubmissionRig) -> None:
    assert rig.only(rig.submit(hold_path(rig, 250))).error is None
    rig.executor.begin(PLACE)
    assert rig.replies(rig.submit(hold_path(rig, 251))) == []


def test_a_long_path_is_judged_over_several_ticks_and_begins_then(rig: SubmissionRig) -> None:
    ticket = rig.submit(hold_path(rig, SLICED))
    rig.ticks(1)
    assert rig.replies(ticket) == []
    rig.ticks(1)
    assert rig.only(ticket).error is None
    assert rig.verdicts()[0].time == rig.clock.now()
    assert rig.traced("judge") == [["taken", rig.clock.now()]]


def test_the_lease_is_judged_again_at_the_end(rig: SubmissionRig) -> None:
    ticket = rig.submit(hold_path(rig, SLICED))
    rig.lease.release(CLIENT)
    rig.ticks(3)
    assert codes(rig.only(ticket)) == ["LEASE_MISSING"]


def test_what_is_wrong_with_the_path_is_not_judged_again(rig: SubmissionRig) -> None:
    ticket = rig.submit(hold_path(rig, SLICED), refused=[SHAPE])
    rig.lease.release(CLIENT)
    rig.submissions.stop(CLIENT, rig.clock.now())
    rig.ticks(3)
    assert codes(rig.only(ticket)) == ["SELF_COLLISION"]


def test_a_long_path_begins_from_a_hold_alone(rig: SubmissionRig) -> None:
    ticket = rig.submit(hold_path(rig, SLICED))
    rig.executor.begin(PLACE + 0.001)
    rig.ticks(3)
    assert codes(rig.only(ticket)) == ["BUSY"]
    assert rig.only(ticket).parameters["findings"][0].message.startswith("the robot moved while")
    rig.executor.begin(PLACE)
    ticket = rig.submit(hold_path(rig, SLICED))
    rig.executor.idle()
    rig.ticks(3)
    assert codes(rig.only(ticket)) == ["BUSY"]


def test_a_limp_joint_may_move_while_a_long_path_is_judged(rig: SubmissionRig) -> None:
    rig.torque.leave_limp(np.array([True, False, False]))
    whole = hold_path(rig, SLICED)
    part = Trajectory(whole.time, whole.position, np.array([False, True, True]))
    ticket = rig.submit(part)
    rig.executor.begin(PLACE + np.array([0.5, 0.0, 0.0]))
    rig.ticks(3)
    assert rig.only(ticket).error is None


def test_a_stop_ends_the_motion_and_bars_what_is_still_judged(rig: SubmissionRig) -> None:
    rig.submit()
    rig.ticks(2)
    rig.submissions.stop(OTHER, rig.clock.now())
    [outcome] = rig.executor.outcomes()
    assert outcome.phase == "cancelled"
    rig.executor.begin(PLACE)
    ticket = rig.submit(hold_path(rig, SLICED))
    rig.ticks(1)
    rig.submissions.stop(OTHER, rig.clock.now())
    rig.ticks(2)
    assert codes(rig.only(ticket)) == ["BUSY"]
    assert rig.only(ticket).parameters["findings"][0].message == (
        "the robot was stopped while this was judged: send it again"
    )
    ticket = rig.submit(hold_path(rig, SLICED))
    rig.ticks(3)
    assert rig.only(ticket).error is None


# ------------------------------------------------------------------------------------------- a later start


def test_a_later_start_is_judged_from_where_the_robot_will_be(rig: SubmissionRig) -> None:
    assert rig.only(rig.submit()).error is None
    rig.ticks(1)
    later = path([0.0, 0.5], [PLACE + 0.1, PLACE + 0.2])
    reply = rig.only(rig.submit(later, start_in=1.2))
    assert reply.error is None
    assert rig.verdicts()[-1].lead == 0.0
    assert rig.traced("judge")[-1] == ["taken", rig.clock.now()]
    assert len(rig.traced("accept")) == 1, "a delay is no latency"
    assert codes(rig.only(rig.submit(later))) == ["START_JUMP"] * 3


@pytest.mark.parametrize("start_in", [0.6, 60.0])
def test_a_start_of_up_to_a_minute_from_now_is_judged_from_there(rig: SubmissionRig, start_in: float) -> None:
    assert rig.only(rig.submit(to(rig, 0.1, seconds=0.5))).error is None
    rig.ticks(1)
    later = path([0.0, 0.5], [PLACE + 0.1, PLACE + 0.2])
    assert rig.only(rig.submit(later, start_in=start_in)).error is None


@pytest.mark.parametrize("start_in", [60.1, inf])
def test_a_later_start_is_refused(rig: SubmissionRig, start_in: float) -> None:
    assert codes(rig.only(rig.submit(start_in=start_in))) == ["TOO_DISTANT"]


def test_without_a_reference_a_later_start_is_judged_from_the_present(rig: SubmissionRig) -> None:
    rig.executor.idle()
    rig.condition.mode = Mode.MIRROR
    way = path([1.0], [np.zeros(3)])
    assert codes(rig.only(rig.submit(way, start_in=0.5))) == ["NOT_ARMED"]
    assert codes(rig.only(rig.submit(way))) == ["NOT_ARMED"]
    assert rig.traced("accept") == [] and rig.robot.untouched


def test_the_lead_in_to_a_first_point_at_once_is_published(rig: SubmissionRig) -> None:
    way = path([0.0, 0.5], [PLACE + 0.02, PLACE + 0.1])
    assert rig.only(rig.submit(way)).error is None
    assert rig.verdicts()[-1].lead == pytest.approx(0.13, abs=0.05)
    rig.executor.begin(PLACE)
    assert rig.only(rig.submit(way, start_in=0.5)).error is None
    assert rig.verdicts()[-1].lead == rig.verdicts()[0].lead


# ------------------------------------------------------------------------------------------- begun


@pytest.mark.parametrize(("age", "code"), [(STALE, None), (STALE + 0.001, "CMD_EXPIRED")])
def test_the_verdict_of_the_front_holds_for_half_a_second(
    rig: SubmissionRig, age: float, code: str | None
) -> None:
    rig.clock.time = 128.0
    assert rig.lease.acquire(CLIENT, "ann", 5, 128.0)
    reply = rig.only(rig.submit(front_checked=128.0 - age, warned=[SHAPE]))
    if code is None:
        assert reply.error is None
        return
    [found] = reply.parameters["findings"]
    assert (found.code, found.bound) == (code, STALE) and found.value == pytest.approx(age)
    assert rig.verdicts()[-1].verdict["warnings"] == [asdict(SHAPE)]
    assert rig.executor.motion is Motion.HOLDING


def test_an_accepted_trajectory_renews_the_lease_of_its_client(rig: SubmissionRig) -> None:
    rig.ticks(50)
    rig.submit()
    held = rig.lease.info(rig.clock.now())
    assert held is not None and held.expires_in == pytest.approx(1.0)


def ending(rig: SubmissionRig, monkeypatch: pytest.MonkeyPatch, **how: Any) -> tuple[Any, Any]:
    """Tolerances and time of the end that the executor gets."""
    seen: list[Any] = []
    submit = rig.executor.submit

    def noted(*given: Any, **named: Any) -> Any:
        seen.append((named["tolerances"], named["goal_time"]))
        assert named["start_in"] == 0.0 and given[0].startswith("t")
        return submit(*given, **named)

    with monkeypatch.context() as patch:
        patch.setattr(rig.executor, "submit", noted)
        assert rig.only(rig.submit(**how)).error is None
    return seen[0]  # type: ignore[no-any-return]


def test_in_live_a_goal_has_the_tolerances_of_its_client_alone(
    rig: SubmissionRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ending(rig, monkeypatch) == (None, None)
    rig.executor.begin(PLACE)
    tolerances, goal_time = ending(rig, monkeypatch, tolerances=[(1, 0.2, 0.1)], goal_time=3.0)
    assert tolerances.path.tolist() == [inf, 0.2, inf] and tolerances.goal.tolist() == [inf, 0.1, inf]
    assert goal_time == 3.0


@pytest.mark.parametrize(
    ("entries", "asked", "arrival", "goal_time"),
    [
        ((), None, FOLLOW, DRIFT_FOR),
        ((), 3.0, FOLLOW, 3.0),
        ([(1, 0.2, None)], None, FOLLOW, DRIFT_FOR),
        ([(1, None, 0.0)], None, FOLLOW, DRIFT_FOR),
        ([(1, None, -1.0)], None, inf, DRIFT_FOR),
        ([(1, None, 0.1)], None, 0.1, None),
        ([(0, None, None), (1, None, 0.1)], 3.0, 0.1, 3.0),
        ([(1, None, 0.5)], 0.0, 0.5, 0.0),
    ],
)
def test_a_simulated_goal_is_met_as_near_as_a_real_one_must_be(
    rig: SubmissionRig,
    monkeypatch: pytest.MonkeyPatch,
    entries: Any,
    asked: float | None,
    arrival: float,
    goal_time: float | None,
) -> None:
    rig.condition.mode = Mode.MIRROR
    tolerances, found = ending(rig, monkeypatch, tolerances=entries, goal_time=asked)
    assert (tolerances.goal.tolist(), found) == ([FOLLOW, arrival, FOLLOW], goal_time)


def test_a_trajectory_without_a_client_is_refused_for_its_lease(rig: SubmissionRig) -> None:
    assert codes(rig.only(rig.submit(client=0))) == ["LEASE_MISSING"]
