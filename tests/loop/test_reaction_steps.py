"""Reactions to the guard's decision and to faults of the daemon itself, one by one, on scripted buses."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import path
from tests.support.procedure_rig import PLACE, WHY, ProcedureRig
from twind.loop.procedures.internal_faults import QUIET, fail, inhibit
from twind.loop.procedures.procedure_runner import Priority
from twind.loop.tick.reactions import Reactions
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.trajectory import Reference
from twind.safety.guard_types import GuardDecision, Reaction

BUG = Finding(ReasonCode.INTERNAL, message="a bug")
GOAL = Reference(PLACE + 0.01, np.zeros(3), np.zeros(3))
ALERT = Finding(ReasonCode.SERVO_ALERT, 0)
REBOOT = Finding(ReasonCode.SERVO_REBOOTED, 2)


class ReactionRig(ProcedureRig):
    """A held robot, its reactions, and stand-ins for what they tell."""

    def __init__(self) -> None:
        super().__init__()
        self.guard = SimpleNamespace(bars=())
        self.restarted: list[Any] = []
        self.marred: list[Any] = []
        identity: Any = SimpleNamespace(
            restarted=lambda found: self.restarted.append(list(found)),
            verified=SimpleNamespace(mar=lambda found: self.marred.append(list(found))),
        )
        self.twin = SimpleNamespace(resets=0, contact=lambda joint: None)
        parts: Any = SimpleNamespace(guard=self.guard, twin=self.twin)
        self.reactions = Reactions(self, parts, identity, self.release)
        self.hold()

    def react(self, reference: Reference | None = GOAL, **decision: Any) -> Any:
        """React to a decision."""
        return self.reactions.react(GuardDecision(**decision), reference, self.clock.now())

    def moving(self) -> None:
        """A motion is under way."""
        assert self.executor.submit("wave", path([2.0], PLACE + 0.3)) is None
        self.tick()
        assert self.executor.motion is Motion.ACTIVE

    def ended(self) -> list[tuple[str, tuple[Finding, ...]]]:
        return [(goal.phase, tuple(goal.findings)) for goal in self.executor.outcomes()]


def waits() -> Iterator[None]:
    while True:
        yield


@pytest.fixture
def rig() -> ReactionRig:
    return ReactionRig()


# --------------------------------------------------------------------------------------------- the goal


def test_without_a_reaction_the_goal_leaves(rig: ReactionRig) -> None:
    assert rig.react() is GOAL.position
    assert rig.book.events == [] and rig.hardware.log == [] and rig.restarted == [] == rig.marred


def test_without_a_goal_nothing_leaves(rig: ReactionRig) -> None:
    assert rig.react(None) is None


def test_an_inhibited_robot_gets_no_goal(rig: ReactionRig) -> None:
    rig.torque.inhibit()
    assert rig.react() is None


def test_a_refused_goal_is_replaced_by_the_last_one_which_is_then_held(rig: ReactionRig) -> None:
    rig.moving()
    written = rig.robot.written
    assert rig.react(goal_refused=True) is written
    assert rig.executor.reference.position.tolist() == written.tolist()
    assert rig.executor.motion is Motion.HOLDING


def test_a_first_goal_that_is_refused_leaves_nothing(rig: ReactionRig) -> None:
    rig.robot.written = None
    rig.executor.idle()
    assert rig.react(goal_refused=True) is None
    assert rig.executor.reference is None


# --------------------------------------------------------------------------------------------- reports


def test_each_code_is_one_event_with_all_its_joints(rig: ReactionRig) -> None:
    other = Finding(ReasonCode.FOLLOW_ERR, 2, message="the other")
    rig.react(reaction=Reaction.HOLD, findings=(WHY, other, BUG))
    first, second = rig.book.events[:2]
    assert (first.level, first.code, first.message, first.stop) == (
        "warning",
        "FOLLOW_ERR",
        WHY.message,
        "hold",
    )
    assert first.findings == [WHY, other]
    assert (second.code, second.findings, second.stop) == ("INTERNAL", [BUG], "hold")


def test_a_finding_without_a_reaction_stops_nothing(rig: ReactionRig) -> None:
    rig.react(findings=(WHY,))
    assert [event.stop for event in rig.book.events] == [""]
    assert rig.condition.latches == {}


def test_what_is_latched_names_how_many_joints_it_concerns(rig: ReactionRig) -> None:
    joints = (1, 2, 2, None)
    found = tuple(Finding(ReasonCode.FOLLOW_ERR, joint, message="far") for joint in joints)
    rig.react(findings=found, latches=True)
    assert rig.condition.latches[ReasonCode.FOLLOW_ERR].message == "far (and 1 more joints)"
    assert rig.condition.latches[ReasonCode.FOLLOW_ERR].joint == 1
    assert rig.condition.state is RobotState.FAULT


def test_a_single_joint_is_latched_as_it_was_found(rig: ReactionRig) -> None:
    rig.react(findings=(WHY,), latches=True)
    assert rig.condition.latches == {WHY.code: WHY}


@pytest.mark.parametrize("barred", [False, True])
def test_servos_that_restarted_or_raised_an_alert_lose_their_verification(
    rig: ReactionRig, barred: bool
) -> None:
    found = (WHY, ALERT, REBOOT)
    rig.guard.bars = found if barred else ()
    rig.react(findings=() if barred else found)
    assert rig.restarted == [[REBOOT]]
    assert rig.marred == [[ALERT]]


def test_without_a_restart_no_bus_is_identified_anew(rig: ReactionRig) -> None:
    rig.react(findings=(ALERT,))
    assert rig.restarted == [] and rig.marred == [[ALERT]]


def test_a_finding_names_the_contact_that_blocks_its_joint_in_the_simulation(rig: ReactionRig) -> None:
    rig.twin.contact = lambda joint: SimpleNamespace(bodies=("arm", "table"), depth=0.001 * joint)
    rig.react(findings=(Finding(ReasonCode.MIRROR_DRIFT, 2, message="away"),))
    assert "arm and table touch in the simulation, 2.0 mm deep" in rig.book.events[0].message


def test_a_bus_whose_requests_reach_no_device_is_given_up(rig: ReactionRig) -> None:
    rig.react(gone=(1,))
    assert rig.hardware.given_up == [1]


# --------------------------------------------------------------------------------------------- the ladder


def test_a_hold_ends_the_motion_with_its_causes(rig: ReactionRig) -> None:
    rig.moving()
    rig.react(reaction=Reaction.HOLD, causes=(WHY,))
    assert rig.ended() == [("aborted", (WHY,))]
    assert rig.procedures.rank is None


@pytest.mark.parametrize("reaction", [Reaction.NONE, Reaction.HOLD - 1])
def test_less_than_a_hold_ends_nothing(rig: ReactionRig, reaction: int) -> None:
    rig.moving()
    rig.react(reaction=Reaction(reaction), causes=(WHY,))
    assert rig.ended() == [] and rig.executor.motion is Motion.ACTIVE


def test_a_robot_that_holds_is_not_stopped_again(rig: ReactionRig) -> None:
    stops: list[Any] = []
    rig.executor.stop = lambda *args: stops.append(args)
    rig.react(reaction=Reaction.HOLD, causes=(WHY,))
    assert stops == []
    rig.moving()
    rig.react(reaction=Reaction.HOLD, causes=(WHY,))
    assert stops == [("aborted", (WHY,))]


@pytest.mark.parametrize(("mode", "place"), [(Mode.LIVE, 0.2), (Mode.MIRROR, 0.7)])
def test_a_blocked_joint_is_held_where_it_is(rig: ReactionRig, mode: Mode, place: float) -> None:
    rig.condition.mode = mode
    rig.robot.measured = rig.state(np.array([0.0, 0.2, 3.0]))
    rig.robot.simulated = rig.state(np.array([0.0, 0.7, 3.0]))
    given: list[Any] = []
    rig.executor.give_in = lambda joints, where, findings: given.append((joints, where.tolist(), findings))
    rig.react(reaction=Reaction.HOLD, here=(1,), causes=(WHY,))
    assert given == [([1], [0.0, place, 2.0], (WHY,))]


def test_all_joints_that_the_same_motors_turn_are_held_with_it(rig: ReactionRig) -> None:
    rig.robot.joints.transmission_groups = (np.array([1, 2]),)
    given: list[Any] = []
    rig.executor.give_in = lambda joints, where, findings: given.append(joints)
    rig.react(reaction=Reaction.HOLD, here=(1,))
    rig.react(reaction=Reaction.HOLD, here=(0,))
    assert given == [[1, 2], [0]]


def test_a_procedure_that_moves_the_robot_is_not_made_to_give_in(rig: ReactionRig) -> None:
    rig.own(Priority.FAULT, waits)
    rig.executor.give_in = lambda *args: pytest.fail("gave in")
    rig.moving()
    rig.react(reaction=Reaction.HOLD, here=(1,), causes=(WHY,))
    assert rig.ended() == [("aborted", (WHY,))]


def test_a_settle_lowers_the_robot_for_its_causes(rig: ReactionRig) -> None:
    rig.moving()
    rig.react(reaction=Reaction.SETTLE, causes=(WHY,))
    assert rig.procedures.rank is Priority.FAULT
    assert rig.torque.soft_since is None
    assert rig.ended()[0] == ("aborted", (WHY,))
    assert rig.condition.state is RobotState.SETTLING


def test_a_fault_precedes_its_reaction(rig: ReactionRig) -> None:
    rig.react(reaction=Reaction.SETTLE, findings=(WHY,), causes=(WHY,), latches=True)
    assert rig.condition.state is RobotState.FAULT
    assert rig.codes() == ["FOLLOW_ERR", "fault"]


def test_a_damp_is_demanded_before_the_robot_is_released(rig: ReactionRig) -> None:
    rig.react(reaction=Reaction.DAMP, causes=(WHY,))
    assert rig.torque.soft_since == rig.clock.now()
    assert rig.procedures.rank is Priority.FAULT
    assert rig.book.events[0].findings == [WHY]
    rig.tick()
    assert rig.requests() == ["damp"]


@pytest.mark.parametrize("reaction", [Reaction.SETTLE, Reaction.DAMP])
def test_a_robot_without_torque_is_not_lowered(reaction: Reaction) -> None:
    rig = ReactionRig()
    rig.torque.lose_every_bus()
    rig.moving()
    rig.react(reaction=reaction, causes=(WHY,))
    assert rig.procedures.rank is None and rig.torque.soft_since is None
    assert rig.ended() == [("aborted", (WHY,))], "it holds instead"


def test_a_release_under_way_goes_on_and_is_damped_when_that_is_demanded(rig: ReactionRig) -> None:
    rig.own(Priority.ESTOP, waits)
    rig.react(reaction=Reaction.DAMP, causes=(WHY,))
    assert rig.procedures.rank is Priority.ESTOP
    assert rig.torque.soft_since is not None


@pytest.mark.parametrize("reaction", [Reaction.HOLD, Reaction.SETTLE, Reaction.DAMP])
def test_nothing_softer_ends_an_inhibit(rig: ReactionRig, reaction: Reaction) -> None:
    rig.react(reaction=Reaction.INHIBIT, findings=(BUG,))
    rig.hardware.log.clear()
    rig.react(reaction=reaction, causes=(WHY,), here=(1,))
    assert rig.hardware.log == [] and rig.procedures.rank is None and rig.torque.soft_since is None
    assert rig.torque.armed and rig.torque.inhibited


def test_an_inhibit_writes_nothing_and_names_its_cause(rig: ReactionRig) -> None:
    rig.moving()
    assert rig.react(reaction=Reaction.INHIBIT, findings=(BUG, WHY)) is None
    assert rig.torque.inhibited
    assert rig.condition.latches == {BUG.code: BUG}


# --------------------------------------------------------------------------------------------- pace


def test_a_motion_is_slowed_and_that_is_reported_once_with_its_reason(rig: ReactionRig) -> None:
    rig.moving()
    rig.react(pace=0.5, findings=(WHY,), slowing=(WHY.code,))
    rig.react(pace=0.4)
    assert rig.executor.pace == 0.4
    [_, event] = rig.book.events
    assert (event.level, event.code) == ("info", "PACE")
    assert event.message == "the motion is slowed to 50%: FOLLOW_ERR"
    assert rig.executor.slowed_by == ()
    rig.react(pace=1.0)
    assert rig.executor.pace == 1.0
    rig.react(pace=0.99, slowing=(WHY.code,))
    assert rig.book.events[-1].message == "the motion is slowed to 99%: FOLLOW_ERR"
    assert rig.executor.slowed_by == (WHY.code,)


def test_a_motion_at_its_own_speed_is_not_reported(rig: ReactionRig) -> None:
    rig.moving()
    rig.react()
    assert rig.executor.motion is Motion.ACTIVE and rig.book.events == []


def test_a_hold_that_is_paced_is_not_reported(rig: ReactionRig) -> None:
    rig.react(pace=0.5)
    assert rig.book.events == []


def test_the_way_to_the_rest_pose_is_never_slowed(rig: ReactionRig) -> None:
    rig.moving()
    rig.own(Priority.FAULT, waits)
    rig.react(pace=0.5)
    assert rig.executor.pace == 1.0 and rig.book.events == []


# --------------------------------------------------------------------------------------------- fence

FENCE = (PLACE - 0.1, PLACE + 0.1)


def test_the_fence_of_a_decision_bounds_the_stream_until_the_next_one(rig: ReactionRig) -> None:
    rig.react(fence=FENCE)
    assert rig.executor.fence is FENCE
    rig.react()
    assert rig.executor.fence is None


def test_offsets_of_gravity_compensation_stay_within_the_fence(rig: ReactionRig) -> None:
    """Commands are bounded by less than the goals, as both differ by the offset."""
    narrower = (PLACE - 0.05, PLACE + 0.08)

    def of_commands(fence: Any) -> Any:
        assert fence is FENCE
        return narrower

    rig.robot.compensation = SimpleNamespace(fence_of_commands=of_commands)
    rig.react(fence=FENCE)
    assert rig.executor.fence is narrower
    rig.react()
    assert rig.executor.fence is None


def test_the_way_to_the_rest_pose_has_no_fence(rig: ReactionRig) -> None:
    rig.own(Priority.FAULT, waits)
    rig.react(fence=FENCE)
    assert rig.executor.fence is None


# --------------------------------------------------------------------------------------------- simulation


@pytest.mark.parametrize(("mode", "ends"), [(Mode.SIM, True), (Mode.MIRROR, True), (Mode.LIVE, False)])
def test_a_simulation_that_broke_down_is_reported_once_and_ends_its_motion(
    rig: ReactionRig, mode: Mode, ends: bool
) -> None:
    rig.moving()
    rig.condition.mode = mode
    rig.reactions.watch_simulation()
    assert rig.book.events == []
    rig.twin.resets = 2
    rig.reactions.watch_simulation()
    rig.reactions.watch_simulation()
    [event] = rig.book.events
    assert (event.level, event.code) == ("error", "INTERNAL")
    assert event.findings[0].code is ReasonCode.INTERNAL
    assert event.findings[0].value == 2.0 and event.findings[0].message == event.message
    assert rig.ended() == ([("aborted", tuple(event.findings))] if ends else [])


def test_a_simulation_that_broke_down_at_rest_ends_nothing(rig: ReactionRig) -> None:
    rig.condition.mode = Mode.SIM
    rig.executor.idle()
    rig.executor.stop = lambda *args: pytest.fail("stopped")
    rig.twin.resets = 1
    rig.reactions.watch_simulation()


# --------------------------------------------------------------------------------------------- own faults


def test_an_internal_fault_holds_the_last_goal_and_latches(rig: ReactionRig) -> None:
    rig.moving()
    written = rig.robot.written
    fail(rig, BUG)
    assert rig.executor.motion is Motion.HOLDING
    assert rig.executor.reference.position.tolist() == written.tolist()
    assert rig.condition.latches == {BUG.code: BUG} and rig.condition.state is RobotState.FAULT
    first, second = rig.book.events
    assert (first.level, first.code, first.message, first.findings, first.stop) == (
        "error",
        "INTERNAL",
        "a bug",
        [BUG],
        "hold",
    )
    assert second.code == "fault"


@pytest.mark.parametrize("odd", ["idle", "nothing written"])
def test_without_a_motion_or_a_goal_nothing_is_begun(rig: ReactionRig, odd: str) -> None:
    if odd == "idle":
        rig.executor.idle()
    else:
        rig.robot.written = None
    before = rig.executor.motion
    fail(rig, BUG)
    assert rig.executor.motion is before


def test_an_internal_fault_ends_an_arming_with_torque_off(rig: ReactionRig) -> None:
    rig.torque.lose_every_bus()
    rig.own(Priority.ARM, waits)
    rig.torque.begin_energising()
    fail(rig, BUG)
    assert rig.procedures.rank is Priority.DISARM
    [outcome] = rig.outcomes
    assert outcome.parameters == {"what": "arming was ended by INTERNAL: a bug"}
    assert "torque False" in rig.hardware.log


@pytest.mark.parametrize("rank", [rank for rank in Priority if rank > Priority.ARM])
def test_a_robot_on_its_way_down_goes_on_after_an_internal_fault(rig: ReactionRig, rank: Priority) -> None:
    rig.moving()
    rig.own(rank, waits)
    fail(rig, BUG)
    assert rig.procedures.rank is rank
    assert rig.executor.motion is Motion.ACTIVE


def test_an_inhibit_is_quiet_until_the_watchdogs_have_tripped(rig: ReactionRig) -> None:
    rig.moving()
    inhibit(rig, BUG, 50.0)
    assert rig.hardware.log == ["clear", "hold False"]
    assert rig.hardware.quiet_until == 50.0 + QUIET and QUIET == 0.3
    assert rig.executor.reference is None
    assert rig.torque.armed and rig.torque.inhibited
    [event] = rig.book.events
    assert (event.code, event.stop) == ("inhibited", "inhibit")


@pytest.mark.parametrize("rank", [rank for rank in Priority if rank is not Priority.ARM])
@pytest.mark.parametrize("switching", [False, True])
def test_an_inhibit_ends_a_way_down_but_not_torque_that_is_going_off(
    rig: ReactionRig, rank: Priority, switching: bool
) -> None:
    rig.own(rank, waits)
    rig.torque.demand_damping(1.0)
    if switching:
        rig.torque.begin_energising()
    before = rig.hardware.quiet_until
    inhibit(rig, BUG, 50.0)
    assert rig.procedures.rank is (rank if switching else None)
    assert rig.hardware.quiet_until == (before if switching else 50.0 + QUIET)
    assert rig.torque.soft_since == (1.0 if switching else None)
    if not switching:
        [outcome] = rig.outcomes
        assert outcome.parameters["what"].endswith("was ended by INTERNAL: a bug")


@pytest.mark.parametrize("switching", [False, True])
def test_an_inhibit_ends_an_arming_and_torque_that_it_switches_on_goes_off(
    rig: ReactionRig, switching: bool
) -> None:
    rig.own(Priority.ARM, waits)
    if switching:
        rig.torque.begin_energising()
    inhibit(rig, BUG, 50.0)
    assert rig.procedures.rank is (Priority.DISARM if switching else None)
    assert rig.hardware.log.count("torque False") == switching
    assert rig.hardware.quiet_until == (-np.inf if switching else 50.0 + QUIET)
