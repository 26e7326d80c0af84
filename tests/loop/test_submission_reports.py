"""Trajectories that are followed, and setpoints, each step alone: progress, ends, latencies."""

from dataclasses import asdict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import condition, path
from tests.support.procedure_rig import PERIOD, PLACE, WHY
from tests.support.submission_rig import CLIENT, OTHER, RECEIVED, SubmissionRig, codes, to
from twind import link
from twind.loop.procedures.trajectory_submissions import own_time
from twind.motion.time_scaling import Stretch
from twind.motion.trajectory_executor import GoalOutcome
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion

COLLISION = Finding(ReasonCode.SELF_COLLISION, 1, message="ordered by the test")
CONTACT = SimpleNamespace(bodies=("hand", "hip"), depth=0.002)


@pytest.fixture
def rig() -> SubmissionRig:
    return SubmissionRig()


def phases(rig: SubmissionRig, ticket: int) -> list[str]:
    return [reply.parameters["phase"] for reply in rig.replies(ticket)]


# ------------------------------------------------------------------------------------------- followed


def test_a_followed_trajectory_reports_its_progress_ten_times_a_second_to_its_end(rig: SubmissionRig) -> None:
    ticket = rig.submit(more=True)
    other = rig.submit(check_only=True)
    rig.ticks(110)
    replies = rig.replies(ticket)
    assert phases(rig, ticket) == ["accepted", *["running"] * 10, "succeeded"]
    assert [reply.continues for reply in replies] == [True] * 11 + [False]
    running = [reply.parameters for reply in replies[1:-1]]
    own = {"duration": 1.0, "stretch": 0.0, "stretched_by": []}
    assert running[2] == {"id": "t1", "phase": "running", "progress": pytest.approx(0.21)} | own
    end = {"id": "t1", "phase": "succeeded", "progress": 1.0, "findings": []} | own
    assert replies[-1].parameters == end
    [event] = rig.logged()
    assert (event.level, event.code, event.message) == ("info", "MOTION", "t1 succeeded")
    assert (event.id, event.phase, event.findings) == ("t1", "succeeded", [])
    assert rig.traced("end") == [] and len(rig.replies(other)) == 1


def test_a_trajectory_without_a_follower_ends_with_an_event_alone(rig: SubmissionRig) -> None:
    ticket = rig.submit()
    rig.reports.urgent = False
    rig.ticks(110)
    assert phases(rig, ticket) == ["accepted"]
    assert rig.logged()[0].phase == "succeeded" and rig.reports.urgent


def test_a_followed_trajectory_keeps_the_lease_and_begins_a_last_term_at_its_end(rig: SubmissionRig) -> None:
    rig.submit(to(rig, 0.1, seconds=3.0), more=True)
    rig.ticks(250)
    assert rig.lease.held_by(CLIENT, rig.clock.now())
    while rig.executor.motion is Motion.ACTIVE:
        rig.tick()
        assert rig.lease.holds(rig.clock.now())
    now = rig.clock.now()
    assert rig.lease.holds(now + 0.99) and not rig.lease.holds(now + 1.01)


def test_without_more_a_trajectory_keeps_no_lease(rig: SubmissionRig) -> None:
    rig.submit(to(rig, 0.1, seconds=3.0))
    assert not rig.lease.holds(rig.clock.now() + 1.01)


@pytest.mark.parametrize("how", ["one connection", "all"])
def test_a_connection_that_is_gone_gets_no_reports(rig: SubmissionRig, how: str) -> None:
    mine = rig.submit(more=True)
    rig.submissions.drop_client(OTHER)
    rig.ticks(15)
    assert phases(rig, mine) == ["accepted", "running", "running"]
    if how == "all":
        rig.submissions.forget()
    else:
        rig.submissions.drop_client(CLIENT)
        assert not rig.lease.holds(rig.clock.now() + 1.2)
    rig.ticks(100)
    assert len(phases(rig, mine)) == 3
    assert [event.phase for event in rig.logged()] == ["succeeded"]


@pytest.mark.parametrize(
    ("phase", "level", "traced"),
    [
        ("succeeded", "info", False),
        ("replaced", "info", True),
        ("cancelled", "info", True),
        ("aborted", "warning", True),
    ],
)
def test_the_end_of_a_goal_is_reported_by_its_phase(
    rig: SubmissionRig, phase: str, level: str, traced: bool
) -> None:
    ended = [GoalOutcome("t8", phase, (COLLISION,), 0.25, Stretch(2.0, 0.5, (ReasonCode.OVERTEMP,)))]
    rig.executor = SimpleNamespace(outcomes=lambda: ended, progress=lambda: None)
    rig.submissions.report(rig.clock.now())
    [event] = rig.logged()
    assert (event.level, event.message, event.findings) == (level, f"t8 {phase}", [COLLISION])
    assert rig.traced("end") == [["t8"]] * traced


def test_the_end_of_a_followed_goal_has_its_findings_and_its_own_time(rig: SubmissionRig) -> None:
    ticket = rig.submit(more=True)
    ended = [GoalOutcome("t1", "aborted", (WHY,), 0.25, Stretch(2.0, 0.5, (ReasonCode.OVERTEMP,)))]
    rig.executor = SimpleNamespace(outcomes=lambda: ended, progress=lambda: None)
    rig.submissions.report(rig.clock.now())
    assert rig.replies(ticket)[-1].parameters == {
        "id": "t1",
        "phase": "aborted",
        "progress": 0.25,
        "findings": [asdict(WHY)],
        "duration": 2.0,
        "stretch": 0.5,
        "stretched_by": ["OVERTEMP"],
    }
    rig.submissions.report(rig.clock.now())
    assert len(rig.replies(ticket)) == 2


def test_an_end_of_the_simulation_names_the_contact_that_blocks_its_joint(rig: SubmissionRig) -> None:
    rig.contact = CONTACT
    rig.condition.mode = Mode.MIRROR
    found = Finding(ReasonCode.GOAL_TOLERANCE, 1)
    ended = [GoalOutcome("t8", "aborted", (found,))]
    rig.executor = SimpleNamespace(outcomes=lambda: ended, progress=lambda: None)
    rig.submissions.report(rig.clock.now())
    assert rig.logged()[0].findings[0].message.startswith("hand and hip touch in the simulation")


def test_a_motion_without_a_duration_of_its_own_has_none() -> None:
    assert own_time(None) == {}


def test_progress_is_for_the_follower_of_the_goal_that_runs(rig: SubmissionRig) -> None:
    first = rig.submit(more=True)
    rig.ticks(5)
    second = rig.submit(path([0.5], [PLACE + 0.1]), more=True, start_in=1.2)
    rig.ticks(60)
    assert phases(rig, second) == ["accepted"] and phases(rig, first).count("running") == 7
    rig.ticks(130)
    assert phases(rig, second)[-1] == "succeeded"


def test_progress_is_due_a_tenth_of_a_second_after_the_last(rig: SubmissionRig) -> None:
    ticket = rig.submit(more=True)
    rig.executor = SimpleNamespace(outcomes=list, progress=lambda: ("t1", 0.5), stretch=None)
    for now, reports in ((0.0, 1), (0.099, 1), (0.1, 2)):
        rig.submissions.report(now)
        assert phases(rig, ticket) == ["accepted", *["running"] * reports]


# ------------------------------------------------------------------------------------------- setpoints


def test_an_accepted_setpoint_is_followed_answered_with_its_tick_and_traced(rig: SubmissionRig) -> None:
    now = rig.clock.now()
    before = rig.executor.reference
    reply = rig.setpoint(PLACE[1] + 0.01)
    assert (reply.error, reply.parameters) == (None, {"sequence": 42, "changes": []})
    assert rig.executor.motion is Motion.STREAMING and not rig.robot.untouched
    assert rig.submissions.epoch == rig.lease.epoch and rig.book.events == []
    assert rig.traced("take") == [[RECEIVED, now]] and rig.traced("judge") == [["taken", now]]
    [[taken, id, joints, reference, at]] = rig.traced("accept")
    assert (taken, id, joints.tolist(), at) == ("taken", "", [False, True, False], now)
    assert reference is before
    held = rig.lease.info(now)
    assert held is not None and held.expires_in == pytest.approx(0.25)


def test_a_refused_setpoint_is_published_and_moves_nothing(rig: SubmissionRig) -> None:
    reply = rig.setpoint(2.5)
    assert codes(reply) == ["POS_LIMIT"]
    [report] = rig.verdicts()
    assert (report.id, report.time, report.lead) == ("", rig.clock.now(), 0.0)
    assert [each["code"] for each in report.verdict["refusals"]] == ["POS_LIMIT"]
    assert rig.traced("judge") and rig.traced("accept") == [] and rig.robot.untouched
    assert rig.executor.motion is Motion.HOLDING
    held = rig.lease.info(rig.clock.now())
    assert held is not None and held.expires_in == pytest.approx(1.0)


def test_a_setpoint_is_refused_for_all_that_is_wrong(rig: SubmissionRig) -> None:
    assert rig.setpoint(PLACE[1]).error is None
    rig.submissions.stop(CLIENT + 1, rig.clock.now())
    rig.torque.leave_limp(np.array([False, True, False]))
    rig.lease.release(CLIENT)
    assert codes(rig.setpoint(2.5)) == ["LEASE_MISSING", "JOINT_LIMP", "STREAM_STOPPED", "POS_LIMIT"]
    rig.lease.acquire(CLIENT, "ann", 5, rig.clock.now())
    rig.clock.sleep_until(rig.clock.now() + 0.6)
    rig.lease.acquire(CLIENT, "ann", 5, rig.clock.now())
    assert rig.setpoint(PLACE[0], joints=(0,)).error is None, "only the joints that it names count"


def test_a_stop_of_its_own_client_bars_no_stream(rig: SubmissionRig) -> None:
    assert rig.setpoint(PLACE[1]).error is None
    rig.submissions.stop(CLIENT, rig.clock.now())
    assert rig.setpoint(PLACE[1]).error is None


def test_a_joint_that_gets_hot_ends_no_stream_and_begins_none(rig: SubmissionRig) -> None:
    hot = {"condition": condition(3, temperature=np.full(3, 69.0))}
    rig.seen = hot
    assert codes(rig.setpoint(PLACE[1])) == ["THERMAL_HEADROOM"]
    rig.seen = {}
    assert rig.setpoint(PLACE[1]).error is None
    rig.seen = hot
    assert rig.setpoint(PLACE[1]).error is None


def test_velocities_clamping_and_validity_reach_gate_and_executor(rig: SubmissionRig) -> None:
    reply = rig.setpoint(2.5, velocities=[9.0], allow_clamp=True)
    [change] = [each for each in reply.parameters["changes"] if each["code"] == "POS_LIMIT"]
    assert (change["value"], change["bound"]) == (2.5, 2.0)
    assert [each["code"] for each in reply.parameters["changes"]] == ["POS_LIMIT", "VEL_LIMIT"]
    now = rig.clock.now()
    assert codes(rig.setpoint(PLACE[1], valid_until=now - 0.001)) == ["CMD_EXPIRED"]
    assert rig.setpoint(PLACE[1], valid_for=0.1, valid_until=now + 0.03).error is None
    rig.ticks(3)
    assert rig.executor.motion is Motion.STREAMING
    rig.ticks(3)
    assert rig.executor.motion is not Motion.STREAMING


def test_a_setpoint_that_would_lead_to_a_collision_is_refused(rig: SubmissionRig) -> None:
    seen: list[Any] = []

    def refuses(executor: Any, joints: Any, position: Any, velocity: Any) -> tuple[Finding, ...]:
        seen.append((executor, joints.tolist(), position.tolist(), velocity))
        return (COLLISION,) if len(seen) == 1 else ()

    rig.robot.outlook = SimpleNamespace(refuses=refuses)  # type: ignore[assignment]
    assert codes(rig.setpoint(0.6)) == ["SELF_COLLISION"]
    assert rig.executor.motion is Motion.HOLDING
    assert rig.setpoint(0.6).error is None
    assert seen[0] == (rig.executor, [1], [0.6], None)
    assert codes(rig.setpoint(2.5)) == ["POS_LIMIT"] and len(seen) == 2


def test_a_setpoint_that_the_executor_refuses_starts_no_stream(rig: SubmissionRig) -> None:
    rig.condition.mode = Mode.MIRROR
    rig.executor.idle()
    assert codes(rig.setpoint(0.5)) == ["NOT_ARMED"]
    rig.submissions.stop(OTHER, rig.clock.now())
    rig.executor.begin(PLACE)
    assert rig.setpoint(0.5).error is None, "a stream that never began was not stopped"


def test_the_reply_says_how_far_behind_a_joint_of_the_stream_is(rig: SubmissionRig) -> None:
    late = Finding(ReasonCode.VEL_LIMIT, 2, value=0.3, bound=0.1, message="ordered by the test")
    assert rig.setpoint(PLACE[1], PLACE[2], joints=(1, 2)).error is None
    assert rig.executor.stream is not None
    rig.executor.stream.behind = lambda: (np.array([0.1, 0.2, 0.3]), (late,))
    reply = rig.setpoint(PLACE[2], PLACE[1], joints=(2, 1))
    assert reply.parameters == {"sequence": 42, "changes": [asdict(late)], "behind": [0.3, 0.2]}
    rig.executor.stream.behind = lambda: (np.array([0.1, 0.2, 0.3]), ())
    assert rig.setpoint(PLACE[1]).parameters == {"sequence": 42, "changes": []}


def test_an_ended_stream_is_named_by_words(rig: SubmissionRig) -> None:
    assert rig.setpoint(PLACE[1]).error is None
    rig.ticks(round(0.5 / PERIOD))
    [event] = [each for each in rig.logged() if isinstance(each, link.Event)]
    assert (event.message, event.id, event.phase) == ("streamed setpoints aborted", "", "aborted")
