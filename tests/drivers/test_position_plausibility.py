"""Acceptance of positions behind a weak checksum, at the exact bounds."""

from collections.abc import Sequence

import numpy as np
import pytest

from twind_drivers.bus import BusSample
from twind_drivers.half_duplex.position_plausibility import (
    AFTER_GAP,
    AGREE,
    CHANGE,
    FASTEST,
    LONGEST,
    MARGIN,
    ZERO,
    PositionPlausibility,
)

PERIOD = 0.125  # s; the bounds are whole numbers
WAY = round(FASTEST * PERIOD)  # counts in a cycle
REACH = WAY + MARGIN
REGULAR = round(CHANGE * WAY) + MARGIN  # counts off the continued motion
START = 2048


class Readings:
    """A filter, fed with one reading a period."""

    def __init__(self, count: int = 1) -> None:
        self.filter = PositionPlausibility(count, PERIOD)
        self.now = 0.0

    def take(self, *positions: int | None, after: float = PERIOD) -> BusSample:
        """Filter one reading of all devices; None: not received."""
        self.now += after
        heard = np.array([each is not None for each in positions])
        count = len(positions)
        return self.filter.filter(
            BusSample(
                self.now,
                self.now,
                np.array([each or 0 for each in positions], np.int64),
                np.full(count, 5, np.int64),
                np.full(count, 7, np.int64),
                np.full(count, 0x80, np.uint8),
                heard,
                np.ones(count, np.bool_),
                0,
                0,
                heard.copy(),
            )
        )

    def believed(self, positions: Sequence[int | None]) -> list[bool]:
        """Return, of each reading of a single device, whether it is believed."""
        return [bool(self.take(each).heard[0]) for each in positions]


def late(count: int) -> list[bool]:
    """Return the outcome of readings of which the last of `count` is the first that is believed."""
    return [False] * (count - 1) + [True]


def still(at: int = START) -> Readings:
    """A device that was read long enough at rest."""
    readings = Readings()
    readings.believed([at] * 20)
    assert readings.take(at).heard[0]
    return readings


def test_the_first_position_is_believed_at_once_unless_it_is_zero() -> None:
    assert Readings().believed([START, START]) == [True, True]
    assert Readings().believed([1]) == [True]
    assert Readings().believed([0] * ZERO) == late(ZERO)


@pytest.mark.parametrize("way", [1, -1])
def test_a_change_of_speed_is_believed_up_to_its_bound(way: int) -> None:
    assert still().believed([START + way * REGULAR]) == [True]
    assert still().believed([START + way * (REGULAR + 1)]) == [False]


@pytest.mark.parametrize("way", [1, -1])
def test_a_motion_is_continued_by_its_speed(way: int) -> None:
    readings = still()
    fast = [START + way * 50 * step for step in range(1, 30)]
    assert all(readings.believed(fast))
    assert readings.believed([fast[-1] + way * 50 + REGULAR]) == [True]
    readings = still()
    readings.believed(fast)
    assert readings.believed([fast[-1] + way * (50 + REGULAR + 1)]) == [False]


def test_within_reach_of_the_last_one_two_readings_that_agree_are_believed() -> None:
    assert still().believed([START + REACH] * 3) == [*late(AFTER_GAP), True]
    assert still().believed([START - REACH] * 3) == [*late(AFTER_GAP), True]


def test_beyond_it_more_of_them_are() -> None:
    assert still().believed([START + REACH + 1] * AGREE) == late(AGREE)
    assert still().believed([START - REACH - 1] * AGREE) == late(AGREE)


def test_noise_of_32_counts_is_no_motion() -> None:
    assert still().believed([START + round(CHANGE * WAY) + 32]) == [True]
    assert still().believed([START + round(CHANGE * WAY) + 33]) == [False]


def test_a_far_zero_is_believed_the_eighth_time_a_row() -> None:
    assert still().believed([0] * 8) == late(8)
    assert still().believed([*[0] * 7, None, *[0] * 8]) == [False] * 8 + late(8), (
        "and counted anew after a gap"
    )
    pair = Readings(2)
    for _ in range(3):
        pair.take(START, START)
    zeros: list[int | None] = [*[0] * 7, None, *[0] * 8]
    assert [bool(pair.take(each, START).heard[0]) for each in zeros] == [False] * 8 + late(8)


def test_a_zero_within_reach_needs_no_more_than_another_position() -> None:
    assert still(at=REACH).believed([0, 0]) == late(AFTER_GAP)
    assert still(at=10).believed([0]) == [True]


def test_readings_that_do_not_agree_are_counted_anew() -> None:
    far = START + 1000
    assert still().believed([far, far, far, far + REACH + 1, *[far] * AGREE]) == [False] * 4 + late(AGREE)
    assert still().believed([far, far + REACH, far + 2 * REACH, far + 3 * REACH]) == late(AGREE)


def test_a_reading_that_is_missed_begins_the_count_anew() -> None:
    far = START + 1000
    assert still().believed([far, far, far, None, *[far] * AGREE]) == [False] * 4 + late(AGREE)


def test_a_position_goes_on_from_a_jump_that_was_believed() -> None:
    readings = still()
    readings.believed([START + 1000] * AGREE)
    assert readings.believed([START + 1000 + REGULAR]) == [True]
    assert readings.believed([START] * AGREE) == late(AGREE), "the old position is far now"


def test_a_single_wrong_reading_costs_the_next_cycle_alone() -> None:
    assert still().believed([START + 1000, START, START, START]) == [False, *late(AFTER_GAP), True]


def test_after_a_gap_the_motion_is_not_continued() -> None:
    readings = still()
    assert readings.believed([None, START, START]) == [False, *late(AFTER_GAP)]
    assert readings.believed([START + REGULAR]) == [True]


@pytest.mark.parametrize("cycles", [2.0, LONGEST, 50.0])
def test_a_late_cycle_extends_the_reach_but_no_further_than_three_periods(cycles: float) -> None:
    longest = round(min(cycles, LONGEST) * WAY * CHANGE) + MARGIN
    assert still().take(START + longest, after=cycles * PERIOD).heard[0]
    assert not still().take(START + longest + 1, after=cycles * PERIOD).heard[0]


def test_a_device_that_is_not_believed_counts_as_not_received_and_the_others_do_not() -> None:
    readings = Readings(3)
    for _ in range(5):
        whole = readings.take(100, 200, 300)
    assert whole.heard.all()
    sample = readings.take(100, 200 + 1000, None)
    assert sample.heard.tolist() == [True, False, False]
    assert sample.position.tolist() == [100, 0, 0]
    assert sample.velocity.tolist() == [5, 0, 0]
    assert sample.effort.tolist() == [7, 0, 0]
    assert sample.error.tolist() == [0x80, 0, 0] and sample.error.dtype == np.uint8
    assert sample.effort_told is not None and sample.effort_told.tolist() == [True, False, False]
    assert readings.take(100, 200, 300).heard.tolist() == [True, False, False]
    assert readings.take(100, 200, 300).heard.tolist() == [True, True, True]


def test_a_silent_device_does_not_hold_the_last_position_of_another() -> None:
    readings = Readings(2)
    moved = [START + 50 * step for step in range(30)]
    assert all(readings.take(each, None).heard[0] for each in moved)
    readings.take(None, None)
    assert [readings.take(moved[-1], None).heard[0] for _ in range(AFTER_GAP)] == late(AFTER_GAP)


def test_each_device_is_counted_for_itself() -> None:
    readings = Readings(2)
    for _ in range(5):
        readings.take(1000, START)
    outcome = [readings.take(3000, 0).heard.tolist() for _ in range(ZERO)]
    assert [first for first, _ in outcome[:AGREE]] == late(AGREE)
    assert [second for _, second in outcome] == late(ZERO)
