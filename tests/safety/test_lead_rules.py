"""LEAD_LIMIT: a goal leads a joint without a watchdog only so far; it waits, and is never pulled back."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.gate_rig import ratings
from tests.support.guard_rig import FINE, LIMITS, PERIOD, N, facts, reading
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot.joint_state import JointState
from twind.robot.modes import Mode, Motion
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.guard import MOVING, REACTING, Guard, GuardDecision, GuardThresholds, Reaction
from twind.safety.lead_rules import LeadRules, TorqueAtRest

MOST = 0.12  # rad
SLOWER = 0.09  # rad, three quarters of it
STIFF = 10.0  # N·m/rad
TINY = 1e-9
JOINT = 1
CALM = GuardThresholds(gap=inf, follow=10.0, follow_damp=10.0)  # no other rule applies
WAIT = CALM.lead_for


def guard(
    at_rest: TorqueAtRest | None = None, lead: tuple[float, ...] = (inf, MOST, MOST), stiffness: float = STIFF
) -> Guard:
    rated = replace(ratings(N), lead=np.array(lead), stiffness=np.full(N, stiffness))
    return Guard(LIMITS, CALM, ratings=rated, at_rest=at_rest)


def load(torque: float) -> TorqueAtRest:
    """N·m that each joint holds."""
    return lambda position: np.full(N, torque)


def follow(
    to: Guard,
    away: float,
    speed: float = 1e-6,
    *,
    own: float | None = None,
    joint: int = JOINT,
    **over: object,
) -> GuardDecision:
    """Decision on a goal `away` rad from its joint; it moves with `speed` rad/s, the joint with `own`."""
    now = over.get("now", 10.0)
    assert isinstance(now, float)
    here = reading(time=now)
    place = np.zeros(N)
    fast = np.zeros(N)
    place[joint] = away
    fast[joint] = speed
    turning = np.zeros(N)
    turning[joint] = speed if own is None else own
    given = {"goal": Reference(place, fast, np.zeros(N)), "previous": place}
    given |= {"measured": replace(here, velocity=turning)}
    return to.judge(facts(**(given | over)))


@pytest.mark.parametrize(
    ("away", "pace"),
    [
        (0.0, 1.0),
        (SLOWER, 1.0),
        (SLOWER + TINY, 1.0 - TINY / (MOST - SLOWER)),
        (0.105, 0.5),
        (0.1169, 0.1033),
        (0.1171, 0.0),  # less than a tenth: the motion waits
        (MOST, 0.0),
        (0.19, 0.0),
        (nan, 0.0),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_motion_is_slower_near_the_limit_and_waits_at_it(away: float, pace: float, sign: float) -> None:
    judged = follow(guard(), sign * away, sign * 1e-6)
    assert judged.reaction is Reaction.NONE or away != away
    assert judged.pace == pytest.approx(pace, abs=1e-3)
    assert (judged.pace < 1.0) is (pace < 1.0)
    assert judged.fence is None
    found = [each for each in judged.findings if each.code is ReasonCode.LEAD_LIMIT]
    assert len(found) == (pace < 1.0)
    if found and away == away:
        assert judged.slowing == (ReasonCode.LEAD_LIMIT,)
        assert (found[0].joint, found[0].bound) == (JOINT, MOST)
        assert found[0].value == pytest.approx(away)
        assert found[0].message == (
            "its goal leads it, beyond the sag of its load, and it has no watchdog: "
            "the motion is slower, or waits"
        )


def test_a_device_with_a_watchdog_may_be_led_as_far_as_ever() -> None:
    assert follow(guard(), 0.19, 1.0, joint=0) == FINE
    assert follow(Guard(LIMITS, ratings=ratings(N)), 0.19, 1.0) == FINE


@pytest.mark.parametrize(
    ("speed", "own", "coming"),
    [
        (1.0, 0.0, 0.025),
        (1.0, 0.5, 0.00625),
        (0.5, -1.0, 0.00625),
        (1.0, 1.5, 0.0),
        (1.0, -1.0, 0.025),
        (-1.0, 0.0, 0.0),
        (1.0, nan, 0.025),
    ],
)
def test_the_way_that_the_goal_needs_to_stop_counts(speed: float, own: float, coming: float) -> None:
    """At 20 rad/s² a goal of 1 rad/s goes on for 0.025 rad; it counts as far as the joint stays behind."""
    assert LIMITS.acceleration[JOINT] == 20.0
    below = follow(guard(), SLOWER - coming - 1e-6, speed, own=own)
    beyond = follow(guard(), SLOWER - coming + 1e-6, speed, own=own)
    assert below.pace == 1.0
    assert (beyond.pace < 1.0) is (speed > 0.0)


@pytest.mark.parametrize(
    ("torque", "away", "lead"),
    [
        (2.0, 0.2, 0.0),  # a sag of 0.2 rad explains it
        (2.0, 0.1, 0.0),  # something else carries the load: nothing would move
        (2.0, 0.31, 0.11),
        (2.0, -0.11, 0.11),  # against the load: whole
        (-2.0, -0.31, 0.11),
        (-2.0, 0.11, 0.11),
        (nan, 0.11, 0.11),
        (inf, 0.11, 0.11),
    ],
)
def test_the_sag_of_the_load_is_no_lead(torque: float, away: float, lead: float) -> None:
    judged = follow(guard(load(torque)), away, np.copysign(1e-6, away))
    found = [each for each in judged.findings if each.code is ReasonCode.LEAD_LIMIT]
    assert [each.value for each in found] == ([pytest.approx(lead)] if lead else [])
    assert (judged.pace < 1.0) is (lead > 0.0)


def test_an_unknown_stiffness_explains_no_lead() -> None:
    assert follow(guard(load(2.0), stiffness=nan), 0.11).pace < 1.0


def test_the_load_is_computed_only_where_a_joint_is_far_from_its_goal() -> None:
    asked: list[Floats] = []

    def torque(position: Floats) -> Floats:
        asked.append(position)
        return np.zeros(N)

    follow(guard(torque), SLOWER)
    assert not asked
    follow(guard(torque), SLOWER + 0.001)
    assert len(asked) == 1


def test_a_goal_that_comes_back_to_its_joint_is_not_slowed() -> None:
    to = guard()
    assert follow(to, 0.15, -1e-6).pace == 1.0
    assert follow(to, 0.15, 0.0).pace == 1.0  # it moves nowhere: others may
    assert follow(to, 0.15, 1e-6).pace == 0.0
    assert follow(to, 0.15, 0.0).pace == 0.0  # it waits
    assert follow(to, 0.08, 0.0).pace == 1.0
    assert follow(to, 0.15, 0.0).pace == 1.0
    assert follow(to, 0.15, 1e-6).pace == 0.0
    assert follow(to, 0.15, -1e-6).pace == 1.0
    assert follow(to, 0.15, 0.0).pace == 1.0


def test_the_joint_that_is_farthest_beyond_its_own_limit_is_named_and_decides() -> None:
    to = guard(lead=(0.16, MOST, 0.02))
    place = np.array([0.155, 0.1, 0.019])
    goal = Reference(place, np.full(N, 1e-6), np.zeros(N))
    judged = to.judge(facts(goal=goal, previous=place))
    (finding,) = judged.findings
    assert (finding.joint, finding.value, finding.bound) == (2, pytest.approx(0.019), 0.02)
    assert judged.pace == pytest.approx(0.125)


@pytest.mark.parametrize(
    "over",
    [
        {"motion": Motion.HOLDING},
        {"motion": Motion.IDLE},
        {"mode": Mode.SIM},
        {"torque_expected": False},
        {"torque_settled": False},
        {"goal": None},
        {"measured": None},
        *({"state": state} for state in REACTING),
    ],
)
def test_stops_holds_and_simulations_are_not_limited_and_begin_anew(over: dict[str, object]) -> None:
    to = guard()
    assert follow(to, 0.15).pace == 0.0
    other = follow(to, 0.15, **over)
    assert ReasonCode.LEAD_LIMIT not in [each.code for each in (*other.findings, *other.causes)]
    assert (other.pace, other.fence) == (1.0, None)
    assert follow(to, 0.15, 0.0).pace == 1.0  # nothing is remembered


@pytest.mark.parametrize(("joint", "limp"), [(1, True), (2, False)])
def test_a_limp_joint_is_led_by_no_goal_and_the_others_are_as_ever(joint: int, limp: bool) -> None:
    judged = follow(guard(), 0.15, joint=joint, limp=np.array([False, True, False]))
    assert judged.pace == (1.0 if limp else 0.0)
    assert [found.joint for found in judged.findings] == ([] if limp else [joint])


def test_exactly_at_three_quarters_of_the_bound_beyond_its_sag_a_joint_is_not_slowed() -> None:
    """Numbers without rounding: 3/4 of 1/8 rad, and a sag of 1/16 rad."""
    to = guard(load(0.5), lead=(inf, 0.125, 0.125), stiffness=8.0)
    assert follow(to, 0.09375 + 0.0625) == FINE
    assert follow(to, 0.09375 + 0.0625 + TINY).pace < 1.0


def test_a_motion_that_waits_for_two_seconds_is_held_and_another_may_begin() -> None:
    to = guard()
    for now, reaction in (
        (10.0, Reaction.NONE),
        (10.0 + WAIT - 0.001, Reaction.NONE),
        (10.0 + WAIT, Reaction.HOLD),
    ):
        judged = follow(to, 0.15, 0.0 if now > 10.0 else 1e-6, now=now)
        assert judged.reaction is reaction
        assert judged.pace == (1.0 if reaction else 0.0)
        assert (judged.latches, judged.goal_refused, judged.here) == (False, False, ())
    (cause,) = judged.causes
    assert cause.message.endswith("holding, as the motion waited 2 s near this bound: what blocks it?")
    assert to.holding(0, PERIOD) == ()


@pytest.mark.parametrize(("away", "speed"), [(0.08, 1e-6), (0.1, 1e-6), (0.15, -1e-6)])
def test_a_joint_that_follows_again_has_its_time_anew(away: float, speed: float) -> None:
    to = guard()
    follow(to, 0.15)
    follow(to, away, speed, now=11.9)
    assert follow(to, 0.15, now=12.0).reaction is Reaction.NONE
    assert follow(to, 0.15, now=13.9).reaction is Reaction.NONE
    assert follow(to, 0.15, now=14.0).reaction is Reaction.HOLD


@pytest.mark.parametrize(
    ("torque", "low", "high"), [(0.0, -MOST, MOST), (0.5, -MOST, MOST + 0.05), (-0.5, -MOST - 0.05, MOST)]
)
def test_a_stream_is_fenced_around_its_joint_and_not_slowed(torque: float, low: float, high: float) -> None:
    to = guard(load(torque))
    for now in (10.0, 15.0):
        judged = follow(
            to,
            np.copysign(0.15, -torque),
            np.copysign(1e-6, -torque),
            motion=Motion.STREAMING,
            setpoint_age=0.0,
            now=now,
        )
        assert (judged.pace, judged.reaction) == (1.0, Reaction.NONE)
        assert judged.fence is not None
        lower, upper = judged.fence
        assert lower.tolist() == [-inf, pytest.approx(low), pytest.approx(low)]
        assert upper.tolist() == [inf, pytest.approx(high), pytest.approx(high)]
    assert (
        follow(guard(), 0.15, motion=Motion.STREAMING, setpoint_age=0.0)
        .findings[0]
        .message.endswith("its setpoints are limited")
    )
    assert follow(guard(), SLOWER, motion=Motion.STREAMING, setpoint_age=0.0) == FINE


@pytest.mark.parametrize(("lateness", "lease_ok"), [(0.01, True), (0.0, False)], ids=["warned of", "held"])
def test_a_stream_keeps_its_fence_beside_another_finding(lateness: float, lease_ok: bool) -> None:
    judged = follow(
        guard(), 0.15, motion=Motion.STREAMING, setpoint_age=0.0, lateness=lateness, lease_ok=lease_ok
    )
    assert judged.fence is not None
    assert [bound[JOINT] for bound in judged.fence] == [-MOST, MOST]


def test_the_goal_of_a_joint_without_a_position_stays() -> None:
    measured = replace(reading(), position=np.array([0.0, nan, 0.0]))
    judged = follow(guard(), 0.15, measured=measured, motion=Motion.STREAMING, setpoint_age=0.0)
    assert judged.fence is not None
    assert [bound[JOINT] for bound in judged.fence] == [0.15, 0.15]


def test_limits_and_gains_of_a_reload_count() -> None:
    to = guard(load(1.0))
    assert follow(to, 0.18).pace == 1.0
    stiff = replace(ratings(N), lead=np.full(N, MOST), stiffness=np.full(N, 2 * STIFF))
    to.limit(LIMITS, stiff)
    assert follow(to, 0.18).pace == 0.0
    to.limit(replace(LIMITS, acceleration=np.full(N, 5.0)), stiff)
    assert follow(to, 0.06, 1.0, own=0.0).pace < 1.0


@pytest.mark.parametrize(("lead", "applies"), [((inf, inf, inf), False), ((inf, MOST, inf), True)])
def test_only_a_robot_with_a_device_without_watchdog_has_the_rule(
    lead: tuple[float, ...], applies: bool
) -> None:
    rated = replace(ratings(N), lead=np.array(lead))
    assert LeadRules(LIMITS, rated, CALM, None).applies is applies


def test_the_bounds_themselves_are_free_and_slowest() -> None:
    to = Guard(
        LIMITS,
        replace(CALM, least_pace=0.125),
        ratings=replace(ratings(N), lead=np.ones(N), stiffness=np.full(N, STIFF)),
        at_rest=load(2.5),
    )
    assert follow(to, 1.0).slowing == ()  # 0.75 beyond a sag of 0.25
    assert follow(to, 1.21875).pace == 0.125


# ---------------------------------------------------------------------------------- with an executor


class Joints:
    """Three joints behind their goals with executor and guard; one of them may be blocked."""

    def __init__(self, lag: float, torque: float, at_rest: bool = True) -> None:
        self.lag = lag  # s
        self.sag = torque / STIFF
        self.executor = TrajectoryExecutor(LIMITS, PERIOD)
        rated = replace(ratings(N), lead=np.array([inf, MOST, MOST]), stiffness=np.full(N, STIFF))
        self.rules = LeadRules(LIMITS, rated, CALM, load(torque) if at_rest else None)
        self.position = np.full(N, -self.sag)
        self.velocity = np.zeros(N)
        self.now = 10.0
        self.blocked = False
        self.held = False
        self.executor.begin(np.zeros(N))
        self.goal = np.zeros(N)

    @property
    def most(self) -> float:
        """Lead that is reached at most: a block may stop the joint while its goal is still fast."""
        assert self.executor.reference is not None
        speed = np.abs(self.executor.reference.velocity)
        later = speed + 2.0 * LIMITS.acceleration * PERIOD  # it brakes two ticks after the block
        way = (later**2 / (2.0 * LIMITS.acceleration) + 2.0 * later * PERIOD).max()
        return max(MOST, self.lead + float(way)) + 0.005

    def tick(self) -> None:
        reference = self.executor.goal(self.now)
        assert reference is not None
        state = JointState(
            self.now, self.position, self.velocity, np.zeros(N), np.zeros(N), np.ones(N, np.bool_)
        )
        given = facts(now=self.now, measured=state, goal=reference, motion=self.executor.motion)
        judged = next(iter(self.rules.judge(given)), None)
        self.executor.pace = 1.0 if judged is None else judged.pace
        self.executor.slowed_by = () if judged is None else (judged.finding.code,)
        self.executor.fence = None if judged is None else judged.fence
        if judged is not None and judged.reaction is Reaction.HOLD:
            self.held = True
            self.executor.stop("aborted", (judged.finding,))
        self.goal = reference.position
        before = self.position.copy()
        self.position = self.position + (self.goal - self.sag - self.position) * min(1.0, PERIOD / self.lag)
        if self.blocked:
            self.position[JOINT] = before[JOINT]
        self.velocity = (self.position - before) / PERIOD
        self.now += PERIOD

    @property
    def lead(self) -> float:
        """Way that its goal would drive the joint on if the daemon died, beyond what its load does."""
        away = self.goal - self.position
        return float(np.abs(away - np.clip(away, min(self.sag, 0.0), max(self.sag, 0.0)))[1:].max())


def straight(place: float, seconds: float) -> Trajectory:
    rows = np.full((1, N), place)
    return Trajectory(np.array([seconds]), rows, np.ones(N, np.bool_), np.zeros((1, N)))


SOFT = st.floats(0.02, 0.06)
LOAD = st.floats(-1.5, 1.5)


@given(
    lag=SOFT,
    torque=LOAD,
    at=st.floats(0.0, 1.5),
    free_at=st.floats(0.0, 1.2),
    place=st.sampled_from([0.9, -0.9]),
)
def test_a_goal_never_leads_a_blocked_joint_by_more_than_the_limit_and_never_turns_back(
    lag: float, torque: float, at: float, free_at: float, place: float
) -> None:
    joints = Joints(lag, torque)
    joints.executor.submit("one", straight(place, 1.5))
    way = [0.0]
    most = MOST
    for tick in range(300):
        most = most if joints.blocked else joints.most
        joints.blocked = at <= tick * PERIOD < at + free_at
        joints.tick()
        way.append(float(joints.goal[JOINT]))
        assert joints.lead <= most, (tick, joints.lead)
    steps = np.diff(way) * np.sign(place)
    assert steps.min() >= -1e-9
    assert joints.held or way[-1] == pytest.approx(place)
    assert joints.executor.motion not in MOVING


@given(lag=SOFT, torque=LOAD, at=st.floats(0.0, 0.6), place=st.sampled_from([0.9, -0.9]))
def test_a_stream_leads_a_blocked_joint_no_further_and_may_turn_back_at_once(
    lag: float, torque: float, at: float, place: float
) -> None:
    joints = Joints(lag, torque)
    all_joints = np.arange(N)
    way = [0.0]
    most = MOST
    for tick in range(80):
        most = most if joints.blocked else joints.most
        joints.blocked = tick * PERIOD >= at
        joints.executor.setpoint(all_joints, np.full(N, place), None, 0.1)
        joints.tick()
        way.append(float(joints.goal[JOINT]))
        assert joints.lead <= most, (tick, joints.lead)
    assert (np.diff(way) * np.sign(place)).min() >= -1e-9
    stream = joints.executor.stream
    assert stream is not None
    late = {each.joint: each.code for each in stream.behind()[1]}
    assert late.get(JOINT, ReasonCode.LEAD_LIMIT) is ReasonCode.LEAD_LIMIT
    joints.executor.setpoint(all_joints, np.zeros(N), None, 0.1)
    before = abs(joints.goal[JOINT])
    joints.tick()
    assert abs(joints.goal[JOINT]) < before or before == 0.0


def test_a_soft_joint_under_load_moves_and_is_held_without_a_step_towards_it() -> None:
    """A sag of 0.15 rad, more than the limit: the load explains it."""
    joints = Joints(0.04, 1.5)
    joints.executor.submit("one", straight(0.6, 1.5))
    for _ in range(400):
        joints.tick()
    assert joints.executor.motion is Motion.HOLDING and not joints.held
    assert joints.goal.tolist() == [0.6] * N
    for _ in range(1000):
        joints.tick()
    assert joints.goal.tolist() == [0.6] * N
    other = Joints(0.04, 1.5, at_rest=False)
    other.executor.submit("one", straight(0.6, 1.5))
    for _ in range(400):
        other.tick()
    assert other.held and other.goal[JOINT] < 0.1


def test_the_stretch_of_a_motion_that_waited_has_its_reason() -> None:
    joints = Joints(0.04, 0.0)
    joints.executor.submit("one", straight(0.9, 1.5))
    for tick in range(350):
        joints.blocked = 50 <= tick < 150
        joints.tick()
    (ended,) = joints.executor.outcomes()
    assert ended.phase == "succeeded"
    assert ended.stretch is not None
    assert ended.stretch.reasons == (ReasonCode.LEAD_LIMIT,)
    assert 0.5 < ended.stretch.added < 1.2
