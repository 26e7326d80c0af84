"""Arm, Disarm, EStop, Reset, Mark, Cancel: answers, refusals, what they begin or end. On scripted buses."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.command_rig import FAULT, OTHER, RANKS, CommandRig, begin_arming, latch
from tests.support.procedure_rig import PLACE
from twind import link
from twind.loop.ipc.call_outcome import CallRefusal, CallReply
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion
from twind.safety.state_machine import RobotEvent

OTHER_FAULT = Finding(ReasonCode.STATE_STALE, 0, message="s: too old")
LOWERING = [rank for rank in RANKS if rank >= Priority.DISARM]


@pytest.fixture
def rig() -> CommandRig:
    return CommandRig()


# ------------------------------------------------------------------------------- torque


def test_an_arming_gets_the_joints_that_stay_limp_and_the_edited_files(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    context, _, edited, limp, now = begin_arming(rig, monkeypatch, joints=[0, 2], edited=["a.yaml"])
    assert context is rig and list(edited) == ["a.yaml"] and now == rig.clock.now()
    assert limp.tolist() == [False, True, False]
    assert rig.procedures.rank is Priority.ARM


def test_an_arming_without_joints_named_leaves_none_limp_and_is_judged_for_its_client(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[Any] = []
    monkeypatch.setattr(
        rig.handlers.gate_input, "may_arm", lambda *how, limp: judged.append((how, limp.tolist()))
    )
    _, judge, _, limp, _ = begin_arming(rig, monkeypatch, client=OTHER)
    judge(3.0)
    assert judged == [((OTHER, 3.0), [False] * 3)] and not limp.any()


def test_an_armed_robot_is_answered_and_the_simulation_placed_there(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.hold(PLACE)
    warning = Finding(ReasonCode.DEVICE_MISMATCH, 1, message="no watchdog")
    begin_arming(rig, monkeypatch, CallReply({"joints": [0], "warnings": [warning]}))
    rig.tick()
    assert rig.reply_to(1).parameters["joints"] == [0]
    [place] = rig.placed
    assert np.array_equal(place, PLACE)
    [event] = rig.book.events
    assert (event.level, event.code) == ("warning", ReasonCode.DEVICE_MISMATCH)
    assert event.message.startswith("1 joints armed without a device watchdog") and event.findings == [
        warning
    ]


@pytest.mark.parametrize("outcome", [CallRefusal([FAULT]), CallReply({"joints": []})])
def test_an_arming_without_commanded_position_or_success_places_nothing(
    rig: CommandRig, outcome: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    if isinstance(outcome, CallRefusal):
        rig.hold(PLACE)
    begin_arming(rig, monkeypatch, outcome)
    rig.tick()
    assert rig.placed == [] and len(rig.book.replies) == 1 and rig.texts() == []


def test_a_disarm_ends_what_is_less_urgent_and_is_answered_when_torque_is_off(rig: CommandRig) -> None:
    rig.hold(PLACE)
    rig.serve(rig.message(link.Disarm))
    assert rig.procedures.rank is Priority.DISARM and rig.book.replies == []
    rig.until_done()
    assert rig.reply_to(1).parameters == {"state": "connected"}


def test_a_disarm_that_is_overtaken_is_answered_by_what_overtook_it(rig: CommandRig) -> None:
    rig.hold(PLACE)
    rig.serve(rig.message(link.Disarm))
    rig.serve(rig.message(link.EStop))
    assert rig.reply_to(1).error == "Busy"
    assert rig.reply_to(1).parameters["what"] == "disarming was ended by ESTOP: e-stop (settle)"


def test_torque_that_was_found_on_cannot_be_disarmed_without_a_writer(rig: CommandRig) -> None:
    rig.found()
    rig.condition.mode = Mode.MIRROR
    rig.hardware.writers = []
    [finding] = rig.call(link.Disarm).parameters["findings"]
    assert finding == Finding(
        ReasonCode.MODE_DENIES,
        message="mode mirror has nothing that writes: torque was found on; disarm in mode live",
    )
    assert rig.procedures.rank is None


def test_without_torque_a_disarm_needs_no_writer(rig: CommandRig) -> None:
    rig.hardware.writers = []
    assert rig.call(link.Disarm).parameters == {"state": "connected"}


@pytest.mark.parametrize("rank", LOWERING)
def test_a_disarm_beside_something_as_urgent_is_busy_and_says_what_to_wait_for(
    rig: CommandRig, rank: Priority
) -> None:
    rig.occupy(rank)
    reply = rig.call(link.Disarm)
    assert (reply.error, reply.parameters) == (
        "Busy",
        {"what": f"{rank.name.lower()}: wait until torque is off, as `twindctl status --joints` shows"},
    )


def test_an_arming_beside_an_end_stop_search_is_busy_without_that_advice(rig: CommandRig) -> None:
    rig.occupy(Priority.HOME)
    assert rig.call(link.Arm).parameters == {"what": "home"}


def test_an_unknown_level_of_an_e_stop_is_refused_with_the_known_ones(rig: CommandRig) -> None:
    reply = rig.call(link.EStop, level="hard")
    assert reply.error == "NotFound"
    assert reply.parameters == {"what": "level", "name": "hard", "known": ["settle", "cut"]}
    assert rig.condition.latches == {}


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({}, "e-stop (settle)"),
        ({"level": "cut"}, "e-stop (cut)"),
        ({"reason": "smoke"}, "smoke"),
    ],
)
def test_an_e_stop_latches_its_reason_and_begins_at_once(
    rig: CommandRig, how: dict[str, str], text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(rig.handlers.stops, "ask", asked.append)
    rig.hold(PLACE)
    rig.serve(rig.message(link.EStop, **how))
    assert rig.condition.latches[ReasonCode.ESTOP].message == text
    assert rig.torque.stop_level == how.get("level", "settle") and len(asked) == 1


# ------------------------------------------------------------------------------- reset


def test_a_reset_acknowledges_all_latches_and_settles_the_state(rig: CommandRig) -> None:
    latch(rig, FAULT, OTHER_FAULT)
    rig.reports.urgent = False
    reply = rig.call(link.Reset)
    assert reply.parameters == {"state": "connected"} and rig.condition.latches == {}
    assert rig.settled == [rig.clock.now()] and rig.reports.urgent
    assert rig.entered == [] and rig.identified == []


def test_a_reset_of_one_code_keeps_the_others_and_the_latched_state(rig: CommandRig) -> None:
    latch(rig, FAULT, OTHER_FAULT)
    rig.reports.urgent = False
    assert rig.call(link.Reset, codes=[FAULT.code]).parameters == {"state": "fault"}
    assert rig.reports.urgent
    assert list(rig.condition.latches) == [OTHER_FAULT.code] and rig.settled == []
    assert rig.call(link.Reset, codes=[OTHER_FAULT.code]).parameters == {"state": "connected"}


def test_a_code_that_is_not_latched_is_refused_and_nothing_is_acknowledged(rig: CommandRig) -> None:
    latch(rig, FAULT)
    reply = rig.call(link.Reset, codes=["WIRE_CLAMP", FAULT.code, "ESTOP"])
    assert reply.error == "NotFound"
    assert reply.parameters == {"what": "latched code", "name": "ESTOP", "known": ["FOLLOW_ERR"]}
    assert list(rig.condition.latches) == [FAULT.code]


def test_a_reset_without_a_latch_changes_nothing(rig: CommandRig) -> None:
    assert rig.call(link.Reset).parameters == {"state": "connected"}
    assert rig.settled == [] and rig.texts() == []


@pytest.mark.parametrize(("codes", "level"), [(["ESTOP"], None), (["FOLLOW_ERR"], "cut"), (None, None)])
def test_a_stop_is_lifted_with_its_own_code(
    rig: CommandRig, codes: list[str] | None, level: str | None
) -> None:
    latch(rig, FAULT, Finding(ReasonCode.ESTOP, message="e-stop (cut)"))
    rig.torque.latch_stop("cut")
    rig.call(link.Reset, codes=codes)
    assert rig.torque.stop_level == level


@pytest.mark.parametrize("rank", [None, *LOWERING])
@pytest.mark.parametrize("on", [True, False])
def test_with_torque_on_or_on_its_way_off_nothing_is_acknowledged(
    rig: CommandRig, on: bool, rank: Priority | None
) -> None:
    if rank is None and not on:
        return
    latch(rig, FAULT)
    rig.found((int(on), 0, 0))
    if rank is not None:
        rig.occupy(rank)
    reply = rig.call(link.Reset)
    wait = "wait until torque is off, as `twindctl status --joints` shows"
    assert reply.error == "WrongState" and reply.parameters == {
        "state": "fault, torque on" if on else "fault, torque going off",
        "allowed": ["torque off: " + ("disarm" if rank is None else wait)],
    }
    assert list(rig.condition.latches) == [FAULT.code]


def test_a_reset_of_an_inhibited_robot_identifies_all_buses_anew(rig: CommandRig) -> None:
    rig.condition.latch(FAULT)
    rig.torque.inhibit()
    rig.condition.change(RobotEvent.INHIBIT)
    assert rig.call(link.Reset).parameters == {"state": "disconnected"}
    assert rig.identified == ["lower", "upper"] and not rig.torque.inhibited
    assert rig.settled == [rig.clock.now()]


@pytest.mark.parametrize(
    ("mode", "motion", "halted", "entered"),
    [
        (Mode.MIRROR, Motion.IDLE, False, True),
        (Mode.SIM, Motion.HOLDING, True, True),
        (Mode.SIM, Motion.HOLDING, False, False),
        (Mode.LIVE, Motion.IDLE, True, False),
    ],
)
def test_a_reset_lets_a_stopped_simulation_go_on(
    rig: CommandRig, mode: Mode, motion: Motion, halted: bool, entered: bool
) -> None:
    rig.condition.mode = mode
    rig.executor = SimpleNamespace(motion=motion)
    rig.twin.halted = halted
    rig.call(link.Reset)
    assert rig.entered == ([mode] if entered else [])


# ------------------------------------------------------------------------------- marks, motion


@pytest.mark.parametrize(
    ("how", "code", "text"),
    [
        ({"kind": "begin", "task": "pick"}, "EPISODE_BEGIN", "pick"),
        (
            {"kind": "end", "task": "pick", "success": True, "text": "well"},
            "EPISODE_END",
            "pick: succeeded: well",
        ),
        ({"kind": "end", "success": False}, "EPISODE_END", "failed"),
        ({"kind": "end"}, "EPISODE_END", "ended"),
        ({"kind": "note", "text": "look", "success": True}, "NOTE", "look"),
    ],
)
def test_an_annotation_becomes_an_event(rig: CommandRig, how: dict[str, Any], code: str, text: str) -> None:
    assert rig.call(link.Mark, annotation=link.Annotation(**how)).parameters["sequence"] == 1
    [event] = rig.book.events
    assert (event.code, event.message, event.holder) == (code, text, "ann")


def test_a_cancel_stops_motion_and_streams_and_needs_no_lease(rig: CommandRig) -> None:
    stopped: list[Any] = []
    rig.handlers.submissions.stopped = SimpleNamespace(stop=lambda *how: stopped.append(how))  # type: ignore[assignment]
    rig.move()
    reply = rig.call(link.Cancel, client=OTHER)
    assert reply.parameters == {"state": "armed"} and stopped == [(OTHER, rig.clock.now())]
    [outcome] = rig.executor.outcomes()
    assert outcome.phase == "cancelled"


@pytest.mark.parametrize("rank", RANKS)
def test_a_cancel_leaves_a_procedure_alone_but_for_an_end_stop_search(
    rig: CommandRig, rank: Priority, monkeypatch: pytest.MonkeyPatch
) -> None:
    cancelled: list[bool] = []
    monkeypatch.setattr(rig.handlers.homing, "cancel", lambda: cancelled.append(True))
    rig.move()
    rig.occupy(rank)
    assert rig.call(link.Cancel).parameters == {"state": "armed"}
    assert rig.executor.motion is Motion.ACTIVE and bool(cancelled) is (rank is Priority.HOME)
