"""Silence of CAN actuators, frame by frame: from when on one is barred, limp, or of unknown state."""

import numpy as np
import pytest

from tests.support.can_driver_rig import CanRig
from tests.support.can_frame_rig import AK, BOTH, DM, OD, PERIOD, Reading, ak, dm, estimates
from twind_drivers.can.actuator_family import HEAT
from twind_drivers.ports.channel import CanErrorState


def test_an_actuator_is_barred_once_it_has_been_silent_for_a_tenth_of_a_second() -> None:
    for last, barred in ((0.0999, False), (0.1, True)):
        rig = Reading(DM, DM)
        rig.cycle(0.0, dm(1), dm(2))
        rig.hold(0, 1)
        rig.cycle(0.05, dm(1))
        rig.cycle(last, dm(1))
        assert rig.cyclic.barred.tolist() == [False, barred]
        assert not rig.cyclic.limp.any()


def test_a_pause_of_the_program_bars_actuators_that_all_answer_after_it() -> None:
    """Their watchdogs have run out. One without torque has none that could."""
    rig = Reading(DM, DM)
    rig.believed(0.0, *[[dm(1), dm(2)]] * 2)
    rig.hold(1)
    assert rig.cycle(PERIOD + 0.1, dm(1), dm(2)).heard.all()
    assert rig.cyclic.barred.tolist() == [False, True]
    rig = Reading(DM, DM)
    rig.believed(0.0, *[[dm(1), dm(2)]] * 2)
    rig.hold(1)
    rig.believed(2 * PERIOD, *[[dm(1), dm(2)]] * 20)
    assert not rig.cyclic.barred.any()


@pytest.mark.parametrize(("rate", "lost"), [(25.0, 1), (40.0, 2), (50.0, 3), (100.0, 8)])
def test_an_actuator_whose_answers_are_lost_for_less_than_its_watchdog_time_keeps_its_torque(
    rate: float, lost: int
) -> None:
    rig = CanRig((DM,) * 3, rate_hz=rate)
    here = rig.arm()
    rig.ticks(10, here)
    for _ in range(lost):
        rig.faults.drop(1, 2)
        assert not rig.tick(here).heard[1]
    rig.ticks(20, here)
    assert not rig.reader.cyclic.barred.any()
    assert rig.energised().all()
    assert rig.registers.watchdog.tolist() == [100] * 3


def test_an_actuator_that_misses_each_third_answer_is_neither_believed_nor_barred() -> None:
    rig = Reading(DM, DM)
    rig.hold(0, 1)
    both, one = [dm(1), dm(2)], [dm(1)]
    assert not any(each[1] for each in rig.believed(0.0, *[one, both, both] * 10))
    assert not rig.cyclic.barred.any()


def test_an_answer_outside_the_readings_is_no_silence() -> None:
    rig = Reading(DM, DM)
    rig.cycle(0.0, dm(1), dm(2))
    rig.hold(0, 1)
    rig.rare(BOTH, 0.0625, dm(1), dm(2))
    rig.cycle(0.125, dm(1))
    assert not rig.cyclic.barred.any()
    rig.cycle(0.1626, dm(1))
    assert rig.cyclic.barred.tolist() == [False, True]


def test_an_answer_counts_for_the_reading_after_it_alone() -> None:
    """The second actuator answers in two ways before a complete reading, and not after it."""
    for before in ([dm(1)], [dm(1), dm(2)]):
        rig = Reading(DM, DM)
        rig.believed(0.0, [dm(1), dm(2)], [dm(1), dm(2)])
        rig.hold(0, 1)
        rig.wire.coming += before
        rig.cycle(0.0625, dm(1), dm(2))
        rig.cycle(0.125, dm(1))
        rig.cycle(0.1626, dm(1))
        assert rig.cyclic.barred.tolist() == [False, True]


def test_a_late_answer_counts_once() -> None:
    rig = Reading(DM, DM)
    rig.cycle(0.0, dm(1), dm(2))
    rig.hold(0, 1)
    rig.wire.coming.append(dm(2))
    rig.cycle(0.0625, dm(1))
    rig.cycle(0.125, dm(1))
    assert not rig.cyclic.barred.any()
    rig.cycle(0.1626, dm(1))
    assert rig.cyclic.barred.tolist() == [False, True]


@pytest.mark.parametrize("at", [0.0, 0.5])
def test_silence_counts_from_torque_on_for_an_actuator_that_never_answered(at: float) -> None:
    rig = Reading(DM, DM)
    for step in range(4):
        rig.cycle(at + step * PERIOD, dm(1))
    rig.hold(0, 1, at=at + 4 * PERIOD)
    rig.cycle(at + 0.125, dm(1))
    assert not rig.cyclic.barred.any()
    rig.cycle(at + 0.1328125, dm(1))
    assert rig.cyclic.barred.tolist() == [False, True]


def test_an_actuator_that_never_answered_hides_the_silence_of_no_other() -> None:
    rig = Reading(DM, DM, DM)
    rig.cycle(0.5, dm(1), dm(2))
    rig.hold(0, 1, at=0.5)
    rig.cycle(0.5625, dm(1))
    rig.cycle(0.625, dm(1))
    assert rig.cyclic.barred.tolist() == [False, True, False]


def test_torque_on_does_not_make_an_answer_older() -> None:
    rig = Reading(DM, DM)
    rig.cycle(0.0625, dm(1), dm(2))
    rig.hold(0, 1, at=0.0)
    rig.cycle(0.125, dm(1))
    assert not rig.cyclic.barred.any()


def test_a_dead_line_bars_all_that_have_torque_those_without_a_watchdog_too() -> None:
    rig = Reading(OD, OD, OD)
    rig.believed(0.0, *[[estimates(1), estimates(2), estimates(3)]] * 2)
    rig.hold(0, 1)
    rig.cyclic.watched[:] = False
    rig.cyclic.barred[2] = True
    rig.cycle(2 * PERIOD, estimates(1), estimates(2))
    assert rig.cyclic.barred.tolist() == [False, False, True]
    rig.wire.condition.line = CanErrorState.OFF
    rig.cycle(3 * PERIOD)
    assert rig.cyclic.barred.tolist() == [True, True, True]


def test_a_cubemars_with_torque_that_was_silent_is_limp_and_its_torque_unknown_until_it_is_ordered() -> None:
    rig = Reading(AK, AK, DM)
    rig.cycle(0.0, ak(1), ak(2), dm(3), goal=True)
    rig.hold(0, 1)
    rig.reader.slow.assume(np.array([True, True, False]), True)
    rig.cycle(0.0625, ak(2), dm(3), goal=True)
    assert rig.reader.registers.torque.tolist() == [1, 1, 1]
    rig.cycle(0.1, ak(2), dm(3), goal=True)
    assert rig.cyclic.limp.tolist() == [True, False, False]
    assert not rig.cyclic.barred.any(), "it has no watchdog that could have run out"
    rig.cycle(0.125, ak(1), ak(2), dm(3), goal=True)
    assert rig.reader.registers.torque.tolist() == [-1, 1, 1]
    rig.cyclic.energise(np.array([False, True, True]), 0.125)
    assert rig.cyclic.limp.tolist() == [True, False, False]
    rig.cyclic.energise(np.ones(3, np.bool_), 0.125)
    assert not rig.cyclic.limp.any()


def test_those_with_torque_stay_the_same_whatever_becomes_of_the_array_of_the_order() -> None:
    rig = Reading(DM, DM)
    rows = np.array([True, False])
    rig.cyclic.energise(rows, 0.0)
    rows[:] = True
    assert rig.cyclic.energised.tolist() == [True, False]


def test_a_fault_is_unknown_after_silence_and_known_after_a_single_missed_answer() -> None:
    rig = Reading(DM, DM)
    fault = [dm(1), dm(2, state=0xC)]
    rig.believed(0.0, fault, fault)
    rig.cycle(0.0625, dm(1))
    assert rig.reader.registers.fault.tolist() == [0, HEAT]
    rig.cycle(PERIOD + 0.1, dm(1))
    assert rig.reader.registers.fault.tolist() == [0, -1]
    rig.believed(0.125, *[fault] * 3)
    assert rig.reader.registers.fault.tolist() == [0, HEAT]
    rig.cycle(0.15, dm(1))
    assert rig.reader.registers.fault.tolist() == [0, HEAT]
