from math import inf, isnan, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.robot.finding import Code, Finding
from twind.robot.state import JointState
from twind.safety.health import HOPS, Health, Window

durations = st.floats(1e-6, 5.0)


def test_nothing_is_known_of_an_empty_window() -> None:
    window = Window(0.05)
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
    assert isnan(window.p95(0.0))
    assert (window.count, window.violations) == (0, 0)


@given(st.lists(durations, min_size=1, max_size=260))
def test_statistics_are_those_of_the_last_hundred(values: list[float]) -> None:
    window = Window(0.05)
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
    window = Window()
    for value in values:
        window.add(value)
    ordered = sorted(values)
    for share, seen in ((0.5, window.p50), (0.99, window.p99)):
        true = ordered[max(0, int(np.ceil(share * len(values))) - 1)]
        assert seen == pytest.approx(true, rel=0.021)
    assert window.p50 <= window.p99 <= window.worst


@pytest.mark.parametrize("value", [0.0, 1e-9, 1e-6, 100.0, 1e300])
def test_values_beyond_the_histogram_keep_their_own_size(value: float) -> None:
    window = Window()
    window.add(value)
    assert (window.p50, window.p99) == (value, value)


@pytest.mark.parametrize("unknown", [nan, -1e-9, -inf, inf])
def test_what_is_unknown_or_negative_is_too_late_and_in_no_average(unknown: float) -> None:
    window = Window(0.05)
    window.add(0.01, 1.0)
    window.add(unknown, 1.01)
    assert isnan(window.now)
    assert (window.mean, window.max, window.worst, window.count) == (0.01, 0.01, 0.01, 2)
    assert window.violations == 1
    assert window.p95(1.02) == inf
    window.add(0.02, 1.03)
    assert window.now == 0.02


def test_p95_looks_at_the_last_half_second_alone() -> None:
    window = Window()
    for tick in range(200):
        window.add(0.2 if tick < 100 else 0.01, tick * 0.01)
    assert window.p95(1.99) == 0.01
    assert window.p95(1.20) == 0.2
    assert isnan(window.p95(3.0))
    assert isnan(window.p95(nan))


@pytest.mark.parametrize(("late", "seen"), [(2, 0.01), (3, 0.2)])
def test_p95_lets_five_percent_be_late_and_no_more(late: int, seen: float) -> None:
    window = Window()
    for tick in range(50):
        window.add(0.2 if tick < late else 0.01, tick * 0.01)
    assert window.p95(0.49) == seen


# ---------------------------------------------------------------------------------------------- health


class Exchange:
    """Two buses that answered in 2 and 3 ms."""

    def __init__(self) -> None:
        self.hops = (0.001, 0.002)
        self.trips = [0.002, 0.003]


def reading(time: float, trip: float = 0.003, heard: bool = True) -> JointState:
    still = np.zeros(2)
    return JointState(time, still, still, still, still, np.array([heard, False]), trip)


def test_latency_is_the_age_of_the_state_and_its_round_trip() -> None:
    health = Health(2)
    assert isnan(health.latency(0.0))
    assert isnan(health.latency_p95(0.0))
    assert not health.connected(0.0)
    for tick in range(10):
        now = tick * 0.01
        health.update(reading(now + 0.003), Exchange(), now, live=True)
    assert health.latency(0.1) == pytest.approx(0.01)
    assert health.latency_p95(0.1) == pytest.approx(0.01)
    assert health.total.count == 9
    assert [window.now for window in health.buses] == [0.002, 0.003]
    assert (health.hops["request"].now, health.hops["reply"].now) == (0.001, 0.002)


def test_while_nobody_answers_the_latency_grows_and_then_it_counts_as_disconnected() -> None:
    health = Health(2)
    health.update(reading(1.0), Exchange(), 1.0, live=True)
    health.update(reading(1.5, nan, heard=False), Exchange(), 1.5, live=True)
    assert health.latency(1.5) == pytest.approx(0.503)
    assert health.connected(3.0)
    assert not health.connected(3.001)
    assert not health.connected(nan)


def test_in_sim_nothing_of_a_bus_is_known() -> None:
    health = Health(2)
    health.update(reading(1.0), Exchange(), 1.0, live=True)
    assert health.update(reading(1.01), Exchange(), 1.01, live=False) == ()
    assert isnan(health.latency(1.01))
    assert not health.connected(1.01)


def test_the_hops_have_names_and_others_are_errors() -> None:
    health = Health(1)
    assert tuple(health.hops) == HOPS
    health.hop("twin", 0.001, 0.0)
    assert health.hops["twin"].now == 0.001
    with pytest.raises(KeyError):
        health.hop("bridge", 0.001, 0.0)


def warnings(latencies: list[float]) -> int:
    """How often it is told, when the latency at the start of each tick of 10 ms is this."""
    health, count = Health(2), 0
    for tick, latency in enumerate(latencies):
        now = tick * 0.01
        count += len(health.update(reading(now, 0.0), Exchange(), now, live=True))
        # What the next tick will see: a reading that is as old as wanted then.
        health.update(reading(now + 0.01 - latency, 0.0), Exchange(), now, live=True)
    return count


def test_a_latency_above_the_threshold_is_told_once_with_its_numbers() -> None:
    health = Health(2)
    health.update(reading(0.0, 0.0), Exchange(), 0.0, live=True)
    assert health.update(reading(0.05, 0.0), Exchange(), 0.05, live=True) == ()
    found = health.update(reading(0.05, 0.0), Exchange(), 0.11, live=True)
    assert found == (Finding(Code.LATENCY_WARN, value=pytest.approx(0.06), bound=0.05, message="s"),)
    assert health.update(reading(0.05, 0.0), Exchange(), 0.12, live=True) == ()


@pytest.mark.parametrize(("calm", "level", "times"), [(50, 0.01, 1), (110, 0.01, 2), (110, 0.045, 1)])
def test_it_is_told_again_only_after_it_was_calm_for_a_second(calm: int, level: float, times: int) -> None:
    assert warnings([0.01, 0.06, *[level] * calm, 0.06, 0.01]) == times
