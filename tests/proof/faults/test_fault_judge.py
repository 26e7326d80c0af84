"""The judge of the fault runs can fail: it finds the one defect in each of these drivers."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import Rig
from tests.support.fault_rig import Judge, Moved, Wire
from twind.robot.joint_state import JointState
from twind.robot.modes import Mode
from twind_drivers.bus import BusSample
from twind_drivers.dynamixel import packet, replies
from twind_drivers.dynamixel.dynamixel_cyclic_read import DynamixelCyclicRead
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_slow_registers import DynamixelSlowRegisters
from twind_drivers.dynamixel.packet import Framer, Packet
from twind_drivers.dynamixel.replies import FastSyncReadReply, StatusReply
from twind_drivers.virtual.serial_bus_faults import SerialBusFaults

Patch = pytest.MonkeyPatch
Mutation = Callable[[Patch], None]
Injury = Callable[[SerialBusFaults], None]


def samples(patch: Patch, change: Callable[[BusSample], BusSample]) -> None:
    """Every cyclic reading passes `change` on its way out of the driver."""
    finish = DynamixelReader.finish
    patch.setattr(DynamixelReader, "finish", lambda self, now: change(finish(self, now)))


def the_last_number_is_taken_for_fresh(patch: Patch) -> None:
    kept: list[BusSample] = []

    def change(sample: BusSample) -> BusSample:
        if sample.heard.all():
            kept[:] = [sample]
            return sample
        return replace(kept[0], sent=sample.sent, received=sample.received)

    samples(patch, change)


def zero_is_taken_for_a_reading(patch: Patch) -> None:
    samples(patch, lambda sample: replace(sample, heard=np.ones_like(sample.heard)))


def readings_behind_a_hole_move_up(patch: Patch) -> None:
    def change(sample: BusSample) -> BusSample:
        return sample if sample.heard.all() else replace(sample, position=np.roll(sample.position, 1))

    samples(patch, change)


def a_reading_is_stamped_one_cycle_early(patch: Patch) -> None:
    samples(patch, lambda sample: replace(sample, received=sample.received - 0.01))


def a_reading_is_stamped_when_it_is_looked_at_later(patch: Patch) -> None:
    samples(patch, lambda sample: replace(sample, received=sample.received + 0.02))


def one_count_is_lost(patch: Patch) -> None:
    samples(patch, lambda sample: replace(sample, position=sample.position & ~1))


def no_crc_is_checked(patch: Patch) -> None:
    def intact(self: Any) -> int:
        stride = self.size + 4
        return int(min(len(self.ids), (self._got - 8) // stride))

    def open_(self: Any, start: int, size: int) -> Packet:
        body = packet.unstuff(self.buffer[start + 7 : start + size - 2])
        return Packet(self.buffer[start + 4], body[0], body[1:])

    patch.setattr(FastSyncReadReply, "_intact", intact)
    patch.setattr(Framer, "_open", open_)
    patch.setattr(replies, "crc16", lambda data: 0)


def a_late_answer_is_taken_for_the_new_one(patch: Patch) -> None:
    patch.setattr(DynamixelCyclicRead, "_troubled", lambda self: self._steady)


def an_answer_of_another_length_is_taken(patch: Patch) -> None:
    def accept(self: Any, found: Packet) -> None:
        place = self._index.get(found.id)
        if place is None:
            return
        self.answered[place] = self.heard[place] = True
        data = np.zeros(self.size, np.uint8)
        part = np.frombuffer(found.data[: self.size], np.uint8)
        data[: len(part)] = part
        self._spare[place] = data

    patch.setattr(StatusReply, "_accept", accept)


def registers_get_a_new_stamp_for_old_values(patch: Patch) -> None:
    fold = DynamixelSlowRegisters.update_from_replies
    first = dict[Any, Any]()

    def keep_first(self: Any, query: Any, ids: Any, data: Any, time: float) -> None:
        fold(self, query, ids, first.setdefault((query, ids), data.copy()), time)

    patch.setattr(DynamixelSlowRegisters, "update_from_replies", keep_first)


MUTANTS: list[tuple[Mutation, Injury, str]] = [
    (the_last_number_is_taken_for_fresh, lambda faults: faults.drop(30), "fresh and wrong"),
    (zero_is_taken_for_a_reading, lambda faults: faults.drop(3), "fresh and wrong"),
    (readings_behind_a_hole_move_up, lambda faults: faults.drop(1, id=7), "fresh and wrong"),
    (a_reading_is_stamped_one_cycle_early, lambda faults: None, "stamp"),
    (a_reading_is_stamped_when_it_is_looked_at_later, lambda faults: None, "stamp"),
    (one_count_is_lost, lambda faults: None, "fresh and wrong"),
    (no_crc_is_checked, lambda faults: faults.corrupt(100, bits=3), "fresh and wrong"),
    (a_late_answer_is_taken_for_the_new_one, lambda faults: faults.delay(0.01), "fresh and wrong"),
    (a_late_answer_is_taken_for_the_new_one, lambda faults: faults.delay(0.01, id=7), "fresh and wrong"),
    (an_answer_of_another_length_is_taken, lambda faults: faults.delay(0.01), "fresh and wrong"),
    (registers_get_a_new_stamp_for_old_values, lambda faults: faults.damage(5, 1), "hardware error"),
]


@pytest.fixture
def mirror() -> Iterator[tuple[Rig, Judge, Wire]]:
    rig = Rig(mode=Mode.MIRROR, muscles=Moved)
    judge = Judge(rig)
    wire = Wire(rig, writes=False)
    yield rig, judge, wire
    rig.close()


def run(rig: Rig, injury: Injury) -> None:
    rig.connect()
    rig.ticks(3)
    injury(rig.virtual["main"].faults)
    rig.ticks(30)


@pytest.mark.parametrize("number", range(len(MUTANTS)))
def test_the_judge_finds_the_defect_and_blames_no_sound_driver(
    mirror: tuple[Rig, Judge, Wire], monkeypatch: Patch, number: int
) -> None:
    mutate, injury, said = MUTANTS[number]
    rig, judge, _ = mirror
    run(rig, injury)
    judge.verdict()
    mutate(monkeypatch)
    other = Rig(mode=Mode.MIRROR, muscles=Moved)
    other_judge = Judge(other)
    run(other, injury)
    with pytest.raises(AssertionError, match=said):
        other_judge.verdict()
    other.close()


@pytest.mark.parametrize(
    ("seen", "change", "message"),
    [
        (False, lambda state: {"position": np.nan_to_num(state.position)}, "never heard, and yet a number"),
        (True, lambda state: {"age": state.age * state.heard}, "not heard, and yet a new stamp"),
        (True, lambda state: {"position": state.position * state.heard}, "not heard, and yet another number"),
    ],
)
def test_the_judge_finds_each_wrong_reading_of_a_stale_joint(
    seen: bool, change: Callable[[JointState], dict[str, Any]], message: str
) -> None:
    rig = Rig(mode=Mode.MIRROR, muscles=Moved)
    exchange = rig.loop.hardware.exchange

    def broken(goal: Any, now: float) -> JointState:
        state = exchange(goal, now)
        return replace(state, **change(state))

    rig.loop.hardware.exchange = broken  # type: ignore[method-assign]
    judge = Judge(rig)
    rig.ticks(10 if seen else 0)
    rig.virtual["main"].faults.silence(3)
    rig.ticks(10)
    with pytest.raises(AssertionError, match=message):
        judge.verdict()
    rig.close()


def test_the_watch_on_the_wire_finds_a_mirror_that_writes(mirror: tuple[Rig, Judge, Wire]) -> None:
    rig, _, wire = mirror
    run(rig, lambda faults: None)
    wire.verdict()
    port = rig.loop.hardware.ports[0]
    assert port.reader is not None
    port.reader.transport.write(packet.sync_write(116, {1: b"\0\x08\0\0"}))
    with pytest.raises(AssertionError, match="a mirror writes"):
        wire.verdict()


def test_the_watch_on_the_wire_finds_a_goal_that_jumps_or_leaves_its_range(armed: Rig) -> None:
    wire = Wire(armed, writes=True)
    armed.ticks(3)
    wire.verdict()
    port = armed.loop.hardware.ports[0]
    place = int(armed.counts[0])
    assert port.reader is not None
    port.reader.transport.write(packet.sync_write(116, {1: (place + 300).to_bytes(4, "little")}))
    with pytest.raises(AssertionError, match="the last goal"):
        wire.verdict()
    wire.wrong.clear()
    port.reader.transport.write(packet.sync_write(116, {1: (9000).to_bytes(4, "little")}))
    with pytest.raises(AssertionError, match="outside"):
        wire.verdict()
