"""FOLLOW_ERR, OVERSPEED, MIRROR_DRIFT, SENSE_FROZEN: dense around every threshold; no normal motion trips."""

from dataclasses import replace
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from tests.support.guard_rig import FINE, LIMITS, PERIOD, TINY, N, codes, facts, joints, reading
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.trajectory import Reference
from twind.safety.guard import Guard, GuardDecision, Reaction

HOLD = Reaction.HOLD
DAMP = Reaction.DAMP
NONE = Reaction.NONE


class Watch:
    """A guard on a gantry, tick by tick."""

    def __init__(self, *, ratings: ActuatorRatings | None = None, **usual: object) -> None:
        self.guard = Guard(LIMITS, support="gantry", ratings=ratings)
        self.now = 10.0
        self.usual = usual

    def tick(
        self,
        place: list[float] | None = None,
        goal: list[float] | None = None,
        *,
        speed: list[float] | None = None,
        fresh: list[bool] | None = None,
        goal_speed: list[float] | None = None,
        dt: float = PERIOD,
        **over: object,
    ) -> GuardDecision:
        self.now += dt
        measured = reading(place, time=self.now)
        if speed is not None:
            measured = replace(measured, velocity=np.array(speed))
        if fresh is not None:
            measured = replace(measured, heard=np.array(fresh))
        target = joints(*(goal or [0.0] * N))
        still = np.zeros(N)
        moving = np.array(goal_speed) if goal_speed is not None else still
        given = {
            "now": self.now,
            "period": dt,
            "measured": measured,
            "goal": Reference(target, moving, still),
            "previous": target,
        }
        return self.guard.judge(facts(**(given | self.usual | over)))


# ------------------------------------------------------------------------------------------- FOLLOW_ERR


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("off", "ticks", "trips"),
    [
        (0.19, 100, False),
        (0.2, 100, False),
        (0.2 + TINY, 10, False),
        (0.2 + TINY, 11, True),
        (0.3, 10, False),
        (0.3, 11, True),
        (0.5, 10, False),
        (0.5, 11, True),
    ],
)
def test_follow_err_a_joint_off_for_a_tenth_of_a_second_is_held_where_it_is(
    side: float, off: float, ticks: int, trips: bool
) -> None:
    watch = Watch()
    found = [watch.tick([0.0, side * off, 0.0]) for _ in range(ticks)]
    assert all(one == FINE for one in found[:-1])
    last = found[-1]
    assert last.latches is trips
    if trips:
        (finding,) = last.findings
        assert (finding.code, finding.joint, finding.bound) == (ReasonCode.FOLLOW_ERR, 1, 0.2)
        assert finding.value == pytest.approx(off)
        assert (last.reaction, last.here) == (HOLD, (1,))
        assert "held where it is" in finding.message
    else:
        assert last == FINE


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("off", "damps"), [(0.5 - TINY, False), (0.5, False), (0.5 + TINY, True), (1.9, True)]
)
def test_follow_err_further_still_is_damped_at_once(side: float, off: float, damps: bool) -> None:
    first = Watch().tick([side * off, 0.0, 0.0])
    assert (first.reaction, first.latches) == (DAMP if damps else NONE, damps)
    if damps:
        assert (codes(first), first.findings[0].bound) == ([ReasonCode.FOLLOW_ERR], 0.5)
        assert "soft" in first.findings[0].message


@pytest.mark.parametrize("near", range(1, 7))
@pytest.mark.parametrize("off", [0.2 + TINY, 0.205, 0.29])
def test_follow_err_counts_from_the_tick_in_which_a_joint_goes_off(near: int, off: float) -> None:
    watch = Watch()
    assert all(watch.tick([0.0, 0.01, 0.0]) == FINE for _ in range(near))
    assert all(watch.tick([0.0, off, 0.0]) == FINE for _ in range(10))
    assert watch.tick([0.0, off, 0.0]).latches


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_follow_err_each_joint_has_the_bounds_of_its_owner(joint: int, side: float) -> None:
    far = np.array([0.1, nan, 0.8])  # nan: not stated
    long = np.array([0.05, nan, 0.3])
    rated = replace(ActuatorRatings.unknown(N), follow=far, follow_for=long)
    bound = (0.1, 0.2, 0.8)[joint]
    ticks = (6, 11, 31)[joint]
    place = np.zeros(N)

    def watched(off: float, count: int) -> GuardDecision:
        watch = Watch(ratings=rated)
        place[joint] = side * off
        found = [watch.tick(place.tolist()) for _ in range(count)]
        assert all(one == FINE for one in found[:-1])
        return found[-1]

    assert watched(bound, 100) == FINE
    assert watched(bound + TINY, ticks - 1) == FINE
    last = watched(bound + TINY, ticks)
    assert (last.reaction, last.latches) == (HOLD, True)
    assert (last.findings[0].joint, last.findings[0].bound) == (joint, bound)
    assert watched(bound + 0.3 - TINY, 1) == FINE
    soft = watched(bound + 0.3 + TINY, 1)
    assert (soft.reaction, soft.findings[0].bound) == (DAMP, pytest.approx(bound + 0.3))


def test_follow_err_a_reload_with_other_gains_has_other_bounds() -> None:
    watch = Watch()
    rated = replace(ActuatorRatings.unknown(N), follow=np.full(N, 0.3))
    watch.guard.limit(LIMITS, rated)
    assert all(watch.tick([0.25, 0.0, 0.0]) == FINE for _ in range(20))
    watch.guard.limit(LIMITS, ActuatorRatings.unknown(N))
    assert [watch.tick([0.25, 0.0, 0.0]) for _ in range(11)][-1].latches


def test_follow_err_counts_from_the_last_time_it_was_where_it_may_be() -> None:
    watch = Watch()
    for _ in range(5):
        assert all(watch.tick([0.3, 0.0, 0.0]) == FINE for _ in range(10))
        assert watch.tick([0.1, 0.0, 0.0]) == FINE


@pytest.mark.parametrize(
    ("behind", "speed", "trips"),
    [
        (0.2 + 0.03 * 4.0, 4.0, False),
        (0.2 + 0.03 * 4.0 + TINY, 4.0, True),
        (0.2 + 0.03 * 4.0, -4.0, False),
        (0.2 + 0.03 * 1.0 + TINY, 1.0, True),
        (0.2 + TINY, 0.0, True),
    ],
)
def test_follow_err_a_goal_that_moves_may_be_ahead_by_the_lag_of_the_servos_loop(
    behind: float, speed: float, trips: bool
) -> None:
    watch = Watch()
    for _ in range(11):
        last = watch.tick([0.0] * N, [0.0, 0.0, behind], goal_speed=[0.0, 0.0, speed])
    assert last.latches is trips


@pytest.mark.parametrize("speed", [4.0, 40.0, inf, -inf])
def test_follow_err_no_goal_moves_faster_than_its_joint_so_no_more_lag_is_allowed(speed: float) -> None:
    watch = Watch()
    for _ in range(11):
        last = watch.tick([0.0] * N, [0.0, 0.0, 0.2 + 0.03 * 4.0 + TINY], goal_speed=[0.0, 0.0, speed])
    assert last.latches


def test_follow_err_who_lost_its_torque_and_sinks_does_not_make_the_others_soft() -> None:
    limp = np.array([0, 1, 1], np.int8)
    watch = Watch(torque=limp, status_time=np.full(N, 9.0))
    assert all(watch.tick([0.02 * tick, 0.0, 0.0]) == FINE for tick in range(60))
    for unknown in (limp - 1, np.ones(N, np.int8)):  # torque that nobody knows of counts as torque
        assert watch.tick([1.2, 0.0, 0.0], torque=unknown).reaction is DAMP
    assert (
        watch.tick([1.2, 0.0, 0.0], torque_settled=False).reaction is DAMP
    )  # TORQUE_MISMATCH does not judge that
    assert watch.tick([1.2, 0.9, 0.0]).findings[0].joint == 1


@pytest.mark.parametrize(
    ("alert", "watchdog", "torque", "soft"),
    [
        (128, 5, 0, False), (0, 0, 0, False), (128, 0, 0, False),  # it shut itself down, or began anew
        (0, 5, 0, True), (1, 5, 0, True), (0, -1, 0, True), (0, 255, 0, True),  # it is being let go
        (128, 5, 1, True), (128, 5, -1, True), (0, 0, 1, True), (0, 0, -1, True),
    ],
)  # fmt: skip
def test_follow_err_who_let_go_by_itself_does_not_make_the_others_soft_on_the_way_down_either(
    alert: int, watchdog: int, torque: int, soft: bool
) -> None:
    alerts = np.array([alert, 0, 0], np.uint8)
    limp = np.array([torque, 1, 1], np.int8)
    dogs = np.array([watchdog, 5, 5], np.int16)
    watch = Watch(torque_settled=False, state=RobotState.FAULT, torque=limp, alerts=alerts, watchdog=dogs)
    assert (ReasonCode.FOLLOW_ERR in [one.code for one in watch.tick([1.2, 0.0, 0.0]).causes]) == soft


def test_follow_err_who_takes_no_goals_since_its_watchdog_tripped_does_not_make_the_others_soft() -> None:
    watch = Watch(watchdog=np.array([255, 5, 5], np.int16))
    for _ in range(30):
        found = watch.tick([0.9, 0.0, 0.0])
        assert (found.reaction, [one.code for one in found.causes]) == (HOLD, [ReasonCode.WATCHDOG_TRIPPED])
    assert watch.tick([0.9, 0.9, 0.0]).reaction is DAMP


def test_follow_err_two_joints_are_two_findings_each_by_its_own_time() -> None:
    watch = Watch()
    for _ in range(5):
        watch.tick([0.3, 0.0, 0.0])
    for _ in range(6):
        last = watch.tick([0.3, 0.0, -0.3])
    assert ([finding.joint for finding in last.findings], last.here) == ([0], (0,))
    for _ in range(5):
        last = watch.tick([0.3, 0.0, -0.3])
    assert last.here == (0, 2)


def test_follow_err_a_stale_joint_is_not_checked_and_continues_its_count() -> None:
    watch = Watch()
    silent = [False, True, True]
    assert all(watch.tick([1.9, 0.0, 0.0], fresh=silent) == FINE for _ in range(30))
    watch = Watch()
    for _ in range(5):
        watch.tick([0.3, 0.0, 0.0])
    for _ in range(5):
        assert watch.tick([0.3, 0.0, 0.0], fresh=silent) == FINE
    assert watch.tick([0.3, 0.0, 0.0]).here == (0,)


def test_follow_err_a_place_that_is_no_number_is_far() -> None:
    found = Watch().tick([nan, 0.0, 0.0])
    assert (found.reaction, codes(found)) == (DAMP, [ReasonCode.FOLLOW_ERR])


@pytest.mark.parametrize(
    "over",
    [{"torque_expected": False}, {"mode": Mode.MIRROR}, {"previous": None}, {"previous": joints(inf, 0, 0)}],
)
def test_follow_err_a_joint_without_a_goal_has_no_error(over: dict[str, object]) -> None:
    watch = Watch(**over)
    for _ in range(20):
        assert ReasonCode.FOLLOW_ERR not in codes(watch.tick([1.0, 0.0, 0.0]))
    if over.get("previous", 0) is None:  # and what was before it does not count afterwards
        watch.usual = {}
        assert watch.tick([0.3, 0.0, 0.0]) == FINE


@pytest.mark.parametrize(
    ("over", "ticks"), [({"place": [0.3, 0.0, 0.0]}, 10), ({"simulated": reading([0.1, 0.0, 0.0])}, 40)]
)
def test_follow_err_and_mirror_drift_count_from_the_last_arming_however_many_there_were(
    over: dict[str, Any], ticks: int
) -> None:
    watch = Watch()
    for _ in range(4):
        assert all(watch.tick(**over) == FINE for _ in range(ticks))
        watch.tick(**over, torque_expected=False)


@pytest.mark.parametrize("missing", [{"measured": None}, {"previous": None}], ids=["reading", "goal"])
def test_follow_err_counts_from_the_last_tick_without_a_reading_or_a_goal(missing: dict[str, Any]) -> None:
    watch = Watch()
    for place, ticks in (([0.0] * N, 1), ([0.3, 0.0, 0.0], 10), ([0.3, 0.0, 0.0], 10)):
        assert all(watch.tick(place) == FINE for _ in range(ticks))
        assert ReasonCode.FOLLOW_ERR not in codes(watch.tick(place, **missing))


@pytest.mark.parametrize(
    ("state", "settled", "reaction"),
    [
        (RobotState.ARMED, True, HOLD),
        (RobotState.FAULT, True, HOLD),  # still pushed: held where it is now
        (RobotState.FAULT, False, NONE),  # on its way down
        (RobotState.SETTLING, False, NONE),
        (RobotState.SETTLING, True, NONE),
        (RobotState.ESTOP, True, NONE),
    ],
)
def test_follow_err_a_way_down_is_not_cut_short_but_the_fault_is_latched(
    state: RobotState, settled: bool, reaction: Reaction
) -> None:
    watch = Watch(state=state, torque_settled=settled)
    for _ in range(11):
        last = watch.tick([0.3, 0.0, 0.0])
    assert (last.reaction, last.latches, codes(last)) == (reaction, True, [ReasonCode.FOLLOW_ERR])
    assert last.here == ((0,) if reaction else ())
    assert watch.tick([0.6, 0.0, 0.0]).reaction is DAMP


def test_without_a_goal_to_write_the_last_one_is_what_counts() -> None:
    watch = Watch(goal=None)
    for _ in range(11):
        last = watch.tick([0.3, 0.0, 0.0])
    assert last.latches


def servo(lag: float, dead: int, speed: float = 4.0, accel: float = 10.0) -> tuple[np.ndarray, ...]:
    """Goals to and fro at full speed, and a servo that follows them `dead` ticks and `lag` s behind."""
    goal = 0.0
    place = 0.0
    v = 0.0
    rows = []
    way = 1.0
    past = [0.0] * (dead + 1)
    for _ in range(600):
        room = (1.8 - way * goal) - v * v / (2.0 * accel) * np.sign(way * v)
        v += np.clip((way * speed if room > 0.06 else 0.0) - v, -accel * PERIOD, accel * PERIOD)
        if abs(v) < 1e-9 and room <= 0.06:
            way = -way
        goal += v * PERIOD
        past = [*past[1:], goal]
        place += (past[0] - place) * (1.0 - np.exp(-PERIOD / lag))
        rows.append((goal, v, place))
    return tuple(np.array(rows).T)


@pytest.mark.parametrize(("lag", "dead"), [(0.005, 1), (0.02, 1), (0.04, 1), (0.04, 2)])
def test_follow_err_a_servo_that_follows_at_full_speed_never_trips(lag: float, dead: int) -> None:
    watch = Watch()
    goals, speeds, places = servo(lag, dead)
    assert np.abs(speeds).max() == pytest.approx(4.0)
    for goal, speed, place in zip(goals, speeds, places, strict=True):
        assert watch.tick([place, 0, 0], [goal, 0, 0], goal_speed=[speed, 0, 0], speed=[speed, 0, 0]) == FINE


# ------------------------------------------------------------------------------------------- frozen


def frozen(
    ticks: int,
    *,
    speed: float = 0.0,
    load: float = nan,
    pace: float = 0.5,
    motion: Motion = Motion.ACTIVE,
    flicker: int = 0,
) -> GuardDecision:
    """A goal that moves on at `pace` (rad/s) while the position of joint 1 stays; the last judgement."""
    watch = Watch(motion=motion, setpoint_age=0.0, load=joints(0.0, load, 0.0))
    for tick in range(ticks):
        place = 0.001 * (flicker and tick // flicker % 2)
        last = watch.tick([0.0, place, 0.0], [0.0, tick * PERIOD * pace, 0.0], speed=[0.0, speed, 0.0])
        if last.reaction:
            break
    return last


@pytest.mark.parametrize("motion", [Motion.ACTIVE, Motion.STREAMING])
@pytest.mark.parametrize(
    ("speed", "load", "trips"),
    [
        (0.1, nan, True),  # it says that it turns
        (-0.1, nan, True),
        (0.1 - TINY, nan, False),
        (0.0, 0.02, True),  # current flows, and not as in a blocked motor
        (0.0, 0.15, True),
        (0.0, 0.02 - TINY, False),
        (0.0, 0.15 + TINY, False),  # blocked: FOLLOW_ERR tells
        (0.0, nan, False),
    ],
)
def test_a_position_that_stays_while_the_motor_works_is_a_frozen_encoder(
    motion: Motion, speed: float, load: float, trips: bool
) -> None:
    found = frozen(35, speed=speed, load=load, motion=motion)
    assert (found.reaction, found.latches) == (HOLD if trips else NONE, trips)
    if trips:
        assert ([(one.code, one.joint) for one in found.findings], found.here) == (
            [(ReasonCode.SENSE_FROZEN, 1)],
            (),  # where it is read is where it is not
        )
        assert 0.2 - TINY < (found.findings[0].value or 0.0) < 0.27


@pytest.mark.parametrize(("looks", "trips"), [(1, False), (2, True)])
def test_a_joint_that_comes_loose_turns_before_a_count_has_passed(looks: int, trips: bool) -> None:
    """It rested, its goal went on, and it stuck; one look may see it turn on the same count, two not."""
    watch = Watch(motion=Motion.ACTIVE)
    still = [watch.tick([0.0] * N, [0.0, 0.002 * tick, 0.0]) for tick in range(31)]
    assert set(still) == {FINE}
    loose = [watch.tick([0.0] * N, [0.0, 0.06, 0.0], speed=[0.0, 0.4, 0.0]) for _ in range(5 * looks)]
    assert any(one.reaction for one in loose) is trips
    after = [
        watch.tick([0.0, 0.002 * tick, 0.0], [0.0, 0.06, 0.0], speed=[0.0, 0.4, 0.0]) for tick in range(30)
    ]
    assert trips or set(after) == {FINE}


@pytest.mark.parametrize(("ticks", "trips"), [(20, False), (21, True)])
def test_sense_frozen_needs_a_fifth_of_a_second_and_one_check(ticks: int, trips: bool) -> None:
    assert bool(frozen(ticks, speed=0.5).reaction) is trips


def test_at_another_rate_too_it_takes_a_fifth_of_a_second() -> None:
    watch = Watch()
    found = [
        watch.tick([0.0] * N, [0.0, 0.015 * tick, 0.0], speed=[0.0, 0.5, 0.0], dt=0.03) for tick in range(9)
    ]
    assert [one.reaction for one in found] == [NONE] * 8 + [HOLD]  # a look every 60 ms: not after 180


@pytest.mark.parametrize(
    ("far", "speed", "load", "trips"),
    [
        (0.0095, 0.5, nan, False),
        (0.01, 0.5, nan, True),
        (0.012, 0.5, nan, True),
        (0.095, 0.0, 0.1, False),
        (0.1, 0.0, 0.1, True),
        (0.11, 0.0, 0.1, True),
    ],
)
def test_the_goal_must_have_moved(far: float, speed: float, load: float, trips: bool) -> None:
    watch = Watch(load=joints(0.0, load, 0.0))
    for tick in range(60):
        last = watch.tick([0.0] * N, [0.0, min(tick * 0.005, far), 0.0], speed=[0.0, speed, 0.0])
        if last.reaction:
            break
    assert bool(last.reaction) is trips


def test_sense_frozen_a_flicker_of_one_count_or_a_resting_joint_gives_no_finding() -> None:
    assert frozen(39, speed=0.5, flicker=5).findings == ()
    assert frozen(300, speed=0.5, pace=0.0).findings == ()
    assert frozen(39, speed=0.5, motion=Motion.HOLDING) == FINE


@pytest.mark.parametrize("place", [1.0, -1.0])
def test_sense_frozen_a_joint_at_rest_away_from_zero_gives_no_finding(place: float) -> None:
    watch = Watch()
    there = [place] * N
    assert all(watch.tick(there, there, speed=[0.5, 0.5, 0.5]) == FINE for _ in range(60))


@pytest.mark.parametrize("place", [0.0, 1.0])
def test_all_may_be_frozen_at_once(place: float) -> None:
    watch = Watch()
    found = [watch.tick([place] * N, [place + 0.005 * tick] * N, speed=[0.5] * N) for tick in range(35)]
    first = next(one for one in found if one.findings)
    assert [one.joint for one in first.findings] == list(range(N))
    assert {one.code for one in first.findings} == {ReasonCode.SENSE_FROZEN}


def test_silence_is_no_frozen_encoder() -> None:
    watch = Watch()
    for tick in range(35):
        goal = [0.0, tick * 0.005, 0.0]
        assert watch.tick([0.0] * N, goal, speed=[0.0, 1.0, 0.0], fresh=[True, False, True]) == FINE


@pytest.mark.parametrize("between", [{"motion": Motion.HOLDING}, {"torque_expected": False}])
def test_a_motion_begins_anew(between: dict[str, object]) -> None:
    watch = Watch(load=None)
    for tick in range(20):
        watch.tick([0.0] * N, [0.0, tick * 0.005, 0.0], speed=[0.0, 1.0, 0.0])
    for _ in range(6):
        watch.tick([0.0] * N, [0.0, 0.1, 0.0], **between)
    for tick in range(20):
        assert watch.tick([0.0] * N, [0.0, 0.1 + tick * 0.004, 0.0], speed=[0.0, 1.0, 0.0]) == FINE


# ------------------------------------------------------------------------------------------- OVERSPEED


FAST = 1.2 * 4.0 + 0.05


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("speed", "trips"), [(4.0, False), (4.8, False), (FAST, False), (FAST + TINY, True), (20.0, True)]
)
def test_overspeed_too_fast_in_two_readings_holds(side: float, speed: float, trips: bool) -> None:
    watch = Watch()
    assert watch.tick(speed=[0.0, 0.0, side * speed]) == FINE
    second = watch.tick(speed=[0.0, 0.0, side * speed])
    assert (second.reaction, second.latches) == (HOLD if trips else NONE, False)
    if trips:
        (finding,) = second.findings
        assert (finding.code, finding.joint, finding.value) == (ReasonCode.OVERSPEED, 2, speed)
        assert finding.bound == pytest.approx(FAST)


def test_overspeed_a_single_fast_or_stale_reading_gives_no_finding() -> None:
    watch = Watch()
    for _ in range(10):
        assert watch.tick(speed=[9.0, 0.0, 0.0]) == FINE
        assert watch.tick(speed=[0.0, 0.0, 0.0]) == FINE
    for _ in range(10):
        assert watch.tick(speed=[9.0, 0.0, 0.0], fresh=[False, True, True]) == FINE
    never = [False, True, True]
    assert all(watch.tick(speed=[nan, 0.0, 0.0], fresh=never) == FINE for _ in range(10))


@pytest.mark.parametrize("speed", [nan, inf, -inf])
def test_overspeed_a_speed_that_is_read_and_is_no_number_is_too_fast(speed: float) -> None:
    watch = Watch()
    assert watch.tick(speed=[speed, 0.0, 0.0]) == FINE
    found = watch.tick(speed=[speed, 0.0, 0.0])
    assert (found.reaction, codes(found)) == (HOLD, [ReasonCode.OVERSPEED])


def test_overspeed_an_old_reading_neither_counts_nor_forgives() -> None:
    watch = Watch()
    assert watch.tick(speed=[9.0, 0.0, 0.0]) == FINE
    assert watch.tick(speed=[9.0, 0.0, 0.0], fresh=[False, True, True]) == FINE
    assert watch.tick(speed=[9.0, 0.0, 0.0]).reaction is HOLD


def test_overspeed_a_slow_reading_forgives_and_no_more_than_that() -> None:
    watch = Watch()
    found = [watch.tick(speed=[speed, 0.0, 0.0]).reaction for speed in (9.0, 0.0, 9.0, 9.0)]
    assert found == [NONE, NONE, NONE, HOLD]


def test_overspeed_a_slow_joint_has_a_slow_bound() -> None:
    slow = replace(LIMITS, velocity=joints(4.0, 0.3, 4.0))  # 0.41 rad/s
    for speed, reaction in ((0.4, NONE), (0.42, HOLD)):
        watch = Watch()
        watch.guard = Guard(slow, support="gantry")
        watch.tick(speed=[0.0, speed, 0.0])
        assert watch.tick(speed=[0.0, speed, 0.0]).reaction is reaction


def test_overspeed_three_at_their_own_limit_are_none() -> None:
    watch = Watch()
    assert all(watch.tick(speed=[FAST, -FAST, 1.0]) == FINE for _ in range(5))
    assert all(watch.tick(speed=[4.8, -4.8, 4.8]) == FINE for _ in range(5))


@pytest.mark.parametrize("over", [{"torque_expected": False}, {"mode": Mode.MIRROR}, {"measured": None}])
def test_overspeed_a_hand_may_move_a_limp_joint_as_fast_as_it_likes(over: dict[str, object]) -> None:
    watch = Watch(**over)
    for _ in range(10):
        assert ReasonCode.OVERSPEED not in codes(watch.tick(speed=[9.0, 0.0, 0.0]))
    watch.usual = {}
    assert watch.tick(speed=[9.0, 0.0, 0.0]) == FINE  # what was before does not count
    assert watch.tick(speed=[9.0, 0.0, 0.0]).reaction is HOLD


def test_overspeed_is_only_reported_while_settling() -> None:
    watch = Watch(state=RobotState.SETTLING, torque_settled=False)
    watch.tick(speed=[9.0, 0.0, 0.0])
    last = watch.tick(speed=[9.0, 0.0, 0.0])
    assert (last.reaction, codes(last)) == (NONE, [ReasonCode.OVERSPEED])


# ------------------------------------------------------------------------------------------- MIRROR_DRIFT


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("apart", "ticks", "reported"),
    [
        (0.05, 200, False),
        (0.05 + TINY, 46, False),
        (0.05 + TINY, 56, True),
        (1.0, 46, False),
        (1.0, 56, True),
    ],
)
def test_mirror_drift_a_deviation_for_half_a_second_is_only_reported(
    side: float, apart: float, ticks: int, reported: bool
) -> None:
    watch = Watch()
    said = [watch.tick(simulated=reading([0.0, side * apart, 0.0])) for _ in range(ticks)]
    assert {one.reaction for one in said} == {NONE}
    assert not any(one.latches for one in said)
    found = [finding for one in said for finding in one.findings]
    assert [(one.code, one.joint, one.bound) for one in found] == (
        [(ReasonCode.MIRROR_DRIFT, 1, 0.05)] if reported else []
    )


def test_mirror_drift_is_reported_at_most_every_ten_seconds_also_for_a_nan_simulation() -> None:
    watch = Watch()
    found = [
        finding for _ in range(2000) for finding in watch.tick(simulated=reading([nan, 0.0, 0.0])).findings
    ]
    assert [one.code for one in found] == [ReasonCode.MIRROR_DRIFT] * 2


def test_mirror_drift_at_a_thousand_looks_a_second_it_is_half_a_second_too() -> None:
    watch = Watch()
    found = [watch.tick(dt=0.001, simulated=reading([0.1, 0.0, 0.0])) for _ in range(560)]
    assert [count for count, one in enumerate(found) if one.findings] == [500]


def test_mirror_drift_is_checked_once_in_a_look_also_while_a_joint_is_off_its_goal() -> None:
    """The first look is that of tick 0. Joint 1 drifts from tick 2 on, which the look of tick 5 shows."""
    watch = Watch(ratings=replace(ActuatorRatings.unknown(N), follow_for=np.full(N, 5.0)))
    off = [0.3, 0.0, 0.0]
    found = [
        watch.tick(off, simulated=reading([0.3, 0.1 if tick >= 2 else 0.0, 0.0])).findings
        for tick in range(60)
    ]
    assert [(tick, one.joint) for tick, told in enumerate(found) for one in told] == [(55, 1)]


def test_mirror_drift_what_comes_together_again_counts_anew() -> None:
    watch = Watch()
    for _ in range(10):
        for _ in range(30):
            assert watch.tick(simulated=reading([0.1, 0.0, 0.0])) == FINE
        for _ in range(6):
            assert watch.tick(simulated=reading()) == FINE


@pytest.mark.parametrize("over", [{"torque_expected": False}, {"mode": Mode.SIM}, {"simulated": None}])
def test_mirror_drift_only_a_robot_that_we_hold_has_a_simulation_of_its_goals(
    over: dict[str, object],
) -> None:
    watch = Watch(**({"simulated": reading([0.1, 0.0, 0.0])} | over))
    assert all(watch.tick() == FINE for _ in range(100))


def test_mirror_drift_where_they_agree_they_agree_anywhere() -> None:
    place = [1.0, -1.0, 0.5]
    watch = Watch(simulated=reading(place))
    assert all(watch.tick(place, place) == FINE for _ in range(100))


@pytest.mark.parametrize("soft", [0.1, 0.11])
def test_follow_err_a_soft_servo_trips_by_the_default_and_not_by_what_its_gain_gives(soft: float) -> None:
    unknown = ActuatorRatings.unknown(N)
    known = replace(unknown, stiffness=np.ones(N), lag=np.full(N, soft))
    guards = [Guard(LIMITS, support="gantry", ratings=rated, load=np.zeros(N)) for rated in (unknown, known)]
    latched = [False, False]
    watches = [Watch(), Watch()]
    for goal, speed, place in zip(*servo(soft, 1), strict=True):
        for number, (watch, guard) in enumerate(zip(watches, guards, strict=True)):
            watch.guard = guard
            moving = [speed, 0, 0]
            found = watch.tick([place, 0, 0], [goal, 0, 0], goal_speed=moving, speed=moving)
            latched[number] |= found.latches
    assert latched == [True, False]


def test_a_goal_at_rest_at_the_position_gives_no_finding() -> None:
    watch = Watch()
    assert all(watch.tick([1.0, -1.0, 0.5], [1.0, -1.0, 0.5]) == FINE for _ in range(300))
