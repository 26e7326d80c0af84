"""Cyclic reading over CAN, frame by frame: whose answers are awaited, and whose are believed."""

from math import nan

import numpy as np
import pytest

from tests.support.can_driver_rig import BITRATE, CanRig, actuators
from tests.support.can_frame_rig import AK, BOTH, DM, OD, PERIOD, Reading, Wire, ak, dm, estimates, heartbeat
from twind_drivers.bus import ReadRequest
from twind_drivers.can.actuator_family import HEAT, SILENCE, VOLTAGE
from twind_drivers.can.can_cyclic_read import alert
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.register_access import STATE
from twind_drivers.ports.frame import frames

# ------------------------------------------------------------------------------------- the sample


def test_a_sample_has_counts_of_actuators_that_answered_and_zeros_of_others() -> None:
    rig = Reading(DM, DM)
    sample = rig.cycle(0.0, dm(1, 0xC000), dm(2, 0x4000))
    counts = 0.5 * 12.5 / COUNT
    assert sample.position == pytest.approx([counts, -counts], abs=1.0)
    assert sample.velocity == pytest.approx([0.0, 0.0], abs=20.0)
    assert sample.effort_told is None
    sample = rig.cycle(PERIOD, dm(2, 0x4000))
    assert sample.position.tolist()[0] == sample.velocity[0] == sample.effort[0] == 0
    assert sample.position[1] == pytest.approx(-counts, abs=1.0)
    assert sample.effort_told is not None
    assert sample.effort_told.tolist() == sample.heard.tolist() == [False, True]
    assert sample.asked.tolist() == [True, True]


def test_an_effort_that_one_actuator_does_not_report_is_zero_beside_those_of_others() -> None:
    rig = Reading(DM, OD)
    sample = rig.cycle(0.0, dm(1), estimates(2))
    assert sample.heard.all()
    assert sample.effort_told is not None
    assert sample.effort_told.tolist() == [True, False]
    assert sample.effort.tolist() == [-2, 0]
    alone = Reading(OD).cycle(0.0, estimates(1))
    assert (alone.effort_told, alone.effort.tolist()) == ([False], [0])


def test_a_fault_is_an_alert_of_its_actuator_alone() -> None:
    rig = Reading(DM, DM)
    assert rig.cycle(0.0, dm(1, state=0xC), dm(2)).error.tolist() == [0x80, 0]


def test_every_fault_is_an_alert_but_a_lost_master() -> None:
    found = alert(np.array([-1, 0, VOLTAGE, HEAT, SILENCE, SILENCE | HEAT]))
    assert found.tolist() == [False, False, True, True, False, True]


def test_frames_of_strangers_are_reported_once() -> None:
    rig = Reading(DM)
    assert rig.cycle(0.0, dm(1), frames([0x6F3])).foreign == 1
    assert rig.cycle(PERIOD, dm(1)).foreign == 0


def test_the_flags_of_a_complete_reading_cannot_be_written_to() -> None:
    rig = Reading(DM)
    for at in (0.0, PERIOD):
        sample = rig.cycle(at, dm(1))
    assert sample.heard.all()
    with pytest.raises(ValueError, match="read-only"):
        sample.heard[0] = False


@pytest.mark.parametrize("wrong", [(nan, 0.0), (0.125, nan)])
def test_an_axis_whose_position_or_velocity_is_no_number_is_not_believed(wrong: tuple[float, float]) -> None:
    rig = Reading(OD, OD)
    assert rig.believed(0.0, *[[estimates(1), estimates(2)]] * 2) == [[True, True]] * 2
    sample = rig.cycle(2 * PERIOD, estimates(1), estimates(2, *wrong))
    assert sample.heard.tolist() == [True, False]
    assert sample.position.tolist() == [2048, 0]


def test_the_position_of_a_silent_actuator_stays_the_last_known_one() -> None:
    rig = Reading(DM, DM)
    rig.cycle(0.0, dm(1, 0xC000), dm(2, 0xC000))
    rig.cycle(PERIOD, dm(1, 0x4000), dm(2, 0x4000))
    assert rig.cyclic.place == pytest.approx([-6.25, -6.25], abs=1e-3)
    rig.cycle(2 * PERIOD, dm(1, 0xC000))
    assert rig.cyclic.place == pytest.approx([6.25, -6.25], abs=1e-3)


# ------------------------------------------------------------------------------------- who is asked


def test_only_families_of_actuators_that_are_not_commanded_are_asked() -> None:
    rig = Reading(DM, OD)
    rig.cycle(0.0, dm(1), estimates(2))
    sent = rig.request(PERIOD, goal=True)
    assert sent["id"].tolist() == [0x01, 2 << 5 | 0x0C, 2 << 5 | 0x09 | 0x4000_0000]
    assert rig.reader.line.expect.tolist() == [1, 1]


def test_a_soft_poll_begins_a_second_after_the_first_request() -> None:
    for first in (0.0, 5.0):
        rig = Reading(DM, AK)
        rig.cycle(first, dm(1))
        for after, polled in ((0.96875, []), (1.0, [2])):
            sent = rig.request(first + after)
            assert [id for id in sent["id"].tolist() if id < 0x7F] == polled
            assert rig.reader.line.expect.tolist() == [1, len(polled)]
            rig.reader.finish(first + after)


def test_without_a_writer_nothing_leaves_that_commands_an_actuator() -> None:
    wire = Wire()
    reader = CanReader("arm", wire, actuators((AK, AK)), bitrate=BITRATE)
    for at in (0.0, 1.0, 2.0):
        reader.request(at)
        reader.finish(at)
    assert not wire.sent


def test_the_bus_time_of_a_state_has_the_soft_poll_and_its_answer() -> None:
    rig = Reading(AK, AK)
    rig.cycle(0.0)
    rig.cycle(1.0, ak(1), ak(2))
    polled = rig.reader.span(BOTH)
    rig.rare(BOTH, 1.0, ak(1), ak(2))
    assert len(rig.wire.sent[-1]) == 2
    one = Reading(DM).reader.span(ReadRequest((1,), STATE, 3))
    assert polled == pytest.approx(2 * one), "a frame and its answer, twice"


def test_an_actuator_that_cannot_be_asked_is_not_waited_for() -> None:
    """A CubeMars with torque that is not commanded, beside actuators on a dead line that is not probed."""
    rig = Reading(DM, AK)
    rig.hold(1)
    for step in range(20):
        sample = rig.cycle(step * PERIOD)
    assert not len(rig.request(20 * PERIOD))
    assert sample.asked.tolist() == [True, False]


def test_three_readings_without_its_answer_park_an_actuator_and_the_others_are_not_kept_waiting() -> None:
    rig = Reading(DM, DM)
    rig.believed(0.0, [dm(1), dm(2)], *[[dm(1)]] * 3)
    assert rig.cycle(4 * PERIOD, dm(1)).asked.tolist() == [True, False]
    rig.request(5 * PERIOD)
    rig.wire.coming.append(dm(1))
    rig.reader.feed(5 * PERIOD)
    assert rig.reader.feed(5 * PERIOD + 0.0005), "once the frames have left"


def test_misses_with_answers_between_them_park_no_actuator() -> None:
    rig = Reading(DM, DM)
    both, one = [dm(1), dm(2)], [dm(1)]
    rig.believed(0.0, one, one, both, one, one, *[both] * 4, one, one)
    assert rig.cyclic.attendance.asked.all()


def test_a_cubemars_is_not_parked_for_answers_that_it_was_not_asked_for() -> None:
    rig = Reading(DM, AK)
    rig.hold(1)
    rig.believed(0.0, *[[dm(1)]] * 10)
    assert rig.cyclic.attendance.asked.all()


@pytest.mark.parametrize("row", [0, 1, 2])
@pytest.mark.parametrize("model", [DM, AK, OD])
def test_a_parked_actuator_that_answers_again_is_waited_for_again(model: str, row: int) -> None:
    rig = CanRig((model,) * 3)
    rig.positions()
    rig.faults.silence(row + 1)
    assert not rig.ticks(8)[-1].asked[row]
    rig.faults.silence(row + 1, False)
    assert rig.ticks(8)[-1].asked.all()


def test_only_the_parked_actuator_that_answers_is_waited_for_again() -> None:
    rig = Reading(DM, DM, DM)
    rig.believed(0.0, [dm(1), dm(2), dm(3)], *[[dm(1)]] * 4, [dm(1), dm(3)])
    assert rig.cyclic.attendance.asked.tolist() == [True, False, True]


# ------------------------------------------------------------------------------------- who is believed


def test_after_a_missed_answer_three_readings_with_exactly_one_are_needed() -> None:
    rig = Reading(DM, DM)
    both, one, more = [dm(1), dm(2)], [dm(1)], [dm(1), dm(2), dm(2)]
    found = rig.believed(0.0, both, one, both, both, both, both)
    assert [each[1] for each in found] == [True, False, False, False, True, True]
    assert all(each[0] for each in found)
    found = rig.believed(0.0, one, both, both, more, both, both, both)
    assert [each[1] for each in found] == [False] * 6 + [True]
    found = rig.believed(0.0, one, both, both, one, both, both, both)
    assert [each[1] for each in found] == [False] * 6 + [True]


def test_a_second_answer_makes_no_actuator_suspect_that_missed_none() -> None:
    rig = Reading(DM, DM)
    assert rig.believed(0.0, [dm(1), dm(2), dm(2)], [dm(1), dm(2)]) == [[True, True]] * 2


def test_fewer_answers_than_requests_are_a_missed_answer() -> None:
    """Beside one that is barred, its whole family is asked: who is commanded answers twice."""
    rig = Reading(DM, DM)
    rig.cycle(0.0, dm(1), dm(2))
    rig.cyclic.barred[1] = True
    found = rig.believed(PERIOD, [dm(1), dm(1), dm(2)], [dm(1), dm(2)], [dm(1), dm(1), dm(2)], goal=True)
    assert found == [[True, True], [False, True], [False, True]]


def test_heartbeats_beside_its_position_make_no_axis_suspect_and_do_not_stand_for_it() -> None:
    rig = Reading(OD)
    usual, beside, alone = [estimates(1)], [estimates(1), heartbeat(1)], [heartbeat(1)]
    assert rig.believed(0.0, usual, beside, alone) == [[True], [True], [False]]
    assert rig.believed(3 * PERIOD, beside, usual, beside) == [[False], [False], [True]]


def test_readings_without_a_command_neither_clear_nor_accuse_a_cubemars() -> None:
    rig = Reading(DM, AK)
    rig.hold(1)
    both, one = [dm(1), ak(2)], [dm(1)]
    assert rig.believed(0.0, both, goal=True) == [[True, True]]
    assert rig.believed(PERIOD, one, one) == [[True, False]] * 2
    assert rig.believed(3 * PERIOD, both, one, both, both, goal=True)[0] == [True, True]
    assert rig.believed(7 * PERIOD, one) == [[True, False]]
    assert rig.believed(8 * PERIOD, both, goal=True) == [[True, True]]


def test_answers_of_a_suspect_outside_the_readings_are_not_believed() -> None:
    rig = Reading(DM, DM)
    rig.believed(0.0, [dm(1), dm(2)], [dm(1)])
    rig.rare(BOTH, PERIOD, dm(1, 0xC000, state=0), dm(2, 0xC000, state=0))
    assert rig.cyclic.place == pytest.approx([6.25, 0.0], abs=1e-3)
    assert rig.reader.registers.torque.tolist() == [0, 1]
