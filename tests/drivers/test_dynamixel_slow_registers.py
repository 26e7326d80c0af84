"""The turns of the slow registers: what is lost is asked again, and nobody waits for it."""

from itertools import product

import numpy as np
import pytest

from twind_drivers.bus import ReadRequest
from twind_drivers.dynamixel.control_tables import table
from twind_drivers.dynamixel.device_layout import layout_of
from twind_drivers.dynamixel.dynamixel_slow_registers import DynamixelSlowRegisters
from twind_drivers.dynamixel.serial_cycle_budget import upkeep

IDS = tuple(range(1, 25))
TICK = 0.01  # s
HEALTH = 120  # the first register of a health slice


def registers(fast: bool, *, roomy: bool = False) -> DynamixelSlowRegisters:
    tables = [table(1020)] * len(IDS)
    made = DynamixelSlowRegisters(IDS, tables, [layout_of(each) for each in tables])
    made.schedule(IDS, upkeep([len(IDS)], 100.0, fast=fast, fits=lambda count, _size: roomy))
    return made


def answer(slow: DynamixelSlowRegisters, query: ReadRequest, ids: tuple[int, ...], now: float) -> None:
    slow.update_from_replies(query, ids, np.zeros((len(ids), query.size), np.uint8), now)


def test_a_periodic_loss_leaves_no_servo_with_stale_health() -> None:
    """Health has a round of a fifth of a second: else it would be the same slice that is lost each time."""
    for roomy, fast, phase in product((True, False), (True, False), range(20)):
        slow = registers(fast, roomy=roomy)
        for tick in range(400):
            now = tick * TICK
            query = slow.next()
            if query is not None and tick % 20 != phase:
                answer(slow, query, query.ids, now)
            if tick > 60:
                assert (now - slow.registers.health_time).max() <= 0.46, (roomy, fast, phase)


@pytest.mark.parametrize("roomy", [True, False])
@pytest.mark.parametrize("fast", [True, False])
def test_a_dead_servo_delays_the_health_of_others_by_one_turn_and_their_status_by_none(
    fast: bool, roomy: bool
) -> None:
    slow = registers(fast, roomy=roomy)
    dead = 7
    others = np.array(IDS) != dead
    for tick in range(200):
        now = tick * TICK
        query = slow.next()
        if query is not None:
            answer(slow, query, tuple(id for id in query.ids if id != dead), now)
        if tick > 50:
            assert (now - slow.registers.status_time)[others].max() <= 0.051
            assert (now - slow.registers.health_time)[others].max() <= 0.251
    assert not np.isfinite(slow.registers.health_time[~others]).any()


def test_a_slice_that_was_never_sent_is_asked_again_in_the_next_round_and_once_only() -> None:
    slow = registers(True)
    asked = []
    for tick in range(40):
        query = slow.next()
        assert query is not None
        if query.address == HEALTH:
            asked.append(query.ids[0])
            continue  # no answer of anybody
        answer(slow, query, query.ids, tick * TICK)
    assert asked == [1, 1, 7, 7, 13, 13, 19, 19]


def test_narrow_slices_are_read_while_replies_are_missing_and_wide_ones_else() -> None:
    slow = registers(True)
    narrow = upkeep([len(IDS)], 100.0, fast=True)
    slow.schedule(IDS, upkeep([len(IDS)], 100.0, fast=True, fits=lambda count, size: size < 35), narrow)
    rounds = [
        [None if each is None else len(each.ids) for each in (slow.next(narrow=few) for _ in range(5))]
        for few in (False, True)
    ]
    assert rounds == [[24, 24, None, None, 6], [8, 8, 8, 24, 6]]


def test_each_device_has_its_turn_once_in_two_rounds_whenever_replies_are_missing() -> None:
    for period, length in product(range(2, 21), (1, 2, 3)):
        slow = registers(True)
        wide = upkeep([len(IDS)], 100.0, fast=True, fits=lambda count, size: size < 35)
        slow.schedule(IDS, wide, upkeep([len(IDS)], 100.0, fast=True))
        for tick in range(400):
            query = slow.next(narrow=tick % period < length)
            if query is not None:
                answer(slow, query, query.ids, tick * TICK)
            if tick > 20:
                age = tick * TICK - slow.registers.status_time
                assert age.max() <= 0.1 + 1e-9, (period, length, tick, int(age.argmax()))
