"""The reading half of a bus, against servos that speak the bytes: holes, fallback, deadlines, upkeep."""

from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np
import pytest

from tests.support.driver_rig import is_output_full
from tests.support.dynamixel_reader_rig import pose
from tests.support.dynamixel_responder import Servos, Wire
from twind.exceptions import InvalidInput
from twind_drivers.bus import (
    BusSample,
    DeviceRefused,
    NoReply,
    PingRequest,
    PortError,
    ReadRequest,
    WriteRequest,
)
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.half_duplex.cyclic_read import CALM
from twind_drivers.run_script import perform

IDS = tuple(range(1, 25))
FAST = p.Instruction.FAST_SYNC_READ
PLAIN = p.Instruction.SYNC_READ


def make(
    servos: Servos, *, ids: tuple[int, ...] = IDS, model: int = 1020, **more: Any
) -> tuple[DynamixelReader, Wire]:
    wire = Wire(servos)
    settings = {"baud": 1_000_000, "return_delay_us": 0.0, "fast": True, **more}
    return DynamixelReader("main", wire, ids, [model] * len(ids), **settings), wire


def cycle(reader: DynamixelReader, clock: FakeClock) -> BusSample:
    """One cyclic reading as the loop does it."""
    reader.request(clock.now())
    while not reader.feed(clock.now()) and clock.now() < reader.deadline:
        clock.wait([reader.transport], reader.deadline)
    return reader.finish(clock.now())


@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("chunk", [None, 1, 62])
def test_every_reading_arrives_in_the_order_of_the_ids(fast: bool, chunk: int | None) -> None:
    servos = Servos(IDS)
    pose(servos)
    ids = tuple(reversed(IDS))
    reader, wire = make(servos, ids=ids, fast=fast)
    wire.chunk = chunk
    sample = cycle(reader, FakeClock())
    assert sample.heard.all()
    assert sample.effort.tolist() == [-id for id in ids]
    assert sample.velocity.tolist() == [-1000 * id for id in ids]
    assert sample.position.tolist() == [100_000 - id for id in ids]
    assert sample.discarded == 0
    assert sample.error.tolist() == [0] * 24
    assert servos.seen[-1].instruction == (FAST if fast else PLAIN)
    assert len(wire.writes) == 1


@pytest.mark.parametrize("fast", [True, False])
def test_a_reading_does_not_change_when_the_next_arrives(fast: bool) -> None:
    servos = Servos(IDS)
    reader, _ = make(servos, fast=fast)
    first = cycle(reader, FakeClock())
    pose(servos)
    servos.error = {3: 0x80}
    cycle(reader, FakeClock())
    servos.silent = set(IDS)
    cycle(reader, FakeClock())
    assert not first.position.any()
    assert not first.error.any()
    assert first.heard.all()


def test_a_hole_in_the_fast_read_is_followed_by_plain_reads_until_some_were_whole() -> None:
    servos = Servos(IDS)
    pose(servos)
    reader, _ = make(servos)
    clock = FakeClock()
    servos.silent = {7}
    assert cycle(reader, clock).heard.tolist() == [id < 7 for id in IDS]
    assert cycle(reader, clock).heard.sum() == 23
    servos.silent = set()
    kinds = []
    for _ in range(CALM + 2):
        assert cycle(reader, clock).heard.all()
        kinds.append(servos.seen[-1].instruction)
    assert kinds == [PLAIN] * CALM + [FAST] * 2


def test_a_reply_that_the_machine_holds_back_is_not_taken_for_that_of_another_register() -> None:
    servos = Servos(IDS)
    servos.put(3, 84, 111, 2)
    servos.put(3, 82, 222, 2)
    reader, wire = make(servos)
    clock = FakeClock()
    wire.held = bytearray()
    assert perform_once(reader, ReadRequest((3,), 84, 2), clock) == {}
    assert wire.held
    assert perform_once(reader, ReadRequest((3,), 82, 2), clock) == {3: (222).to_bytes(2, "little")}


def perform_once(reader: DynamixelReader, query: ReadRequest, clock: FakeClock) -> Mapping[int, bytes]:
    """Data of one query, as a script gets them."""
    reader.begin(query, clock.now())
    while not reader.feed(clock.now()) and clock.now() < reader.deadline:
        clock.wait([reader.transport], reader.deadline)
    return reader.answer(clock.now()).data


def test_bytes_that_arrive_late_are_not_taken_for_the_next_answer() -> None:
    servos = Servos(IDS)
    reader, wire = make(servos)
    clock = FakeClock()
    reader.begin(ReadRequest((3,), 132, 4), clock.now())
    late = bytes(wire.inbox)
    wire.inbox.clear()
    reader.answer(clock.now())
    wire.inbox += late
    servos.put(3, 144, 120, 2)
    reader.begin(ReadRequest((3,), 144, 2), clock.now())
    wire.inbox[:0] = late  # and once more, after the drain
    assert reader.feed(clock.now())
    assert reader.answer(clock.now()).data == {3: (120).to_bytes(2, "little")}


@pytest.mark.parametrize(("fast", "wanted"), [(True, 0.00382 + 0.0005), (False, 0.00542 + 24 * 0.0005)])
def test_the_deadline_is_wire_time_and_return_delays_and_two_milliseconds(fast: bool, wanted: float) -> None:
    servos = Servos(IDS)
    reader, wire = make(servos, fast=fast, return_delay_us=500.0)
    reader.request(10.0)
    assert reader.deadline == pytest.approx(10.0 + wanted + 0.002)
    assert wire.arrival() == 0.0
    assert reader.deadline < inf


# ------------------------------------------------------------------------------------------- the rare path


def test_ping_and_reads_answer_by_id() -> None:
    servos = Servos(IDS)
    servos.silent = {4}
    servos.error = {5: 0x80, 6: 7}
    reader, _ = make(servos)
    clock = FakeClock()

    def ask(query: PingRequest | ReadRequest) -> tuple[dict[int, bytes], dict[int, int]]:
        reader.begin(query, clock.now())
        while not reader.feed(clock.now()) and clock.now() < reader.deadline:
            clock.wait([reader.transport], reader.deadline)
        reply = reader.answer(clock.now())
        return dict(reply.data), dict(reply.error)

    assert ask(PingRequest(3)) == ({3: b"\xfc\x03\x2d"}, {3: 0})
    assert ask(PingRequest(4)) == ({}, {})
    assert ask(ReadRequest((5,), 7, 1)) == ({5: b"\x05"}, {5: 0x80})
    assert ask(ReadRequest((6,), 7, 1)) == ({}, {6: 7})
    assert ask(ReadRequest((3, 4, 5), 7, 1)) == ({3: b"\3", 5: b"\5"}, {3: 0, 5: 0x80})
    assert ask(PingRequest(99)) == ({}, {})


@pytest.mark.parametrize(("fast", "longest"), [(True, 214e-5), (False, 296e-5)])
def test_upkeep_refreshes_status_twenty_and_health_five_times_a_second(fast: bool, longest: float) -> None:
    servos = Servos(IDS)
    for id in IDS:
        servos.put(id, 98, 5, 1)
        servos.put(id, 120, 32_767 - id, 2)
        servos.put(id, 144, 118, 2)
        servos.put(id, 146, 41, 1)
    reader, _ = make(servos, fast=fast)
    clock = FakeClock()
    spans = []
    for tick in range(100):
        clock.sleep_until(tick * 0.01)
        query = reader.upkeep(clock.now())
        if query is None:
            continue
        spans.append(reader.span(query))
        reader.begin(query, clock.now())
        assert reader.feed(clock.now())
        reader.answer(clock.now())
        if tick >= 20:
            assert (clock.now() - reader.registers.status_time < 0.05).all()
            assert (clock.now() - reader.registers.health_time < 0.2).all()
    assert reader.registers.torque.tolist() == [0] * 24
    assert reader.registers.watchdog.tolist() == [5] * 24
    assert reader.registers.voltage == pytest.approx([11.8] * 24)
    assert reader.registers.temperature == pytest.approx([41.0] * 24)
    assert reader.registers.tick.tolist() == [32_767 - id for id in IDS]
    assert max(spans) == pytest.approx(longest)


def test_status_is_as_old_as_the_older_of_its_two_slices() -> None:
    reader, _ = make(Servos((1, 2)), ids=(1, 2))
    clock = FakeClock(1.0)
    perform(reader, reader.collect((1, 2), 64, 7), clock)
    assert reader.registers.status_time.tolist() == [-inf, -inf]
    clock.sleep_until(2.0)
    perform(reader, reader.collect((2,), 98, 1), clock)
    assert reader.registers.status_time.tolist() == [-inf, 1.0]
    reader.slow.forget(2)
    assert reader.registers.status_time.tolist() == [-inf, -inf]
    assert reader.registers.torque.tolist() == [0, -1]


def test_a_query_that_a_full_port_did_not_take_is_not_answered_by_what_comes_next() -> None:
    """TX_BACKLOG, then a register write: its answer carries no data, and nothing is kept of it."""
    servos = Servos((1,))
    reader, wire = make(servos, ids=(1,), fast=False)
    wire.holds = True
    wire.backlog = lambda: 1000
    with pytest.raises(PortError, check=is_output_full):
        reader.begin(ReadRequest((1,), 64, 7), 0.0)
    wire.holds = False
    writer = DynamixelWriter(reader, lower=np.array([0]), upper=np.array([4095]))
    writer.begin(WriteRequest({1: b"\1"}, 65), 0.01)
    assert reader.feed(0.01)
    assert reader.answer(0.01).error == {1: 0}
    assert reader.registers.status_time.tolist() == [-inf]


def test_a_tripped_watchdog_reads_as_255() -> None:
    servos = Servos((1,))
    servos.put(1, 98, -1, 1)
    reader, _ = make(servos, ids=(1,))
    perform(reader, reader.collect((1,), 98, 1), FakeClock())
    assert reader.registers.watchdog.tolist() == [255]
    assert reader.registers.status_time.tolist() == [-inf]  # only one of the three was read


# ------------------------------------------------------------------------------------------- scripts


def test_a_register_is_read_by_name() -> None:
    servos = Servos(IDS)
    servos.put(2, 20, -300, 4)
    reader, _ = make(servos)
    found = perform(reader, reader.read(2, "homing offset"), FakeClock())
    assert (found.name, found.address, found.size, found.value) == ("Homing Offset", 20, 4, -300)


def test_a_failed_register_read_reports_the_cause() -> None:
    servos = Servos(IDS)
    servos.silent = {3}
    servos.error = {4: 7}
    reader, _ = make(servos)
    clock = FakeClock()
    with pytest.raises(NoReply, match=r"\[3\]"):
        perform(reader, reader.read(3, "led"), clock)
    with pytest.raises(DeviceRefused, match=r"id 4.*read-only, undefined"):
        perform(reader, reader.read(4, "led"), clock)
    with pytest.raises(InvalidInput, match="led"):
        perform(reader, reader.read(1, "ledd"), clock)
    with pytest.raises(KeyError, match="no id 99"):
        perform(reader, reader.read(99, "led"), clock)


def test_collect_asks_the_silent_once_more_and_names_them_all() -> None:
    servos = Servos(IDS)
    reader, wire = make(servos)
    lost = [True]

    def lose_one(reply: bytes) -> bytes:
        drop = lost[0]
        lost[0] = False
        return b"" if drop else reply

    wire.change = lose_one
    assert len(perform(reader, reader.collect(IDS, 64, 1), FakeClock())) == 24
    servos.silent = {5, 9}
    with pytest.raises(NoReply) as caught:
        perform(reader, reader.collect(IDS, 64, 1), FakeClock())
    assert caught.value.ids == (5, 9)


def test_collect_reads_all_others_before_it_reports_one_that_refuses() -> None:
    """Torque off needs the state of every servo."""
    servos = Servos(IDS)
    servos.error = {2: 7, 4: 7}
    for id in IDS:
        servos.put(id, 64, 1, 1)
    reader, _ = make(servos)
    with pytest.raises(DeviceRefused, match=r"id 2.*read-only, undefined"):
        perform(reader, reader.collect(IDS, 64, 1), FakeClock())
    assert [id for id, on in zip(IDS, reader.registers.torque, strict=True) if on != 1] == [2, 4]


def test_slices_of_a_script_are_short_enough_to_fit_beside_a_cycle() -> None:
    servos = Servos(IDS)
    reader, _ = make(servos, return_delay_us=20.0)
    script = reader.collect(IDS, 9, 55)
    request = next(script)
    assert isinstance(request, ReadRequest)
    assert reader.span(request) < 0.0025
    script.close()


@pytest.mark.parametrize(
    ("rate_hz", "least", "most"), [(50.0, 0.002, 0.002), (250.0, 0.002, 0.002), (500.0, 0.001, 0.001)]
)
def test_neither_a_silent_servo_nor_a_script_takes_more_than_half_a_period_beside_the_wire_time(
    rate_hz: float, least: float, most: float
) -> None:
    """1 ms is what an adapter's latency timer is set to at best (FTDI): less would make all late."""
    reader, _ = make(Servos(IDS), rate_hz=rate_hz, baud=4_000_000)
    reader.begin(ReadRequest((99,), 64, 1), 1.0)
    assert least <= reader.deadline - 1.0 - reader.span(ReadRequest((99,), 64, 1)) + 1e-9 <= most + 2e-9
    script = reader.collect(IDS, 9, 55)
    for request in (next(script), next(reader.identify())):
        assert isinstance(request, ReadRequest)
        assert reader.span(request) <= most + reader.span(ReadRequest((1,), 9, 55))
        assert len(request.ids) > 1
    script.close()


def test_ids_given_twice_no_ids_and_models_that_cannot_be_driven_are_refused() -> None:
    wire = Wire(Servos(IDS))
    with pytest.raises(ValueError, match="distinct ids"):
        DynamixelReader("main", wire, (1, 1), [1020, 1020], baud=1_000_000, return_delay_us=0)
    with pytest.raises(ValueError, match=r"XL320 cannot be driven: .*bus_watchdog"):
        DynamixelReader("main", wire, (1, 2), [1020, 350], baud=1_000_000, return_delay_us=0)
    with pytest.raises(ValueError, match="0 distinct ids"):
        DynamixelReader("main", wire, (), [], baud=1_000_000, return_delay_us=0)


# ------------------------------------------------------------------------------------------- real bytes
