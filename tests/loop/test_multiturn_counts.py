"""Counts off by whole turns: positions, goals and WIRE_CLAMP are those of the joint."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.two_bus_rig import JOINTS, LOWER, PERIOD, UPPER, TwoBuses
from twind.loop.bus.joint_readings import JointReadings
from twind_drivers.bus import BusSample, WireRangeError

WHOLE = 4096
LEFT = JOINTS.buses[0]
TURNS = st.lists(st.integers(-3, 3), min_size=3, max_size=3).map(lambda row: WHOLE * np.array(row))
NONE = np.zeros(3, np.int64)


def sample(position: np.ndarray, at: float, fresh: np.ndarray | None = None) -> BusSample:
    """Make a sample of the left bus."""
    ears = np.ones(3, np.bool_) if fresh is None else fresh
    return BusSample(
        sent=at,
        received=at + 0.002,
        position=np.where(ears, position, 0),
        velocity=NONE,
        effort=NONE,
        error=NONE.astype(np.uint8),
        heard=ears,
        asked=np.ones(3, np.bool_),
        discarded=0,
        foreign=0,
    )


@given(TURNS, TURNS, st.lists(st.integers(-1000, 1000), min_size=3, max_size=3).map(np.array))
def test_a_joint_position_follows_from_its_count_and_its_turns(
    off: np.ndarray, later: np.ndarray, place: np.ndarray
) -> None:
    readings = JointReadings(JOINTS, PERIOD)
    here = place * LEFT.scale
    before = NONE
    for shift, at in ((NONE, 10.0), (off, 10.01), (later, 10.02)):
        readings.turn(0, shift)
        if at > 10.0:  # what was read before goes along
            assert readings.position[LEFT.joints] == pytest.approx(here + (shift - before) * LEFT.scale)
        readings.forget(0)  # where it is now is no question of SENSE_JUMP
        assert readings.take(0, sample(LEFT.zero + place - shift, at)).all()
        assert readings.position[LEFT.joints] == pytest.approx(here)
        assert readings.raw.ticks[LEFT.joints].tolist() == (LEFT.zero + place - shift).tolist()
        before = shift


@pytest.mark.slow
@examples(50)
@given(TURNS, st.lists(st.integers(LOWER, UPPER), min_size=3, max_size=3).map(np.array))
def test_goals_leave_as_the_counts_of_the_wire_and_never_others(off: np.ndarray, goal: np.ndarray) -> None:
    world = TwoBuses()
    world.connect()
    world.hardware.turn(0, off)
    servos = world.virtual["left"].servos
    servos.registers.put("operating_mode", 4)
    servos.invalidate_cache()
    position = np.zeros(6)
    position[LEFT.joints] = (goal - LEFT.zero) * LEFT.scale
    world.hardware.pairs[0][0].holding = True
    writer = world.hardware.writers[0]
    writer.goals(goal - off)
    for beyond in (LOWER - 1, UPPER + 1):
        with pytest.raises(WireRangeError):
            writer.goals(np.full(3, beyond) - off)
    world.tick(position, count=2)
    assert world.hardware.clamped is None and world.hardware.left
    assert servos["goal_position"].tolist() == (goal - off).tolist()
    assert world.hardware.quantised(position)[LEFT.joints] == pytest.approx(position[LEFT.joints])


def test_a_write_half_that_is_made_later_has_the_clamp_of_the_wire_too() -> None:
    world = TwoBuses(live=False)
    world.connect()
    world.hardware.turn(0, np.full(3, WHOLE))
    world.hardware.access(read=True, write=True)
    world.hardware.hold(True)
    world.hardware.writers[0].goals(LEFT.zero - WHOLE)
    with pytest.raises(WireRangeError):
        world.hardware.writers[0].goals(LEFT.zero)
    world.hardware.writers[1].goals(JOINTS.buses[1].zero)


def test_ranges_that_change_keep_the_turns() -> None:
    world = TwoBuses()
    world.connect()
    world.hardware.turn(0, np.full(3, WHOLE))
    narrower = tuple(replace(bus, lower=bus.lower + 500) for bus in JOINTS.buses)
    world.hardware.rejoin(replace(JOINTS, buses=narrower))
    world.hardware.writers[0].goals(np.full(3, LOWER + 500 - WHOLE))
    with pytest.raises(WireRangeError):
        world.hardware.writers[0].goals(np.full(3, LOWER + 499 - WHOLE))


def test_a_count_that_jumps_by_a_turn_is_rejected() -> None:
    readings = JointReadings(JOINTS, PERIOD)
    readings.turn(0, np.full(3, WHOLE))
    assert readings.take(0, sample(LEFT.zero - WHOLE, 10.0)).all()
    assert not readings.take(0, sample(LEFT.zero, 10.01)).any()
    assert readings.jumps[LEFT.joints].all()
    assert readings.position[LEFT.joints] == pytest.approx(0.0)
