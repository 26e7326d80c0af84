"""DAMP on the wire and in the muscles: capped first, soft, read back, and given back by preparing."""

from typing import Any

import numpy as np
import pytest

from tests.support.dynamixel_rig import SYNC, Bench
from twind_drivers.bus import Script
from twind_drivers.dynamixel.damping import SHARE
from twind_drivers.half_duplex.soft_gain import SOFT

HERE = np.array([2000, 2100, 2200])
P = 84
I_GAIN = 82
D = 80
PWM = 100
CURRENT = 102


def words(bench: Bench, address: int) -> list[int]:
    return [bench.servos.get(id, address, 2) for id in bench.ids]


def first_lost(bench: Bench, script: Script[Any], ids: set[int]) -> Script[Any]:
    """The script, whose first order does not reach these servos."""
    bench.servos.frozen = {id: set(range(1024)) for id in ids}
    reply = yield next(script)
    bench.servos.frozen.clear()
    try:
        while True:
            reply = yield script.send(reply)
    except StopIteration as stop:
        return stop.value


def test_the_cap_comes_before_the_gains_in_one_system_call() -> None:
    bench = Bench(gains=[(1600, 7, 0)] * 3)
    bench.run(bench.writer.prepare(HERE))
    before = len(bench.wire.writes)
    assert bench.run(bench.writer.damp()) == ()
    assert bench.addresses(before) == [(SYNC, PWM), (SYNC, D)]
    assert words(bench, PWM) == [int(SHARE * 885)] * 3
    assert words(bench, P) == [1600 // SOFT] * 3
    assert words(bench, I_GAIN) == [0] * 3
    assert words(bench, D) == [1600] * 3, "as much damping as there was stiffness"


def test_only_ram_is_written_and_neither_torque_nor_goal() -> None:
    bench = Bench()
    bench.run(bench.writer.prepare(HERE))
    before = len(bench.wire.writes)
    bench.run(bench.writer.damp())
    written = [
        address
        for place in range(before, len(bench.wire.writes))
        for code, address in bench.addresses(place)
        if code == SYNC
    ]
    assert written == [PWM, D]


@pytest.mark.parametrize("gains", [(0, 0, 0), (1, 0, 0), (7, 0, 9000), (16383, 0, 16383), (None, None, None)])
def test_no_gain_makes_a_servo_stiffer(gains: tuple[int | None, int | None, int | None]) -> None:
    bench = Bench(gains=[gains] * 3)
    bench.run(bench.writer.prepare(HERE))
    before = words(bench, P), words(bench, D)
    assert bench.run(bench.writer.damp()) == ()
    assert words(bench, P)[0] <= before[0][0]
    assert (words(bench, P)[0] > 0) == (before[0][0] > 0), "limp is no damping"
    assert words(bench, D)[0] >= before[1][0]
    assert words(bench, I_GAIN) == [0] * 3


def test_a_current_based_servo_keeps_a_share_of_its_own_cap() -> None:
    bench = Bench(modes=[5, 3, 4], current_caps=[400, None, None])
    bench.run(bench.writer.prepare(HERE))
    assert bench.run(bench.writer.damp()) == ()
    assert words(bench, CURRENT)[0] == int(SHARE * 400)
    assert words(bench, PWM) == [885, int(SHARE * 885), int(SHARE * 885)]


def test_a_lower_limit_of_the_servo_counts() -> None:
    bench = Bench()
    bench.servos.put(2, 36, 500, 2)
    bench.run(bench.writer.prepare(HERE))
    assert words(bench, PWM) == [885, 500, 885]
    assert bench.run(bench.writer.damp()) == ()
    assert words(bench, PWM) == [int(SHARE * 885), int(SHARE * 500), int(SHARE * 885)]


def test_speeds_and_currents_are_left_at_rest() -> None:
    bench = Bench(modes=[0, 1, 3], lower=np.array([-100, -100, 1000]), upper=np.array([100, 100, 3000]))
    bench.run(bench.writer.prepare(np.array([0, 0, 2000])))
    assert bench.run(bench.writer.damp()) == ()
    assert words(bench, PWM) == [885, 885, int(SHARE * 885)]


def test_a_bus_without_positions_has_nothing_to_damp() -> None:
    bench = Bench(modes=[0, 1], ids=[1, 2], lower=np.array([-100, -100]), upper=np.array([100, 100]))
    bench.run(bench.writer.prepare(np.array([0, 0])))
    before = len(bench.wire.writes)
    assert bench.run(bench.writer.damp()) == ()
    assert len(bench.wire.writes) == before


@pytest.mark.parametrize(("limit", "left"), [(0, 0), (1, 1), (2, 1), (3, 1), (6, 1), (7, 2)])
def test_the_cap_is_never_raised_and_only_0_where_it_was_0(limit: int, left: int) -> None:
    bench = Bench()
    bench.servos.put(2, 36, limit, 2)
    bench.run(bench.writer.prepare(HERE))
    assert bench.run(bench.writer.damp()) == ()
    assert words(bench, PWM)[1] == left


@pytest.mark.parametrize("lost", [{1, 2, 3}, {2}])
def test_an_order_to_damp_that_is_lost_is_sent_again_to_those_that_missed_it(lost: set[int]) -> None:
    bench = Bench(gains=[(1600, 7, 0)] * 3)
    bench.run(bench.writer.prepare(HERE))
    before = len(bench.wire.writes)
    assert bench.run(first_lost(bench, bench.writer.damp(), lost)) == ()
    assert words(bench, PWM) == [int(SHARE * 885)] * 3
    assert words(bench, P) == [1600 // SOFT] * 3
    again = [
        place for place in range(before, len(bench.wire.writes)) if bench.sent(place)[0].instruction == SYNC
    ]
    assert len(again) == 2
    ids = {id for each in bench.sent(again[1]) for id in each.params[4 :: 1 + each.params[2]]}
    assert ids == lost


def test_a_servo_that_never_confirms_damping_is_given_up_after_the_second_order() -> None:
    bench = Bench()
    bench.run(bench.writer.prepare(HERE))
    bench.servos.frozen[3] = {D}
    bench.servos.seen.clear()
    assert bench.run(bench.writer.damp()) == (3,)
    assert [each.instruction for each in bench.servos.seen].count(SYNC) == 2 * 2


def test_servos_that_refuse_the_read_are_named_and_the_others_confirm() -> None:
    bench = Bench((1, 2, 3, 4))
    bench.run(bench.writer.prepare(np.array([2000] * 4)))
    bench.servos.error = {2: 7, 3: 7}  # access error
    assert bench.run(bench.writer.damp()) == (2, 3)
    assert words(bench, PWM) == [int(SHARE * 885)] * 4


def test_a_servo_without_a_reply_is_named_and_the_others_are_damped() -> None:
    bench = Bench()
    bench.run(bench.writer.prepare(HERE))
    bench.servos.silent.add(2)
    assert bench.run(bench.writer.damp()) == (2,)
    assert [bench.servos.get(id, PWM, 2) for id in (1, 3)] == [int(SHARE * 885)] * 2


@pytest.mark.parametrize("address", [PWM, D])
def test_a_servo_that_ignores_damp_writes_is_named(address: int) -> None:
    bench = Bench()
    bench.run(bench.writer.prepare(HERE))
    bench.servos.frozen[3] = {address}
    assert bench.run(bench.writer.damp()) == (3,)
    assert words(bench, PWM)[:2] == [int(SHARE * 885)] * 2, "the others are soft"


def test_preparing_gives_gains_and_output_back_and_the_output_last() -> None:
    bench = Bench(gains=[(1600, 7, 3)] * 3)
    bench.run(bench.writer.prepare(HERE))
    bench.run(bench.writer.damp())
    before = len(bench.wire.writes)
    bench.run(bench.writer.prepare(HERE))
    orders = [
        address
        for place in range(before, len(bench.wire.writes))
        for code, address in bench.addresses(place)
        if code == SYNC
    ]
    assert orders[-1] == PWM
    assert words(bench, PWM) == [885] * 3
    assert (words(bench, P), words(bench, I_GAIN), words(bench, D)) == ([1600] * 3, [7] * 3, [3] * 3)


def test_arming_reads_the_output_back() -> None:
    bench = Bench()
    bench.run(bench.writer.prepare(HERE))
    bench.run(bench.writer.damp())
    bench.servos.frozen[2] = {PWM}
    with pytest.raises(Exception, match=r"id 2: goal PWM \(100\)"):
        bench.run(bench.writer.prepare(HERE))
