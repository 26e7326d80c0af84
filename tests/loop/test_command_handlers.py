"""Commands of a tick, the end of the daemon, and connections that end. On scripted buses."""

from typing import Any

import pytest

from tests.support.command_rig import CLIENT, OTHER, RANKS, CommandRig, begin_arming, ended, streams
from tests.support.gate_rig import path
from tests.support.procedure_rig import PLACE
from twind import link
from twind.loop.ipc.call_outcome import CallReply
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Motion


@pytest.fixture
def rig() -> CommandRig:
    return CommandRig()


# ------------------------------------------------------------------------------- all of a tick


def test_an_e_stop_of_a_tick_goes_before_all_other_commands(rig: CommandRig) -> None:
    note = link.Annotation(kind="note", text="first")
    rig.serve(
        rig.message(link.Mark, annotation=note),
        rig.message(link.EStop),
        rig.message(link.Mark, annotation=note),
    )
    codes = [code for code in rig.codes() if code in ("estop", "NOTE")]
    assert codes == ["estop", "NOTE", "NOTE"]
    assert [each.ticket for each in rig.book.replies] == [1, 3]


def test_an_error_inside_one_call_latches_is_answered_and_leaves_the_others(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig.lease, "renew", lambda *_: 1 / 0)
    rig.serve(rig.message(link.RenewLease), rig.message(link.ReleaseLease))
    assert rig.reply_to(1).error == "Busy"
    assert rig.reply_to(1).parameters["what"] == "failed inside: ZeroDivisionError('division by zero')"
    assert rig.reply_to(2).error is None
    assert rig.condition.latches[ReasonCode.INTERNAL].message == "ZeroDivisionError('division by zero')"


def test_an_error_inside_a_message_that_expects_no_answer_latches(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig.lease, "release_client", lambda *_: 1 / 0)
    rig.serve(rig.message(link.ConnectionClosed, client=CLIENT))
    assert ReasonCode.INTERNAL in rig.condition.latches and rig.book.replies == []


def test_a_calibration_without_its_lease_ends_in_the_same_tick(rig: CommandRig) -> None:
    rig.take_lease()
    assert rig.call(link.Calibrate, on=True).parameters == {"state": "calibrating"}
    rig.serve(rig.message(link.ReleaseLease))
    assert rig.condition.state == "connected"


def test_a_reload_that_was_asked_for_reaches_the_front(rig: CommandRig) -> None:
    rig.handlers.reloads.want()
    rig.serve()
    assert rig.link.rereads == 1


def test_a_trajectory_is_judged_with_its_bytes_and_changes_come_with_their_briefing(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []
    monkeypatch.setattr(rig.handlers.submissions, "begin", lambda *how: given.append(how))
    monkeypatch.setattr(rig.handlers.reloads, "adopt", lambda *how: given.append(how))
    now = rig.clock.now()
    submit = rig.message(link.Submit, id="a", points=1, commanded=[0])
    submit.data = b"path"
    changes = rig.message(link.ApplyChanges, generation=1, changes={})
    changes.fd = 33
    rig.serve(submit, changes)
    assert given == [(submit.command, b"path", now), (changes.command, 33, now)]


@pytest.mark.parametrize(
    ("kind", "how", "part", "name"),
    [
        (link.ReloadStarted, {}, "reloads", "begin"),
        (link.ReloadFailed, {"message": "no file"}, "reloads", "failed"),
        (link.Setpoint, {"joints": [0], "positions": [0.1]}, "submissions", "setpoint"),
    ],
)
def test_messages_reach_the_part_that_serves_them(
    rig: CommandRig, kind: Any, how: dict[str, Any], part: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []
    monkeypatch.setattr(getattr(rig.handlers, part), name, lambda *how: given.append(how))
    message = rig.message(kind, **how)
    rig.serve(message)
    now = rig.clock.now()
    assert given == [{"begin": (now,), "failed": ("no file",), "setpoint": (message.command, now)}[name]]


# ------------------------------------------------------------------------------- the end of the daemon


@pytest.mark.parametrize(
    ("held", "text"), [(True, "the daemon ends: lowering the robot"), (False, "the daemon ends")]
)
def test_the_end_of_the_daemon_is_reported_once_and_ends_it(rig: CommandRig, held: bool, text: str) -> None:
    if held:
        rig.hold()
    rig.condition.stop_wanted = True
    for _ in range(3000):
        if not rig.condition.finished:
            rig.serve()
            rig.tick()
    assert rig.condition.finished and rig.texts("STOPPING") == [text]
    assert ("torque False" in rig.hardware.log) is held


@pytest.mark.parametrize("rank", RANKS)
def test_an_ending_daemon_takes_over_all_but_an_e_stop_and_its_own_end(
    rig: CommandRig, rank: Priority
) -> None:
    rig.occupy(rank)
    rig.torque.begin_release()
    rig.condition.stop_wanted = True
    rig.serve()
    over = rank < Priority.SHUTDOWN
    lowers = rank in (Priority.DISARM, Priority.FAULT)
    assert rig.texts("STOPPING") == (
        ["the daemon ends" + (": lowering the robot" if lowers else "")] if over else []
    )
    assert rig.procedures.rank is (Priority.SHUTDOWN if over else rank)


def test_torque_that_was_going_off_goes_off_although_the_robot_is_inhibited(rig: CommandRig) -> None:
    rig.occupy(Priority.DISARM)
    rig.found()
    rig.torque.inhibit()
    rig.condition.stop_wanted = True
    rig.serve()
    rig.until_done()
    assert "torque False" in rig.hardware.log


# ------------------------------------------------------------------------------- connections


def test_a_closed_connection_loses_its_lease_its_submissions_and_its_e_stop_calls(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    dropped: list[Any] = []
    monkeypatch.setattr(rig.handlers.submissions, "drop_client", dropped.append)
    monkeypatch.setattr(rig.handlers.stops, "drop_client", dropped.append)
    rig.take_lease()
    rig.serve(rig.message(link.ConnectionClosed, client=OTHER))
    assert rig.lease.held_by(CLIENT, rig.clock.now())
    rig.serve(rig.message(link.ConnectionClosed, client=CLIENT))
    assert not rig.lease.holds(rig.clock.now()) and dropped == [OTHER, OTHER, CLIENT, CLIENT]


@pytest.mark.parametrize(("client", "rank"), [(CLIENT, Priority.DISARM), (OTHER, Priority.ARM)])
def test_an_arming_ends_with_the_connection_that_began_it(
    rig: CommandRig, client: int, rank: Priority, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_arming(rig, monkeypatch)
    rig.torque.begin_energising()
    rig.serve(rig.message(link.ConnectionClosed, client=client))
    assert rig.procedures.rank is rank


def test_an_armed_robot_stays_armed_without_the_connection_that_armed_it(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.hold(PLACE)
    begin_arming(rig, monkeypatch, CallReply({"joints": []}))
    rig.tick()
    rig.serve(rig.message(link.ConnectionClosed, client=CLIENT))
    assert rig.procedures.rank is None and rig.torque.armed
    rig.occupy(Priority.HOME)
    rig.serve(rig.message(link.ConnectionClosed, client=CLIENT))
    assert rig.procedures.rank is Priority.HOME


def test_a_disarm_goes_on_without_the_connection_of_an_earlier_arming(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_arming(rig, monkeypatch)
    rig.occupy(Priority.FAULT)
    rig.serve(rig.message(link.ConnectionClosed, client=CLIENT))
    assert rig.procedures.rank is Priority.FAULT


def test_the_connection_of_a_busy_arming_does_not_end_the_one_under_way(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_arming(rig, monkeypatch)
    assert rig.call(link.Arm, client=OTHER).parameters == {"what": "arm"}
    rig.torque.begin_energising()
    rig.serve(rig.message(link.ConnectionClosed, client=OTHER))
    assert rig.procedures.rank is Priority.ARM


# ------------------------------------------------------------------------------- a lost front, gone sockets


def test_a_lost_front_holds_motion_and_drops_lease_and_submissions(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(rig.handlers.submissions, "forget", lambda: calls.append("forget"))
    monkeypatch.setattr(rig.handlers.reloads, "front_lost", lambda: calls.append("reload"))
    rig.move()
    rig.take_lease()
    rig.link.lost = True
    rig.serve()
    assert not rig.link.lost and not rig.lease.holds(rig.clock.now()) and calls == ["forget", "reload"]
    assert ended(rig) == Finding(ReasonCode.LEASE_LOST, message="the front was lost")
    assert rig.texts(ReasonCode.LEASE_LOST) == ["the front was lost; a new one is started"]
    assert rig.book.events[-1].level == "error" and rig.torque.armed


def test_a_lost_front_ends_an_arming_with_torque_off(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_arming(rig, monkeypatch)
    rig.torque.begin_energising()
    rig.link.lost = True
    rig.serve()
    assert rig.procedures.rank is Priority.DISARM


@pytest.mark.parametrize("rank", [rank for rank in RANKS if rank > Priority.ARM])
def test_a_lost_front_leaves_any_other_procedure_and_its_motion(rig: CommandRig, rank: Priority) -> None:
    rig.move()
    rig.occupy(rank)
    rig.link.lost = True
    rig.serve()
    assert rig.procedures.rank is rank and rig.executor.motion is Motion.ACTIVE


def test_a_motion_that_waits_for_its_start_is_held_with_a_lost_front(rig: CommandRig) -> None:
    rig.hold(PLACE)
    assert rig.executor.submit("wave", path([2.0], PLACE + 0.3), start_in=1.0) is None
    assert rig.executor.waiting
    rig.link.lost = True
    rig.serve()
    assert not rig.executor.waiting


@pytest.mark.parametrize("motion", [Motion.STREAMING, Motion.HOLDING, Motion.IDLE])
def test_a_stream_is_held_with_a_lost_front(rig: CommandRig, motion: Motion) -> None:
    stops = streams(rig, motion)
    rig.link.lost = True
    rig.serve()
    assert [how[0] for how in stops] == (["aborted"] if motion is Motion.STREAMING else [])


def test_a_robot_that_holds_is_left_alone_with_a_lost_front(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.hold(PLACE)
    monkeypatch.setattr(rig.executor, "stop", lambda *_: 1 / 0)
    rig.link.lost = True
    rig.serve()
    assert rig.executor.motion is not Motion.IDLE


def test_motion_is_held_while_no_client_can_connect(rig: CommandRig) -> None:
    rig.move()
    rig.reports.urgent = False
    rig.serve(rig.message(link.Reachable, missing="control.sock: removed"))
    gone = Finding(ReasonCode.SOCKETS_GONE, message="control.sock: removed")
    assert rig.condition.unreachable == gone and ended(rig) == gone
    assert [(each.level, each.message, each.findings) for each in rig.book.events] == [
        ("error", "control.sock: removed", [gone])
    ]
    assert rig.reports.urgent
    rig.reports.urgent = False
    rig.serve(rig.message(link.Reachable, missing="control.sock: removed"))
    assert len(rig.book.events) == 1 and not rig.reports.urgent
    rig.serve(rig.message(link.Reachable, rebound=["/run/a", "/run/b"]))
    assert rig.condition.unreachable is None and rig.reports.urgent
    assert set(rig.codes()) == {ReasonCode.SOCKETS_GONE}
    assert [(each.level, each.message) for each in rig.book.events[1:]] == [
        ("warning", "/run/a was removed or replaced; it is bound again"),
        ("warning", "/run/b was removed or replaced; it is bound again"),
        ("info", "clients can connect again; motion may be requested"),
    ]


def test_another_socket_that_is_gone_too_is_no_further_event(rig: CommandRig) -> None:
    rig.serve(
        rig.message(link.Reachable, missing="control.sock"), rig.message(link.Reachable, missing="both")
    )
    assert rig.texts() == ["control.sock"]
    assert rig.condition.unreachable is not None and rig.condition.unreachable.message == "both"


def test_sockets_that_are_in_place_are_no_event(rig: CommandRig) -> None:
    rig.reports.urgent = True
    rig.serve(rig.message(link.Reachable))
    assert rig.texts() == [] and rig.reports.urgent


@pytest.mark.parametrize(
    ("kind", "how", "error"),
    [
        (link.FindStop, {"joint": 1, "side": "lower"}, "WrongState"),
        (link.LocateJoints, {"joints": [1], "positions": [0.0]}, "Refused"),
        (link.ReadRegister, {"bus": "tail", "id": 1, "name": "led"}, "NotFound"),
        (link.WriteRegister, {"bus": "tail", "id": 1, "name": "led", "value": 1}, "NotFound"),
        (link.Reboot, {"bus": "tail", "id": 1}, "NotFound"),
        (link.Scan, {"bus": "tail"}, "NotFound"),
    ],
)
def test_commands_on_devices_reach_the_part_that_serves_them(
    rig: CommandRig, kind: Any, how: dict[str, Any], error: str
) -> None:
    assert rig.call(kind, **how).error == error
    assert rig.condition.latches == {}
