"""Published state: a tick each period, the overview ten times a second or at once, state before answer."""

import itertools
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.robot.modes import Mode
from twind.telemetry.timing_monitor import COMMAND, READING

N = 24


@pytest.fixture
def sim(make_rig: MakeRig) -> Rig:
    rig: Rig = make_rig(mode=Mode.SIM)
    return rig


def of(rig: Rig, kind: type[Any]) -> list[Any]:
    return [news for news in rig.news if isinstance(news, kind)]


def floats(data: bytes) -> np.ndarray:
    return np.frombuffer(data, np.float64)


def test_every_tick_is_published_once_with_its_number(live: Rig) -> None:
    live.ticks(30)
    numbers = [tick.sequence for tick in of(live, link.Tick)]
    assert numbers == list(range(numbers[0], numbers[0] + 30))
    gaps = np.diff([tick.time for tick in of(live, link.Tick)])
    assert gaps == pytest.approx(live.loop.robot.period)


def test_the_arrays_of_a_tick_are_the_loops_own_in_joint_order(armed: Rig) -> None:
    armed.ticks(5)
    tick = of(armed, link.Tick)[-1]
    loop = armed.loop
    assert floats(tick.position).tolist() == loop.robot.measured.position.tolist()
    assert floats(tick.velocity).tolist() == loop.robot.measured.velocity.tolist()
    assert floats(tick.effort).tolist() == loop.robot.measured.effort.tolist()
    assert floats(tick.age).tolist() == loop.robot.measured.age.tolist()
    assert floats(tick.simulated).tolist() == loop.robot.simulated.position.tolist()
    assert tick.heard == bytes([1] * N)
    assert floats(tick.goal) == pytest.approx(loop.robot.written)
    assert (tick.mode, tick.state, tick.motion, tick.armed) == ("live", "armed", "holding", True)


def test_the_skew_of_two_buses_is_in_every_tick_and_its_maximum_in_the_overview(make_rig: MakeRig) -> None:
    rig = make_rig("h24-split")
    rig.connect()
    rig.ticks(20)
    tick = of(rig, link.Tick)[-1]
    overview = of(rig, link.Overview)[-1]
    assert tick.skew == rig.loop.hardware.last_exchange.skew >= 0.0
    assert overview.skew_ms is not None
    assert overview.skew_max_ms == pytest.approx(rig.loop.hardware.last_exchange.worst_skew * 1e3)


def test_a_robot_of_one_bus_has_no_skew(live: Rig) -> None:
    live.connect()
    assert np.isnan(of(live, link.Tick)[-1].skew)
    assert of(live, link.Overview)[-1].skew_ms is None


def test_without_a_goal_the_goal_is_unknown_and_not_zero(live: Rig) -> None:
    live.connect()
    assert np.isnan(floats(of(live, link.Tick)[-1].goal)).all()


def test_in_sim_the_position_is_the_simulated_one_and_no_latency_is_made_up(sim: Rig) -> None:
    sim.ticks(20)
    tick = of(sim, link.Tick)[-1]
    overview = of(sim, link.Overview)[-1]
    assert tick.position == tick.simulated
    assert (overview.latency_ms, overview.hw_connected) == (None, False)
    assert overview.torque == bytes([255] * N)  # -1: unknown
    assert np.isnan(floats(overview.voltage)).all()
    assert [bus.connected for bus in overview.buses] == [False]
    assert [bus.utilisation for bus in overview.buses] == [0.0]


def test_the_overview_is_published_ten_times_a_second(live: Rig) -> None:
    live.connect()
    live.seconds(1.0)
    live.news.clear()
    live.seconds(2.0)
    assert len(of(live, link.Overview)) == pytest.approx(20, abs=2)
    assert len(of(live, link.Tick)) == 200


def test_a_change_of_mode_or_state_is_published_in_the_same_tick(live: Rig) -> None:
    live.connect()
    for at, kind in itertools.product(range(4), (link.AcquireLease, link.ReleaseLease)):
        live.ticks(1 + at)
        live.news.clear()
        live.send(kind)
        live.ticks(1)
        assert len(of(live, link.Overview)) == 1


def test_the_state_comes_before_the_answer_that_it_explains(live: Rig) -> None:
    live.connect()
    live.news.clear()
    live.send(link.SetMode, mode="sim")
    live.ticks(1)
    kinds = [type(news) for news in live.news]
    assert kinds.index(link.Tick) < kinds.index(link.Reply)
    assert of(live, link.Tick)[0].mode == "sim"


def test_the_lease_is_published_with_its_holder_and_remaining_time(live: Rig) -> None:
    live.connect()
    assert of(live, link.Overview)[-1].lease is None
    assert of(live, link.Overview)[-1].lease_client == 0
    live.lease()
    overview = of(live, link.Overview)[-1]
    assert (overview.lease.holder, overview.lease_client) == ("test", 7)
    assert 0.0 < overview.lease.expires_in <= 1.0


def test_a_bus_is_published_with_its_counts_and_utilisation(live: Rig) -> None:
    live.connect()
    live.virtual["main"].faults.silence(3)
    live.seconds(1.0)
    (bus,) = of(live, link.Overview)[-1].buses
    assert (bus.name, bus.port, bus.connected) == ("main", "virtual:main", True)
    assert 0.0 < bus.utilisation < 1.0
    assert bus.exchanges > bus.errors >= 90
    assert 0.0 < bus.latency_ms <= bus.latency_p99_ms * 1.05


def test_slow_registers_are_published_in_joint_order(live: Rig) -> None:
    live.connect()
    live.virtual["main"].faults.damage(5, 0b100)
    live.seconds(1.0)
    overview = of(live, link.Overview)[-1]
    place = next(at for at, joint in enumerate(live.robot.joints) if joint.id == 5)
    faults = np.frombuffer(overview.fault_bits, np.int16)
    assert np.flatnonzero(faults).tolist() == [place]
    assert faults[place] == 0x104  # the alert of the reading and the bit of the register
    assert (floats(overview.temperature) > 0).all()
    assert np.frombuffer(overview.torque, np.int8).tolist() == [0] * N


def test_in_sim_nothing_is_published_of_the_robot_that_was_read_before(live: Rig) -> None:
    live.connect()
    live.virtual["main"].faults.damage(5, 0b100)
    live.seconds(1.0)
    assert live.call(link.SetMode, mode="sim").error is None
    live.seconds(0.2)
    overview = of(live, link.Overview)[-1]
    assert np.isnan(floats(overview.temperature)).all()
    assert np.isnan(floats(overview.voltage)).all()
    assert (np.frombuffer(overview.fault_bits, np.int16) == -1).all()
    assert live.call(link.SetMode, mode="mirror").error is None
    live.seconds(1.0)
    assert (floats(of(live, link.Overview)[-1].temperature) > 0).all()


def test_ticks_that_a_slow_front_missed_are_counted_in_the_next(live: Rig) -> None:
    live.connect()
    live.loop.run(until=live.clock.now() + 5.0)  # the front's end is not read meanwhile
    live.ticks(1)
    last = of(live, link.Tick)[-1].sequence
    live.news.clear()
    live.ticks(2)
    first, second = of(live, link.Tick)
    lost = first.sequence - last - 1
    assert lost > 100
    assert lost < first.dropped <= 1.2 * lost  # overviews too
    assert second.dropped == 0


def test_every_hop_is_published_with_its_figures(live: Rig) -> None:
    live.connect()
    live.seconds(1.0)
    told = {latency.hop: latency for latency in of(live, link.Overview)[-1].latencies}
    assert list(told) == ["total", *READING, *COMMAND]
    assert told["total"].now_ms > 0.0
    assert told["total"].min_ms <= told["total"].mean_ms <= told["total"].max_ms
    assert told["total"].violations == 0
