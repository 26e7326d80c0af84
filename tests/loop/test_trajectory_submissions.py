"""A trajectory on its way through the gate: one verdict, reports to whoever follows, and one end."""

from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import CLIENT, Rig
from twind import link, sealed_memfd
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Trajectory
from twind.safety.guard_types import GuardDecision, Reaction

JOINT = "l_elbow"


def path(rig: Rig, *way: float, step: float = 0.5) -> Trajectory:
    """Places of one joint, rad of bending from where it is, `step` s apart."""
    here = float(rig.loop.robot.measured.position[rig.names.index(JOINT)])
    return rig.path(JOINT, [here - each for each in way], [step * (k + 1) for k in range(len(way))])


def last(rig: Rig, ticket: int, ticks: int = 400) -> list[link.Reply]:
    """Everything that answered, up to the last reply."""
    for _ in range(ticks):
        replies = rig.replies(ticket)
        if replies and not replies[-1].continues:
            return replies
        rig.ticks(1)
    raise AssertionError(f"no last reply: {rig.replies(ticket)}")


def codes(reply: link.Reply) -> list[str]:
    return [finding["code"] for finding in reply.parameters["findings"]]


def raw(rig: Rig, data: bytes, **fields: Any) -> int:
    """A submission whose bytes are the test's."""
    import os
    import socket

    rig.last_ticket += 1
    given = {"id": f"t{rig.last_ticket}", "points": 2, "commanded": [0]} | fields
    command = link.Submit(ticket=rig.last_ticket, client=CLIENT, **given)
    fd = sealed_memfd.seal("path", data)
    socket.send_fds(rig.front.outer, [link.encode(command)], [fd])
    os.close(fd)
    return rig.last_ticket


# ------------------------------------------------------------------------------------- the verdict


def test_a_check_gives_the_verdict_and_moves_nothing(armed: Rig) -> None:
    before = armed.counts
    (reply,) = last(armed, armed.submit(path(armed, 0.05), check_only=True))
    assert reply.error is None
    assert reply.parameters["verdict"] == {"refusals": [], "warnings": [], "changes": []}
    armed.seconds(0.6)
    assert armed.loop.executor.motion == "holding"
    assert np.abs(armed.counts - before).max() < 2.0
    assert not armed.events("MOTION")


def test_a_check_of_a_bad_one_is_an_answer_and_no_error(armed: Rig) -> None:
    (reply,) = last(armed, armed.submit(path(armed, 9.0), check_only=True))
    assert reply.error is None
    refused = {finding["code"] for finding in reply.parameters["verdict"]["refusals"]}
    assert "POS_LIMIT" in refused
    (reply,) = last(armed, armed.submit(path(armed, 9.0)))
    assert reply.error == "Refused"
    assert set(codes(reply)) == refused


def test_every_verdict_is_published_to_subscribers(armed: Rig) -> None:
    armed.news.clear()
    for way in (0.05, 9.0):
        last(armed, armed.submit(path(armed, way)))
    armed.ticks(1)
    moments = [news for news in armed.news if isinstance(news, link.VerdictReport)]
    assert [bool(moment.verdict["refusals"]) for moment in moments] == [False, True]
    assert moments[0].id != moments[1].id
    (event,) = [event for event in armed.events() if event.message.startswith("refused")]
    assert event.level == "warning"


def test_bytes_that_do_not_fit_are_refused_and_no_fault_of_the_daemon(armed: Rig) -> None:
    whole = bytes(8 * (2 + 2 * 24))
    misfits: list[tuple[bytes, dict[str, Any]]] = [
        (b"", {}),
        (bytes(7), {}),
        (whole[8:], {}),
        (whole, {"velocity": True}),
        (whole, {"commanded": [24]}),
        (bytes(8 * (2 + 4 * 24)), {"acceleration": True}),
    ]
    for data, fields in misfits:
        (reply,) = last(armed, raw(armed, data, **fields))
        assert reply.error == "Refused"
        assert codes(reply) == ["BAD_SHAPE"]
        assert armed.loop.condition.state == "armed"
        assert not armed.loop.commands.gate_input.busy


def test_the_longest_verdict_there_can_be_fits_one_datagram(armed: Rig) -> None:
    count = 2000
    n = len(armed.names)
    noise = np.random.default_rng(1).uniform(-9.0, 9.0, (3, count, n)) * [[[1.0]], [[50.0]], [[900.0]]]
    worst = Trajectory(np.arange(count) * 0.02 + 0.02, noise[0], np.ones(n, np.bool_), noise[1], noise[2])
    (reply,) = last(armed, armed.submit(worst))
    assert reply.error == "Refused"
    assert len(codes(reply)) > 100
    assert len(link.encode(reply)) < link.DATAGRAM / 2


def test_a_verdict_of_the_front_that_is_old_is_refused(armed: Rig) -> None:
    old = armed.clock.now() - 0.6
    fresh = armed.clock.now() - 0.4
    (reply,) = last(armed, armed.submit(path(armed, 0.05), front_checked=old))
    assert (reply.error, codes(reply)) == ("Refused", ["CMD_EXPIRED"])
    assert armed.loop.executor.motion == "holding"
    (reply,) = last(armed, armed.submit(path(armed, 0.05), front_checked=fresh))
    assert reply.error is None


def long_hold(rig: Rig) -> Trajectory:
    """As many points as a path may have, all where the robot is: judged over several ticks."""
    count = 2000
    n = len(rig.names)
    rows = np.tile(rig.loop.robot.measured.position, (count, 1))
    return Trajectory(np.arange(count) * 0.02 + 0.02, rows, np.ones(n, np.bool_))


def test_a_state_change_during_a_long_check_is_checked_again(armed: Rig) -> None:
    ticket = armed.submit(long_hold(armed))
    armed.send(link.ReleaseLease)
    (reply,) = last(armed, ticket)
    assert (reply.error, codes(reply)) == ("Refused", ["LEASE_MISSING"])
    assert armed.loop.executor.motion == "holding"


@pytest.mark.parametrize("client", [CLIENT, CLIENT + 1])
def test_a_trajectory_that_is_judged_when_the_robot_is_stopped_does_not_begin_afterwards(
    armed: Rig, client: int
) -> None:
    ticket = armed.submit(long_hold(armed))
    armed.ticks(2)
    assert armed.call(link.Cancel, client=client).error is None
    (reply,) = last(armed, ticket)
    assert (reply.error, codes(reply)) == ("Refused", ["BUSY"])
    assert armed.loop.executor.motion == "holding"
    assert last(armed, armed.submit(path(armed, 0.05)))[0].error is None


# ------------------------------------------------------------------------------------- following


def test_without_more_there_is_one_reply_and_the_end_is_an_event(armed: Rig) -> None:
    (reply,) = last(armed, armed.submit(path(armed, 0.05)))
    assert (reply.parameters["phase"], reply.continues) == ("accepted", False)
    armed.seconds(0.8)
    armed.call(link.AcquireLease)
    (event,) = armed.events("MOTION")
    assert (event.id, event.phase) == (reply.parameters["id"], "succeeded")


def test_with_more_progress_grows_from_accepted_to_the_end(armed: Rig) -> None:
    replies = last(armed, armed.submit(path(armed, 0.05, 0.1, 0.0), more=True))
    phases = [reply.parameters["phase"] for reply in replies]
    assert phases == ["accepted", *["running"] * (len(phases) - 2), "succeeded"]
    assert len(phases) == pytest.approx(17, abs=2)  # ten times a second, for 1.5 s
    progress = [reply.parameters["progress"] for reply in replies]
    assert progress == sorted(progress)
    assert (progress[0], progress[-1]) == (0.0, 1.0)
    assert [reply.continues for reply in replies] == [True] * (len(replies) - 1) + [False]
    assert len({reply.parameters["id"] for reply in replies}) == 1


@pytest.mark.parametrize("phase", ["cancelled", "replaced"])
def test_a_motion_ended_early_reports_its_progress(armed: Rig, phase: str) -> None:
    ticket = armed.submit(path(armed, 0.1, 0.2, step=1.0), more=True)
    armed.seconds(0.5)
    if phase == "cancelled":
        armed.send(link.Cancel)
    else:
        armed.submit(path(armed, 0.0), more=True)
    end = last(armed, ticket)[-1].parameters
    assert end["phase"] == phase
    assert 0.1 < end["progress"] < 0.5


def test_a_closed_client_gets_no_reports_and_another_may_take_the_lease(armed: Rig) -> None:
    ticket = armed.submit(path(armed, 0.05, 0.1, step=1.0), more=True)
    armed.ticks(20)
    armed.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT)))
    armed.ticks(1)
    known = len(armed.replies(ticket))
    armed.seconds(2.5)
    assert len(armed.replies(ticket)) == known
    assert armed.call(link.AcquireLease, client=CLIENT + 1).error is None


def test_reports_of_two_goals_do_not_mix(armed: Rig) -> None:
    first = armed.submit(path(armed, 0.05), more=True)
    armed.ticks(5)
    second = armed.submit(path(armed, 0.1, 0.1), more=True, start_in=1.0)
    ends = {ticket: last(armed, ticket) for ticket in (first, second)}
    for ticket, replies in ends.items():
        assert {reply.parameters["id"] for reply in replies} == {f"t{ticket}"}
        assert replies[-1].parameters["phase"] == "succeeded"


# ------------------------------------------------------------------------------------- setpoints


def setpoint(rig: Rig, *positions: float, joints: list[int] | None = None, **more: Any) -> link.Reply:
    places = [rig.names.index(JOINT)] if joints is None else joints
    return rig.call(link.Setpoint, joints=places, positions=list(positions), **more)


def test_a_setpoint_is_answered_with_the_tick_that_takes_it_and_no_changes(armed: Rig) -> None:
    here = float(armed.loop.robot.measured.position[armed.names.index(JOINT)])
    reply = setpoint(armed, here + 0.01)
    assert reply.error is None
    assert reply.parameters == {"sequence": pytest.approx(armed.loop.figures.ticks, abs=2), "changes": []}
    assert armed.loop.executor.motion == "streaming"


def test_a_clamped_setpoint_reports_joint_value_and_bound(armed: Rig) -> None:
    place = armed.names.index(JOINT)
    upper = float(armed.loop.robot.limits.upper[place])
    reply = setpoint(armed, upper + 0.5, allow_clamp=True)
    (change,) = reply.parameters["changes"]
    assert (change["code"], change["joint"]) == ("POS_LIMIT", place)
    assert (change["value"], change["bound"]) == (pytest.approx(upper + 0.5), pytest.approx(upper))


def test_a_malformed_setpoint_is_refused_and_no_fault_of_the_daemon(armed: Rig) -> None:
    malformed: list[tuple[list[int], list[float], str]] = [
        ([], [], "NO_JOINTS"),
        ([0, 0], [0.0, 0.0], "DUP_JOINT"),
        ([24], [0.0], "UNKNOWN_JOINT"),
        ([-1], [0.0], "UNKNOWN_JOINT"),
        ([0], [], "BAD_SHAPE"),
        ([0], [float("nan")], "NONFINITE"),
    ]
    for joints, positions, code in malformed:
        reply = setpoint(armed, *positions, joints=joints)
        assert reply.error == "Refused"
        assert code in codes(reply)
        assert armed.loop.executor.motion == "holding"
        assert armed.loop.condition.state == "armed"


def test_a_setpoint_without_the_lease_is_refused(armed: Rig) -> None:
    reply = setpoint(armed, 0.0, client=CLIENT + 1)
    assert (reply.error, codes(reply)) == ("Refused", ["LEASE_MISSING"])


def test_a_motion_that_is_cancelled_replaced_or_refused_is_named_by_its_event(armed: Rig) -> None:
    names = []
    for way in (0.05, 0.1):
        (reply,) = last(armed, armed.submit(path(armed, way)))
        names.append(reply.parameters["id"])
    armed.call(link.Cancel)
    ends = [(event.id, event.phase) for event in armed.events("MOTION")]
    assert ends == [(names[0], "replaced"), (names[1], "cancelled")]
    last(armed, armed.submit(path(armed, 9.0)))
    (refused,) = [event for event in armed.events() if event.id and event.code != "MOTION"]
    assert refused.phase == "" and refused.id not in names


def test_a_stream_that_ends_has_a_phase_and_no_id(armed: Rig) -> None:
    here = [float(each) for each in armed.loop.executor.reference.position[:1]]
    armed.call(link.Setpoint, joints=[0], positions=here, valid_for=0.1)
    armed.seconds(0.5)
    (event,) = armed.events("MOTION")
    assert (event.id, event.phase) == ("", "aborted")


def test_a_setpoint_that_waited_is_followed_until_its_time_and_refused_after_it(armed: Rig) -> None:
    here = [float(each) for each in armed.loop.executor.reference.position[:1]]
    now = armed.clock.now()
    late = armed.call(link.Setpoint, joints=[0], positions=here, valid_until=now - 0.001)
    assert (late.error, codes(late)) == ("Refused", ["CMD_EXPIRED"])
    now = armed.clock.now()
    assert armed.call(link.Setpoint, joints=[0], positions=here, valid_until=now + 0.04).error is None
    armed.seconds(0.08)
    (event,) = armed.events("MOTION")
    (stale,) = event.findings
    assert stale.code == "STREAM_STALE" and 0.02 <= stale.bound <= 0.04


@pytest.mark.parametrize("level", ["settle", "cut"])
def test_an_e_stop_is_an_event_with_its_level_and_the_change_of_state(armed: Rig, level: str) -> None:
    armed.call(link.EStop, level=level, reason="")
    (event,) = armed.events("estop")
    assert (event.before, event.cause, event.stop) == ("armed", "estop", level)


def test_the_reaction_of_the_guard_is_in_its_event(armed: Rig) -> None:
    why = (Finding(ReasonCode.FOLLOW_ERR, 3, message="ordered by the test"),)
    armed.loop.reactions.react(GuardDecision(Reaction.HOLD, why, causes=why), None, armed.clock.now())
    armed.loop.reactions.react(GuardDecision(Reaction.NONE, why), None, armed.clock.now())
    armed.ticks(2)
    assert [event.stop for event in armed.events(ReasonCode.FOLLOW_ERR)] == ["hold", ""]


# ---------------------------------------------------------------------------- setpoints beyond limits


def test_the_reply_to_setpoints_that_are_too_fast_says_how_far_behind_the_joint_is(armed: Rig) -> None:
    """±0.5 rad at 2 Hz, in positions alone; then a slow one."""
    joint = armed.names.index("head_yaw")
    changes: list[dict[str, Any]] = []
    furthest = 0.0
    for k in range(100):
        place = 0.5 * float(np.sin(2.0 * np.pi * 2.0 * k * armed.loop.robot.period))
        reply = armed.call(link.Setpoint, joints=[joint], positions=[place], ticks=2)
        assert reply.error is None
        changes += reply.parameters["changes"]
        furthest = max(furthest, *reply.parameters.get("behind", [0.0]))
    assert {(each["code"], each["joint"]) for each in changes} >= {("VEL_LIMIT", joint)}
    assert 0.1 < furthest < 1.0
    for _ in range(50):
        reply = armed.call(link.Setpoint, joints=[joint], positions=[0.0], ticks=2)
    assert reply.parameters == {"sequence": reply.parameters["sequence"], "changes": []}


# ------------------------------------------------------------------------------------- a motion's own time


def test_a_motion_that_is_slowed_says_by_how_much_and_why(
    armed: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hot motor halves its speed, and some ticks are missed."""
    begun = armed.clock.now()
    ticket = armed.submit(path(armed, 0.2, step=1.0), more=True)
    armed.ticks(30)
    armed.virtual["main"].faults.heat(1, 66.0)
    armed.seconds(0.5)
    with monkeypatch.context() as patch:
        patch.setattr(armed.loop, "_observe", lambda now, _: armed.clock.sleep_until(now + 0.03))
        armed.ticks(1)
    assert armed.loop.figures.missed_in_a_row >= 2
    replies = last(armed, ticket)
    took = armed.clock.now() - begun
    running = [reply.parameters for reply in replies if reply.parameters["phase"] == "running"]
    assert (running[0]["duration"], running[0]["stretch"], running[0]["stretched_by"]) == (1.0, 0.0, [])
    stretched = [each["stretch"] for each in running]
    assert stretched == sorted(stretched)
    end = replies[-1].parameters
    assert (end["phase"], end["duration"]) == ("succeeded", 1.0)
    assert end["stretch"] > 0.1
    assert took == pytest.approx(1.0 + end["stretch"], abs=0.05)
    assert set(end["stretched_by"]) == {"OVERTEMP", "LOOP_LATE"}


def test_a_tick_that_begins_late_does_not_stretch_a_motion(armed: Rig) -> None:
    ticket = armed.submit(path(armed, 0.05, step=0.3), more=True)
    armed.ticks(10)
    armed.clock.sleep_until(armed.next_tick + 0.55 * armed.loop.robot.period)
    armed.ticks(1)
    assert armed.loop.figures.missed == 0
    end = last(armed, ticket)[-1].parameters
    assert (end["stretch"], end["stretched_by"]) == (0.0, [])


def test_a_motion_in_its_time_has_no_stretch_and_no_reason(armed: Rig) -> None:
    end = last(armed, armed.submit(path(armed, 0.05, step=0.3), more=True))[-1].parameters
    assert (end["duration"], end["stretch"], end["stretched_by"]) == (pytest.approx(0.3), 0.0, [])
