"""Durations: the last hundred values, and the whole run."""

from math import inf, isnan, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.telemetry.rolling_stats import BOUNDS, BOUNDS_MS, SIZE, RecentValues, RollingStats

durations = st.floats(1e-6, 5.0)


def test_nothing_is_known_of_an_empty_window() -> None:
    window = RollingStats(0.05)
    known = (
        window.now,
        window.mean,
        window.std,
        window.min,
        window.max,
        window.p50,
        window.p99,
        window.worst,
    )
    assert all(isnan(value) for value in known)
    assert isnan(RecentValues().p95(0.0))
    assert (window.count, window.violations) == (0, 0)


@given(st.lists(durations, min_size=1, max_size=260))
def test_statistics_are_those_of_the_last_hundred(values: list[float]) -> None:
    window = RollingStats(0.05)
    for value in values:
        window.add(value)
    last = np.array(values[-100:])
    assert (window.now, window.count) == (values[-1], len(values))
    assert window.mean == pytest.approx(last.mean())
    assert window.std == pytest.approx(last.std(), abs=1e-12)
    assert (window.min, window.max) == (last.min(), last.max())
    assert window.violations == (last > 0.05).sum()
    assert window.worst == max(values)


@given(st.lists(durations, min_size=1, max_size=300))
def test_percentiles_of_the_run_are_within_two_percent_of_a_value_of_their_rank(values: list[float]) -> None:
    window = RollingStats()
    for value in values:
        window.add(value)
    ordered = sorted(values)
    for share, seen in ((0.5, window.p50), (0.99, window.p99)):
        true = ordered[max(0, int(np.ceil(share * len(values))) - 1)]
        assert seen == pytest.approx(true, rel=0.021)
    assert window.p50 <= window.p99 <= window.worst


def test_p99_of_a_long_run_follows_a_burst_at_once() -> None:
    """The burst is less than a hundredth of the run, and raises the share of slow values to 1.9 %."""
    window = RollingStats()
    for place in range(100_000):
        window.add(0.02 if place % 1000 < 9 else 0.001)
    assert window.p99 == pytest.approx(0.001, rel=0.021)
    for _ in range(999):
        window.add(0.02)
    assert window.p99 == pytest.approx(0.02, rel=0.021)
    assert window.p50 == pytest.approx(0.001, rel=0.021)


def test_quantiles_are_computed_on_the_first_known_value() -> None:
    window = RollingStats()
    for _ in range(1000):
        window.add(nan)
    assert isnan(window.p99)
    window.add(0.02)
    assert window.p99 == pytest.approx(0.02, rel=0.021)


@pytest.mark.parametrize("value", [0.0, 1e-9, 1e-6, 100.0, 1e300])
def test_values_beyond_the_histogram_keep_their_own_size(value: float) -> None:
    window = RollingStats()
    window.add(value)
    assert (window.p50, window.p99) == (value, value)


@pytest.mark.parametrize("unknown", [nan, -1e-9, -inf, inf])
def test_an_unknown_or_negative_time_is_a_violation_and_in_no_average(unknown: float) -> None:
    window = RollingStats(0.05)
    window.add(0.01, 1.0)
    window.add(unknown, 1.01)
    assert isnan(window.now)
    assert (window.mean, window.max, window.worst, window.count) == (0.01, 0.01, 0.01, 2)
    assert window.violations == 1
    window.add(0.02, 1.03)
    assert window.now == 0.02
    recent = RecentValues()
    recent.add(0.01, 1.0)
    recent.add(unknown, 1.01)
    assert recent.p95(1.02) == inf


def test_p95_looks_at_the_last_half_second_alone() -> None:
    recent = RecentValues()
    for tick in range(200):
        recent.add(0.2 if tick < 100 else 0.01, tick * 0.01)
    assert recent.p95(1.99) == 0.01
    assert recent.p95(1.20) == 0.2
    assert isnan(recent.p95(3.0))
    assert isnan(recent.p95(nan))


@pytest.mark.parametrize(("late", "seen"), [(2, 0.01), (3, 0.2)])
def test_p95_lets_five_percent_be_late_and_no_more(late: int, seen: float) -> None:
    recent = RecentValues()
    for tick in range(50):
        recent.add(0.2 if tick < late else 0.01, tick * 0.01)
    assert recent.p95(0.49) == seen


# --------------------------------------------------------------------------------------- violations


def test_a_value_is_held_to_the_bound_of_its_own_time() -> None:
    window = RollingStats(0.05)
    window.add(0.06, 1.0)
    window.add(0.06, 1.0, bound=0.1)
    window.add(0.06, 1.0, bound=inf)
    window.add(0.2, 1.0, bound=0.1)
    window.threshold = 0.1
    window.add(0.06, 1.0)
    assert window.violations == 2  # the first, and the one above its own bound


def test_a_value_at_the_bound_is_none_and_the_next_float_is_one() -> None:
    window = RollingStats(0.05)
    window.add(0.05)
    assert window.violations == 0
    window.add(float(np.nextafter(0.05, 1.0)))
    assert window.violations == 1


def test_violations_leave_the_window_with_their_values() -> None:
    window = RollingStats(0.05)
    window.add(nan)
    for count in range(SIZE):
        assert window.violations == 1, count
        window.add(0.01)
    assert window.violations == 0


def test_rolling_stats_keep_the_time_of_the_last_value() -> None:
    window = RollingStats()
    assert window.at == -inf
    window.add(0.01, 5.0)
    window.add(nan, 6.0)
    assert window.at == 6.0


# --------------------------------------------------------------------------------------- the run's buckets

anything = durations | st.sampled_from([nan, inf, -inf, -1e-9, 0.0, *BOUNDS]) | st.floats()


@given(st.lists(anything, max_size=300))
def test_every_value_of_the_run_is_in_one_bucket_and_those_of_no_size_in_the_last(
    values: list[float],
) -> None:
    window = RollingStats()
    for value in values:
        window.add(value)
    assert sum(window.buckets) == len(values) == window.count
    for place, upper in enumerate(BOUNDS):
        assert sum(window.buckets[: place + 1]) == sum(0.0 <= value <= upper for value in values)
    known = [value for value in values if 0.0 <= value < inf]
    assert window.sum == pytest.approx(sum(known))


def test_bounds_are_one_two_five_and_stand_in_order() -> None:
    assert list(BOUNDS_MS) == sorted(set(BOUNDS_MS))
    assert {float(f"{bound:.0e}"[0]) for bound in BOUNDS_MS} == {1.0, 2.0, 5.0}
    assert (BOUNDS_MS[0], BOUNDS_MS[-1]) == (0.01, 1000.0)
    assert [bound * 1e3 for bound in BOUNDS] == pytest.approx(BOUNDS_MS)
