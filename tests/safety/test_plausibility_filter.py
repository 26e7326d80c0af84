"""Positions that no motor reaches are dropped (SENSE_JUMP); a joint is never lost for ever."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.guard_rig import LIMITS, N, codes, facts
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard import Guard, Reaction
from twind.safety.plausibility_filter import PlausibilityFilter

# ticks/s, s
FASTEST = 3000.0
PERIOD = 0.01
TRIP = 0.0021  # s, from the question to the end of the answer
STEP = 1.5 * FASTEST * (PERIOD + TRIP) + 3.0  # ticks: the bound between two readings
TURN = 4096
YES = np.array([True, True])
NO = np.array([False, False])


class World:
    """Two joints, read every period; joint 0 stays at 0."""

    def __init__(self) -> None:
        self.senses = PlausibilityFilter(np.full(2, FASTEST), PERIOD)
        self.now = 5.0

    def read(self, place: float, fresh: bool = True, limp: bool = False) -> bool:
        """Is it believed that joint 1 is at `place`?"""
        position = np.array([0, round(place)], np.int64)
        ears = np.array([True, fresh])
        after = self.now + TRIP
        if fresh and self.senses.usual(position, self.now, after):
            believed = ears
        else:
            believed = self.senses.believe(position, ears, self.now, after, np.array([limp, limp]))
        assert believed[0]
        assert (believed & ~ears).sum() == 0
        self.now += PERIOD
        return bool(believed[1])


@given(st.integers(-(2**31), 2**31))
def test_the_first_reading_is_accepted_at_any_position(place: int) -> None:
    assert World().read(place)


@pytest.mark.parametrize(("step", "fits"), [(STEP - 1, True), (STEP, True), (STEP + 1, False), (TURN, False)])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_step_is_accepted_up_to_the_reach_of_the_motor(step: float, fits: bool, sign: int) -> None:
    world = World()
    world.read(100)
    assert world.read(100 + sign * int(step)) == fits
    assert world.senses.jumps.tolist() == [0, int(not fits)]


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60), st.lists(st.booleans(), max_size=60))
def test_no_motion_that_the_motor_can_do_is_ever_dropped(speeds: list[float], deaf: list[bool]) -> None:
    world = World()
    place = 0.0
    for number, speed in enumerate(speeds):
        place += speed * FASTEST * PERIOD
        heard = not (number < len(deaf) and deaf[number])
        assert world.read(place, fresh=heard) == heard


@given(st.integers(1, 40))
def test_the_accepted_step_grows_with_the_number_of_missed_readings(missed: int) -> None:
    world = World()
    world.read(0)
    for _ in range(missed):
        assert not world.read(0, fresh=False)
    most = int(1.5 * FASTEST * ((missed + 1) * PERIOD + TRIP) + 3.0)
    assert world.read(most)
    assert not world.read(-most)


def test_a_single_implausible_reading_is_dropped_and_the_next_good_one_counts() -> None:
    world = World()
    assert [world.read(place) for place in (0, TURN, 5, 7)] == [True, False, True, True]
    assert world.senses.jumps.tolist() == [0, 0]


def test_a_lost_turn_is_dropped_twice_and_then_accepted() -> None:
    """A wrong turn is 2 pi away (e-manual, extended position mode; DynamixelSDK #380)."""
    world = World()
    rows = [
        (world.read(place), int(world.senses.jumps[1])) for place in (0, TURN, TURN + 4, TURN + 9, TURN + 9)
    ]
    assert rows == [(True, 0), (False, 1), (False, 2), (True, 3), (True, 0)]


def test_implausible_readings_that_disagree_are_never_accepted() -> None:
    world = World()
    world.read(0)
    for number in range(20):
        assert not world.read(20_000 + 4000 * (-1) ** number)
        assert world.senses.jumps[1] == number + 1


def test_however_long_all_was_well_the_last_reading_is_what_counts() -> None:
    world = World()
    assert all(world.read(7) for _ in range(200))
    assert not world.read(7 + TURN)
    assert world.senses.leaps.tolist() == [0, TURN]


def first(fastest: float = FASTEST, sent: float = 5.0, received: float = 5.0 + TRIP) -> PlausibilityFilter:
    """Two joints that were both heard once, at 0."""
    senses = PlausibilityFilter(np.full(2, fastest), PERIOD)
    assert senses.believe(np.array([0, 0]), YES, sent, received, NO).all()
    return senses


@pytest.mark.parametrize(("places", "short"), [
    ([0, 0], True), ([39, 0], True), ([40, 0], False), ([-39, 39], True), ([TURN, TURN], False),
])  # fmt: skip
def test_the_fast_path_is_taken_only_if_every_joint_is_fresh_and_plausible(
    places: list[int], short: bool
) -> None:
    """1.5 x 3010 ticks/s x 8 ms + 3 ticks are 39.12."""
    senses = first(3010.0)
    assert senses.usual(np.array(places), 5.0081 - TRIP, 5.0081) is short


def test_the_fast_path_needs_a_minimum_period_and_an_earlier_reading() -> None:
    zero = np.array([0, 0])
    assert first().usual(zero, 5.0079 - TRIP, 5.0079) is False
    assert PlausibilityFilter(np.full(2, FASTEST), PERIOD).usual(zero, 5.0, 5.01) is False


def test_the_short_way_needs_its_time_and_no_more() -> None:
    senses = PlausibilityFilter(np.full(2, FASTEST), 1.25 / 64)
    zero = np.array([0, 0])
    assert senses.believe(zero, YES, 5.0, 5.0, NO).all()
    assert senses.usual(zero, 5.0 + 1 / 64, 5.0 + 1 / 64) is True


@pytest.mark.parametrize(("trip", "most"), [(0.0021, 57), (0.0024, 58), (0.00227, 58), (0.00242, 58)])
def test_three_ticks_of_flicker_are_added_to_what_the_motor_can_do(trip: float, most: int) -> None:
    for place, fits in ((most, True), (most + 1, False)):
        after = 5.0 + PERIOD + trip
        found = first().believe(np.array([0, place]), YES, after - trip, after, NO)
        assert found.tolist() == [True, fits]


@pytest.mark.parametrize(("step", "fits"), [(27, True), (28, False)])
def test_right_at_the_bound_it_fits_and_agrees(step: int, fits: bool) -> None:
    """1.5 x 1024 ticks/s x 1/64 s + 3 ticks are 27, exactly."""
    senses = first(1024.0, 5.0, 5.0)
    assert senses.believe(np.array([0, step]), YES, 5.0 + 1 / 64, 5.0 + 1 / 64, NO).tolist() == [True, fits]
    senses = first(1024.0, 5.0, 5.0)
    for count in range(1, 4):
        now = 5.0 + count / 64
        place = 1000 + step * count
        believed = senses.believe(np.array([0, place]), YES, now, now, NO)
    assert believed.tolist() == [True, fits]


def test_an_implausible_position_that_changes_must_agree_three_times_anew() -> None:
    world = World()
    assert [world.read(place) for place in (0, 9000, -9000, -9001, -9002)] == [
        True,
        False,
        False,
        False,
        True,
    ]


@pytest.mark.parametrize(("gap", "fits"), [(0.001, False), (0.0058, False), (0.0061, True), (0.010, True)])
def test_readings_closer_in_time_may_differ_by_less(gap: float, fits: bool) -> None:
    """A late tick is followed by one in time: the full step of a period is too much between them."""
    senses = PlausibilityFilter(np.full(2, FASTEST), PERIOD)
    ears = np.array([True, True])
    senses.believe(np.array([0, 0]), ears, 5.0, 5.0 + TRIP, NO)
    place = np.array([0, int(1.5 * FASTEST * 0.008 + 3.0)])
    at = 5.0 + gap
    usual = senses.usual(place, at, at + TRIP)
    believed = ears if usual else senses.believe(place, ears, at, at + TRIP, NO)
    assert believed.tolist() == [True, fits]


def test_a_wrong_beginning_is_corrected() -> None:
    world = World()
    assert [world.read(place) for place in (TURN, 0, 1, 2, 3)] == [True, False, False, True, True]


def test_a_limp_joint_moved_fast_by_hand_is_reported_and_accepted() -> None:
    world = World()
    assert [world.read(place, limp=True) for place in (0, 1000, 2000, 3000)] == [True] * 4
    assert world.senses.jumps[1] == 1


def test_a_missing_reading_leaves_the_count_of_jumps_unchanged() -> None:
    world = World()
    world.read(0)
    assert not world.read(TURN)
    assert not world.read(0, fresh=False)
    assert world.senses.jumps[1] == 0  # nothing was read that could be wrong
    assert not world.read(TURN)
    assert world.senses.jumps[1] == 2


def test_a_joint_without_readings_near_zero_counts_is_not_taken_as_fresh() -> None:
    world = World()
    for _ in range(5):
        assert world.read(0)
    assert not world.read(0, fresh=False)


# ------------------------------------------------------------------------------- what the guard says of it


def say(jumps: int, **over: object):
    row = np.zeros(N, np.int64)
    row[1] = jumps
    return Guard(LIMITS).judge(facts(jumps=row, leaps=np.where(row, 6.28, 0.0), **over))


@pytest.mark.parametrize(("jumps", "reaction"), [
    (0, Reaction.NONE), (1, Reaction.NONE), (2, Reaction.NONE), (3, Reaction.HOLD), (9, Reaction.HOLD),
])  # fmt: skip
def test_sense_jump_three_in_a_row_hold_and_every_first_one_is_reported(
    jumps: int, reaction: Reaction
) -> None:
    judgement = say(jumps)
    assert (judgement.reaction, judgement.latches) == (reaction, False)
    assert codes(judgement) == [ReasonCode.SENSE_JUMP] * (jumps > 0)
    bound, words = (3.0, "check its horn") if jumps >= 3 else (1.0, "more than its motor can do")
    told = [(one.joint, one.value, one.bound, words in one.message) for one in judgement.findings]
    assert told == [(1, 6.28, bound, True)] * (jumps > 0)


@pytest.mark.parametrize("over", [
    {"mode": Mode.MIRROR, "goal": None, "motion": Motion.IDLE},
    {"state": RobotState.CONNECTED, "torque_expected": False, "goal": None, "motion": Motion.IDLE},
    {"state": RobotState.FAULT},
])  # fmt: skip
def test_sense_jump_without_our_torque_or_while_settling_is_only_reported(over: dict[str, object]) -> None:
    judgement = say(3, **over)
    assert (judgement.reaction, codes(judgement)) == (Reaction.NONE, [ReasonCode.SENSE_JUMP])
