"""The roll of a bus by itself: who is left out, when a probe is due, who comes back."""

from itertools import pairwise

import numpy as np
import pytest

from twind_drivers.device_presence import FIRST, MISSES, PROBE, DevicePresence

ALL = np.ones(3, np.bool_)


def answered_flags(*flags: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.array(flags, np.bool_)


def test_misses_count_in_a_row_only() -> None:
    roll = DevicePresence(3)
    for _ in range(5):
        for _ in range(MISSES - 1):
            assert not roll.record_missing_reply(answered_flags(1, 0, 1), ALL, 0.0)
        assert not roll.record_missing_reply(answered_flags(1, 1, 0), ALL, 0.0)
        for _ in range(MISSES - 1):
            assert not roll.record_missing_reply(answered_flags(1, 0, 1), ALL, 0.0)
        roll.record_complete_reply()
    assert not roll.parked


def test_a_device_that_could_not_reply_is_not_missed() -> None:
    roll = DevicePresence(3)
    for _ in range(9):
        assert not roll.record_missing_reply(answered_flags(1, 0, 0), answered_flags(1, 0, 0), 0.0)
    for _ in range(MISSES - 1):
        assert not roll.record_missing_reply(answered_flags(1, 0, 0), answered_flags(1, 1, 0), 0.0)
    assert roll.record_missing_reply(answered_flags(1, 0, 0), answered_flags(1, 1, 0), 0.0)
    assert roll.asked.tolist() == [True, False, True]


def test_a_reading_without_any_reply_parks_no_device() -> None:
    roll = DevicePresence(3)
    assert not any(roll.record_missing_reply(answered_flags(0, 0, 0), ALL, 0.0) for _ in range(9))


def test_probes_begin_soon_and_come_ever_more_rarely_up_to_a_second_apart() -> None:
    roll = DevicePresence(3)
    now = 5.0
    assert roll.due(1e9) is None
    for _ in range(MISSES):
        roll.record_missing_reply(answered_flags(1, 0, 1), ALL, now)
    assert roll.due(now + 0.99 * FIRST) is None
    pauses = []
    for _ in range(9):
        before = now
        while roll.due(now) is None:
            now += 0.001
        roll.probed(1, now)
        pauses.append(now - before)
    assert pauses[0] == pytest.approx(FIRST, abs=0.002)
    assert all(late >= early - 0.002 for early, late in pairwise(pauses))
    assert pauses[-1] == pytest.approx(PROBE, abs=0.002)
    assert (
        sum(pauses[:2]) + MISSES * 0.01 < 0.15
    )  # a joint is stale for a moment, not until STATE_STALE lets it down


def test_an_intermittent_device_is_probed_at_growing_intervals() -> None:
    roll = DevicePresence(2)
    now = 0.0
    pauses = []
    for _ in range(8):
        for _ in range(MISSES):
            now += 0.01
            roll.record_missing_reply(answered_flags(1, 0), np.ones(2, np.bool_), now)
        before = now
        while roll.due(now) is None:
            now += 0.001
        pauses.append(now - before)
        roll.probed(1, now)
        roll.back(1, now)
    assert pauses[-1] > 0.9 * PROBE


def test_a_device_present_for_a_while_after_its_return_is_probed_soon() -> None:
    roll = DevicePresence(2)
    now = 0.0
    for _ in range(MISSES):
        roll.record_missing_reply(answered_flags(1, 0), np.ones(2, np.bool_), now)
    for _ in range(9):
        roll.probed(1, now)
    roll.back(1, now)
    now += 1.5 * PROBE
    for _ in range(MISSES):
        roll.record_missing_reply(answered_flags(1, 0), np.ones(2, np.bool_), now)
    assert roll.due(now + 1.01 * FIRST) == 1


def test_all_parked_are_probed_at_once_when_another_came_back() -> None:
    roll = DevicePresence(3)
    for _ in range(MISSES):
        roll.record_missing_reply(answered_flags(1, 0, 0), ALL, 5.0)
    before = roll.asked
    roll.probed(1, 6.0)
    roll.probed(2, 6.01)
    assert roll.due(6.02) is None
    roll.back(1, 6.02)
    assert roll.due(6.02) == 2
    assert roll.asked.tolist() == [True, True, False]
    assert before.tolist() == [True, False, False]  # a sample that holds it does not change
    with pytest.raises(ValueError, match="read-only"):
        roll.asked[2] = True


def test_a_returned_device_is_parked_only_after_the_full_number_of_misses() -> None:
    roll = DevicePresence(3)
    for _ in range(MISSES):
        roll.record_missing_reply(answered_flags(1, 0, 1), ALL, 0.0)
    roll.back(1, 1.0)
    for _ in range(MISSES - 1):
        assert not roll.record_missing_reply(answered_flags(1, 0, 1), ALL, 1.0)
    assert roll.record_missing_reply(answered_flags(1, 0, 1), ALL, 1.0)
