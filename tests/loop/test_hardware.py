"""Ticks become radians here and nowhere else; both buses go together; what was not heard is never made up."""

import re
from math import inf

import numpy as np
import pytest

from tests.support.two_bus_rig import PERIOD, TURN, TwoBuses
from twind.loop.bus.bus_port import PortState
from twind.robot.arrays import Floats

# ------------------------------------------------------------------------------------- raw ↔ SI


def test_a_reading_has_every_joint_at_its_place_with_its_sign_and_ratio() -> None:
    world = TwoBuses()
    for bus in world.virtual.values():
        bus.servos.muscles.position += [10.0, 20.0, 30.0]
    state = world.tick(count=2)
    expected = np.array([10 * 1.0, 10 * -0.5, 20 * -1.0, 20 * 1.0, 30 * 0.5, 30 * -1.0]) * TURN
    assert state.position == pytest.approx(expected)
    assert state.heard.all()


def test_goals_reach_the_servos_as_the_ticks_that_the_position_means() -> None:
    world = TwoBuses()
    world.connect()
    world.tick(np.array([100, 200, 300, 400, 50, 600]) * TURN)
    assert world.goals() == [2048 + 100, 2048 - 400, 2060 - 300, 1990 + 400, 2100 + 100, 2048 - 600]


# ------------------------------------------------------------------------------------- all or nothing


def test_goals_of_both_buses_leave_or_none_when_one_is_outside_its_clamp() -> None:
    world = TwoBuses()
    world.connect()
    world.tick(np.zeros(6))
    before = world.goals()
    wrong = np.full(6, 50 * TURN)
    wrong[5] = 1100 * TURN  # the last joint of the second bus: 948, below its 1000
    state = world.hardware.exchange(wrong, world.clock.now())
    assert re.search(r"right: id 6: goal 948 outside 1000\.\.3000", str(world.hardware.clamped))
    assert not world.hardware.left
    assert state.heard.all()  # reading goes on: silence would trip every watchdog
    world.tick(count=5)
    assert world.goals() == before


@pytest.mark.parametrize("value", [np.nan, inf, -inf, 1e300])
def test_a_goal_that_is_no_tick_at_all_is_refused_and_nothing_leaves(value: float) -> None:
    world = TwoBuses()
    world.connect()
    world.tick(np.zeros(6))
    before = world.goals()
    wrong = np.full(6, 50 * TURN)
    wrong[3] = value
    state = world.hardware.exchange(wrong, world.clock.now())
    assert re.search("right: id 5: goal", str(world.hardware.clamped))
    assert not world.hardware.left
    assert state.heard.all()  # reading goes on: silence would trip every watchdog
    world.tick(count=5)
    assert world.goals() == before


def test_goals_go_only_to_buses_that_hold() -> None:
    world = TwoBuses()
    world.connect()
    world.tick(np.full(6, 50 * TURN))
    before = world.goals()
    world.hardware.hold(False)
    world.tick(np.full(6, 90 * TURN), count=3)
    assert world.goals() == before
    assert not world.hardware.left


def test_without_a_writer_goals_go_nowhere() -> None:
    world = TwoBuses(live=False)
    world.connect()
    before = world.goals()
    world.tick(np.full(6, 50 * TURN), count=3)
    assert world.hardware.writers == []
    assert world.goals() == before


def test_after_clear_no_goal_and_no_script_is_left() -> None:
    world = TwoBuses()
    world.connect()
    before = world.goals()
    for (_, bus), writer in zip(world.hardware.pairs, world.hardware.writers, strict=True):
        writer.goals(bus.zero + 50)
    tasks = world.hardware.write_goals(np.full(6, 50 * TURN))
    world.hardware.clear()
    world.tick(count=5)
    assert world.goals() == before
    assert all(task.done and "more urgent" in str(task.error) for task in tasks)


# ------------------------------------------------------------------------------------- what is not known


def test_before_the_first_answer_everything_is_unknown_never_zero() -> None:
    world = TwoBuses()
    for bus in world.virtual.values():
        bus.faults.unplug()
    state = world.tick()
    assert np.isnan(state.position).all()
    assert np.isnan(state.velocity).all()
    assert np.isnan(state.effort).all()
    assert np.isinf(state.age).all()
    assert not state.heard.any()
    assert np.isnan(state.round_trip)


def test_a_silent_servo_keeps_its_old_numbers_and_they_grow_old() -> None:
    world = TwoBuses()
    world.connect()
    old = world.tick().position[2]
    world.virtual["left"].faults.silence(2)
    for bus in world.virtual.values():
        bus.servos.muscles.position += 40.0
    state = world.tick(count=20)
    assert state.heard.tolist() == [True, True, False, True, True, True]
    assert state.position[2] == old
    assert 19 * PERIOD < state.age[2] < 21 * PERIOD
    others = [0, 1, 3, 4, 5]
    assert (state.age[others] < PERIOD).all()
    assert state.position[0] == pytest.approx(40 * TURN)


def test_a_reading_is_read_only_and_unchanged_by_the_next() -> None:
    world = TwoBuses()
    first = world.tick()
    was = first.position.copy()
    for bus in world.virtual.values():
        bus.servos.muscles.position += 40.0
    second = world.tick()
    assert first.position.tolist() == was.tolist() != second.position.tolist()
    for array in (second.position, second.velocity, second.effort, second.age, second.heard):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_slow_registers_are_in_joint_order_and_cleared_with_their_bus() -> None:
    world = TwoBuses()
    world.connect()
    slow = world.hardware.slow
    assert slow.torque.tolist() == [0] * 6
    assert slow.fault.tolist() == [0] * 6
    assert np.isfinite(slow.voltage).all()
    world.virtual["right"].faults.damage(5, 0b100)
    world.tick(count=20)
    assert slow.fault.tolist() == [0, 0, 0, 4, 0, 0]
    assert world.hardware.readings.alerts[3] == 0x80
    world.virtual["right"].faults.unplug()
    world.tick()
    assert slow.torque.tolist() == [0, -1, 0, -1, 0, -1]
    assert slow.fault.tolist() == [0, -1, 0, -1, 0, -1]
    assert np.isnan(slow.voltage[[1, 3, 5]]).all()
    assert np.isfinite(slow.voltage[[0, 2, 4]]).all()


# ------------------------------------------------------------------------------------- life of the ports


def test_a_lost_bus_is_reported_once_and_the_other_continues() -> None:
    world = TwoBuses()
    world.connect()
    world.virtual["right"].faults.unplug()
    state = world.tick(count=3)
    assert [(lost.bus, lost.error.lost) for lost in world.hardware.lost] == [("right", True)]
    assert state.heard.tolist() == [True, False, True, False, True, False]
    assert world.ports[1].link is PortState.CLOSED
    world.virtual["right"].faults.replug()
    assert world.tick(count=20).heard.all()


def test_connected_means_every_bus() -> None:
    world = TwoBuses()
    world.connect()
    world.ports[1].link = PortState.IDENTIFYING
    assert not world.hardware.connected
    world.ports[1].link = PortState.CONNECTED
    assert world.hardware.connected


def test_access_decides_what_is_open_and_whether_anything_could_write() -> None:
    world = TwoBuses(live=False)
    world.connect()
    assert world.hardware.writers == []
    world.hardware.access(read=True, write=True)
    assert len(world.hardware.writers) == 2
    world.hardware.access(read=True, write=False)
    assert world.hardware.writers == []
    world.hardware.access(read=False, write=False)
    assert not any(port.reader for port in world.ports)
    tries = len(world.tries)
    assert not world.tick(count=10).heard.any()
    assert len(world.tries) == tries
    assert world.hardware.lost == []


def test_an_exchange_ends_within_the_period_even_without_replies() -> None:
    world = TwoBuses()
    world.connect()
    for bus, ids in (("left", (1, 2, 3)), ("right", (4, 5, 6))):
        for id in ids:
            world.virtual[bus].faults.silence(id)
    begin = world.clock.now()
    state = world.hardware.exchange(None, begin)
    assert not state.heard.any()
    assert world.clock.now() < begin + PERIOD
    assert np.isnan(world.hardware.last_exchange.hops).all()
    assert np.isnan(world.hardware.last_exchange.trips).all()


def test_hops_and_trips_are_the_times_of_the_last_exchange() -> None:
    world = TwoBuses()
    world.connect()
    state = world.tick()
    waited, read = world.hardware.last_exchange.hops
    assert waited > 0.0
    assert read >= 0.0
    assert waited + read == pytest.approx(state.round_trip)
    assert max(world.hardware.last_exchange.trips) == pytest.approx(state.round_trip)


def test_the_skew_is_the_time_between_the_first_and_the_last_bus_that_had_answered() -> None:
    world = TwoBuses()
    world.connect()
    world.tick()
    usual = world.hardware.last_exchange.skew
    assert 0.0 <= usual == pytest.approx(abs(np.diff(world.hardware.last_exchange.trips).item()), abs=5e-4)
    world.virtual["left"].faults.delay(0.0006)
    world.tick()
    later = world.hardware.last_exchange.skew
    assert later == pytest.approx(usual + 0.0006, abs=3e-4)
    world.virtual["left"].faults.delay(0.0)
    world.tick(count=20)
    assert world.hardware.last_exchange.skew == pytest.approx(usual, abs=1e-4)
    assert world.hardware.last_exchange.worst_skew >= later


def test_a_single_answering_bus_has_no_skew() -> None:
    world = TwoBuses()
    world.connect()
    worst = world.hardware.last_exchange.worst_skew
    for id in (1, 2, 3):
        world.virtual["left"].faults.silence(id)
    world.tick(count=3)
    assert np.isnan(world.hardware.last_exchange.skew)
    assert world.hardware.last_exchange.worst_skew >= worst > -1.0


def test_foreign_bytes_are_counted_and_move_no_joint() -> None:
    world = TwoBuses()
    world.connect()
    before = world.tick().position
    world.virtual["left"].faults.foreign(1)
    state = world.tick()
    assert world.hardware.last_exchange.discarded > 0
    assert state.position.tolist() == before.tolist()
    world.tick()
    assert world.hardware.last_exchange.discarded == 0


def test_arming_scripts_go_to_every_bus_and_torque_off_does_not_wait() -> None:
    world = TwoBuses()
    world.connect()
    for script in (world.hardware.prepare(np.zeros(6)), world.hardware.torque(True)):
        world.tick(count=12)
        assert [task.error for task in script] == [None, None]
        assert all(task.done for task in script)
    assert all(bus.servos["torque_enable"].tolist() == [1, 1, 1] for bus in world.virtual.values())
    slow = world.hardware.prepare(np.zeros(6))
    off = world.hardware.torque(False)
    world.tick()
    assert all(bus.servos["torque_enable"].tolist() == [0, 0, 0] for bus in world.virtual.values())
    assert not any(task.done for task in slow)
    world.tick(count=20)
    assert all(task.done and task.error is None for task in [*slow, *off])


def test_alerts_that_come_and_go_delay_no_script_that_changes_torque() -> None:
    """Servos at too low a supply on a bad contact: an alert, and every other reply missing."""
    world = TwoBuses()
    world.connect()
    for script in (world.hardware.prepare(np.zeros(6)), world.hardware.torque(True)):
        world.tick(count=12)
        assert all(task.done and task.error is None for task in script)
    left = world.virtual["left"]
    world.ports[0].alert_register = "hardware_error_status"
    for id in (1, 2, 3):
        left.faults.damage(id, 1)
    world.tick(np.zeros(6), count=20)
    strong = left.servos["goal_pwm"].tolist()
    tasks = world.hardware.damp()
    for tick in range(40):
        for id in (1, 2, 3):
            left.faults.silence(id, on=bool((tick + id) % 2))
        world.tick(np.zeros(6))
    assert [task.result for task in tasks] == [(), ()]
    assert all(soft < once for soft, once in zip(left.servos["goal_pwm"], strong, strict=True))


def test_goals_are_read_back_where_they_are_sent_and_a_bus_without_goals_delays_nothing() -> None:
    """A bus that is back after a loss: its silent servo does not keep an e-stop from its reply."""
    world = TwoBuses()
    world.connect()
    goal = np.full(6, 50 * TURN)
    world.tick(goal, count=3)
    left = world.virtual["left"]
    left.faults.unplug()
    world.tick(goal, count=2)
    left.faults.replug()
    left.faults.silence(2)
    world.tick(goal, count=60)
    assert [port.holding for port in world.ports] == [False, True]
    reading = world.hardware.read_goals()
    ended: list[Floats] = []
    while not ended:
        try:
            next(reading)
        except StopIteration as stop:
            ended.append(stop.value)
        world.tick(goal)
    assert ended[0] == pytest.approx(
        [np.nan, goal[1], np.nan, goal[3], np.nan, goal[5]], nan_ok=True, abs=TURN
    )
