"""Readings of joints that several actuators turn together, and what a tick makes of the last readings."""

from dataclasses import replace
from itertools import product
from math import inf

import numpy as np
import pytest

from tests.support import transmission_robot_file as linked
from tests.support.two_bus_rig import JOINTS, PERIOD
from twind.loop.bus.joint_readings import JointReadings, radians, reach, resolution, ticks, velocities
from twind.robot.joint_map import JointBusMap, JointMap
from twind.twin.binding import bind
from twind.virtual.virtual_robot_spec import calibration, make_spec
from twind_drivers.bus import BusSample, SlowRegisterValues

AT = 10.0  # s


@pytest.fixture(scope="module")
def joints(tmp_path_factory: pytest.TempPathFactory) -> JointMap:
    robot = linked.read_robot(linked.write(tmp_path_factory.mktemp("linked")))
    return bind(robot, calibration(make_spec(robot))).joint_map


def rows(bus: JointBusMap) -> list[int]:
    """Return the places of the first transmission on its bus."""
    found: list[int] = bus.linked[0].rows.tolist()
    return found


def reply(position: np.ndarray, replied: list[bool] | None = None, at: float = AT) -> BusSample:
    ears = np.ones(len(position), np.bool_) if replied is None else np.array(replied)
    return BusSample(
        sent=at,
        received=at + 0.002,
        position=np.where(ears, position, 0),
        velocity=np.where(ears, 40, 0),
        effort=np.where(ears, 30, 0),
        error=np.zeros(len(position), np.uint8),
        heard=ears,
        asked=np.ones(len(position), np.bool_),
        discarded=0,
        foreign=0,
    )


def test_the_resolution_is_the_most_that_a_count_of_each_actuator_moves_a_joint(joints: JointMap) -> None:
    bus = joints.buses[0]
    here = ticks(bus, np.zeros(len(joints)))
    steps = [np.array(step) for step in product((-1, 0, 1), repeat=len(bus.ids))]
    moved = np.array([radians(bus, here + step) - radians(bus, here) for step in steps])
    assert resolution(bus) == pytest.approx(np.abs(moved).max(axis=0))


def test_goals_reach_to_the_limits_of_a_transmission_and_else_to_those_of_the_counts(
    joints: JointMap,
) -> None:
    for bus in joints.buses:
        least, most = reach(bus)
        each = bus.linked[0]
        assert least[each.rows].tolist() == each.lower.tolist()
        assert most[each.rows].tolist() == each.upper.tolist()
        for row in set(range(len(bus.ids))) - set(rows(bus)):
            ends = sorted((end - bus.zero[row]) * bus.scale[row] for end in (bus.lower[row], bus.upper[row]))
            assert [least[row], most[row]] == pytest.approx(ends)


def test_without_one_of_its_actuators_no_joint_of_a_transmission_is_read_and_others_are(
    joints: JointMap,
) -> None:
    bus = joints.buses[0]
    first, second = rows(bus)
    (single,) = set(range(3)) - {first, second}
    for missing in (first, second):
        readings = JointReadings(joints, PERIOD)
        assert readings.take(0, reply(bus.zero)).all()
        before = readings.position.copy(), readings.velocity.copy(), readings.effort.copy()
        heard = [row != missing for row in range(3)]
        accepted = readings.take(0, reply(bus.zero + 5, heard, AT + PERIOD))
        assert accepted.tolist() == [row == single for row in range(3)]
        pair = bus.joints[[first, second]]
        for old, new in zip(before, (readings.position, readings.velocity, readings.effort), strict=True):
            assert new[pair].tolist() == old[pair].tolist()
        assert readings.heard_at[pair].tolist() == [AT + 0.002] * 2
        assert readings.heard_at[bus.joints[single]] == AT + PERIOD + 0.002
        assert readings.position[bus.joints[single]] == pytest.approx(5 * bus.scale[single])


@pytest.mark.parametrize("whole", [True, False])
def test_velocities_are_those_of_the_joints_also_where_another_device_is_silent(
    joints: JointMap, whole: bool
) -> None:
    bus = joints.buses[0]
    (single,) = set(range(3)) - set(rows(bus))
    readings = JointReadings(joints, PERIOD)
    readings.take(0, reply(bus.zero, [whole or row != single for row in range(3)]))
    pair = bus.joints[rows(bus)]
    expected = velocities(bus, bus.zero, np.full(3, 40))[rows(bus)]
    assert readings.velocity[pair] == pytest.approx(expected)
    assert readings.velocity[pair] != pytest.approx((40 * bus.velocity_scale)[rows(bus)])
    assert np.isnan(readings.velocity[bus.joints[single]]) != whole


def test_turns_of_an_actuator_move_all_joints_of_its_transmission(joints: JointMap) -> None:
    bus = joints.buses[0]
    readings = JointReadings(joints, PERIOD)
    place = ticks(bus, np.full(len(joints), 0.1))
    readings.take(0, reply(place))
    shift = np.zeros(3, np.int64)
    shift[rows(bus)[0]] = 40
    readings.turn(0, shift)
    assert readings.position[bus.joints] == pytest.approx(radians(bus, place + shift))
    readings.turn(0, np.zeros(3, np.int64))
    assert readings.position[bus.joints] == pytest.approx(radians(bus, place))


def test_they_are_unknown_while_one_of_its_actuators_was_never_read(joints: JointMap) -> None:
    bus = joints.buses[0]
    first, second = rows(bus)
    readings = JointReadings(joints, PERIOD)
    readings.take(0, reply(bus.zero, [row != second for row in range(3)]))
    shift = np.zeros(3, np.int64)
    shift[first] = 40
    readings.turn(0, shift)
    assert np.isnan(readings.position[bus.joints[[first, second]]]).all()
    (single,) = set(range(3)) - {first, second}
    assert readings.position[bus.joints[single]] == pytest.approx(0.0)


# ------------------------------------------------------------------------------ two plain buses

LEFT = JOINTS.buses[0]


def read(at: float = AT, number: int = 0, readings: JointReadings | None = None) -> JointReadings:
    """Make readings in which all of a bus was read once."""
    readings = readings or JointReadings(JOINTS, PERIOD)
    assert readings.take(number, reply(JOINTS.buses[number].zero, at=at)).all()
    return readings


def test_a_bus_is_silent_since_the_last_reply_of_any_of_its_devices() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    assert readings.silence(LEFT, AT) == inf
    read(AT, readings=readings)
    readings.take(0, reply(LEFT.zero, [False, True, False], AT + 1.0))
    assert readings.silence(LEFT, AT + 3.0) == pytest.approx(1.998)
    assert readings.silence(JOINTS.buses[1], AT) == inf


def test_a_jump_is_reported_for_one_exchange_with_its_size() -> None:
    readings = read()
    far = LEFT.zero + np.array([0, 2000, 0])
    assert readings.take(0, reply(far, at=AT + PERIOD)).tolist() == [True, False, True]
    at = LEFT.joints[1]
    assert readings.jumps.tolist() == [int(joint == at) for joint in range(6)]
    assert readings.leaps[at] == pytest.approx(2000 * abs(LEFT.scale[1]))
    readings.begin()
    assert not readings.jumps.any()


def test_without_torque_a_jump_is_a_hand_and_accepted() -> None:
    for torque, accepted in ((0, True), (1, False), (-1, False)):
        readings = read()
        readings.slow.torque[:] = 1
        readings.slow.torque[LEFT.joints[1]] = torque
        far = LEFT.zero + np.array([0, 2000, 0])
        assert readings.take(0, reply(far, at=AT + PERIOD)).tolist() == [True, accepted, True]
        assert readings.jumps[LEFT.joints[1]] == 1, "and reported"


def registers() -> SlowRegisterValues:
    """Make the slow registers of a bus, each with numbers of its own."""
    made = SlowRegisterValues.unknown(3)
    for value, name in enumerate(SLOW):
        getattr(made, name)[:] = np.arange(3) + 10 * value
    return made


SLOW = ("torque", "fault", "watchdog", "tick", "voltage", "temperature", "status_time", "health_time")


def test_slow_registers_are_taken_over_when_their_version_or_their_owner_changes() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    made = registers()
    readings.keep(0, made)
    for name in SLOW:
        stored = getattr(readings.slow, name)
        assert stored[LEFT.joints].tolist() == getattr(made, name).tolist()
        assert np.delete(stored, LEFT.joints).tolist() == pytest.approx(
            np.delete(getattr(JointReadings(JOINTS, PERIOD).slow, name), LEFT.joints).tolist(), nan_ok=True
        )
    made.torque[:] = 0
    readings.keep(0, made)
    assert readings.slow.torque[LEFT.joints].tolist() == [0, 1, 2], "whoever writes increments the version"
    made.expire_torque(0)
    readings.keep(0, made)
    assert readings.slow.torque[LEFT.joints].tolist() == [-1, 0, 0]
    other = registers()
    other.version = made.version
    readings.keep(0, other)
    assert readings.slow.torque[LEFT.joints].tolist() == [0, 1, 2]
    readings.forget(0)
    assert readings.slow.torque[LEFT.joints].tolist() == [-1] * 3
    assert np.isnan(readings.slow.voltage[LEFT.joints]).all()
    assert np.isnan(readings.slow.temperature[LEFT.joints]).all()
    readings.keep(0, other)
    assert readings.slow.torque[LEFT.joints].tolist() == [0, 1, 2], "the bus is back with the same registers"


def test_before_its_first_reading_everything_is_unknown() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    slow = readings.slow
    for array in (slow.torque, slow.fault, slow.watchdog, slow.tick):
        assert array.tolist() == [-1] * 6
    for floats in (slow.voltage, slow.temperature, readings.position, readings.velocity, readings.effort):
        assert np.isnan(floats).all()
    for times in (slow.status_time, slow.health_time, readings.heard_at):
        assert times.tolist() == [-inf] * 6
    for zeros in (readings.jumps, readings.leaps, readings.alerts, readings.shift):
        assert zeros.tolist() == [0] * 6
    assert readings.placed.all()


def test_the_position_of_a_joint_that_is_not_placed_is_unknown() -> None:
    readings = read(number=1, readings=read())
    readings.placed[2] = False
    found = readings.where()
    assert np.isnan(found).tolist() == [False, False, True, False, False, False]
    assert np.isfinite(readings.position).all()
    readings.placed[2] = True
    assert np.isfinite(readings.where()).all()


def test_a_state_is_a_read_only_copy_with_ages() -> None:
    readings = read()
    fresh = np.isin(np.arange(6), LEFT.joints)
    state = readings.state(fresh, AT + 0.5, 0.004)
    assert (state.time, state.round_trip, state.imu) == (AT + 0.5, 0.004, None)
    assert state.age[LEFT.joints] == pytest.approx([0.498] * 3)
    assert np.isinf(np.delete(state.age, LEFT.joints)).all()
    arrays = (state.position, state.velocity, state.effort, state.age, state.heard)
    assert not any(array.flags.writeable for array in arrays)
    before = [array.copy() for array in arrays]
    readings.take(0, reply(LEFT.zero + 5, at=AT + 0.5))
    for old, new in zip(before, arrays, strict=True):
        assert np.array_equal(old, new, equal_nan=True)


@pytest.mark.parametrize("reported", [None, [True, False, True]])
def test_each_reading_in_a_row_replaces_all_values(reported: list[bool] | None) -> None:
    load = np.array([0.001, 0.002, 0.01])
    readings = JointReadings(replace(JOINTS, buses=(replace(LEFT, load_scale=load), JOINTS.buses[1])), PERIOD)
    for step in range(4):
        given = replace(
            reply(LEFT.zero + step, at=AT + step * PERIOD),
            velocity=np.array([1, 2, 3]) + step,
            effort=np.array([-10, 20, -30]) * (1 + step),
            effort_told=None if reported is None else np.array(reported),
        )
        assert readings.take(0, given).all()
        effort = np.where(reported or [True] * 3, given.effort, np.nan)
        assert readings.position[LEFT.joints] == pytest.approx(step * LEFT.scale)
        assert readings.velocity[LEFT.joints] == pytest.approx(given.velocity * LEFT.velocity_scale)
        assert readings.effort[LEFT.joints] == pytest.approx(effort * LEFT.effort_scale, nan_ok=True)
        assert readings.load[LEFT.joints] == pytest.approx(np.abs(effort) * load, nan_ok=True)
        assert readings.heard_at[LEFT.joints].tolist() == [AT + step * PERIOD + 0.002] * 3


def test_a_device_that_is_silent_near_its_count_of_zero_is_not_read() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    for step in range(3):
        assert readings.take(0, reply(np.full(3, 2), at=AT + step * PERIOD)).all()
    accepted = readings.take(0, reply(np.full(3, 2), [True, False, True], AT + 3 * PERIOD))
    assert accepted.tolist() == [True, False, True]
    assert readings.heard_at[LEFT.joints[1]] == AT + 2 * PERIOD + 0.002


def test_an_error_that_is_gone_is_named_again_when_it_returns() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    fault = replace(reply(LEFT.zero), error=np.array([0x80, 0, 0x80], np.uint8))
    assert readings.alert(0, fault) == [0, 2]
    assert readings.alerts[LEFT.joints].tolist() == [0x80, 0, 0x80]
    partly = replace(fault, heard=np.array([True, True, False]))
    assert readings.alert(0, partly) == []
    assert readings.alerts[LEFT.joints].tolist() == [0x80, 0, 0]
    assert readings.alert(0, reply(LEFT.zero)) == []
    assert readings.alerts.tolist() == [0] * 6
    assert readings.alert(0, fault) == [0, 2]
    readings.forget(0)
    assert readings.alerts.tolist() == [0] * 6


def test_loads_of_joints_that_did_not_reply_with_the_others_are_unknown_after_half_a_second() -> None:
    both = tuple(replace(bus, load_scale=np.full(3, 0.01)) for bus in JOINTS.buses)
    readings = JointReadings(replace(JOINTS, buses=both), PERIOD)
    for number in (0, 1):
        readings.take(number, replace(reply(both[number].zero), received=AT))
    readings.state(np.ones(6, np.bool_), AT, 0.0)
    readings.take(0, replace(reply(both[0].zero), received=AT + 0.5))
    readings.state(np.isin(np.arange(6), LEFT.joints), AT + 0.5, 0.0)
    assert np.isfinite(readings.loads(AT + 0.5)).all(), "half a second is not too old"
    later = readings.loads(AT + 0.5 + 2**-10)
    assert np.isnan(later).tolist() == (~np.isin(np.arange(6), LEFT.joints)).tolist()


def test_loads_are_known_for_half_a_second_after_a_tick_in_which_all_replied() -> None:
    both = tuple(replace(bus, load_scale=np.full(3, 0.01)) for bus in JOINTS.buses)
    readings = JointReadings(replace(JOINTS, buses=both), PERIOD)
    for number in (0, 1):
        readings.take(number, reply(both[number].zero))
    readings.state(np.ones(6, np.bool_), AT + 0.002, 0.002)
    assert readings.loads(AT + 0.4).tolist() == pytest.approx([0.3] * 6)
    assert readings.loads(AT + 0.501).tolist() == pytest.approx([0.3] * 6)
    assert np.isnan(readings.loads(AT + 0.503)).all()
