"""Ticks of seconds in which the machine stood still are counted apart."""

from bench.stalls import StallLog, sorted_ticks


def test_a_stall_counts_for_the_seconds_that_it_touches() -> None:
    log = StallLog(0.005)
    log.stalls.append((100.0, 0.02))
    assert log.between(99.0, 100.01)
    assert log.between(100.0, 101.0)
    assert not log.between(101.0, 102.0)
    assert not log.between(98.0, 99.0)


def test_missed_ticks_of_a_stalled_second_are_not_among_the_others() -> None:
    log = StallLog(0.005)
    log.stalls.append((101.5, 0.02))
    rows = [(100.0, 0, 0), (101.0, 98, 2), (102.0, 190, 10), (103.0, 290, 10)]
    assert sorted_ticks(rows, log) == (200, 2, 100, 8)
