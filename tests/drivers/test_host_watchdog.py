"""The watchdog that a driver keeps for devices without one."""

import numpy as np
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


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=60))
def test_a_device_trips_at_its_return_after_more_than_the_limit_and_never_else(
    history: list[tuple[bool, bool]],
) -> None:
    watchdog, registers = make()
    watchdog.record(ALL, 0.0)
    last = np.zeros(2)
    expected = np.zeros(2, np.bool_)
    for step, replies in enumerate(history, 1):
        now = step * 0.03
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
    watchdog.record(FIRST, 0.1)
    watchdog.record(ALL, 0.5)
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
