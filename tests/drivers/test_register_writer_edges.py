"""Writers of servos without a watchdog: who gets goals and when, what a step that fails leaves behind.

The same claims for Feetech, for Protocol 1.0 and for XL-320.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tests.support.servos_without_watchdog import MAKERS, contents, feetech, ignores_writes, mx, run, xl
from twind_drivers.bus import (
    DeviceRefused,
    NoReply,
    ReadRequest,
    RebootRequest,
    SlowRegisterValues,
    WireRangeError,
    WriteRequest,
)

FIRST = np.array([True, False])


def goals(rig: Any) -> list[int]:
    return contents(rig, "goal_position")


def armed(make: Callable[[], Any]) -> tuple[Any, np.ndarray]:
    """A rig whose servos have torque and got goals, and where they are."""
    rig = make()
    here = rig.arm()
    rig.ticks(20, here)
    return rig, here


def prepared(make: Callable[[], Any]) -> tuple[Any, np.ndarray]:
    """A rig whose servos are ready for torque, and where they are."""
    rig = make()
    here = rig.positions()
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here))
    return rig, here


def recorded(rig: Any) -> bytearray:
    """Return a buffer that gets all that is sent from now on."""
    sent = bytearray()
    write = rig.port.write

    def record(data: bytes) -> None:
        sent.extend(data)
        write(data)

    rig.port.write = record
    return sent


# ------------------------------------------------------------------------------- goals


@MAKERS
def test_a_servo_that_is_left_out_gets_no_goal_as_soon_as_preparing_begins(make: Callable[[], Any]) -> None:
    rig, here = armed(make)
    next(rig.writer.prepare(here, FIRST))
    rig.read(here + 9)
    assert goals(rig) == [here[0] + 9, here[1]]


@MAKERS
def test_new_bounds_do_not_interrupt_the_goals(make: Callable[[], Any]) -> None:
    rig, here = armed(make)
    rig.writer.set_goal_limits(rig.lower, rig.upper)
    rig.read(here + 9)
    assert goals(rig) == (here + 9).tolist()


@MAKERS
def test_bounds_that_a_goal_register_cannot_hold_are_refused_and_change_nothing(
    make: Callable[[], Any],
) -> None:
    rig = make()
    wide = np.array([0, 70_000])
    for lower, upper in ((rig.lower - wide, rig.upper), (rig.lower, rig.upper + wide)):
        with pytest.raises(ValueError, match=r"goal_position = .* is outside"):
            rig.writer.set_goal_limits(lower, upper)
    rig.writer.goals(rig.upper)
    for beyond in (rig.upper + 1, rig.lower - 1):
        with pytest.raises(WireRangeError):
            rig.writer.goals(beyond)


@MAKERS
def test_after_a_cut_no_goal_leaves_which_could_switch_torque_on(make: Callable[[], Any]) -> None:
    rig, here = armed(make)
    rig.writer.goals(here + 9)
    rig.writer.cut()
    assert not rig.reader.line.goals
    for _ in range(4):  # nobody has read yet that torque is off
        rig.read(here + 9)
    assert (rig.registers.torque == 1).all()
    assert goals(rig) == here.tolist()
    assert not rig.energised().any()


@MAKERS
def test_a_cut_is_sent_three_times(make: Callable[[], Any]) -> None:
    rig, _ = armed(make)
    sent = recorded(rig)
    rig.writer.cut()
    rig.ticks(3)
    codec = rig.reader.codec
    assert sent.count(codec.write(codec.broadcast, rig.writer.TORQUE, b"\0")) == 3


@MAKERS
def test_a_servo_whose_torque_was_off_counts_as_tripped_once_it_is_on_until_it_is_prepared(
    make: Callable[[], Any],
) -> None:
    rig, here = armed(make)
    rig.servos.put(1, "torque_enable", 0)
    rig.ticks(20, here)
    assert rig.registers.torque.tolist() == [1, 0]
    assert rig.registers.watchdog.tolist() == [-1, -1], "one that is limp has not tripped, nor has the other"
    rig.servos.put(1, "torque_enable", 1)
    rig.ticks(20, here + 9)
    assert rig.registers.watchdog.tolist() == [-1, 255]
    assert goals(rig) == [here[0] + 9, here[1]]
    rig.beside(rig.writer.prepare(here))
    rig.ticks(20, here + 9)
    assert rig.registers.watchdog.tolist() == [-1, -1]
    assert goals(rig) == (here + 9).tolist()


@MAKERS
def test_a_servo_that_was_silent_for_long_gets_no_goal_until_it_is_prepared(make: Callable[[], Any]) -> None:
    rig, here = armed(make)
    rig.faults.silence(2)
    rig.ticks(15, here)
    rig.faults.silence(2, on=False)
    rig.ticks(30, here + 9)
    assert rig.registers.watchdog.tolist() == [-1, 255]
    assert goals(rig) == [here[0] + 9, here[1]]
    rig.beside(rig.writer.prepare(here, np.array([False, True])))
    rig.ticks(5, here + 9)
    assert rig.registers.watchdog.tolist() == [-1, -1]
    assert goals(rig) == (here + 9).tolist()


@MAKERS
def test_pending_goals_are_dropped_with_the_end_of_a_drive_of_one_device(make: Callable[[], Any]) -> None:
    rig, here = armed(make)
    with pytest.raises(ValueError, match="id 2: this servo has no mode with a limited current"):
        rig.writer.begin_single_device(2, cap=10, profile=0)
    rig.writer.goals(here + 9)
    rig.writer.end_single_device()
    rig.read()
    assert goals(rig) == here.tolist()


@MAKERS
def test_goals_of_scripts_are_checked_before_anything_is_sent(make: Callable[[], Any]) -> None:
    rig = make()
    for script in (rig.writer.prepare, rig.writer.write_goals):
        with pytest.raises(ValueError, match="2 whole ticks needed"):
            next(script(np.array([500, 500, 500])))
        with pytest.raises(WireRangeError, match="id 2: goal 1099511627776 outside"):
            next(script(np.array([500, 1 << 40])))


# ------------------------------------------------------------------------------- preparing


@MAKERS
def test_a_pending_goal_is_dropped_once_preparing_begins(make: Callable[[], Any]) -> None:
    rig, here = armed(make)
    rig.writer.goals(here + 9)
    next(rig.writer.prepare(here))
    rig.read()
    assert goals(rig) == here.tolist()


@MAKERS
def test_a_goal_of_an_earlier_preparation_is_not_enough_for_torque(make: Callable[[], Any]) -> None:
    rig, here = prepared(make)
    rig.beside(rig.writer.prepare(here, FIRST))
    with pytest.raises(DeviceRefused, match="id 1: torque: it got no goal since it was prepared"):
        rig.beside(rig.writer.torque(True))
    assert not rig.energised().any()


@MAKERS
def test_a_servo_that_has_torque_gets_its_goal_by_being_prepared(make: Callable[[], Any]) -> None:
    rig, here = armed(make)
    for among in (np.array([True, True]), FIRST):
        rig.beside(rig.writer.prepare(here + 5, among))
        rig.beside(rig.writer.torque(True))
    assert goals(rig) == (here + 5).tolist()
    assert rig.energised().all()


def test_a_servo_that_lost_its_torque_and_refuses_ends_the_preparation() -> None:
    rig, here = armed(feetech)
    rig.servos.put(1, "torque_enable", 0)
    rig.ticks(20, here)
    rig.faults.damage(2, 0x01)
    with pytest.raises(DeviceRefused, match=r"id 2: .*supply voltage"):
        rig.beside(rig.writer.prepare(here))


def test_a_servo_that_refuses_after_another_was_silent_is_left_out_and_both_are_reported() -> None:
    rig, here = armed(lambda: feetech(3))
    rig.faults.damage(2, 0x01)
    rig.faults.silence(3)
    text = r"no reply to read of .* or preparation \(.*supply voltage.*from \[3, 2\] within"
    with pytest.raises(NoReply, match=text) as told:
        rig.beside(rig.writer.prepare(here + 9))
    assert told.value.ids == (3, 2) and 0.0 < told.value.waited < 0.5
    assert goals(rig) == [here[0] + 9, here[1], here[2]]


def test_a_servo_that_is_silent_after_another_refused_is_left_out_and_both_are_reported() -> None:
    rig, here = armed(lambda: feetech(3))
    rig.faults.damage(2, 0x01)

    def meet(order: Any) -> None:
        if isinstance(order, ReadRequest) and 2 not in order.ids and 3 in order.ids:
            rig.faults.silence(3)

    text = r"preparation \(.*supply voltage.* or read of .*from \[2, 3\] within"
    with pytest.raises(NoReply, match=text) as told:
        run(rig, rig.writer.prepare(here + 9), meet)
    assert told.value.ids == (2, 3)
    assert goals(rig) == [here[0] + 9, here[1], here[2]]


@MAKERS
def test_what_a_servo_does_not_take_is_reported_with_both_values(make: Callable[[], Any]) -> None:
    rig, here = prepared(make)
    ignores_writes(rig, 1, of="goal_position")
    with pytest.raises(DeviceRefused, match=f"id 2: goal_position: wrote {here[1] + 9}, reads {here[1]}"):
        rig.beside(rig.writer.write_goals(here + 9))
    rig = make()
    rig.positions()
    rig.servos.put(1, "torque_limit", 999)
    ignores_writes(rig, 1, of="torque_limit")
    with pytest.raises(DeviceRefused, match=r"id 2: torque_limit: wrote \d+, reads 999"):
        rig.beside(rig.writer.prepare(here))


# ------------------------------------------------------------------------------- torque


@MAKERS
def test_torque_goes_on_where_it_was_prepared_and_off_everywhere(make: Callable[[], Any]) -> None:
    rig = make()
    here = rig.positions()
    rig.servos.put(1, "goal_position", int(here[1]) + 20)
    rig.beside(rig.writer.prepare(here, FIRST))
    rig.beside(rig.writer.write_goals(here))
    rig.beside(rig.writer.torque(True))
    assert rig.energised().tolist() == [True, False]
    assert goals(rig) == [here[0], here[1] + 20]
    rig.servos.put(1, "torque_enable", 1)
    rig.beside(rig.writer.torque(False))
    assert not rig.energised().any()


@MAKERS
def test_nothing_is_sent_to_switch_torque_on_where_no_servo_is_prepared(make: Callable[[], Any]) -> None:
    rig = make()
    here = rig.positions()
    rig.perform(rig.writer.prepare(here, ~FIRST & FIRST))
    before = rig.sent()
    rig.perform(rig.writer.torque(True))
    assert rig.sent() == before


@MAKERS
@pytest.mark.parametrize(("on", "times"), [(False, 3), (True, 1)])
def test_off_is_written_three_times_and_on_once_and_the_state_is_unknown_until_it_is_read(
    make: Callable[[], Any], on: bool, times: int
) -> None:
    rig, _ = prepared(make)
    rig.ticks(20)
    assert rig.registers.torque.tolist() == [0, 0]
    sent = recorded(rig)
    rig.transact(next(rig.writer.torque(on)))
    data = bytes((on,))
    assert sent.count(rig.reader.codec.sync_write(rig.writer.TORQUE, {1: data, 2: data})) == times
    assert rig.registers.torque.tolist() == [-1, -1]


@MAKERS
def test_no_goal_leaves_after_torque_off_that_a_servo_did_not_confirm(make: Callable[[], Any]) -> None:
    rig, here = armed(make)
    rig.faults.silence(2)
    with pytest.raises(NoReply):
        rig.beside(rig.writer.torque(False))
    rig.faults.silence(2, on=False)
    rig.ticks(20, here + 9)
    assert rig.registers.torque.tolist() == [0, 1]
    assert rig.registers.watchdog.tolist() == [-1, -1]
    assert goals(rig) == here.tolist()


@MAKERS
def test_a_servo_that_does_not_switch_is_named_and_no_goal_leaves(make: Callable[[], Any]) -> None:
    rig, here = prepared(make)
    ignores_writes(rig, 1, of="torque_enable")
    where = rf"id 2: torque enable \({rig.writer.TORQUE}\): reads 0, not 1"
    with pytest.raises(DeviceRefused, match=where):
        rig.beside(rig.writer.torque(True))
    rig.ticks(20, here + 9)
    assert rig.registers.torque.tolist() == [1, 0]
    assert goals(rig) == here.tolist()


@pytest.mark.parametrize(
    ("make", "steps"),
    [(feetech, [300, 500, 750, 1000]), (mx, [306, 511, 767, 1023]), (xl, [306, 511, 767, 1023])],
)
def test_the_torque_limit_rises_in_steps(make: Callable[[], Any], steps: list[int]) -> None:
    rig, _ = prepared(make)
    found: list[int] = []
    run(rig, rig.writer.torque(True), lambda _: found.append(rig.servos.get(0, "torque_limit")))
    found.append(rig.servos.get(0, "torque_limit"))
    assert [found[0]] + [after for before, after in pairwise(found) if after != before] == steps


# ------------------------------------------------------------------------------- single writes

SOME = [(feetech, "acceleration", 254), (mx, "position_p_gain", 254), (xl, "position_p_gain", 254)]


@pytest.mark.parametrize(("make", "name", "most"), SOME)
def test_a_value_out_of_range_is_not_sent(make: Callable[[], Any], name: str, most: int) -> None:
    rig = make()
    rig.positions()
    before = rig.sent()
    for value in (-1, 300):
        with pytest.raises(ValueError, match=f"{name} = {value} is outside 0..{most}"):
            rig.perform(rig.writer.write(2, name, value))
    assert rig.sent() == before


@pytest.mark.parametrize(("make", "name", "most"), SOME)
def test_a_write_that_is_not_confirmed_is_reported(make: Callable[[], Any], name: str, most: int) -> None:
    rig = make()
    rig.positions()
    rig.faults.silence(2)
    with pytest.raises(NoReply, match=f"write of {name}") as told:
        rig.perform(rig.writer.write(2, name, most))
    assert told.value.ids == (2,)
    assert told.value.waited > 0.0


@MAKERS
def test_a_single_write_waits_for_one_return_delay_and_a_group_write_for_none(
    make: Callable[[], Any],
) -> None:
    rig = make()
    rig.positions()
    line, codec = rig.reader.line, rig.reader.codec
    line.return_delay_s = 0.005
    now = rig.clock.now() + 1.0
    rig.writer.begin(WriteRequest({1: b"\0"}, rig.writer.TORQUE), now)
    size = len(codec.write(1, rig.writer.TORQUE, b"\0")) + codec.overhead
    assert line.deadline == pytest.approx(now + size * 10 / line.baud + 0.005 + line.slack)
    now += 1.0
    rig.writer.begin(WriteRequest({1: b"\0", 2: b"\0"}, rig.writer.TORQUE), now)
    size = len(codec.sync_write(rig.writer.TORQUE, {1: b"\0", 2: b"\0"}))
    assert line.deadline == pytest.approx(now + size * 10 / line.baud)


def test_protocol_1_sends_no_restart() -> None:
    rig = mx()
    before = rig.sent()
    with pytest.raises(TypeError, match="these servos have no restart"):
        rig.writer.begin(RebootRequest(1), rig.clock.now())
    assert rig.sent() == before


@pytest.mark.parametrize("make", [feetech, xl])
def test_a_restarted_servo_counts_as_limp_and_one_that_then_refuses_is_named(make: Callable[[], Any]) -> None:
    """Preparation leaves out a servo that holds and refuses; one without torque must not be left out."""
    rig, here = armed(make)
    rig.servos.write(1, rig.reader.table(2)["torque_enable"].address, b"\0")
    rig.beside(rig.writer.reboot(2))
    ignores_writes(rig, 1)
    with pytest.raises(DeviceRefused, match="id 2"):
        rig.beside(rig.writer.prepare(here))


def test_a_watchdog_that_trips_is_news_once() -> None:
    registers = SlowRegisterValues.unknown(2)
    for rows, version in (([False, False], 0), ([False, True], 1), ([False, True], 1), ([True, True], 2)):
        registers.trip(np.array(rows))
        assert registers.version == version
    assert registers.watchdog.tolist() == [255, 255]
