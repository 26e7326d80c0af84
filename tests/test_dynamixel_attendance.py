"""The roll of a bus by itself: who is left out, when a probe is due, who comes back."""

import numpy as np
import pytest

from twind_drivers.dynamixel.attendance import MISSES, PROBE, Attendance

ALL = np.ones(3, np.bool_)


def heard(*flags: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.array(flags, np.bool_)


def test_misses_count_in_a_row_only() -> None:
    roll = Attendance(3)
    for _ in range(5):
        for _ in range(MISSES - 1):
            assert not roll.missed(heard(1, 0, 1), ALL, 0.0)
        assert not roll.missed(heard(1, 1, 0), ALL, 0.0)
        for _ in range(MISSES - 1):
            assert not roll.missed(heard(1, 0, 1), ALL, 0.0)
        roll.whole()
    assert not roll.parked


def test_who_could_not_be_heard_is_not_missed() -> None:
    roll = Attendance(3)
    for _ in range(9):
        assert not roll.missed(heard(1, 0, 0), heard(1, 0, 0), 0.0)
    for _ in range(MISSES - 1):
        assert not roll.missed(heard(1, 0, 0), heard(1, 1, 0), 0.0)
    assert roll.missed(heard(1, 0, 0), heard(1, 1, 0), 0.0)
    assert roll.asked.tolist() == [True, False, True]


def test_a_reading_that_nobody_answered_parks_nobody() -> None:
    roll = Attendance(3)
    assert not any(roll.missed(heard(0, 0, 0), ALL, 0.0) for _ in range(9))


def test_probes_are_due_a_second_apart_and_at_once_when_another_came_back() -> None:
    roll = Attendance(3)
    assert roll.due(1e9) is None
    for _ in range(MISSES):
        roll.missed(heard(1, 0, 0), ALL, 5.0)
    before = roll.asked
    assert roll.due(5.0 + 0.99 * PROBE) is None
    assert roll.due(5.0 + PROBE) == 1
    roll.probed(1, 6.0)
    assert roll.due(6.0) == 2
    roll.probed(2, 6.2)
    assert roll.due(6.5) is None
    roll.back(1, 6.5)
    assert roll.due(6.5) == 2
    assert roll.asked.tolist() == [True, True, False]
    assert before.tolist() == [True, False, False]  # a sample that holds it does not change
    with pytest.raises(ValueError, match="read-only"):
        roll.asked[2] = True


def test_who_came_back_is_missed_anew_before_it_is_parked_again() -> None:
    roll = Attendance(3)
    for _ in range(MISSES):
        roll.missed(heard(1, 0, 1), ALL, 0.0)
    roll.back(1, 1.0)
    for _ in range(MISSES - 1):
        assert not roll.missed(heard(1, 0, 1), ALL, 1.0)
    assert roll.missed(heard(1, 0, 1), ALL, 1.0)
