"""Take-over of torque before the robot is lowered: what is held, left out, left alone. On scripted buses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import ratings
from tests.support.procedure_rig import BROKEN, PERIOD, PLACE, REST, SILENT, ProcedureRig
from twind.loop.procedures import torque_takeover
from twind.loop.procedures.torque_takeover import take_over
from twind.robot.finding import ReasonCode
from twind_drivers.bus import BusError

NONE = np.zeros(3, np.bool_)
UPPER = np.array([False, False, True])


@pytest.fixture
def rig() -> ProcedureRig:
    return ProcedureRig()


def taken(rig: ProcedureRig, whole: bool = False, unjudged: Any = lambda: NONE) -> bool:
    held = rig.run(take_over(rig, unjudged, whole))
    assert isinstance(held, bool)
    return held


# --------------------------------------------------------------------------------------------- nothing to do


def test_a_robot_that_is_held_goes_on_as_it_is(rig: ProcedureRig) -> None:
    rig.hold()
    assert taken(rig)
    assert rig.hardware.log == []


def test_a_robot_without_torque_has_nothing_to_lower(rig: ProcedureRig) -> None:
    assert not taken(rig)
    assert rig.hardware.log == []


def test_torque_that_is_being_switched_is_not_taken_over(rig: ProcedureRig) -> None:
    rig.found()
    rig.torque.begin_energising()
    assert not taken(rig)
    assert rig.hardware.log == []


def test_a_robot_that_sinks_damped_keeps_its_softness(rig: ProcedureRig) -> None:
    rig.hold()
    rig.hardware.slow.watchdog[:] = 255
    rig.torque.demand_damping(rig.clock.now())
    assert taken(rig)
    assert rig.hardware.log == []


def test_a_demand_for_damping_alone_holds_nothing(rig: ProcedureRig) -> None:
    rig.torque.demand_damping(rig.clock.now())
    assert not taken(rig)


# --------------------------------------------------------------------------------------------- inherited


def test_torque_that_was_found_on_is_held_where_it_is(rig: ProcedureRig) -> None:
    rig.found()
    assert taken(rig)
    assert rig.hardware.log == ["clear", "prepare", "hold True"]
    assert rig.hardware.goals[0].tolist() == PLACE.tolist()
    assert rig.hardware.among.all()
    assert rig.torque.armed
    assert rig.robot.written.tolist() == PLACE.tolist()


def test_a_goal_lies_within_the_range_of_goals(rig: ProcedureRig) -> None:
    rig.found()
    rig.robot.measured = rig.state(np.array([2.055, 0.0, -2.055]))
    assert taken(rig)
    assert rig.hardware.goals[0].tolist() == [2.0, 0.0, -2.0]


def test_a_motion_ends_before_goals_are_written(rig: ProcedureRig) -> None:
    rig.found()
    rig.executor.begin(PLACE + 0.3)
    body = take_over(rig, lambda: NONE, False)
    next(body)
    assert rig.hardware.log == ["clear", "prepare"]
    assert rig.executor.reference is None


def test_joints_beyond_their_hard_limits_are_left_and_named(rig: ProcedureRig) -> None:
    rig.found()
    rig.robot.measured = rig.state(np.array([0.0, 2.2, -2.3]))
    assert not taken(rig)
    assert rig.hardware.log == []
    [event] = rig.book.events
    assert (event.level, event.code) == ("error", "OUT_OF_LIMIT")
    [finding] = event.findings
    assert (finding.code, finding.joint, finding.value) == (ReasonCode.OUT_OF_LIMIT, 1, 2.2)
    assert finding.message == "to hold knee, toe inside the hard limits would be a step"
    assert event.message == f"{finding.message}: torque goes off where the robot stands; support it"


def test_a_joint_whose_place_is_unknown_gets_no_goal(rig: ProcedureRig) -> None:
    rig.found()
    rig.robot.measured = rig.state(np.array([0.3, np.nan, 0.2]))
    assert taken(rig)
    assert rig.hardware.among.tolist() == [True, False, True]
    assert rig.hardware.goals[0].tolist() == [0.3, REST[1], 0.2]
    assert rig.torque.held.tolist() == [True, False, True]
    [event] = rig.book.events
    assert (event.level, event.code, event.findings[0].joint) == ("error", "CALIB_MISMATCH", 1)
    assert event.findings[0].message == "the position of knee is unknown"
    assert event.message.endswith("it gets no goal, and torque goes off where it stands; support it")


def test_a_robot_of_unknown_pose_is_not_held(rig: ProcedureRig) -> None:
    rig.found()
    rig.robot.measured = rig.state(np.full(3, np.nan))
    assert not taken(rig)
    assert rig.hardware.log == []
    [event] = rig.book.events
    [finding] = event.findings
    assert (event.code, finding.code, finding.joint) == ("CALIB_MISMATCH", ReasonCode.CALIB_MISMATCH, 0)
    assert finding.value is None


def test_a_silent_device_does_not_keep_the_others_from_being_lowered(rig: ProcedureRig) -> None:
    rig.found()
    rig.hardware.failing["prepare"] = SILENT
    assert taken(rig)
    [event] = rig.book.events
    assert (event.level, event.code) == ("error", "DEVICE_MISSING")
    assert event.message == f"lowered although a device did not answer: {SILENT} (toe)"
    assert rig.torque.armed


def test_any_other_error_ends_the_take_over(rig: ProcedureRig) -> None:
    rig.found()
    rig.hardware.failing["prepare"] = BROKEN
    with pytest.raises(BusError, match="broken"):
        taken(rig)
    assert not rig.torque.armed


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ([0.0, 2.2, 0.0], "to hold knee inside the hard limits would be a step"),
        ([0.0, np.nan, 0.0], "the position of knee is unknown"),
    ],
)
def test_where_the_whole_robot_is_wanted_a_joint_that_cannot_be_held_fails_it(
    rig: ProcedureRig, place: list[float], text: str
) -> None:
    rig.found()
    rig.robot.measured = rig.state(np.array(place))
    with pytest.raises(BusError, match=text):
        taken(rig, whole=True)
    assert rig.hardware.log == [] and rig.book.events == []


def test_where_the_whole_robot_is_wanted_a_silent_device_fails_it(rig: ProcedureRig) -> None:
    rig.found()
    rig.hardware.failing["prepare"] = SILENT
    with pytest.raises(BusError):
        taken(rig, whole=True)
    assert not rig.torque.armed and rig.book.events == []


def test_a_robot_that_this_daemon_armed_is_lowered_even_where_the_whole_is_wanted(rig: ProcedureRig) -> None:
    rig.hold()
    rig.hardware.slow.watchdog[2] = 255
    rig.robot.measured = rig.state(np.array([0.4, 0.5, np.nan]))
    assert taken(rig, whole=True)
    assert rig.hardware.among.tolist() == [True, True, False]


# --------------------------------------------------------------------------------------------- tripped


def test_a_tripped_joint_is_held_where_it_is_and_the_others_where_they_were_sent(rig: ProcedureRig) -> None:
    rig.hold()
    rig.hardware.slow.watchdog[1] = 255
    rig.robot.measured = rig.state(PLACE - 0.1)
    assert taken(rig)
    assert rig.hardware.goals[0] == pytest.approx([PLACE[0], PLACE[1] - 0.1, PLACE[2]])
    assert rig.hardware.log == ["clear", "prepare", "hold True"]


def test_joints_that_hold_well_are_known_and_never_a_step(rig: ProcedureRig) -> None:
    rig.hold(np.array([0.4, 2.0, -2.0]))
    rig.hardware.slow.watchdog[0] = 255
    rig.robot.measured = rig.state(np.array([0.4, 2.2, np.nan]))
    assert taken(rig)
    assert rig.hardware.among.all()
    assert rig.hardware.goals[0].tolist() == [0.4, 2.0, -2.0]


def test_without_a_goal_that_was_sent_every_joint_is_held_where_it_is(rig: ProcedureRig) -> None:
    rig.hold()
    rig.hardware.slow.watchdog[0] = 255
    rig.robot.measured = rig.state(PLACE - 0.1)
    rig.robot.written = None
    assert taken(rig)
    assert rig.hardware.goals[0].tolist() == (PLACE - 0.1).tolist()


def test_a_robot_that_is_not_armed_any_more_is_held_where_it_is(rig: ProcedureRig) -> None:
    rig.hold()
    rig.torque.lose_every_bus()
    rig.robot.measured = rig.state(PLACE - 0.1)
    assert taken(rig)
    assert rig.hardware.goals[0].tolist() == (PLACE - 0.1).tolist()


def test_an_armed_robot_of_which_no_joint_gets_goals_is_taken_over(rig: ProcedureRig) -> None:
    rig.hold()
    rig.hardware.holding = False
    assert taken(rig)
    assert rig.hardware.log == ["clear", "prepare", "hold True"]


# --------------------------------------------------------------------------------------------- limp

HIP, KNEE, TOE = np.eye(3, dtype=np.bool_)


def test_torque_that_was_found_on_in_some_joints_is_held_and_the_others_count_as_limp(
    rig: ProcedureRig,
) -> None:
    rig.found((1, 1, 0))
    rig.robot.measured = rig.state(np.array([0.4, 0.5, 2.2]))  # by a hand, past its hard limit
    assert taken(rig)
    assert rig.hardware.among.tolist() == [True, True, False]
    assert rig.torque.limp.tolist() == [False, False, True]
    assert rig.book.events == []


def test_a_joint_whose_torque_is_not_read_is_held_with_the_others(rig: ProcedureRig) -> None:
    rig.found((1, 1, -1))
    assert taken(rig)
    assert rig.hardware.among.all() and not rig.torque.partial


@pytest.mark.parametrize(
    ("support", "legs", "limp"),
    [
        ("gantry", TOE, [False, False, True]),
        ("free", TOE, [False, False, False]),
        ("free", HIP, [False, False, True]),
    ],
)
def test_a_leg_of_a_robot_that_stands_freely_is_held_even_if_it_was_found_without_torque(
    support: str, legs: Any, limp: list[bool]
) -> None:
    rig = ProcedureRig(support=support)
    rig.robot.description = replace(rig.robot.description, ratings=replace(ratings(3), leg=legs))
    rig.found((1, 1, 0))
    assert taken(rig)
    assert rig.torque.limp.tolist() == limp
    assert rig.hardware.among.tolist() == [not one for one in limp]


def test_joints_that_were_left_limp_stay_so_where_a_watchdog_tripped(rig: ProcedureRig) -> None:
    rig.hold()
    rig.torque.leave_limp(TOE)
    rig.hardware.left_out = TOE
    rig.hardware.slow.torque[:] = (1, 0, 1)
    rig.hardware.slow.watchdog[0] = 255
    assert taken(rig)
    assert rig.torque.limp.tolist() == TOE.tolist()
    assert rig.hardware.among.tolist() == [True, True, False]


def test_a_joint_that_lost_its_torque_is_held_where_it_is_and_not_where_it_was_sent(
    rig: ProcedureRig,
) -> None:
    rig.hold()
    rig.hardware.slow.torque[2] = 0
    rig.hardware.slow.watchdog[0] = 255
    rig.robot.measured = rig.state(PLACE - 0.1)
    assert taken(rig)
    assert rig.hardware.goals[0] == pytest.approx([PLACE[0] - 0.1, PLACE[1], PLACE[2] - 0.1])


# --------------------------------------------------------------------------------------------- turns


def test_turns_that_are_being_determined_are_waited_for(rig: ProcedureRig) -> None:
    rig.found()
    begun = rig.clock.now()
    assert taken(rig, unjudged=lambda: UPPER if rig.clock.now() < begun + 0.2 else NONE)
    assert rig.clock.now() - begun == pytest.approx(0.2, abs=2.5 * PERIOD)


def test_a_turn_is_waited_for_half_a_second_at_most(rig: ProcedureRig) -> None:
    rig.found()
    begun = rig.clock.now()
    assert taken(rig, unjudged=lambda: UPPER)
    assert rig.clock.now() - begun == pytest.approx(0.5, abs=2.5 * PERIOD)


def test_the_wait_for_a_turn_ends_with_its_last_tick() -> None:
    rig = ProcedureRig(period=1.0 / 128.0)  # half a second is a whole number of such ticks
    rig.found()
    body = take_over(rig, lambda: UPPER, False)
    next(body)
    rig.clock.time += 0.5
    body.send(0.0)
    assert rig.hardware.log == ["clear", "prepare"]


@pytest.mark.parametrize(("age", "waits"), [(0.1, True), (0.11, False)])
def test_only_a_joint_that_answers_is_waited_for(rig: ProcedureRig, age: float, waits: bool) -> None:
    rig.found()
    rig.read(age=np.array([0.0, 0.0, age]))
    body = take_over(rig, lambda: UPPER, False)
    next(body)
    assert (rig.hardware.log == []) == waits


# --------------------------------------------------------------------------------------------- returned buses


@pytest.fixture
def back(rig: ProcedureRig) -> ProcedureRig:
    """An armed robot whose upper bus was lost and is back."""
    rig.hold()
    rig.hardware.back = UPPER
    rig.torque.lose_bus(UPPER)
    rig.robot.measured = rig.state(PLACE + 0.05)
    rig.follows = False
    return rig


def test_a_bus_that_is_back_is_held_where_it_is_and_the_others_go_on(back: ProcedureRig) -> None:
    assert taken(back)
    assert back.hardware.log == ["prepare back", "hold True"]
    assert back.hardware.goals[0].tolist() == (PLACE + 0.05).tolist()
    assert back.hardware.among.all()
    assert back.torque.held.all()
    expected = [PLACE[0], PLACE[1], PLACE[2] + 0.05]
    assert back.robot.written == pytest.approx(expected)
    assert back.executor.reference.position == pytest.approx(expected)


def test_the_next_goal_of_a_returned_bus_is_compared_with_its_place(back: ProcedureRig) -> None:
    body = take_over(back, lambda: NONE, False)
    next(body)
    back.hardware.serve()
    with pytest.raises(StopIteration):
        body.send(0.0)
    assert back.robot.written == pytest.approx([PLACE[0], PLACE[1], PLACE[2] + 0.05])


def test_joints_that_are_held_brake_before_a_bus_is_taken_back(back: ProcedureRig) -> None:
    back.executor.setpoint(np.array([0]), np.array([1.0]), None, 10.0)
    for _ in range(20):
        back.executor.goal(back.clock.now())
    assert back.executor.reference.velocity.any()
    body = take_over(back, lambda: NONE, False)
    next(body)
    assert back.hardware.log == []
    back.executor.stop()
    while back.executor.reference.velocity.any():
        assert back.hardware.log == []
        body.send(0.0)
        back.executor.goal(back.clock.now())
    body.send(0.0)
    assert back.hardware.log == ["prepare back"]


def test_a_returned_joint_beyond_its_hard_limit_is_not_taken_over(back: ProcedureRig) -> None:
    back.robot.measured = back.state(np.array([0.4, 0.5, 2.2]))
    assert taken(back)
    assert back.hardware.log == []
    [event] = back.book.events
    assert (event.level, event.code) == ("error", "OUT_OF_LIMIT")
    assert event.message == (
        "not taken over, torque goes off where it stands: to hold toe inside the hard limits would be a step"
    )


@pytest.mark.parametrize("joint", [0, 2])
def test_only_a_joint_that_is_back_and_open_can_be_a_step(back: ProcedureRig, joint: int) -> None:
    place = PLACE.copy()
    place[joint] = 2.2
    back.robot.measured = back.state(place)
    if joint == 2:
        back.hardware.away = UPPER
    assert taken(back)
    assert "OUT_OF_LIMIT" not in back.codes()


def test_a_silent_device_on_a_returned_bus_is_reported_and_the_rest_of_it_held(back: ProcedureRig) -> None:
    back.hardware.failing["prepare back"] = SILENT
    assert taken(back)
    [event] = back.book.events
    assert (event.level, event.code) == ("error", "DEVICE_MISSING")
    assert "(toe)" in event.message
    assert back.hardware.log[-1] == "hold True"


def test_a_returned_bus_that_fails_is_no_reason_to_drop_the_joints_that_are_held(back: ProcedureRig) -> None:
    back.hardware.failing["prepare back"] = BROKEN
    assert taken(back)
    [event] = back.book.events
    assert (event.level, event.code) == ("error", "BUS_ERRORS")
    assert event.message.startswith("not taken over, torque goes off where it stands: ")
    assert back.hardware.log == ["prepare back"]
    assert back.robot.written.tolist() == PLACE.tolist()


def test_a_limp_joint_on_a_returned_bus_gets_no_goal_wherever_it_is(rig: ProcedureRig) -> None:
    rig.hold()
    rig.torque.leave_limp(HIP)
    rig.hardware.back = HIP | KNEE
    rig.hardware.left_out = HIP
    rig.torque.lose_bus(HIP | KNEE)
    rig.robot.measured = rig.state(np.array([2.2, 0.6, -0.5]))
    assert taken(rig)
    assert rig.hardware.among.tolist() == [False, True, True]
    assert rig.torque.held.tolist() == [False, True, True]


def test_a_moving_robot_of_which_no_bus_was_lost_is_lowered_at_once(rig: ProcedureRig) -> None:
    rig.hold()
    rig.executor.setpoint(np.array([0]), np.array([1.0]), None, 10.0)
    rig.ticks(20)
    assert rig.executor.reference.velocity.any()
    with pytest.raises(StopIteration) as ended:
        next(take_over(rig, lambda: NONE, False))
    assert ended.value.value is True


def test_a_bus_that_is_still_away_is_not_asked(rig: ProcedureRig) -> None:
    rig.hold()
    rig.hardware.away = UPPER
    assert taken(rig)
    assert rig.hardware.log == []
    assert rig.robot.written.tolist() == PLACE.tolist()


def test_without_a_goal_that_was_sent_a_returned_bus_gets_none(back: ProcedureRig) -> None:
    back.robot.written = None
    back.executor.idle()
    assert taken(back)
    assert back.hardware.log == ["prepare back"]


def test_a_tripped_watchdog_reads_255() -> None:
    assert torque_takeover.TRIPPED == 255
