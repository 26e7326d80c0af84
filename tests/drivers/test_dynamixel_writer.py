"""The writing half of a bus: order of packets, read-backs, refusals, and the last check of every byte."""

from typing import Any

import numpy as np
import pytest

from tests.support.dynamixel_responder import Servos, Wire
from tests.support.dynamixel_rig import IDS, SYNC, Bench
from twind.exceptions import InvalidInput
from twind_drivers.bus import (
    DeviceRefused,
    GroupWriteBatch,
    NoReply,
    RebootRequest,
    WireRangeError,
    WriteRequest,
)
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.packet import Instruction, Packet, status

HERE = np.array([2000, 2100, 2200])


# ------------------------------------------------------------------------------------------- every tick


# ------------------------------------------------------------------------------------------- scripts


def test_prepare_clears_watchdogs_and_sets_the_goal_in_one_system_call_then_reads_back() -> None:
    bench = Bench(gains=[(700, 3, 40)] * 3, watchdog=7)
    for id in IDS:
        bench.servos.put(id, 98, -1, 1)
        bench.servos.put(id, 112, 55, 4)
    bench.run(bench.writer.prepare(HERE))
    assert bench.addresses(1) == [(SYNC, 98), (SYNC, 116), (SYNC, 98)]
    first, _, last = bench.sent(1)
    assert (first.params[5], last.params[5]) == (0, 7)
    for place, id in enumerate(IDS):
        assert bench.servos.get(id, 98, 1) == 7
        assert bench.servos.get(id, 116, 4) == HERE[place]
        assert [bench.servos.get(id, at, 2) for at in (84, 82, 80)] == [700, 3, 40]
        assert [bench.servos.get(id, at, 4) for at in (108, 112)] == [0, 0]
    assert bench.reader.registers.watchdog.tolist() == [7, 7, 7]


def test_gains_are_the_models_own_where_none_are_given() -> None:
    bench = Bench()
    bench.run(bench.writer.prepare(HERE))
    assert bench.servos.get(2, 84, 2) == 800


@pytest.mark.parametrize(
    ("address", "what"), [(98, "bus watchdog"), (84, "position gains"), (116, "goal position")]
)
def test_prepare_fails_when_one_servo_reads_back_another_value(address: int, what: str) -> None:
    bench = Bench()
    bench.servos.frozen = {2: {address}}
    with pytest.raises(DeviceRefused, match=rf"id 2: .*{what}"):
        bench.run(bench.writer.prepare(HERE))


def test_scripts_fail_when_one_servo_is_silent() -> None:
    bench = Bench()
    bench.servos.silent = {3}
    for script in (
        bench.writer.prepare(HERE),
        bench.writer.write_goals(HERE),
        bench.writer.torque(True),
        bench.writer.torque(False),
    ):
        with pytest.raises(NoReply) as caught:
            bench.run(script)
        assert caught.value.ids == (3,)


def test_torque_is_read_back_and_off_is_written_twice() -> None:
    bench = Bench()
    bench.run(bench.writer.torque(True))
    assert bench.addresses(0) == [(SYNC, 64)]
    assert bench.reader.registers.torque.tolist() == [1, 1, 1]
    before = len(bench.wire.writes)
    bench.run(bench.writer.torque(False))
    assert bench.addresses(before) == [(SYNC, 64), (SYNC, 64)]
    assert bench.reader.registers.torque.tolist() == [0, 0, 0]
    bench.servos.frozen = {1: {64}}
    with pytest.raises(DeviceRefused) as refused:
        bench.run(bench.writer.torque(True))
    assert refused.value.id == 1


def test_a_servo_that_ignores_writes_is_explained_by_its_registers() -> None:
    bench = Bench()
    bench.servos.frozen = {1: {64}, 2: {116}}
    bench.servos.put(1, 70, 0x20, 1)
    bench.servos.put(2, 98, -1, 1)
    bench.run(bench.reader.collect(IDS, 64, 35))
    with pytest.raises(DeviceRefused, match=r"hardware error 0x20.*reboot"):
        bench.run(bench.writer.torque(True))
    with pytest.raises(DeviceRefused, match="watchdog has tripped"):
        bench.run(bench.writer.write_goals(HERE))


def test_a_register_is_written_by_name_and_read_back() -> None:
    bench = Bench()
    found = bench.run(bench.writer.write(2, "Goal PWM", -300))
    assert (found.address, found.value) == (100, -300)
    assert bench.servos.get(2, 100, 2) == -300
    bench.servos.frozen = {2: {100, 101}}
    with pytest.raises(DeviceRefused, match="wrote 5, reads -300"):
        bench.run(bench.writer.write(2, "goal_pwm", 5))


def test_eeprom_is_not_written_while_torque_is_on() -> None:
    bench = Bench()
    bench.servos.put(2, 64, 1, 1)
    before = bytes(bench.servos.memory[2])
    with pytest.raises(DeviceRefused, match=r"EEPROM.*disarm first"):
        bench.run(bench.writer.write(2, "homing_offset", 5))
    assert bench.servos.memory[2] == before
    bench.run(bench.writer.write(1, "homing_offset", -5))
    assert bench.servos.get(1, 20, 4) == -5


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("present_position", 1, "read-only"),
        ("position_p_gain", 16384, "0..16383"),
        ("torque_enable", 1, "arming"),
        ("goal_position", 2000, "gate"),
        ("goal_velocity", 5, "gate"),
        ("goal_current", 5, "the goal of mode 0, and the cap of mode 5"),
        ("id", 9, "another id"),
        ("baud_rate", 3, "another baud rate"),
        ("protocol_type", 1, "this protocol"),
        ("indirect_data_1", 1, "mapped to"),
        ("indirect_data_write", 1, "mapped to"),
    ],
)
def test_an_invalid_write_sends_no_byte(name: str, value: int, words: str) -> None:
    bench = Bench()
    with pytest.raises(ValueError, match=words):
        bench.run(bench.writer.write(1, name, value))
    assert bench.wire.writes == []


def test_an_error_status_of_a_servo_is_quoted() -> None:
    bench = Bench()
    bench.servos.error = {2: 4}
    with pytest.raises(DeviceRefused) as refused:
        bench.run(bench.writer.write(2, "led", 1))
    assert (refused.value.id, refused.value.what) == (2, "LED = 1")
    with pytest.raises(InvalidInput, match="led"):
        bench.run(bench.writer.write(2, "lad", 1))


class Limited(Servos):
    """Refuses writes beyond a limit register (e-manual, status packet, error 6), and answers reads."""

    silent_reads = False

    def _single(self, each: Packet) -> bytes:
        if each.instruction == Instruction.WRITE:
            return status(each.id, 6)
        return b"" if self.silent_reads else super()._single(each)


def test_a_value_beyond_a_limit_register_is_refused_with_that_register() -> None:
    bench = Bench(kind=Limited)
    bench.servos.put(2, 36, 300, 2)
    with pytest.raises(DeviceRefused, match=r"Goal PWM = 301: .*limit register: PWM Limit \(36\) is 300"):
        bench.run(bench.writer.write(2, "goal_pwm", 301))
    with pytest.raises(DeviceRefused, match=r"LED = 1: value beyond the configured limit register$"):
        bench.run(bench.writer.write(2, "led", 1))
    bench.servos.silent_reads = True
    with pytest.raises(DeviceRefused, match=r"Goal PWM = 301: value beyond the configured limit register$"):
        bench.run(bench.writer.write(2, "goal_pwm", 301))


def test_a_reboot_waits_for_a_reply_and_clears_the_cached_state() -> None:
    bench = Bench()
    bench.run(bench.writer.torque(True))
    with pytest.raises(DeviceRefused):
        bench.run(bench.writer.reboot(2))
    assert Instruction.REBOOT not in [each.instruction for each in bench.servos.seen]
    bench.servos.put(2, 64, 0, 1)
    bench.servos.deaf_until = {2: 20}
    bench.run(bench.writer.reboot(2))
    assert Instruction.REBOOT in [each.instruction for each in bench.servos.seen]
    assert bench.reader.registers.torque.tolist() == [1, 0, 1]
    bench.servos.deaf_until = {2: 10_000}
    for bench.servos.silent in (set(), {2}):
        with pytest.raises(NoReply) as lost:
            bench.run(bench.writer.reboot(2))
        assert lost.value.ids == (2,)


# ------------------------------------------------------------------------------------------- the last check


@pytest.mark.parametrize(
    "order",
    [
        WriteRequest({1: (3001).to_bytes(4, "little")}, 116),  # goal outside
        WriteRequest({1: bytes(4), 2: bytes(4)}, 116),
        GroupWriteBatch((WriteRequest({1: b"\0"}, 98), WriteRequest({1: (999).to_bytes(4, "little")}, 116))),
        WriteRequest({1: (2000).to_bytes(8, "little")}, 112),  # a goal hidden in a longer block
        WriteRequest({1: (2000).to_bytes(2, "little")}, 118),  # half a goal
        WriteRequest({1: b"\0"}, 70),  # read-only
        WriteRequest({1: b"\0"}, 66),  # no register there
        WriteRequest({9: b"\1"}, 64),  # nobody of this bus
        WriteRequest({9: b"\1", 1: b"\1"}, 64),
        RebootRequest(9),
    ],
)
def test_an_order_outside_the_white_list_sends_no_byte(
    order: WriteRequest | GroupWriteBatch | RebootRequest,
) -> None:
    bench = Bench()
    with pytest.raises(WireRangeError):
        bench.writer.begin(order, 0.0)
    assert bench.wire.writes == []


@pytest.mark.parametrize(
    "more",
    [
        {"watchdog": 0},
        {"watchdog": 128},
        {"lower": np.full(3, 4000)},
        {"lower": np.zeros(2, int)},
        {"gains": [(99999, 0, 0)] * 3},
    ],
)
def test_a_writer_without_sound_bounds_does_not_come_into_being(more: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        Bench(**more)


def test_a_model_without_known_gains_needs_them_given() -> None:
    reader = DynamixelReader("main", Wire(Servos((1,))), (1,), [53769], baud=1_000_000, return_delay_us=0)
    bounds = {"lower": np.array([0]), "upper": np.array([4095])}
    with pytest.raises(ValueError, match="H54-100-S500-RA: set it"):
        DynamixelWriter(reader, **bounds)
    DynamixelWriter(reader, **bounds, gains=[(800, 0, 0)])


def test_a_bus_with_one_device_is_written_and_acknowledged() -> None:
    bench = Bench(ids=(5,))
    bench.run(bench.writer.prepare(np.array([2000])))
    bench.run(bench.writer.torque(True))
    bench.writer.goals(np.array([2001]))
    bench.cycle()
    assert bench.servos.get(5, 116, 4) == 2001
    assert bench.servos.get(5, 64, 1) == 1


def test_every_other_servo_is_prepared_before_a_missing_reply_is_reported() -> None:
    bench = Bench()
    bench.servos.put(1, 98, 255, 1)  # tripped: it takes no goal until its watchdog was cleared
    bench.servos.silent.add(2)
    with pytest.raises(NoReply) as error:
        bench.run(bench.writer.prepare(HERE))
    assert error.value.ids == (2,)
    for id, goal in ((1, HERE[0]), (3, HERE[2])):
        assert bench.servos.get(id, 98, 1) == 5
        assert bench.servos.get(id, 116, 4) == goal
