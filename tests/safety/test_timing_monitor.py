"""The way of a reading, hop by hop, whether anybody answers, and what is told when a hop is too slow."""

from math import inf, isfinite, isnan, nan

import numpy as np
import pytest

from twind.robot.joint_state import JointState
from twind.safety.latency_alarm import LatencyAlert
from twind.telemetry.timing_monitor import COMMAND, READING, TimingMonitor


class Exchange:
    """Two buses that answered in 2 and 3 ms."""

    def __init__(self) -> None:
        self.hops = (0.001, 0.002)
        self.trips = [0.002, 0.003]


def reading(time: float, trip: float = 0.003, fresh: bool = True) -> JointState:
    still = np.zeros(2)
    return JointState(time, still, still, still, still, np.array([fresh, False]), trip)


def test_latency_is_the_age_of_the_state_and_its_round_trip() -> None:
    health = TimingMonitor(2)
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


def test_latency_grows_without_replies_until_the_robot_counts_as_disconnected() -> None:
    health = TimingMonitor(2)
    health.update(reading(1.0), Exchange(), 1.0, live=True)
    health.update(reading(1.5, nan, fresh=False), Exchange(), 1.5, live=True)
    assert health.latency(1.5) == pytest.approx(0.503)
    assert health.connected(3.0)
    assert not health.connected(3.001)
    assert not health.connected(nan)


def test_in_sim_nothing_of_a_bus_is_known() -> None:
    health = TimingMonitor(2)
    health.update(reading(1.0), Exchange(), 1.0, live=True)
    health.update(reading(1.01), Exchange(), 1.01, live=False)
    assert isnan(health.latency(1.01))
    assert not health.connected(1.01)


def test_the_hops_have_names_and_others_are_errors() -> None:
    health = TimingMonitor(1)
    assert tuple(health.hops) == (*READING, *COMMAND)
    health.hop("twin", 0.001, 5.0)
    assert (health.hops["twin"].now, health.hops["twin"].at) == (0.001, 5.0)
    with pytest.raises(KeyError):
        health.hop("bridge", 0.001, 0.0)


def test_another_threshold_is_that_of_all_but_the_motors() -> None:
    health = TimingMonitor(2)
    health.warn_above(0.02)
    others = [window for name, window in health.hops.items() if name != "moved"]
    assert {window.threshold for window in (health.total, *health.buses, *others)} == {0.02}
    assert health.hops["moved"].threshold == inf


# ---------------------------------------------------------------------------------------------- alerts


def latency_alerts(latencies: list[float]) -> list[LatencyAlert]:
    """Return the alerts for these latencies, one at the start of each tick of 10 ms."""
    health = TimingMonitor(2)
    for tick, latency in enumerate(latencies):
        now = tick * 0.01
        health.update(reading(now, 0.0), Exchange(), now, live=True)
        # What the next tick will see: a reading that is as old as wanted then.
        health.update(reading(now + 0.01 - latency, 0.0), Exchange(), now, live=True)
    return health.alerts()


def test_a_latency_above_its_threshold_is_reported_once_with_its_values() -> None:
    health = TimingMonitor(2)
    health.update(reading(0.0, 0.0), Exchange(), 0.0, live=True)
    health.update(reading(0.05, 0.0), Exchange(), 0.05, live=True)
    assert health.alerts() == []
    health.update(reading(0.05, 0.0), Exchange(), 0.11, live=True)
    assert health.alerts() == [LatencyAlert("total", pytest.approx(0.06), 0.05)]
    health.update(reading(0.05, 0.0), Exchange(), 0.12, live=True)
    assert health.alerts() == []


@pytest.mark.parametrize(("calm", "level", "times"), [(50, 0.01, 1), (110, 0.01, 2), (110, 0.045, 1)])
def test_a_latency_is_reported_again_only_after_a_calm_second(calm: int, level: float, times: int) -> None:
    alerts = latency_alerts([0.01, 0.06, *[level] * calm, 0.06, 0.01])
    assert [alert.calm for alert in alerts] == [False, True, False][: 2 * times - 1]
    assert {alert.hop for alert in alerts} == {"total"}


def test_a_latency_that_is_not_known_is_too_late() -> None:
    health = TimingMonitor(2)
    health.update(reading(0.0, nan), Exchange(), 0.0, live=True)
    health.update(reading(0.01, 0.0), Exchange(), 0.01, live=True)
    assert health.alerts() == [LatencyAlert("total", inf, 0.05)]


def test_each_hop_is_reported_by_its_name_against_its_own_bound() -> None:
    health = TimingMonitor(1)
    health.hop("reply", 0.06, 1.0)
    health.hop("written", 0.06, 1.0, bound=0.07)
    health.hop("received", 0.03, 1.0, bound=0.02)
    assert health.alerts() == [LatencyAlert("reply", 0.06, 0.05), LatencyAlert("received", 0.03, 0.02)]


def test_a_hop_with_an_infinite_bound_has_figures_and_no_alarm() -> None:
    health = TimingMonitor(1)
    health.hop("received", 0.3, 1.0, bound=inf)  # a long path is long judged
    health.hop("gated", -0.001, 1.0, bound=inf)
    health.hop("moved", 0.9, 1.0)  # a slow move against friction
    assert health.alerts() == []
    assert [health.hops[name].count for name in ("received", "gated", "moved")] == [1, 1, 1]
    assert [health.hops[name].violations for name in ("received", "gated", "moved")] == [0, 1, 0]


def test_a_slow_stream_has_not_recovered_because_a_trajectory_is_never_late() -> None:
    health = TimingMonitor(1)
    for tick in range(400):
        now = 1.0 + tick * 0.01
        if tick < 10 or tick == 200:
            health.hop("received", 0.08, now)
        elif tick < 300:
            health.hop("received", 3.0, now, bound=inf)
        else:
            health.hop("received", 0.004, now)
        for alert in health.alerts():
            assert isfinite(alert.bound)
            assert (tick, alert.calm) in ((0, False), (301, True))
    assert health.alerts() == []


def test_an_answer_that_is_missing_is_a_violation_and_no_line_of_its_own() -> None:
    health = TimingMonitor(2)
    silent = Exchange()
    silent.hops = (nan, nan)
    for tick in range(3):
        health.update(reading(1.0 + tick * 0.01), silent, 1.0 + tick * 0.01, live=True)
    assert health.hops["request"].violations == health.hops["reply"].violations == 3
    assert health.alerts() == []


def test_reading_alerts_end_in_sim_and_command_alerts_do_not() -> None:
    health = TimingMonitor(2)
    for name in ("reply", "written"):
        health.hop(name, 0.06, 1.0)
    assert len(health.alerts()) == 2
    for now in (1.01, 1.015):
        health.update(reading(now), Exchange(), now, live=False)
    (over,) = health.alerts()
    assert (over.hop, over.calm, isnan(over.value)) == ("reply", True, True)
    for name in ("reply", "written"):
        health.hop(name, 0.06, 1.02)
    assert health.alerts() == [LatencyAlert("reply", 0.06, 0.05)]
