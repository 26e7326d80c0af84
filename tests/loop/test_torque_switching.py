"""Torque off with its read-back and retry, damping, and what is known of torque. On scripted buses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import limits
from tests.support.procedure_rig import BROKEN, NAMES, PERIOD, PLACE, SILENT, WHY, BusTask, ProcedureRig
from twind.loop.procedures import damping, torque_readback, torque_switching
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.modes import Mode
from twind_drivers.bus import BusError

OFF = ["clear", "hold False", "cut 0", "cut 1", "torque False"]


@pytest.fixture
def rig() -> ProcedureRig:
    rig = ProcedureRig()
    rig.hold()
    return rig


def switch_off(rig: ProcedureRig) -> None:
    rig.run(torque_switching.switch_torque_off(rig))


# --------------------------------------------------------------------------------------------- off


def test_goals_end_before_the_cut_and_the_cut_precedes_the_read_back(rig: ProcedureRig) -> None:
    rig.hardware.quiet_until = np.inf
    switch_off(rig)
    assert rig.hardware.log == OFF
    assert rig.hardware.quiet_until == -np.inf
    assert rig.executor.reference is None
    assert (rig.torque.armed, rig.torque.energising, rig.torque.unconfirmed) == (False, False, False)


def test_torque_counts_as_on_until_it_is_read_back(rig: ProcedureRig) -> None:
    rig.torque.demand_damping(1.0)
    body = torque_switching.switch_torque_off(rig)
    next(body)
    assert (rig.torque.armed, rig.torque.energising, rig.torque.unconfirmed) == (False, True, True)
    assert rig.torque.soft_since is None


def test_a_device_that_stays_silent_is_asked_for_a_second_then_left_unconfirmed(rig: ProcedureRig) -> None:
    rig.hardware.failing["torque False"] = [SILENT] * 1000
    begun = rig.clock.now()
    with pytest.raises(BusError):
        switch_off(rig)
    assert rig.clock.now() - begun == pytest.approx(1.0, abs=2.5 * PERIOD)
    assert rig.hardware.log.count("torque False") == pytest.approx(50, abs=2)
    assert rig.hardware.log.count("cut 0") == 1
    assert (rig.torque.energising, rig.torque.unconfirmed) == (False, True)


@pytest.mark.parametrize("error", [KeyError(7), ValueError("a bug")])
def test_torque_off_is_repeated_after_an_error_of_a_driver_and_then_left_unconfirmed(
    rig: ProcedureRig, error: Exception
) -> None:
    rig.hardware.failing["torque False"] = [error]
    switch_off(rig)
    assert not rig.torque.unconfirmed
    rig.hardware.failing["torque False"] = [error] * 1000
    with pytest.raises(BusError, match="failed inside"):
        switch_off(rig)
    assert (rig.torque.energising, rig.torque.unconfirmed) == (False, True)


def test_after_exactly_a_second_nothing_is_repeated(rig: ProcedureRig) -> None:
    rig.hardware.failing["torque False"] = [SILENT] * 1000
    body = torque_switching.switch_torque_off(rig)
    next(body)
    rig.hardware.serve()
    rig.clock.time += 1.0
    with pytest.raises(BusError):
        body.send(0.0)


def test_a_device_that_answers_late_is_confirmed(rig: ProcedureRig) -> None:
    rig.hardware.failing["torque False"] = [SILENT, BROKEN]
    switch_off(rig)
    assert rig.hardware.log.count("torque False") == 3
    assert not rig.torque.unconfirmed


def test_without_a_bus_to_write_to_nothing_is_repeated(rig: ProcedureRig) -> None:
    rig.hardware.failing["torque False"] = [SILENT] * 1000
    body = torque_switching.switch_torque_off(rig)
    next(body)
    rig.hardware.serve()
    rig.hardware.writers.clear()
    with pytest.raises(BusError):
        body.send(0.0)
    assert rig.hardware.log.count("torque False") == 1
    assert not rig.torque.energising


def test_the_retry_reports_that_torque_was_still_on(rig: ProcedureRig) -> None:
    rig.own(Priority.DISARM, lambda: torque_switching.retry_torque_off(rig))
    rig.until_done()
    [event] = rig.book.events
    assert (event.level, event.code) == ("warning", "TORQUE_MISMATCH")
    assert rig.hardware.log == OFF
    assert rig.outcomes == [None]


def test_a_retry_that_fails_names_the_joint(rig: ProcedureRig) -> None:
    rig.hardware.failing["torque False"] = [SILENT] * 1000
    rig.own(Priority.DISARM, lambda: torque_switching.retry_torque_off(rig))
    rig.until_done()
    _, event = rig.book.events
    assert (event.level, event.code) == ("error", "TORQUE_MISMATCH")
    assert event.message == f"torque could not be read back off: {SILENT} (toe)"


# --------------------------------------------------------------------------------------------- on


def test_a_take_over_holds_every_joint_that_is_not_left_out(rig: ProcedureRig) -> None:
    rig.hardware.left_out = np.array([False, True, False])
    goal = PLACE + 0.01
    torque_switching.take(rig, goal)
    assert rig.hardware.log == ["hold True"]
    assert rig.torque.held.tolist() == [True, False, True]
    assert rig.robot.written is goal
    assert rig.executor.reference.position.tolist() == goal.tolist()


@pytest.mark.parametrize(
    ("place", "beyond"), [(2.0586, False), (2.0588, True), (-2.0586, False), (-2.0588, True), (np.nan, False)]
)
def test_a_joint_beyond_its_hard_limit_by_more_than_encoder_error(
    rig: ProcedureRig, place: float, beyond: bool
) -> None:
    assert pytest.approx(0.0087) == torque_switching.EDGE  # rad
    assert limits(1).hard_upper[0] == 2.05
    rig.robot.measured = rig.state(np.array([0.0, place, 0.0]))
    assert torque_switching.beyond_hard_limit(rig).tolist() == [False, beyond, False]


def test_a_joint_at_exactly_the_edge_of_encoder_error_is_not_beyond(rig: ProcedureRig) -> None:
    bounds = rig.robot.limits
    edge = torque_switching.EDGE
    for place in (bounds.hard_lower - edge, bounds.hard_upper + edge):
        rig.robot.measured = rig.state(place)
        assert not torque_switching.beyond_hard_limit(rig).any()


@pytest.mark.parametrize(
    ("count", "text"), [(0, ""), (1, "hip"), (3, "hip, knee, toe"), (4, "hip, knee, toe and 1 more")]
)
def test_of_many_joints_the_first_three_are_named(rig: ProcedureRig, count: int, text: str) -> None:
    rig.robot.joints.names = (*NAMES, "finger")
    assert torque_switching.joint_names(rig, np.arange(4) < count) == text


def test_a_silent_device_is_named_by_its_joint_and_any_other_error_stays_as_it_is(
    rig: ProcedureRig,
) -> None:
    assert torque_switching.error_text(rig, SILENT) == f"{SILENT} (toe)"
    assert torque_switching.error_text(rig, BROKEN) == "the bus is broken"
    assert torque_switching.error_text(rig, ValueError("odd")) == "odd"


# --------------------------------------------------------------------------------------------- what is known


@pytest.mark.parametrize(("age", "known"), [(0.5, 1), (0.51, -1), (np.nan, -1)])
def test_torque_of_a_servo_that_is_silent_for_half_a_second_is_unknown(
    rig: ProcedureRig, age: float, known: int
) -> None:
    rig.robot.measured = replace(rig.robot.measured, age=np.array([0.0, age, 0.0]))
    assert torque_readback.torque_known(rig).tolist() == [1, known, 1]


def test_torque_that_was_read_back_is_inherited_unless_this_daemon_has_it(rig: ProcedureRig) -> None:
    assert torque_readback.torque_inherited(rig) is False, "armed"
    rig.torque.lose_every_bus()
    assert torque_readback.torque_inherited(rig) and torque_readback.torque_on(rig)
    rig.torque.begin_energising()
    assert not torque_readback.torque_inherited(rig), "being switched"
    assert torque_readback.torque_on(rig)
    rig.torque.leave_unconfirmed()
    rig.found((0, 0, 1))
    assert torque_readback.torque_inherited(rig)
    rig.found((0, -1, 0))
    assert not torque_readback.torque_inherited(rig) and not torque_readback.torque_on(rig)


def test_an_armed_robot_has_torque_whatever_the_registers_say(rig: ProcedureRig) -> None:
    rig.found((0, 0, 0))
    assert torque_readback.torque_on(rig) and torque_readback.torque_possible(rig)


def test_torque_of_a_device_on_an_open_bus_is_possible_until_it_reports(rig: ProcedureRig) -> None:
    rig.torque.lose_every_bus()
    rig.found((0, 0, -1))
    assert torque_readback.torque_possible(rig)
    rig.hardware.away = np.array([False, False, True])
    assert not torque_readback.torque_possible(rig), "its bus is closed"
    rig.found((0, 0, 0))
    rig.hardware.away = np.zeros(3, np.bool_)
    assert not torque_readback.torque_possible(rig)


@pytest.mark.parametrize(
    ("torque", "off"), [((0, 0, 0), True), ((0, 1, 0), False), ((0, -1, 0), None), ((1, -1, 0), False)]
)
def test_torque_is_off_only_when_every_servo_says_so(
    rig: ProcedureRig, torque: Any, off: bool | None
) -> None:
    rig.torque.lose_every_bus()
    rig.found(torque)
    assert torque_readback.torque_off(rig) is off
    rig.torque.begin_energising()
    assert torque_readback.torque_off(rig) is False
    rig.torque.confirm_off()
    rig.condition.mode = Mode.SIM
    assert torque_readback.torque_off(rig) is (False if off is False else None)


@pytest.mark.parametrize(
    ("torque", "away", "denied"),
    [(1, False, "torque is on"), (-1, False, "torque is on"), (0, False, ""), (-1, True, "a bus was lost")],
)
@pytest.mark.parametrize("ordered_off", [True, False])
def test_another_mode_waits_until_torque_of_this_daemon_reads_off(
    rig: ProcedureRig, torque: int, away: bool, denied: str, ordered_off: bool
) -> None:
    rig.torque.lose_every_bus()
    rig.hardware.slow.torque[:] = torque
    rig.hardware.away[:] = away
    if away and ordered_off:
        rig.torque.begin_release()
        rig.torque.leave_unconfirmed()
    elif away:
        rig.torque.lose_bus(np.ones(3, np.bool_))
    found = torque_readback.torque_denial(rig)
    assert ("" if found is None else found.message[: len(denied)]) == denied
    assert found is None or found.code == "MODE_DENIES"


def test_torque_on_a_closed_bus_that_is_not_of_this_daemon_holds_no_mode(rig: ProcedureRig) -> None:
    rig.torque.lose_every_bus()
    rig.hardware.slow.torque[:] = -1
    rig.hardware.away[:] = True
    assert torque_readback.torque_denial(rig) is None


# --------------------------------------------------------------------------------------------- damping


def damp(rig: ProcedureRig) -> float:
    """Damp to the end; s that took."""
    begun = rig.clock.now()
    rig.run(damping.damp(rig))
    return rig.clock.now() - begun


def test_a_robot_that_rests_is_damped_for_a_second(rig: ProcedureRig) -> None:
    begun = rig.clock.now()
    assert damp(rig) == pytest.approx(1.0, abs=1.5 * PERIOD)
    assert rig.hardware.log == ["damp"]
    assert rig.torque.soft_since == begun
    assert rig.torque.stop_begun
    [event] = rig.book.events
    assert (event.level, event.code, event.stop) == ("error", "DAMP", "damp")


def test_the_second_of_rest_ends_with_its_last_tick() -> None:
    rig = ProcedureRig(period=1.0 / 128.0)  # a second is a whole number of such ticks, exactly
    rig.hold()
    assert damp(rig) == 1.0
    rig = ProcedureRig(period=1.0 / 128.0)
    rig.hold()
    rig.read(velocity=np.ones(3))
    assert damp(rig) == 5.0, "and so do the five seconds of a robot that does not rest"


@pytest.mark.parametrize("odd", [{"velocity": np.array([0.0, -0.051, 0.0])}, {"age": np.array([0, 0, 1.01])}])
def test_a_joint_that_moves_or_is_silent_keeps_it_damped_for_five_seconds(
    rig: ProcedureRig, odd: dict[str, Any]
) -> None:
    rig.read(**odd)
    assert damp(rig) == pytest.approx(5.0, abs=1.5 * PERIOD)


@pytest.mark.parametrize("fine", [{"velocity": np.array([0.05, -0.05, 0.0])}, {"age": np.array([0, 0, 1.0])}])
def test_slow_joints_with_a_reading_of_the_last_second_rest(rig: ProcedureRig, fine: dict[str, Any]) -> None:
    rig.read(**fine)
    assert damp(rig) == pytest.approx(1.0, abs=1.5 * PERIOD)


def test_the_second_of_rest_begins_when_the_last_joint_has_come_to_rest(rig: ProcedureRig) -> None:
    begun = rig.clock.now()

    def sink() -> None:
        fast = rig.clock.now() - begun < 2.0
        rig.read(velocity=np.array([0.0, 0.5 if fast else 0.0, 0.0]))

    rig.watched = sink
    assert damp(rig) == pytest.approx(3.0, abs=2.5 * PERIOD)


def test_the_five_seconds_count_from_the_demand(rig: ProcedureRig) -> None:
    damping.demand(rig, (WHY,), rig.clock.now() - 3.0)
    rig.read(velocity=np.full(3, 1.0))
    assert damp(rig) == pytest.approx(2.0, abs=1.5 * PERIOD)
    [event] = rig.book.events
    assert event.findings == [WHY] and f"{WHY.code}: {WHY.message}" in event.message


def test_a_second_demand_is_not_reported(rig: ProcedureRig) -> None:
    damping.demand(rig, (WHY,), 1.0)
    damping.demand(rig, (WHY,), 2.0)
    assert rig.codes() == ["DAMP"]
    assert rig.torque.soft_since == 1.0


def test_the_goals_follow_the_sinking_joints_at_half_a_radian_per_second(rig: ProcedureRig) -> None:
    rig.read(position=PLACE - 1.5)
    body = damping.damp(rig)
    next(body)
    places = [rig.executor.goal(rig.clock.now()).position]
    for _ in range(90):
        rig.clock.sleep_until(rig.clock.now() + PERIOD)
        body.send(rig.clock.now())
        places.append(rig.executor.goal(rig.clock.now()).position)
    steps = np.diff(np.array(places), axis=0)
    assert steps.min() == pytest.approx(-0.5 * PERIOD)
    assert places[-1][0] < PLACE[0] - 0.4


def test_one_bus_that_is_not_damped_is_enough_that_a_stop_has_not_begun(rig: ProcedureRig) -> None:
    rig.hardware.damp = lambda: [BusTask(done=True, result=()), BusTask(BROKEN, done=True)]
    damp(rig)
    assert not rig.torque.stop_begun


def test_the_answers_of_all_buses_are_awaited_before_any_is_reported(rig: ProcedureRig) -> None:
    late = BusTask()
    rig.hardware.damp = lambda: [BusTask(done=True, result=()), late]
    body = damping.damp(rig)
    next(body)
    assert not rig.torque.stop_begun
    late.done = True
    late.result = (7,)
    body.send(rig.clock.now())
    assert not rig.torque.stop_begun
    assert rig.book.events[-1].message == "ids [7] did not confirm that they are damped"


@pytest.mark.parametrize(
    ("result", "error", "confirmed", "texts"),
    [
        ((), None, True, []),
        (None, None, True, []),
        ((2, 7), None, False, ["ids [2, 7] did not confirm that they are damped"]),
        ((), BROKEN, False, ["not damped: the bus is broken"]),
    ],
)
def test_what_did_not_confirm_damping_is_reported_once_and_a_stop_counts_as_begun_only_with_all(
    rig: ProcedureRig, result: Any, error: Any, confirmed: bool, texts: list[str]
) -> None:
    rig.hardware.results["damp"] = result
    if error is not None:
        rig.hardware.failing["damp"] = error
    damp(rig)
    assert rig.torque.stop_begun == confirmed
    assert [event.message for event in rig.book.events[1:]] == texts
    assert all(event.code == "DAMP" and event.level == "error" for event in rig.book.events)
