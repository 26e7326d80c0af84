"""Edges of the writer: pending goals, part of a bus, bus time of an order, what preparing leaves alone."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.support.dynamixel_responder import Servos, Wire
from tests.support.dynamixel_rig import IDS, SYNC, XM430, Bench
from twind_drivers.bus import (
    DeviceRefused,
    GroupWriteBatch,
    NoReply,
    Order,
    ReadRequest,
    RebootRequest,
    WireRangeError,
    WriteRequest,
)
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.packet import Instruction, Packet, status

HERE = np.array([2000, 2100, 2200])
BOUNDS = np.full(3, 1000), np.full(3, 3000)


def mixed(modes: list[int], accelerations: list[int | None] | None = None) -> Bench:
    """Devices of these operating modes; speeds and currents of up to 1000 counts both ways."""
    lower = np.array([0 if mode in (3, 5) else -1000 for mode in modes])
    upper = np.array([4095 if mode in (3, 5) else 1000 for mode in modes])
    caps = [500 if mode == 5 else None for mode in modes]
    ids = range(1, len(modes) + 1)
    return Bench(
        tuple(ids), modes=modes, lower=lower, upper=upper, current_caps=caps, accelerations=accelerations
    )


def written(bench: Bench, address: int) -> list[list[int]]:
    """Ids in each sync write to exactly this address."""
    packets = [each.params for each in bench.servos.seen if each.instruction == SYNC]
    spans = [
        (each, int.from_bytes(each[:2], "little"), int.from_bytes(each[2:4], "little")) for each in packets
    ]
    return [list(each[4 :: size + 1]) for each, where, size in spans if where == address]


# --------------------------------------------------------------------------------- pending goals


@pytest.mark.parametrize(
    "drop",
    [
        DynamixelWriter.clear,
        DynamixelWriter.cut,
        lambda writer: writer.set_goal_limits(*BOUNDS),
        lambda writer: next(writer.prepare(HERE)),
        lambda writer: writer.begin_single_device(2, cap=100, profile=17),
    ],
    ids=["clear", "cut", "set_goal_limits", "prepare", "begin_single_device"],
)
def test_goals_of_an_earlier_state_are_never_sent(drop: Callable[[DynamixelWriter], object]) -> None:
    bench = Bench()
    bench.writer.goals(HERE)
    drop(bench.writer)
    assert bench.reader.line.goals == b""


def test_other_devices_get_no_goal_while_one_is_driven_alone_nor_its_last_goal_afterwards() -> None:
    bench = Bench()
    alone = bench.writer.begin_single_device(2, cap=100, profile=17)
    alone.set_goal_limits(1500, 2500)
    alone.goal(2000)
    with pytest.raises(WireRangeError) as refused:
        bench.writer.goals(np.array([2001, 2100, 2200]))
    found = refused.value
    assert (found.id, found.value, found.lower, found.upper) == (2, 2001, 0, -1)
    alone.goal(2000)
    bench.writer.end_single_device()
    assert bench.reader.line.goals == b""


# --------------------------------------------------------------------------------- part of a bus


@pytest.mark.parametrize("mode", [3, 1])
def test_a_device_that_is_not_prepared_gets_no_goal_by_any_way(mode: int) -> None:
    bench = mixed([3, mode, 3])
    bench.run(bench.writer.prepare(HERE, np.array([True, False, True])))
    assert [bench.servos.get(id, 98, 1) for id in IDS] == [5, 0, 5]
    address = {3: 116, 1: 104}[mode]
    bench.servos.put(2, address, 77, 4)
    bench.writer.goals(HERE + 5)
    bench.cycle()
    assert [bench.servos.get(1, 116, 4), bench.servos.get(3, 116, 4)] == [2005, 2205]
    assert bench.servos.get(2, address, 4) == 77
    for goal in (-1, 0, 1):
        with pytest.raises(WireRangeError):
            bench.writer.begin(WriteRequest({2: goal.to_bytes(4, "little", signed=True)}, address), 0.0)
    bench.run(bench.writer.prepare(HERE))  # and all of them again afterwards
    assert bench.servos.get(2, 98, 1) == 5


def test_torque_goes_on_in_the_devices_that_get_goals_and_off_in_all() -> None:
    bench = Bench()
    bench.run(bench.writer.prepare(HERE, np.array([True, False, True])))
    bench.run(bench.writer.torque(True))
    assert [bench.servos.get(id, 64, 1) for id in IDS] == [1, 0, 1]
    bench.servos.put(2, 64, 1, 1)
    bench.run(bench.writer.torque(False))
    assert [bench.servos.get(id, 64, 1) for id in IDS] == [0, 0, 0]


def test_a_new_preparation_forgets_the_limit_registers_of_the_last() -> None:
    bench = mixed([1, 3])
    bench.run(bench.writer.prepare(np.array([0, 2000])))
    bench.writer.goals(np.array([500, 2000]))
    next(bench.writer.prepare(np.array([0, 2000])))
    with pytest.raises(WireRangeError):
        bench.writer.goals(np.array([500, 2000]))


# --------------------------------------------------------------------------------- one order


@pytest.mark.parametrize(
    ("order", "size", "delays"),
    [
        (RebootRequest(1), 10 + 11, 1),
        (WriteRequest({1: b"\1"}, 65), 13 + 11, 1),
        (WriteRequest({1: b"\1", 2: b"\1"}, 65), 18, 0),
        (GroupWriteBatch((WriteRequest({1: b"\1"}, 65), WriteRequest({2: b"\1"}, 98))), 2 * 16, 0),
    ],
)
def test_the_bus_time_of_an_order_is_its_bytes_and_the_return_delays_of_its_replies(
    order: Order, size: int, delays: int
) -> None:
    reader = DynamixelReader("main", Wire(Servos(IDS)), IDS, [XM430] * 3, baud=1_000_000, return_delay_us=500)
    writer = DynamixelWriter(reader, lower=BOUNDS[0], upper=BOUNDS[1])
    writer.begin(order, 0.0)
    exchange = reader.line.exchange
    assert exchange is not None
    assert reader.line.span(exchange) == pytest.approx(size * 1e-5 + delays * 5e-4)


def test_an_order_of_another_kind_is_an_error_and_sends_no_byte() -> None:
    bench = Bench()
    with pytest.raises(TypeError, match="a writer does not read"):
        bench.writer.begin(ReadRequest(IDS, 64, 1), 0.0)  # type: ignore[arg-type]
    assert bench.wire.writes == []


class Replying(Servos):
    """Carries a write out, and answers it with `reply`: an error, or not at all."""

    reply: int | None = None

    def _single(self, each: Packet) -> bytes:
        answer = super()._single(each)
        if each.instruction != Instruction.WRITE:
            return answer
        return b"" if self.reply is None else status(each.id, self.reply)


def test_a_lost_reply_to_a_write_is_no_refusal_because_the_register_is_read_back() -> None:
    bench = Bench(kind=Replying)
    assert bench.run(bench.writer.write(2, "goal_pwm", 5)).value == 5


@pytest.mark.parametrize(("error", "words"), [(1, "goal pwm = 400: "), (7, "EEPROM while torque is on$")])
def test_a_refused_write_is_reported_with_the_cause_that_the_servo_gave(error: int, words: str) -> None:
    bench = Bench(kind=Replying)
    bench.servos.reply = error  # type: ignore[attr-defined]
    bench.servos.put(2, 36, 300, 2)
    with pytest.raises(DeviceRefused, match=f"(?i){words}"):
        bench.run(bench.writer.write(2, "goal_pwm", 400))


def test_torque_is_unknown_after_switching_until_a_servo_has_answered() -> None:
    bench = Bench()
    bench.run(bench.writer.torque(True))
    bench.servos.silent = {3}
    with pytest.raises(NoReply):
        bench.run(bench.writer.torque(False))
    assert bench.reader.registers.torque[2] == -1


# --------------------------------------------------------------------------------- preparing


@pytest.mark.parametrize("watchdog", [1, 127])
def test_the_shortest_and_the_longest_watchdog_are_armed(watchdog: int) -> None:
    bench = Bench(watchdog=watchdog)
    bench.run(bench.writer.prepare(HERE))
    assert [bench.servos.get(id, 98, 1) for id in IDS] == [watchdog] * 3


def test_the_output_is_restored_only_where_it_caps_the_force() -> None:
    bench = mixed([5, 1, 0, 3])
    for id in (2, 3, 4):
        bench.servos.put(id, 100, 300, 2)
    bench.run(bench.writer.prepare(np.array([2000, 0, 0, 2000])))
    assert written(bench, 100) == [[4]]
    assert [bench.servos.get(id, 100, 2) for id in bench.ids] == [885, 300, 300, 885]


def test_a_speed_that_does_not_go_to_zero_is_refused_and_positions_are_read_back_once() -> None:
    bench = mixed([3, 1])
    bench.run(bench.writer.prepare(np.array([2000, 0])))
    spans = [
        (int.from_bytes(each.params[:2], "little"), int.from_bytes(each.params[2:4], "little"))
        for each in bench.servos.seen
        if each.instruction in (Instruction.READ, Instruction.SYNC_READ, Instruction.FAST_SYNC_READ)
    ]
    assert sum(start <= 116 < start + size for start, size in spans) == 1  # each costs a tick of arming
    bench.servos.put(2, 104, 7, 4)
    bench.servos.frozen = {2: {104}}
    with pytest.raises(DeviceRefused, match="id 2: goal velocity"):
        bench.run(bench.writer.prepare(np.array([2000, 0])))


def test_profiles_are_cleared_whole_and_an_acceleration_of_0_is_written_as_0() -> None:
    bench = mixed([3, 1], accelerations=[None, 0])
    for id in bench.ids:
        bench.servos.put(id, 108, -1, 4)
        bench.servos.put(id, 112, -1, 4)
    bench.run(bench.writer.prepare(np.array([2000, 0])))
    assert [bench.servos.get(1, at, 4) for at in (108, 112)] == [0, 0]
    assert [bench.servos.get(2, at, 4) for at in (108, 112)] == [0, -1]


def test_a_limit_register_that_reads_minus_one_refuses_the_device_and_not_the_program() -> None:
    bench = mixed([5])
    bench.servos.put(1, 36, -1, 2)
    with pytest.raises(DeviceRefused, match="goal PWM"):
        bench.run(bench.writer.prepare(np.array([2000])))


class Fading(Servos):
    """Id 3 falls silent when the watchdogs of the others are armed."""

    def _store(self, id: int, address: int, data: bytes) -> None:
        super()._store(id, address, data)
        if address == 98 and data != b"\0":
            self.silent |= {3}


def test_preparing_ends_when_no_servo_is_left_and_reports_all_that_were_missing() -> None:
    bench = Bench(kind=Fading)
    bench.servos.silent = {1, 2}
    with pytest.raises(NoReply) as lost:
        bench.run(bench.writer.prepare(HERE))
    assert lost.value.ids == (1, 2, 3)


def test_each_missing_servo_is_reported_and_the_last_of_the_others_is_still_prepared() -> None:
    bench = Bench(kind=Fading)
    bench.servos.silent = {2}
    with pytest.raises(NoReply) as lost:
        bench.run(bench.writer.prepare(HERE))
    assert lost.value.ids == (2, 3)
    assert [bench.servos.get(1, 98, 1), bench.servos.get(1, 116, 4)] == [5, 2000]
