"""The watchdog that a driver keeps for devices without one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind_drivers.bus import TRIPPED, SlowRegisterValues
from twind_drivers.half_duplex.host_watchdog import LIMIT, HostWatchdog

ALL = np.array([True, True])
FIRST = np.array([True, False])


def make() -> tuple[HostWatchdog, SlowRegisterValues]:
    registers = SlowRegisterValues.unknown(2)
    watchdog = HostWatchdog(registers, 0.01)
    watchdog.watched = ALL
    return watchdog, registers


def silent(watchdog: HostWatchdog, since: float, until: float) -> None:
    """The second device does not reply to readings 20 ms apart."""
    for step in range(round((until - since) / 0.02) + 1):
        watchdog.record(FIRST, since + step * 0.02)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=60))
def test_a_device_trips_at_its_return_after_more_than_the_limit_and_never_else(
    history: list[tuple[bool, bool]],
) -> None:
    watchdog, registers = make()
    watchdog.record(ALL, 0.0)
    last = np.zeros(2)
    expected = np.zeros(2, np.bool_)
    for step, replies in enumerate(history, 1):
        now = step * 0.025
        rows = np.array(replies)
        expected |= rows & (now - last > LIMIT)
        last[rows] = now
        watchdog.record(rows, now)
        assert np.array_equal(registers.watchdog == TRIPPED, expected)
        assert np.array_equal(watchdog.overdue, now - last > LIMIT)


def test_a_tripped_device_is_released_by_its_preparation_alone() -> None:
    watchdog, registers = make()
    watchdog.record(ALL, 0.0)
    for step in range(1, 20):
        watchdog.record(FIRST, step * 0.01)
    watchdog.record(ALL, 0.2)
    watchdog.record(ALL, 0.21)
    assert registers.watchdog.tolist() == [-1, TRIPPED]
    before = registers.version
    watchdog.clear(~FIRST)
    assert registers.watchdog.tolist() == [-1, -1]
    assert registers.version > before


def test_a_device_that_gets_no_goals_does_not_trip() -> None:
    watchdog, registers = make()
    watchdog.watched = ~ALL
    watchdog.record(ALL, 0.0)
    silent(watchdog, 0.02, 0.48)
    watchdog.record(ALL, 0.5)
    assert registers.watchdog.tolist() == [-1, -1]


@pytest.mark.parametrize(("rate_hz", "limit"), [(1000.0, 0.1), (100.0, 0.1), (20.0, 0.175), (10.0, 0.35)])
def test_the_limit_is_a_tenth_of_a_second_and_at_a_low_rate_three_and_a_half_readings(
    rate_hz: float, limit: float
) -> None:
    assert HostWatchdog(SlowRegisterValues.unknown(2), 1.0 / rate_hz).limit == pytest.approx(limit, rel=1e-12)


def test_silence_of_just_the_limit_is_not_too_long() -> None:
    watchdog, registers = make()
    watchdog.record(ALL, 0.0)
    silent(watchdog, 0.02, 0.08)
    watchdog.record(FIRST, watchdog.limit)
    assert watchdog.overdue.tolist() == [False, False]
    watchdog.record(ALL, watchdog.limit)
    assert registers.watchdog.tolist() == [-1, -1]


def test_a_device_that_was_silent_from_the_first_reading_on_is_overdue_too() -> None:
    watchdog, registers = make()
    silent(watchdog, 5.0, 5.1)
    assert watchdog.overdue.tolist() == [False, False]
    watchdog.record(FIRST, 5.11)
    assert watchdog.overdue.tolist() == [False, True]
    watchdog.record(ALL, 5.12)
    assert registers.watchdog.tolist() == [-1, TRIPPED]


def test_the_registers_change_while_a_device_is_overdue_and_at_its_return_and_then_no_more() -> None:
    """By the version the writer chooses anew who gets goals, and the loop takes over the registers."""
    watchdog, registers = make()
    for step in range(20):
        watchdog.record(ALL, step * 0.01)
    assert registers.version == 0
    silent(watchdog, 0.2, 0.28)
    assert registers.version == 0, "it is silent, and not yet for long"
    watchdog.record(FIRST, 0.3)
    overdue = registers.version
    assert overdue > 0
    watchdog.record(ALL, 0.31)
    tripped = registers.version
    assert tripped > overdue
    watchdog.record(ALL, 0.32)
    assert registers.version == tripped


def test_a_silent_device_that_gets_no_goals_any_more_is_overdue_no_longer() -> None:
    watchdog, registers = make()
    watchdog.record(ALL, 0.0)
    silent(watchdog, 0.02, 0.2)
    assert watchdog.overdue.tolist() == [False, True]
    watchdog.watched = FIRST
    watchdog.record(FIRST, 0.21)
    assert watchdog.overdue.tolist() == [False, False]
    watchdog.record(ALL, 0.22)
    assert registers.watchdog.tolist() == [-1, -1]


def test_at_a_low_rate_three_missed_readings_are_no_silence() -> None:
    registers = SlowRegisterValues.unknown(2)
    watchdog = HostWatchdog(registers, 0.05)
    watchdog.watched = ALL
    watchdog.record(ALL, 0.0)
    for now in (0.05, 0.1, 0.15):
        watchdog.record(FIRST, now)
        assert not watchdog.overdue.any()
    watchdog.record(FIRST, 0.2)
    assert watchdog.overdue.tolist() == [False, True]


@pytest.mark.parametrize("pauses", [(0.5,), (0.06, 0.06), (0.01, 5.0, 5.0)])
def test_of_a_pause_between_readings_no_more_counts_than_of_a_missed_reading_at_a_low_rate(
    pauses: tuple[float, ...],
) -> None:
    """The daemon stood still, and no goal left that the device could have missed."""
    watchdog, registers = make()
    now = 7.0
    watchdog.record(ALL, now)
    for pause in pauses:
        now += pause
        watchdog.record(FIRST, now)
    assert watchdog.overdue.tolist() == [False, False]
    watchdog.record(ALL, now + 0.01)
    assert registers.watchdog.tolist() == [-1, -1]


def test_a_fourth_reading_without_a_reply_trips_however_long_the_pauses_were() -> None:
    watchdog, registers = make()
    watchdog.record(ALL, 0.0)
    for now in (5.0, 10.0, 15.0):
        watchdog.record(FIRST, now)
        assert not watchdog.overdue.any()
    watchdog.record(FIRST, 20.0)
    assert watchdog.overdue.tolist() == [False, True]
    watchdog.record(ALL, 20.01)
    assert registers.watchdog.tolist() == [-1, TRIPPED]
