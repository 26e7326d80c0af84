"""Figures of the loop: none before the first tick, and the worst of the run is kept."""

from itertools import repeat

import pytest

from twind.loop.process.realtime import Granted, denied
from twind.loop.tick.loop_figures import ON_TIME, LoopFigures


def figures_of(*late: float, missed: int = 0) -> LoopFigures:
    figures = LoopFigures(0.01, {"scheduler": Granted("fifo 40"), "memory": denied("not permitted")})
    for lateness in late:
        figures.lateness = lateness
        figures.tick(missed)
    return figures


def test_before_the_first_tick_lateness_is_unknown_and_not_zero() -> None:
    info = figures_of().info()
    assert (info.ticks, info.missed) == (0, 0)
    assert (info.late_p50_us, info.late_p99_us, info.late_max_us) == (None, None, None)


def test_loop_rate_and_granted_realtime_are_reported_as_measured() -> None:
    info = figures_of(1e-4).info()
    assert info.rate_hz == pytest.approx(100.0)
    assert info.realtime == {"scheduler": "fifo 40", "memory": "no: not permitted"}
    assert info.realtime_denied == ["memory"]


def test_missed_ticks_add_up() -> None:
    figures = figures_of(1e-4, 1e-4, missed=2)
    figures.tick(0)
    assert (figures.info().ticks, figures.info().missed) == (3, 4)


def test_the_worst_is_how_long_ticks_that_were_left_out_had_to_wait() -> None:
    """After a tick that took five periods the next is on time: its own lateness says that all is well."""
    figures = figures_of(1e-4)
    figures.tick(4)
    figures.tick(0)
    info = figures.info(whole=True)
    assert info.late_max_us == pytest.approx(40_000.0)
    assert info.late_p99_us == pytest.approx(100.0, rel=0.03)
    assert info.lateness is not None and sum(each.count for each in info.lateness) == 3


def test_the_median_is_not_moved_by_one_bad_tick_and_the_worst_is_kept() -> None:
    info = figures_of(*repeat(1e-4, 200), 0.05, *repeat(1e-4, 200)).info()
    assert info.late_p50_us == pytest.approx(100.0, rel=0.03)
    assert info.late_p99_us == pytest.approx(100.0, rel=0.03)
    assert info.late_max_us == pytest.approx(50_000.0)


def test_on_time_is_the_share_of_the_last_hundred_ticks() -> None:
    assert figures_of(*repeat(ON_TIME * 1.01, 25)).info().on_time == pytest.approx(0.75)
    assert figures_of(*repeat(0.0, 100)).info().on_time == 1.0
    assert figures_of(*repeat(0.01, 100)).info().on_time == 0.0
    assert figures_of(*repeat(0.01, 100), *repeat(ON_TIME, 100)).info().on_time == 1.0


def test_a_lateness_that_is_unknown_is_not_on_time() -> None:
    assert figures_of(float("nan")).info().on_time == pytest.approx(0.99)
