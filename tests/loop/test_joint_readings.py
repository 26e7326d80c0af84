"""Ticks become radians here and nowhere else; a robot's joints may lie on their buses in any order."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.two_bus_rig import JOINTS, PERIOD, TURN, TwoBuses
from twind.loop.bus.joint_readings import JointReadings, ticks, where
from twind_drivers.bus import BusSample

ANGLES = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).map(np.array)
BUSES = TwoBuses().hardware  # never exchanged: its arithmetic only


@pytest.mark.parametrize(
    ("share", "expected"), [(0.4, 0), (0.6, 1), (1.4, 1), (-0.4, 0), (-0.6, -1), (-1.4, -1), (-1.6, -2)]
)
def test_goals_are_rounded_to_the_nearest_tick_on_both_sides_of_zero(share: float, expected: int) -> None:
    left = JOINTS.buses[0]
    position = np.zeros(6)
    position[left.joints] = share * left.scale
    assert (ticks(left, position) - left.zero).tolist() == [expected] * 3


@examples(100)
@given(ANGLES)
def test_a_quantised_position_is_a_whole_tick_less_than_half_a_tick_away(position: np.ndarray) -> None:
    held = BUSES.quantised(position)
    assert (np.abs(held - position) <= BUSES.resolution / 2 * (1 + 1e-9)).all()
    for _, bus in BUSES.pairs:
        assert ticks(bus, held).tolist() == ticks(bus, position).tolist()
    assert BUSES.quantised(held).tolist() == held.tolist()


def test_the_resolution_of_a_joint_is_a_tick_through_its_gear() -> None:
    assert BUSES.resolution == pytest.approx(np.array([1.0, 0.5, 1.0, 1.0, 0.5, 1.0]) * TURN)


@given(st.permutations(range(6)), st.integers(1, 6))
def test_an_index_of_a_bus_names_its_joints_whatever_their_order(order: list[int], count: int) -> None:
    bus = replace(JOINTS.buses[0], joints=np.array(order[:count], np.int64))
    assert np.arange(6)[where(bus)].tolist() == order[:count]


def sample(position: int, fresh: list[bool], at: float, error: int = 0) -> BusSample:
    """Make a sample of a bus with three devices, all `position` ticks from their zero."""
    ears = np.array(fresh)
    return BusSample(
        sent=at,
        received=at + 0.002,
        position=np.where(ears, JOINTS.buses[0].zero + position, 0),
        velocity=np.where(ears, 7, 0),
        effort=np.zeros(3, np.int64),
        error=np.where(ears, error, 0).astype(np.uint8),
        heard=ears,
        asked=np.ones(3, np.bool_),
        discarded=0,
        foreign=0,
    )


@given(st.lists(st.lists(st.booleans(), min_size=3, max_size=3), min_size=1, max_size=12))
def test_a_joint_without_a_reply_keeps_value_and_stamp(rows: list[list[bool]]) -> None:
    readings = JointReadings(JOINTS, PERIOD)
    bus = JOINTS.buses[0]
    last = np.full(3, np.nan)
    stamp = np.full(3, -np.inf)
    for turn, heard in enumerate(rows):
        at = 10.0 + turn * PERIOD
        assert readings.take(0, sample(turn, heard, at)).tolist() == heard
        last[heard] = turn
        stamp[heard] = at + 0.002
        assert readings.position[bus.joints] == pytest.approx(last * bus.scale, nan_ok=True)
        assert readings.heard_at[bus.joints].tolist() == stamp.tolist()
    others = JOINTS.buses[1].joints
    assert np.isnan(readings.position[others]).all()


def test_a_servo_that_begins_to_report_an_error_is_named_once() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    all_three = [True] * 3
    row = [
        (0x04, all_three),
        (0x80, [True, False, True]),
        (0x80, all_three),
        (0x04, all_three),
        (0x80, all_three),
    ]
    named = [readings.alert(0, sample(0, heard, 10.0, error)) for error, heard in row]
    assert named == [[], [0, 2], [1], [], [0, 1, 2]]
    readings.forget(0)
    assert readings.alert(0, sample(0, all_three, 10.1, 0x80)) == [0, 1, 2]


def test_readings_of_a_lost_bus_are_cleared_and_others_are_kept() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    for store in (readings.slow.torque, readings.slow.fault, readings.slow.watchdog, readings.slow.tick):
        store[:] = 1
    readings.slow.health_time[:] = 5.0
    readings.forget(0)
    lost = np.isin(np.arange(6), JOINTS.buses[0].joints)
    for store in (readings.slow.torque, readings.slow.fault, readings.slow.watchdog, readings.slow.tick):
        assert store.tolist() == np.where(lost, -1, 1).tolist()
    assert readings.slow.health_time.tolist() == np.where(lost, -np.inf, 5.0).tolist()


def test_when_a_lost_bus_is_back_its_joints_may_be_anywhere() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    assert readings.take(0, sample(0, [True] * 3, 10.0)).all()
    assert not readings.take(0, sample(2000, [True] * 3, 10.01)).any()
    readings.forget(0)
    assert readings.take(0, sample(2000, [True] * 3, 10.02)).all()


def test_the_load_is_a_share_of_the_current_limit_without_a_sign_and_nan_where_that_is_unknown() -> None:
    left, right = JOINTS.buses
    known = replace(left, load_scale=np.array([0.001, np.nan, 0.01]))
    readings = JointReadings(replace(JOINTS, buses=(known, right)), PERIOD)
    assert np.isnan(readings.load).all()
    for heard, effort in (([True] * 3, -50), ([True, True, False], 80)):  # all of it, then a part
        given = replace(sample(0, heard, 10.0), effort=np.full(3, effort))
        readings.take(0, given)
    assert readings.load[left.joints] == pytest.approx([0.08, np.nan, 0.5], nan_ok=True)
    readings.take(1, sample(0, [True] * 3, 10.0))
    assert np.isnan(readings.load[right.joints]).all()


def test_the_load_of_a_joint_without_fresh_readings_is_unknown() -> None:
    both = JOINTS.buses
    known = tuple(replace(bus, load_scale=np.full(3, 0.01)) for bus in both)
    readings = JointReadings(replace(JOINTS, buses=known), PERIOD)
    assert np.isnan(readings.loads(10.0)).all()
    for number in (0, 1):
        readings.take(number, replace(sample(0, [True] * 3, 10.0), effort=np.full(3, 90)))
    readings.take(0, replace(sample(0, [True, False, False], 10.3), effort=np.full(3, 10)))
    heard = both[0].joints[0]
    for after, others in ((0.303, 0.9), (0.5, 0.9), (0.504, np.nan), (0.79, np.nan)):
        loads = readings.loads(10.0 + after)
        assert loads[heard] == pytest.approx(0.1)
        assert np.delete(loads, heard) == pytest.approx(np.full(5, others), nan_ok=True)
    assert np.isnan(readings.loads(1000.0)).all()
    assert np.isnan(readings.loads(np.nan)).all()


def test_an_unreported_effort_is_unknown_and_so_is_its_load() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    mine = JOINTS.buses[0].joints
    for heard in ([True] * 3, [True, True, False]):
        whole = sample(3, heard, 1.0)
        readings.take(0, replace(whole, effort_told=np.array([True, False, False])))
        assert np.isnan(readings.effort[mine]).tolist() == [False, True, True]
        assert np.isnan(readings.load[mine])[1:].all()
    readings.take(0, sample(3, [True] * 3, 1.01))
    assert np.isfinite(readings.effort[mine]).all()
