"""An end-stop search tick by tick, on a scripted bus: its order, and that everything is undone after."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import PERIOD
from tests.support.restore_rig import KNEE, TURN
from tests.support.search_rig import CLIENT, LOWER, OTHER_MODE, START, STOP, UPPER, Search
from twind.loop.procedures.homing_procedure import HomingProcedure
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState
from twind.safety.state_machine import RobotEvent

BUSY = "knee gets its mode and settings back"


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Search:
    return Search(monkeypatch)


# ------------------------------------------------------------------------------- found


def test_a_stop_is_found_and_everything_is_undone(scene: Search) -> None:
    scene.ask()
    assert scene.until_answered() == {"phase": "found", "progress": 1.0, "ticks": [STOP, STOP]}
    first = ["alone", "look", "current mode", "prepare", "energise", "cut", "torque False"]
    assert scene.servo.log == [*first, "alone", "all", "give back", "all", "identify"]
    assert scene.servo.hurried == [True] * 4 + [False], "torque waits for no other request"
    assert scene.servo.bounds == (LOWER + OTHER_MODE, UPPER + OTHER_MODE)
    assert scene.servo.goals[0] == START + OTHER_MODE
    assert max(np.abs(np.diff(scene.servo.goals))) <= 6, "a goal was a step"
    assert not scene.servo.torque and scene.servo.offset == 0
    assert scene.rig.condition.state is RobotState.CALIBRATING
    events = [(event.level, event.code, event.message) for event in scene.rig.book.events]
    assert events == [
        ("info", "HOMING", "calibrate: knee goes to its lower stop"),
        ("info", "HOMING", f"knee: its stop is at {[STOP, STOP]}; torque is off"),
    ]


def test_requests_that_wait_are_dropped_before_the_first_write_and_after_the_search(scene: Search) -> None:
    scene.ask()
    scene.until_asked("look")
    assert scene.rig.hardware.log == ["clear"]
    scene.until_moving()
    assert scene.rig.hardware.log == ["clear"]
    scene.until_answered()
    assert scene.rig.hardware.log == ["clear", "clear", "clear", "hold False", "torque False"]


def test_the_lease_lasts_as_long_as_the_search_and_one_term_more(scene: Search) -> None:
    scene.ask()
    scene.until_asked("cut")
    scene.rig.ticks(2)
    scene.lease.holds(scene.rig.clock.now())
    ended = scene.rig.clock.now()
    scene.until(lambda: not scene.lease.held_by(CLIENT, scene.rig.clock.now()))
    assert scene.rig.clock.now() - ended == pytest.approx(1.0, abs=0.05)


def test_progress_is_reported_in_each_phase_and_every_quarter_of_a_second(scene: Search) -> None:
    times: list[float] = []
    scene.rig.book.reply = lambda reply: (  # type: ignore[method-assign]
        times.append(scene.rig.clock.now()),
        scene.rig.book.replies.append(reply),
    )
    scene.ask(more=True)
    assert scene.replies == [{"phase": "waiting", "progress": 0.0}]
    scene.until_answered()
    *reports, _ = scene.replies
    phases = [each["phase"] for each in reports]
    assert list(dict.fromkeys(phases)) == ["waiting", "approaching", "backing off"]
    progress = [each["progress"] for each in reports]
    assert progress == sorted(progress) and 0.0 < progress[2] < 0.5
    pauses = [
        after - before
        for before, after, was, phase in zip(times, times[1:], phases, phases[1:], strict=False)
        if was == phase
    ]
    changes = [
        after - before
        for before, after, was, phase in zip(times, times[1:], phases, phases[1:], strict=False)
        if was != phase
    ]
    assert min(changes) < 0.2, "a new phase waits for the next report"
    assert len(pauses) > 3 and min(pauses) >= 0.25 - 1e-9 and max(pauses) < 0.25 + 1.5 * PERIOD


def test_progress_is_reported_to_those_alone_who_want_it(scene: Search) -> None:
    scene.ask()
    scene.until_answered()
    assert len(scene.replies) == 1


def test_a_second_search_reports_its_progress_from_the_beginning(scene: Search) -> None:
    scene.ask(more=True)
    scene.homing.cancel()
    scene.rig.ticks(2)
    scene.rig.book.replies.clear()
    scene.ask(more=True)
    assert scene.replies == [{"phase": "waiting", "progress": 0.0}]
    scene.rig.book.replies.clear()
    assert scene.until_answered()["phase"] == "found"


# ------------------------------------------------------------------------------- its turn unknown


@pytest.mark.parametrize("turns", [0, 2])
def test_a_search_over_turns_gives_the_place_at_which_the_limp_joint_rests(scene: Search, turns: int) -> None:
    """Its count is off by whole turns: captures and rest are counted from the described stop."""
    scene.request = scene.described(
        turn_unknown=True, shift=turns * TURN, lower=LOWER - TURN, upper=UPPER + 3 * TURN
    )
    swings = iter([30.0, -30.0] * 20)
    scene.servo.limp = lambda count: count + (next(swings, 0.0) if scene.rig.torque.unconfirmed else 0.0)
    scene.ask()
    reply = scene.until_answered()
    assert reply == {"phase": "found", "progress": 1.0, "ticks": [STOP, STOP]}
    [(joint, place)] = scene.turns.places.items()
    assert joint == KNEE and place.count == pytest.approx(scene.servo.count, abs=1)


def test_a_joint_that_does_not_come_to_rest_gets_no_turn(scene: Search) -> None:
    scene.request = scene.described(turn_unknown=True)
    swings = iter([30.0, -30.0] * 1000)
    scene.servo.during["torque False"] = lambda: setattr(
        scene.servo, "limp", lambda count: count + next(swings)
    )
    scene.ask()
    [finding] = scene.findings()
    assert (finding.code, finding.joint) == (ReasonCode.STOP_NOT_FOUND, KNEE)
    assert scene.turns.places == {}


def test_the_registers_of_its_limp_servo_end_no_search(scene: Search) -> None:
    scene.request = scene.described(turn_unknown=True)
    scene.servo.during["torque False"] = lambda: scene.rig.hardware.slow.watchdog.fill(0)
    scene.ask()
    assert scene.until_answered()["phase"] == "found"


# ------------------------------------------------------------------------------- not begun


def error(scene: Search) -> tuple[str | None, dict[str, Any]]:
    [reply] = scene.rig.book.replies
    return reply.error, dict(reply.parameters)


def test_a_search_is_begun_in_the_state_calibrating_alone(scene: Search) -> None:
    scene.rig.condition.change(RobotEvent.CALIBRATED)
    scene.ask()
    assert error(scene) == ("WrongState", {"state": "connected", "allowed": ["calibrating"]})
    assert scene.servo.log == []


@pytest.mark.parametrize("event", [None, RobotEvent.FAULT, RobotEvent.ESTOP])
def test_a_refused_request_gets_all_reasons(scene: Search, event: RobotEvent | None) -> None:
    if event is not None:
        scene.rig.condition.change(event)
    why = Finding(ReasonCode.FAULT_LATCHED, message="made up")
    scene.request = [why]
    scene.ask()
    assert error(scene) == ("Refused", {"findings": [why]})
    assert scene.rig.procedures.rank is None


def test_one_search_at_a_time_is_run(scene: Search) -> None:
    busy = ("Busy", {"what": "an end-stop search or its restoring is under way"})
    scene.ask()
    scene.ask()
    assert error(scene) == busy
    scene.rig.book.replies.clear()
    scene.until_asked("torque False")
    scene.servo.full = True  # it cannot be restored yet
    scene.until(lambda: scene.rig.procedures.rank is None)
    scene.ask()
    assert error(scene) == busy


def test_a_search_is_busy_while_another_procedure_runs(scene: Search) -> None:
    def forever() -> Procedure:
        while True:
            yield

    scene.rig.own(Priority.ARM, forever)
    scene.ask()
    assert error(scene)[0] == "Busy" and scene.rig.procedures.rank is Priority.ARM


@pytest.mark.parametrize("place", [0, 1])
def test_a_search_is_busy_while_a_client_uses_a_bus(scene: Search, place: int) -> None:
    port = scene.rig.hardware.ports[place]
    port.busy = True
    scene.ask()
    what = f"a client reads, writes, scans or reboots on bus {port.name}: try again"
    assert error(scene) == ("Busy", {"what": what})


def test_a_search_whose_first_step_fails_leaves_nothing_under_way(
    scene: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(HomingProcedure, "_outcome", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            scene.ask()
    assert scene.replies == [], "whoever serves the call replies"
    assert scene.rig.procedures.rank is None
    scene.rig.ticks(110)
    assert not scene.lease.held_by(CLIENT, scene.rig.clock.now()), "its lease lasts for ever"


# ------------------------------------------------------------------------------- while it lasts


def test_from_the_first_write_on_its_servo_is_reported_and_kept_from_others(scene: Search) -> None:
    scene.ask()
    scene.until_asked("look")
    assert scene.homing.busy() == "" and scene.turns.unrestored is None
    scene.until_asked("current mode")
    assert scene.homing.busy() == scene.homing.busy("lower", 2) == BUSY
    assert scene.homing.busy("lower", 3) == scene.homing.busy("upper", 2) == ""
    assert scene.turns.unrestored == Finding(
        ReasonCode.CALIB_MISMATCH,
        KNEE,
        message="not restored after an end-stop search yet: it has mode 5",
    )
    scene.until_answered()
    assert scene.homing.busy() == "" and scene.turns.unrestored is None


def test_a_daemon_that_ends_reports_what_is_not_restored(scene: Search) -> None:
    scene.homing.report_pending_restore()
    assert scene.rig.book.events == []
    scene.ask()
    scene.until_moving()
    scene.homing.report_pending_restore()
    [finding] = scene.last[0].parameters["findings"]
    assert finding.code == ReasonCode.DEVICE_MISMATCH and "the daemon ends" in finding.message


def test_torque_counts_as_on_before_it_is_ordered(scene: Search) -> None:
    seen: list[bool] = []
    scene.servo.during["energise"] = lambda: seen.append(scene.rig.torque.energising)
    scene.servo.during["prepare"] = lambda: seen.append(scene.rig.torque.energising)
    scene.ask()
    scene.until_answered()
    assert seen == [False, True]


@pytest.mark.parametrize(("before", "after"), [("current mode", "prepare"), ("prepare", "energise")])
def test_three_ticks_pass_before_a_reading_counts_as_newer_than_a_write(
    scene: Search, before: str, after: str
) -> None:
    scene.ask()
    scene.until_asked(before)
    begun = scene.rig.clock.now()
    scene.until_asked(after)
    assert round((scene.rig.clock.now() - begun) / PERIOD) == 4, "one of them carries the request out"


@pytest.mark.parametrize("before", ["current mode", "prepare", "energise"])
def test_nothing_goes_on_without_a_reading_after_a_write(scene: Search, before: str) -> None:
    scene.ask()
    scene.until_asked(before)
    scene.hears = False
    scene.rig.ticks(8)
    asked = list(scene.servo.log)
    goals = list(scene.servo.goals)
    assert asked[-1] == before
    scene.hears = True
    scene.rig.ticks(2)
    assert scene.servo.log != asked or scene.servo.goals != goals


def test_a_joint_that_hangs_still_again_gets_torque(scene: Search) -> None:
    """Goal := present is written anew while the joint still moves, five times at most."""
    moves = [4.0] * 9
    scene.servo.during["prepare"] = lambda: setattr(
        scene.servo, "limp", lambda count: count + (moves.pop() if moves else 0.0)
    )
    scene.ask()
    assert scene.until_answered()["phase"] == "found"
    assert 2 <= scene.servo.log.count("prepare") <= 5


def test_another_count_of_the_current_mode_is_that_of_a_whole_turn(scene: Search) -> None:
    scene.servo.other = -2 * TURN
    scene.ask()
    assert scene.until_answered()["ticks"] == [STOP, STOP]
    assert scene.servo.bounds == (LOWER - 2 * TURN, UPPER - 2 * TURN)


def test_a_joint_that_was_calibrated_on_another_turn_is_driven_in_its_calibrated_counts(
    scene: Search,
) -> None:
    scene.request = scene.described(shift=TURN)
    scene.servo.count = START - TURN
    scene.servo.stop = STOP - TURN
    scene.read()
    scene.ask()
    assert scene.until_answered()["ticks"] == [STOP, STOP]


@pytest.mark.parametrize(("moves", "attempts"), [(3.0, 1), (-3.0, 1), (4.0, 2), (-4.0, 2)])
def test_a_joint_may_move_by_three_counts_until_its_goal_is_in_force(
    scene: Search, moves: float, attempts: int
) -> None:
    left = [moves]
    scene.servo.during["prepare"] = lambda: setattr(
        scene.servo, "limp", lambda count: count + (left.pop() if left else 0.0)
    )
    scene.ask()
    assert scene.until_answered()["phase"] == "found"
    assert scene.servo.log.count("prepare") == attempts


def test_a_joint_that_is_silent_while_nothing_is_written_yet_is_waited_for(scene: Search) -> None:
    scene.ask()
    scene.rig.ticks(4)
    scene.hears = False
    scene.rig.ticks(30)
    scene.hears = True
    assert scene.until_answered()["phase"] == "found"


def test_requests_of_other_settings_are_carried_out(scene: Search) -> None:
    request: Any = scene.request
    scene.request = replace(request, search=replace(request.search, times=3))
    scene.ask()
    assert scene.until_answered()["ticks"] == [STOP] * 3
