"""The cyclic reading in trouble: who is parked and comes back, what a late answer cannot do, two layouts."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.dynamixel_responder import Servos, Wire
from tests.support.examples import examples, fast_cases
from twind_drivers.bus import BusSample, ReadRequest
from twind_drivers.clock import FakeClock
from twind_drivers.device_presence import MISSES, PROBE
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.half_duplex.cyclic_read import CALM, SURE

IDS = tuple(range(1, 25))
PERIOD = 0.01
FAST = p.Instruction.FAST_SYNC_READ
PLAIN = p.Instruction.SYNC_READ


class Rig:
    """A reader at 100 Hz as the loop drives it: the cyclic reading, then one slice of upkeep."""

    def __init__(self, servos: Servos, ids: tuple[int, ...] = IDS, models: Any = None, **more: Any) -> None:
        self.servos = servos
        self.wire = Wire(servos)
        self.clock = FakeClock(1.0)
        settings = {"baud": 2_000_000, "return_delay_us": 0.0, "fast": True, **more}
        self.reader = DynamixelReader("main", self.wire, ids, models or [1020] * len(ids), **settings)
        self.asked: list[p.Packet] = []

    def read(self) -> BusSample:
        """The cyclic reading of one tick; `asked` keeps its request."""
        before = len(self.servos.seen)
        self.reader.request(self.clock.now())
        self.asked += self.servos.seen[before:][:1]
        self._await()
        return self.reader.finish(self.clock.now())

    def tick(self) -> BusSample:
        """A whole tick."""
        end = self.clock.now() + PERIOD
        sample = self.read()
        query = self.reader.upkeep(self.clock.now())
        if query is not None:
            self.reader.begin(query, self.clock.now())
            self._await()
            self.reader.answer(self.clock.now())
        self.clock.sleep_until(end)
        return sample

    def _await(self) -> None:
        while not self.reader.feed(self.clock.now()) and self.clock.now() < self.reader.deadline:
            self.clock.wait([self.wire], self.reader.deadline)


def number(servos: Servos, value: int) -> None:
    """Present position := value of everybody."""
    for id in servos.memory:
        servos.put(id, 132, value, 4)


# --------------------------------------------------------------------------------------------- parking


@pytest.mark.parametrize("dead", [1, 7, 24])
@pytest.mark.parametrize("fast", [True, False])
def test_a_dead_servo_costs_the_others_at_most_one_reading(dead: int, fast: bool) -> None:
    servos = Servos(IDS)
    rig = Rig(servos, fast=fast)
    servos.silent = {dead}
    samples = [rig.tick() for _ in range(60)]
    others = np.array(IDS) != dead
    assert all(sample.heard[others].all() for sample in samples[1:])
    assert not any(sample.heard[~others].any() for sample in samples)
    parked = [not sample.asked[dead - 1] for sample in samples]
    assert parked == [False] * parked.index(True) + [True] * (60 - parked.index(True))
    assert parked.index(True) <= MISSES + 1
    assert all(sample.asked[others].all() for sample in samples)
    assert rig.asked[-1].instruction == (FAST if fast else PLAIN)
    assert dead not in rig.asked[-1].params[4:]
    start = rig.clock.now()
    rig.read()
    assert rig.clock.now() == start  # nobody is waited for any more


def test_a_parked_servo_is_probed_once_a_second_and_back_in_the_cycle_after_its_answer() -> None:
    servos = Servos(IDS)
    rig = Rig(servos)
    servos.silent = {7}
    for _ in range(int(2.5 / PERIOD)):  # from the first probe to those a second apart
        rig.tick()
    servos.seen.clear()
    for _ in range(int(3.0 / PERIOD)):
        rig.tick()
    probes = [each for each in servos.seen if each.instruction == p.Instruction.READ and each.id == 7]
    assert len(probes) == 3
    assert {each.params for each in probes} == {bytes((126, 0, 10, 0))}
    servos.silent = set()
    ticks = 0
    while not (sample := rig.tick()).heard.all():
        ticks += 1
        assert ticks <= PROBE / PERIOD + 2
    assert sample.asked.all()
    for _ in range(CALM):
        assert rig.tick().heard.all()
    assert rig.asked[-1].instruction == FAST


def test_servos_behind_a_gap_of_a_fast_reading_are_not_counted_as_missing() -> None:
    servos = Servos(IDS)
    rig = Rig(servos)
    servos.silent = {7, 12}
    asked = [rig.tick().asked for _ in range(6)]
    gone = [[id for id, there in zip(IDS, each, strict=True) if not there] for each in asked]
    assert gone == [[], [], [], [7], [7, 12], [7, 12]]  # 12 was missed for the first time one cycle later


@pytest.mark.parametrize(("away", "most"), [(0.1, 0.16), (0.15, 0.28)])
def test_a_servo_that_restarts_is_back_soon_and_its_slow_registers_are_known_in_the_next_tick(
    away: float, most: float
) -> None:
    """SERVO_REBOOTED: a servo that lost its torque unasked is told by its registers. Off the bus some 100 ms
    (e-manual, "Reboot")."""
    servos = Servos(IDS)
    rig = Rig(servos)
    servos.put(7, 64, 1, 1)
    for _ in range(20):
        rig.tick()
    gone = rig.clock.now()
    place = IDS.index(7)
    servos.silent = {7}
    while rig.clock.now() < gone + away:
        rig.tick()
    assert rig.reader.registers.torque[place] == 1
    servos.silent = set()
    servos.put(7, 64, 0, 1)
    while not rig.tick().heard[place]:
        assert rig.clock.now() < gone + most
    rig.tick()
    assert rig.reader.registers.torque[place] == 0
    assert rig.reader.registers.tick[place] == 0
    assert rig.clock.now() - rig.reader.registers.status_time[place] < 2.5 * PERIOD
    assert rig.clock.now() - rig.reader.registers.health_time[place] < 1.5 * PERIOD


@pytest.mark.parametrize("query", [ReadRequest((7,), 64, 1), ReadRequest((7,), 126, 10)])
@pytest.mark.parametrize("error", [0, p.StatusErrorCode.DATA_LENGTH])
def test_a_parked_servo_that_answers_any_queryis_back(query: ReadRequest, error: int) -> None:
    """An error alone is no reading, but the servo is there."""
    servos = Servos(IDS)
    rig = Rig(servos)
    servos.silent = {7}
    for _ in range(10):
        rig.tick()
    servos.silent = set()
    servos.error[7] = error
    rig.reader.begin(query, rig.clock.now())
    rig.reader.feed(rig.clock.now())
    rig.reader.answer(rig.clock.now())
    sample = rig.read()
    assert sample.asked.all()
    assert sample.heard.all() == (error == 0)
    assert rig.asked[-1].instruction == PLAIN  # a late answer to its probe is no row of a fast reading
    assert rig.asked[-1].params[2] != 10


def test_foreign_traffic_is_reported_in_one_sample_only() -> None:
    rig = Rig(Servos(IDS))
    rig.tick()
    rig.wire.inbox += p.status(99, 0, bytes(10)) + p.ping(5)
    assert [rig.tick().foreign for _ in range(3)] == [2, 0, 0]


def test_no_servo_is_parked_when_none_replies() -> None:
    servos = Servos(IDS)
    rig = Rig(servos)
    servos.silent = set(IDS)
    for _ in range(50):
        sample = rig.tick()
        assert sample.asked.all()
        assert not sample.heard.any()
    servos.silent = set()
    assert [rig.tick().heard.all() for _ in range(SURE)] == [False] * (SURE - 1) + [True]


def test_parked_servos_are_in_no_slice_of_the_upkeep() -> None:
    servos = Servos(IDS)
    rig = Rig(servos)
    servos.silent = {7}
    for _ in range(10):
        rig.tick()
    servos.seen.clear()
    for _ in range(40):
        rig.tick()
    slices = [each for each in servos.seen if each.instruction in (FAST, PLAIN)]
    assert slices
    assert not any(7 in each.params[4:] for each in slices)
    others = np.array(IDS) != 7
    assert (rig.clock.now() - rig.reader.registers.status_time[others] < 0.06).all()


@given(st.lists(st.sets(st.integers(1, 6)), min_size=1, max_size=60))
@examples(60)
def test_an_answering_servo_is_fresh_again_within_a_second_after_any_history(dead: list[set[int]]) -> None:
    ids = tuple(range(1, 7))
    servos = Servos(ids)
    rig = Rig(servos, ids)
    for silent in dead:
        servos.silent = silent
        sample = rig.tick()
        assert not (sample.heard & ~sample.asked).any()
        assert not sample.heard[[id - 1 for id in silent]].any()
    servos.silent = set()
    for _ in range(int(PROBE / PERIOD) + len(ids) + 2):
        rig.tick()
    assert rig.tick().heard.all()


def test_a_servo_that_refuses_the_longer_blocks_is_read_with_the_usual_one() -> None:
    servos = Servos(IDS)
    rig = Rig(servos)
    change = rig.wire.change

    def refuse(reply: bytes) -> bytes:  # id 3 answers anything but 10 bytes with an access error
        asked = servos.seen[-1]
        if asked.instruction != PLAIN or asked.params[2] in (1, 7, 10, 27):
            return change(reply)
        return b"".join(
            p.status(each.id, 7) if each.id == 3 else p.status(each.id, 0, each.data)
            for each in p.Framer(status=True).feed(reply)
        )

    rig.wire.change = refuse
    servos.silent = {7}
    rig.tick()
    rig.tick()
    servos.silent = set()
    for _ in range(5):
        sample = rig.tick()
        assert sample.asked.all()
    assert sample.heard.all()


@pytest.mark.parametrize("error", [p.StatusErrorCode.CRC, p.StatusErrorCode.ACCESS])
def test_a_single_error_is_no_refusal_of_the_longer_blocks(error: int) -> None:
    """A bit error makes a request look like one to a single servo, which answers it with an error status."""
    servos = Servos(IDS)
    rig = Rig(servos)
    change = rig.wire.change
    spoilt = [9, 6, 3]

    def spoil(reply: bytes) -> bytes:
        if servos.seen[-1].instruction != PLAIN or servos.seen[-1].params[2] <= 12 or not spoilt:
            return change(reply)
        spoilt.pop()
        return p.status(3, error) if error == p.StatusErrorCode.CRC or len(spoilt) == 1 else change(reply)

    rig.wire.change = spoil
    servos.silent = {7}
    for _ in range(6):
        rig.tick()
    before = len(rig.asked)
    servos.silent = {8}
    for _ in range(3):
        rig.tick()
    assert all(each.params[2] > 12 for each in rig.asked[before + 1 :] if each.instruction == PLAIN)


# --------------------------------------------------------------------------------------------- late answers


@given(
    delays=st.lists(st.integers(0, 40), min_size=1, max_size=60),
    fast=st.booleans(),
    upkeep=st.booleans(),
    burst=st.integers(1, 5),
)
@examples(60, derandomize=True)  # see `cyclic`: improbable, not impossible
def test_a_late_answer_is_never_taken_for_the_new_one(
    delays: list[int], fast: bool, upkeep: bool, burst: int
) -> None:
    """Answers come in order, up to 40 writes late, `burst` of them at a time; the position counts cycles."""
    ids = (1, 2, 3)
    servos = Servos(ids)
    rig = Rig(servos, ids, fast=fast)
    kept: list[tuple[int, bytes]] = []  # due, reply

    def hold(reply: bytes) -> bytes:
        write = len(rig.wire.writes)
        due = max([write + delays[write % len(delays)], *(when for when, _ in kept)])
        kept.append((due, reply))
        now = [each for each in kept if each[0] <= write][:burst]
        del kept[: len(now)]
        return b"".join(reply for _, reply in now)

    rig.wire.change = hold
    for cycle in range(100):
        number(servos, cycle)
        sample = rig.tick() if upkeep else rig.read()
        assert (sample.position[sample.heard] == cycle).all()
        assert sample.foreign == 0
        rig.clock.sleep_until(1.0 + (cycle + 1) * PERIOD)


@pytest.mark.parametrize("lag", fast_cases(range(1, 50), {1, 2, 3, 4, 5, 7, 8, 9, 16, 31, 49}))
@pytest.mark.parametrize("upkeep", [True, False])
def test_a_steady_delay_of_up_to_fifty_cycles_yields_silence_and_no_old_number(
    lag: int, upkeep: bool
) -> None:
    ids = (1, 2, 3)
    servos = Servos(ids)
    rig = Rig(servos, ids, fast=False)
    queue = [b""] * (lag * (2 if upkeep else 1))

    def hold(reply: bytes) -> bytes:
        queue.append(reply)
        return queue.pop(0)

    rig.wire.change = hold
    for cycle in range(200):
        number(servos, cycle)
        sample = rig.tick() if upkeep else rig.read()
        assert not sample.heard.any()
        rig.clock.sleep_until(1.0 + (cycle + 1) * PERIOD)
    rig.wire.change = lambda reply: reply
    assert [rig.tick().heard.all() for _ in range(SURE + 1)][-1]


def test_slow_registers_are_not_taken_from_late_answers() -> None:
    servos = Servos((1, 2))
    rig = Rig(servos, (1, 2))
    rig.tick()
    known = [rig.reader.registers.torque.copy(), rig.reader.registers.status_time.copy()]
    queue = [b""] * 20
    rig.wire.change = lambda reply: (queue.append(reply), queue.pop(0))[1]
    for _ in range(60):
        rig.tick()
    assert (rig.reader.registers.torque == known[0]).all()
    assert (rig.reader.registers.status_time == known[1]).all()


def test_healthy_cycles_always_ask_the_same() -> None:
    rig = Rig(Servos(IDS))
    for _ in range(20):
        rig.tick()
    assert len(set(rig.asked)) == 1


# --------------------------------------------------------------------------------------------- two layouts


@pytest.mark.parametrize("fast", [True, False])
def test_x_mx_and_p_series_on_one_bus_are_read_in_one_bulk_read(fast: bool) -> None:
    ids = (5, 9, 2, 7)
    models = [1020, 2020, 321, 2100]
    servos = Servos(ids)
    where = {1020: 132, 321: 132, 2020: 580, 2100: 580}
    for id, model in zip(ids, models, strict=True):
        servos.put(id, where[model], -100_000 * id, 4)
        servos.put(id, where[model] + 12, 240 + id, 2)  # voltage: 144 and 592
        servos.put(id, 98 if where[model] == 132 else 546, id, 1)
    rig = Rig(servos, ids, models, fast=fast)
    sample = rig.tick()
    assert sample.position.tolist() == [-100_000 * id for id in ids]
    kind = p.Instruction.FAST_BULK_READ if fast else p.Instruction.BULK_READ
    assert rig.asked[0].instruction == kind
    for _ in range(40):
        assert rig.tick().heard.all()
    assert rig.reader.registers.watchdog.tolist() == list(ids)
    assert rig.reader.registers.voltage == pytest.approx([24.0 + 0.1 * id for id in ids])
    assert (rig.clock.now() - rig.reader.registers.status_time < 0.06).all()


def test_trouble_on_a_bus_of_two_layouts_is_read_in_longer_bulk_reads() -> None:
    ids = (5, 9, 2)
    servos = Servos(ids)
    servos.put(5, 132, 11, 4)
    servos.put(9, 580, 22, 4)
    rig = Rig(servos, ids, [1020, 2020, 1020])
    servos.silent = {2}
    for _ in range(30):
        sample = rig.tick()
    assert sample.asked.tolist() == [True, True, False]
    assert sample.position.tolist() == [11, 22, 0]
    sizes = [each.params[3] for each in rig.asked[1:4]]
    assert len(set(sizes)) == 3
    assert 10 not in sizes
