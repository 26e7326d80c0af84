"""Arming, step by step, on scripted buses: what is asked of the devices, in which order, and what ends it."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import BROKEN, PLACE, RESOLUTION, SILENT, ProcedureRig, granted
from twind.loop.ipc.call_outcome import CallFailure, CallRefusal, CallReply
from twind.loop.procedures import arming
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.safety.guard import GuardThresholds
from twind.safety.state_machine import RobotEvent

ORDER = ["prepare", "write goals", "torque True"]
OFF = ["hold False", "cut 0", "cut 1", "torque False"]
UNREAD = (
    Finding(ReasonCode.THERMAL_HEADROOM, 0, value=np.nan, bound=60.0),
    Finding(ReasonCode.VOLTAGE_LOW, 1, value=np.nan, bound=10.0),
)
HOT = Finding(ReasonCode.THERMAL_HEADROOM, 0, value=70.0, bound=60.0)


@pytest.fixture
def rig() -> ProcedureRig:
    return ProcedureRig()


NOBODY = np.zeros(3, np.bool_)


def arm(rig: ProcedureRig, judge: Callable[[float], Verdict] = granted, edited: tuple[str, ...] = ()) -> Any:
    """Begin to arm; the outcome comes when it is over."""
    assert rig.own(Priority.ARM, lambda: arming.arm(rig, judge, edited, NOBODY, rig.clock.now()))


def armed(rig: ProcedureRig, **options: Any) -> Any:
    """Arm; the outcome."""
    arm(rig, **options)
    rig.until_done()
    [outcome] = rig.outcomes
    return outcome


def refusal(rig: ProcedureRig, **options: Any) -> Finding:
    """The only finding of an arming that is refused."""
    outcome = armed(rig, **options)
    assert isinstance(outcome, CallRefusal), outcome
    [finding] = outcome.findings
    return finding


def test_watchdogs_then_goals_then_torque_and_the_robot_holds(rig: ProcedureRig) -> None:
    assert armed(rig) == CallReply({"joints": [0, 1, 2]})
    assert rig.hardware.log == ["clear", *ORDER, "hold True"]
    assert [event.code for event in rig.book.events] == ["arming", "armed"]
    assert rig.torque.armed and not rig.torque.energising
    assert rig.robot.written == pytest.approx(PLACE)
    assert rig.executor.reference.position == pytest.approx(PLACE)
    assert all(goal == pytest.approx(PLACE, abs=RESOLUTION) for goal in rig.hardware.goals)


def test_three_ticks_of_torque_pass_before_the_robot_counts_as_armed(rig: ProcedureRig) -> None:
    arm(rig)
    while "torque True" not in rig.hardware.log:
        rig.tick()
        assert not rig.torque.energising or "torque True" in rig.hardware.log
    assert rig.torque.energising and not rig.torque.armed
    rig.ticks(3)
    assert not rig.torque.armed
    rig.tick()
    assert rig.torque.armed


def test_joints_whose_watchdog_cannot_be_read_are_named_in_the_reply(rig: ProcedureRig) -> None:
    rig.robot.joints.unwatched = (2,)
    outcome = armed(rig)
    assert outcome.parameters["joints"] == [0, 1, 2]
    [warning] = outcome.parameters["warnings"]
    assert (warning.code, warning.joint) == (ReasonCode.DEVICE_MISMATCH, 2)


# --------------------------------------------------------------------------------------------- the request


def test_a_request_that_the_gate_refuses_reaches_no_device(rig: ProcedureRig) -> None:
    assert refusal(rig, judge=lambda now: Verdict((HOT,))) is HOT
    assert rig.hardware.log == [] and rig.book.events == []


def test_files_that_were_edited_refuse_arming_with_their_names(rig: ProcedureRig) -> None:
    outcome = armed(rig, edited=("a.yaml", "b.xml"))
    assert [finding.code for finding in outcome.findings] == [ReasonCode.CALIB_MISMATCH] * 2
    assert [finding.message.split()[0] for finding in outcome.findings] == ["a.yaml", "b.xml"]
    assert rig.hardware.log == []


@pytest.mark.parametrize("unread", UNREAD)
def test_a_value_that_was_never_read_is_waited_for(rig: ProcedureRig, unread: Finding) -> None:
    begun = rig.clock.now()
    arm(rig, judge=lambda now: Verdict((unread,) if now < begun + 0.5 else ()))
    rig.ticks(40)
    assert rig.hardware.log == []
    rig.until_done()
    assert isinstance(rig.outcomes[0], CallReply)


def test_after_a_second_an_unread_value_refuses(rig: ProcedureRig) -> None:
    arm(rig, judge=lambda now: Verdict(UNREAD))
    rig.ticks(98)
    assert rig.outcomes == []
    rig.ticks(4)
    [outcome] = rig.outcomes
    assert isinstance(outcome, CallRefusal) and tuple(outcome.findings) == UNREAD


def test_the_wait_for_an_unread_value_ends_with_its_last_tick() -> None:
    rig = ProcedureRig(period=1.0 / 128.0)  # a second is a whole number of such ticks
    arm(rig, judge=lambda now: Verdict(UNREAD))
    assert rig.until_done() == 1.0


@pytest.mark.parametrize(
    "final",
    [
        HOT,
        Finding(ReasonCode.THERMAL_HEADROOM, 0, value=None, bound=60.0),
        Finding(ReasonCode.LATENCY_BLOCK, value=np.nan, bound=0.1),
    ],
)
def test_nothing_else_is_waited_for(rig: ProcedureRig, final: Finding) -> None:
    arm(rig, judge=lambda now: Verdict((UNREAD[0], final)))
    [outcome] = rig.outcomes
    assert isinstance(outcome, CallRefusal) and final in outcome.findings


def test_a_request_that_waits_and_is_ended_changes_nothing(rig: ProcedureRig) -> None:
    arm(rig, judge=lambda now: Verdict(UNREAD))
    rig.ticks(3)
    rig.procedures.abandon()
    assert rig.hardware.log == [] and rig.book.events == []
    [outcome] = rig.outcomes
    assert outcome == CallFailure("Busy", {"what": "arming was ended by something more urgent"})


# --------------------------------------------------------------------------------------------- readings


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize(("age", "fine"), [(0.05, True), (0.051, False), (np.nan, False)])
def test_no_goal_is_chosen_from_a_reading_older_than_50_ms(
    rig: ProcedureRig, joint: int, age: float, fine: bool
) -> None:
    ages = np.zeros(3)
    ages[joint] = age
    rig.robot.measured = replace(rig.robot.measured, age=ages)
    rig.follows = False
    if fine:
        assert arming.present(rig, NOBODY) is rig.robot.measured.position
        return
    finding = refusal(rig)
    assert (finding.code, finding.joint, finding.bound) == (ReasonCode.HW_DISCONNECTED, joint, 0.05)
    assert finding.value == pytest.approx(age, nan_ok=True)
    assert "prepare" not in rig.hardware.log


def test_the_time_since_the_reading_counts_as_its_age(rig: ProcedureRig) -> None:
    rig.robot.measured = replace(rig.robot.measured, age=np.full(3, 0.03))
    rig.clock.sleep_until(rig.clock.now() + 0.03)
    finding = refusal(rig)
    assert finding.value == pytest.approx(0.06)
    assert "prepare" not in rig.hardware.log


def test_a_reading_that_ages_while_the_devices_are_prepared_ends_arming_before_torque(
    rig: ProcedureRig,
) -> None:
    arm(rig)
    rig.read(age=np.array([0.0, 0.2, 0.0]))
    rig.until_done()
    [outcome] = rig.outcomes
    assert isinstance(outcome, CallRefusal)
    assert (outcome.findings[0].code, outcome.findings[0].joint) == (ReasonCode.HW_DISCONNECTED, 1)
    assert rig.requests() == ["prepare", *OFF]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("beyond", "fine"), [(0.0, True), (0.0086, True), (0.0088, False), (0.1, False)])
def test_a_joint_further_past_its_hard_limits_than_the_guard_allows_is_not_armed(
    rig: ProcedureRig, sign: float, beyond: float, fine: bool
) -> None:
    place = PLACE.copy()
    place[1] = sign * (2.05 + beyond)
    rig.robot.measured = rig.state(place)
    if fine:
        assert arming.present(rig, NOBODY)[1] == place[1]
        return
    finding = refusal(rig)
    assert (finding.code, finding.joint) == (ReasonCode.OUT_OF_LIMIT, 1)
    assert finding.value == place[1]
    assert finding.bound == pytest.approx(sign * (2.05 + GuardThresholds().beyond_hard))
    assert "move it inside by hand" in finding.message
    assert "prepare" not in rig.hardware.log


def test_a_joint_past_the_range_of_goals_gets_the_end_of_that_range(rig: ProcedureRig) -> None:
    place = np.array([0.0, 2.0085, -2.0085])  # goals reach to 2.0
    rig.robot.measured = rig.state(place)
    rig.follows = False
    assert isinstance(armed(rig), CallReply)
    assert all(goal == pytest.approx([0.0, 2.0, -2.0]) for goal in rig.hardware.goals)
    assert rig.robot.written == pytest.approx([0.0, 2.0, -2.0])
    assert rig.hardware.log.count("write goals") == 1


def test_a_joint_whose_position_is_unknown_is_not_armed(rig: ProcedureRig) -> None:
    rig.robot.measured = rig.state(np.array([0.0, np.nan, 0.0]))
    finding = refusal(rig)
    assert (finding.code, finding.joint, finding.value) == (ReasonCode.HW_DISCONNECTED, 1, None)
    assert "prepare" not in rig.hardware.log


def test_a_robot_that_never_hangs_still_is_refused_after_twenty_tries(rig: ProcedureRig) -> None:
    swing = iter(range(10_000))

    def swinging() -> None:
        far = 0.005 * (next(swing) % 2)
        rig.read(position=PLACE + np.array([0.0, far, 0.0]))

    rig.watched = swinging
    finding = refusal(rig)
    assert (finding.code, finding.joint, finding.bound) == (ReasonCode.ARM_FAILED, 1, 2.5)
    assert finding.value == pytest.approx(5.0)
    assert rig.hardware.log.count("write goals") == 20
    assert "torque True" not in rig.hardware.log


def test_the_goal_is_taken_anew_from_where_a_robot_that_moved_came_to_rest(rig: ProcedureRig) -> None:
    def pushed() -> None:
        if rig.hardware.log.count("write goals") == 1:
            rig.read(position=PLACE + 0.1)

    rig.watched = pushed
    assert isinstance(armed(rig), CallReply)
    assert rig.hardware.log.count("write goals") == 2
    assert rig.robot.written == pytest.approx(PLACE + 0.1)


@pytest.mark.parametrize(("ticks", "writes"), [(2.5, 1), (2.6, 2)])
def test_two_ticks_and_a_half_of_motion_are_still(rig: ProcedureRig, ticks: float, writes: int) -> None:
    rig.robot.measured = rig.state(np.zeros(3))

    def pushed() -> None:
        if "write goals" in rig.hardware.log:
            rig.read(position=np.array([0.0, 0.0, ticks * RESOLUTION]))

    rig.watched = pushed
    assert isinstance(armed(rig), CallReply)
    assert rig.hardware.log.count("write goals") == writes


def test_an_unknown_position_while_goals_are_written_is_no_standstill(rig: ProcedureRig) -> None:
    def lost() -> None:
        if rig.hardware.log.count("write goals"):
            rig.read(position=np.array([0.0, np.nan, 0.0]))

    rig.watched = lost
    assert refusal(rig).code is ReasonCode.HW_DISCONNECTED
    assert "torque True" not in rig.hardware.log


# --------------------------------------------------------------------------------------------- torque


@pytest.mark.parametrize(("torque", "first"), [((0, 1, 1), 1), ((1, 0, 0), 0)])
def test_torque_in_some_joints_refuses_arming(rig: ProcedureRig, torque: Any, first: int) -> None:
    rig.found(torque)
    finding = refusal(rig)
    assert (finding.code, finding.joint) == (ReasonCode.ARM_FAILED, first)
    assert (finding.value, finding.bound) == (float(sum(torque)), 0.0)
    assert finding.message.startswith(f"torque is on in {sum(torque)} of 3 joints")
    assert "prepare" not in rig.hardware.log
    assert "torque False" not in rig.hardware.log, "torque that was found on stays"


def test_torque_that_was_found_on_everywhere_is_taken_over(rig: ProcedureRig) -> None:
    rig.found()
    assert isinstance(armed(rig), CallReply)
    assert rig.hardware.log == ["clear", *ORDER, "hold True"]
    assert rig.torque.armed


@pytest.mark.parametrize("step", ORDER)
@pytest.mark.parametrize("error", [BROKEN, SILENT])
def test_a_step_that_fails_ends_with_torque_off_that_is_read_back(
    rig: ProcedureRig, step: str, error: Any
) -> None:
    rig.hardware.failing[step] = error
    finding = refusal(rig)
    assert finding.code is ReasonCode.ARM_FAILED
    assert str(error) in finding.message and ("toe" in finding.message) == (error is SILENT)
    assert rig.requests() == [*ORDER[: ORDER.index(step) + 1], *OFF]
    assert [event.code for event in rig.book.events] == ["arming", "connected"]
    assert not rig.torque.energising and not rig.torque.unconfirmed and not rig.torque.armed
    assert rig.executor.reference is None


def test_torque_that_stays_unconfirmed_after_a_failure_is_reported(rig: ProcedureRig) -> None:
    rig.hardware.failing |= {"torque True": BROKEN, "torque False": [SILENT] * 500}
    refusal(rig)
    assert "TORQUE_MISMATCH" in rig.codes()
    assert rig.torque.unconfirmed and not rig.torque.energising


@pytest.mark.parametrize("step", ORDER)
def test_torque_that_was_on_before_stays_on_when_arming_fails(rig: ProcedureRig, step: str) -> None:
    rig.found()
    rig.hardware.failing[step] = BROKEN
    assert refusal(rig).code is ReasonCode.ARM_FAILED
    assert rig.requests() == ORDER[: ORDER.index(step) + 1]
    assert rig.hardware.log[-1] == "clear", "nothing that was queued may leave later"
    assert rig.condition.state == "connected"
    assert not rig.torque.energising


@pytest.mark.parametrize("when", ["write goals", "torque True"])
@pytest.mark.parametrize("what", ["a fault", "a lost port"])
def test_what_happens_meanwhile_ends_arming(rig: ProcedureRig, when: str, what: str) -> None:
    def disturb() -> None:
        if when not in rig.hardware.log or rig.condition.state != "arming":
            return
        if what == "a fault":
            rig.condition.latch(HOT)
        else:
            rig.condition.change(RobotEvent.PORT_LOST)

    rig.watched = disturb
    finding = refusal(rig)
    assert finding.code is ReasonCode.ARM_FAILED and "meanwhile" in finding.message
    assert (finding.value, finding.bound) == (None, None)
    assert rig.requests() == [*ORDER[: ORDER.index(when) + 1], *OFF]


@pytest.mark.parametrize(("jump", "fine"), [(0.049, True), (0.051, False), (-0.051, False), (np.nan, False)])
def test_a_joint_that_jumps_at_torque_on_ends_with_torque_off(
    rig: ProcedureRig, jump: float, fine: bool
) -> None:
    def slip() -> None:
        if "torque True" in rig.hardware.log:
            rig.read(position=PLACE + np.array([0.0, 0.0, jump]))

    rig.watched = slip
    outcome = armed(rig)
    assert isinstance(outcome, CallReply) == fine
    if not fine:
        [finding] = outcome.findings
        assert (finding.code, finding.joint, finding.bound) == (ReasonCode.ARM_FAILED, 2, 0.05)
        assert finding.value == pytest.approx(abs(jump), nan_ok=True)
        assert rig.requests() == [*ORDER, *OFF]


def test_a_jump_of_exactly_a_twentieth_of_a_radian_is_none(rig: ProcedureRig) -> None:
    rig.robot.measured = rig.state(np.zeros(3))

    def slip() -> None:
        if "torque True" in rig.hardware.log:
            rig.read(position=np.array([0.0, 0.05, 0.0]))

    rig.watched = slip
    assert isinstance(armed(rig), CallReply)


@pytest.mark.parametrize(("falls", "off"), [(True, True), (False, False)])
def test_a_servo_that_would_read_another_turn_at_torque_on_is_not_armed(
    rig: ProcedureRig, falls: bool, off: bool
) -> None:
    whole = np.full(3, 4096)
    rig.robot.joints.turns = SimpleNamespace(
        known=np.ones(3, np.bool_), falls=np.array([False, falls, False]), whole=whole, begin=np.zeros(3, int)
    )
    rig.hardware.readings.raw.ticks = np.array([100, 5000, 300])
    rig.hardware.readings.shift = np.zeros(3, np.int64)
    if not off:
        assert isinstance(armed(rig), CallReply)
        return
    finding = refusal(rig)
    assert (finding.code, finding.joint) == (ReasonCode.CALIB_MISMATCH, 1)
    assert (finding.value, finding.bound) == (904.0, 5000.0)
    assert "would read 904 at torque-on, not 5000" in finding.message
    assert finding.message.endswith("or set its offset to 0")
    assert "torque True" not in rig.hardware.log


def test_a_turn_that_is_not_known_does_not_forbid_arming(rig: ProcedureRig) -> None:
    rig.robot.joints.turns = SimpleNamespace(
        known=np.array([True, False, True]),
        falls=np.ones(3, np.bool_),
        whole=np.full(3, 4096),
        begin=np.zeros(3, int),
    )
    rig.hardware.readings.raw.ticks = np.array([100, 5000, 300])
    assert isinstance(armed(rig), CallReply)


def test_the_calibrated_turn_is_part_of_the_count_that_is_compared(rig: ProcedureRig) -> None:
    rig.robot.joints.turns = SimpleNamespace(
        known=np.ones(3, np.bool_), falls=np.ones(3, np.bool_), whole=np.full(3, 4096), begin=np.zeros(3, int)
    )
    rig.hardware.readings.shift = np.array([0, 0, 4096])
    finding = refusal(rig)
    assert (finding.joint, finding.value, finding.bound) == (2, 0.0, 4096.0)


# --------------------------------------------------------------------------------------------- ended by force


@pytest.mark.parametrize("step", ORDER)
@pytest.mark.parametrize("latched", [False, True])
def test_whoever_ends_arming_finds_an_empty_queue_and_torque_to_switch_off(
    rig: ProcedureRig, step: str, latched: bool
) -> None:
    arm(rig)
    while rig.hardware.log[-1] != step:
        rig.tick()
    rig.hardware.log.clear()
    if latched:
        rig.condition.latch(HOT)
    rig.procedures.abandon()
    assert rig.hardware.log == ["clear"]
    assert rig.torque.energising == (step == "torque True")
    assert rig.condition.state == "connected"
    cause = f"THERMAL_HEADROOM: {HOT.message}" if latched else "something more urgent"
    assert rig.outcomes == [CallFailure("Busy", {"what": f"arming was ended by {cause}"})]


def test_an_arming_that_is_ended_while_it_switches_off_is_answered(rig: ProcedureRig) -> None:
    """The failure before it has no reply yet then."""
    rig.hardware.failing |= {"torque True": BROKEN, "torque False": [SILENT] * 500}
    arm(rig)
    while "torque False" not in rig.hardware.log:
        rig.tick()
    rig.procedures.abandon()
    [outcome] = rig.outcomes
    assert isinstance(outcome, CallFailure)
    assert rig.torque.unconfirmed


@pytest.mark.parametrize("energised", [False, True])
def test_giving_an_arming_up_switches_off_what_it_switched_on(rig: ProcedureRig, energised: bool) -> None:
    rig.condition.change(RobotEvent.ARM)
    if energised:
        rig.torque.begin_energising()
    rig.executor.begin(PLACE)
    rig.own(Priority.DISARM, lambda: arming.give_up(rig))
    rig.until_done()
    assert ("torque False" in rig.hardware.log) == energised
    assert rig.hardware.log[0] == "clear"
    assert rig.executor.reference is None
    assert rig.condition.state == "connected"
    assert rig.outcomes == [None]
