"""Counts off by whole turns: positions, goals and the clamp of the wire (R22) are those of the joint."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from two_buses import JOINTS, LOWER, PERIOD, UPPER, TwoBuses

from twind.loop.readings import Readings
from twind.robot.turns import Turns
from twind_drivers.bus import Sample, WireClamp

WHOLE = 4096
LEFT = JOINTS.buses[0]
TURNS = st.lists(st.integers(-3, 3), min_size=3, max_size=3).map(lambda row: WHOLE * np.array(row))
NONE = np.zeros(3, np.int64)
FEW = np.zeros(6, np.int64)
ANEW = Turns(  # the first two of the left bus fall back to one turn at torque-on
    known=np.ones(6, np.bool_),
    whole=FEW + WHOLE,
    band=FEW,
    first=FEW + LOWER,
    last=FEW + UPPER,
    slack=FEW,
    least=FEW,
    most=FEW + WHOLE - 1,
    lower=FEW + LOWER,
    upper=FEW + UPPER,
    falls=np.isin(np.arange(6), LEFT.joints[:2]),
    begin=FEW,
)


def sample(position: np.ndarray, at: float, heard: np.ndarray | None = None) -> Sample:
    """Of the left bus."""
    ears = np.ones(3, np.bool_) if heard is None else heard
    return Sample(
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
def test_a_joint_stands_where_its_count_and_its_turns_say(
    off: np.ndarray, later: np.ndarray, place: np.ndarray
) -> None:
    readings, here, before = Readings(JOINTS, PERIOD), place * LEFT.scale, NONE
    for shift, at in ((NONE, 10.0), (off, 10.01), (later, 10.02)):
        readings.turn(0, shift)
        if at > 10.0:  # what was read before goes along
            assert readings.position[LEFT.joints] == pytest.approx(here + (shift - before) * LEFT.scale)
        readings.forget(0)  # where it is now is no question of R13
        assert readings.take(0, sample(LEFT.zero + place - shift, at)).all()
        assert readings.position[LEFT.joints] == pytest.approx(here)
        assert readings.raw.ticks[LEFT.joints].tolist() == (LEFT.zero + place - shift).tolist()
        before = shift


@settings(max_examples=50, deadline=None)
@given(TURNS, st.lists(st.integers(LOWER, UPPER), min_size=3, max_size=3).map(np.array))
def test_goals_leave_as_the_counts_of_the_wire_and_never_others(off: np.ndarray, goal: np.ndarray) -> None:
    world = TwoBuses()
    world.connect()
    world.hardware.turn(0, off, off)
    servos = world.virtual["left"].servos
    servos.registers.put("operating_mode", 4)
    servos.changed()
    position = np.zeros(6)
    position[LEFT.joints] = (goal - LEFT.zero) * LEFT.scale
    world.hardware.pairs[0][0].holding = True
    writer = world.hardware.writers[0]
    writer.goals(goal - off)
    for beyond in (LOWER - 1, UPPER + 1):
        with pytest.raises(WireClamp):
            writer.goals(np.full(3, beyond) - off)
    world.tick(position, count=2)
    assert world.hardware.clamped is None and world.hardware.left
    assert servos["goal_position"].tolist() == (goal - off).tolist()
    assert world.hardware.quantised(position)[LEFT.joints] == pytest.approx(position[LEFT.joints])


def test_a_write_half_that_is_made_later_has_the_clamp_of_the_wire_too() -> None:
    world = TwoBuses(live=False)
    world.connect()
    world.hardware.turn(0, np.full(3, WHOLE), np.full(3, WHOLE))
    world.hardware.access(read=True, write=True)
    world.hardware.hold(True)
    world.hardware.writers[0].goals(LEFT.zero - WHOLE)
    with pytest.raises(WireClamp):
        world.hardware.writers[0].goals(LEFT.zero)
    world.hardware.writers[1].goals(JOINTS.buses[1].zero)


def test_ranges_that_change_keep_the_turns() -> None:
    world = TwoBuses()
    world.connect()
    world.hardware.turn(0, np.full(3, WHOLE), np.full(3, WHOLE))
    narrower = tuple(replace(bus, lower=bus.lower + 500) for bus in JOINTS.buses)
    world.hardware.rejoin(replace(JOINTS, buses=narrower))
    world.hardware.writers[0].goals(np.full(3, LOWER + 500 - WHOLE))
    with pytest.raises(WireClamp):
        world.hardware.writers[0].goals(np.full(3, LOWER + 499 - WHOLE))


@given(TURNS, st.integers(-20, 20))
def test_who_begins_to_count_anew_stays_where_it_is_and_its_senses_with_it(
    off: np.ndarray, moved: int
) -> None:
    """At torque-on in position mode: R13 sees no jump, and the joint makes no step of a turn."""
    readings = Readings(replace(JOINTS, turns=ANEW), PERIOD)
    readings.turn(0, off)
    for step in range(3):
        assert readings.take(0, sample(LEFT.zero - off, 10.0 + step * PERIOD)).all()
    readings.expect()
    fallen = np.where([True, True, False], LEFT.zero, LEFT.zero - off) + moved
    assert readings.take(0, sample(fallen, 10.03)).all()
    assert not readings.jumps.any()
    assert readings.position[LEFT.joints] == pytest.approx(moved * LEFT.scale)
    assert readings.shift[LEFT.joints].tolist() == [0, 0, off[2]]


def test_nobody_counts_anew_who_was_not_expected_to() -> None:
    readings = Readings(JOINTS, PERIOD)
    readings.turn(0, np.full(3, WHOLE))
    assert readings.take(0, sample(LEFT.zero - WHOLE, 10.0)).all()
    assert not readings.take(0, sample(LEFT.zero, 10.01)).any()
    assert readings.jumps[LEFT.joints].all()
    assert readings.position[LEFT.joints] == pytest.approx(0.0)


def test_who_was_not_heard_has_not_begun_anew() -> None:
    readings, ears = Readings(replace(JOINTS, turns=ANEW), PERIOD), np.array([True, False, True])
    readings.turn(0, np.full(3, WHOLE))
    assert readings.take(0, sample(LEFT.zero - WHOLE, 10.0)).all()
    readings.expect()
    fallen = np.where([True, True, False], LEFT.zero, LEFT.zero - WHOLE)
    readings.take(0, sample(fallen, 10.01, ears))
    assert readings.shift[LEFT.joints].tolist() == [0, WHOLE, WHOLE]
    assert readings.position[LEFT.joints] == pytest.approx(0.0)
    readings.take(0, sample(fallen, 10.02))
    assert readings.shift[LEFT.joints].tolist() == [0, 0, WHOLE]
    assert readings.position[LEFT.joints] == pytest.approx(0.0)
    assert readings.fallen() is None


def test_who_has_not_begun_anew_is_named_and_not_waited_for_any_more() -> None:
    readings = Readings(replace(JOINTS, turns=ANEW), PERIOD)
    readings.turn(0, np.full(3, WHOLE))
    assert readings.take(0, sample(LEFT.zero - WHOLE, 10.0)).all()
    assert readings.fallen() is None  # nobody was asked to
    readings.expect()
    assert readings.take(0, sample(LEFT.zero - WHOLE, 10.01)).all()
    assert readings.fallen() == LEFT.joints[0]
    assert not readings.take(0, sample(LEFT.zero, 10.02)).any()
    assert readings.shift[LEFT.joints].tolist() == [WHOLE] * 3
