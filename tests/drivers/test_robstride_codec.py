"""RobStride by its own protocol: golden frames, faults and modes in the id, parameters, error echoes."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.can_codec_frames import column, frame, ranges, wire
from tests.support.examples import examples
from twind_drivers.can import actuator_family as bits
from twind_drivers.can.actuator_family import RegisterType, ValuelessCommand
from twind_drivers.can.robstride_codec import (
    IDENTITY,
    PARAMETERS,
    POSITION,
    TIMEOUT,
    VELOCITY,
    RobStrideCodec,
)
from twind_drivers.ports.frame import ERROR, EXTENDED, REMOTE, Frames

IDS = (0x7F, 1)
HOST = 0xFD
MIDDLE = "7F FF 7F FF 7F FF 01 2C"  # nothing moves, 30.0 °C


def motors() -> RobStrideCodec:
    return RobStrideCodec("can0", IDS, ranges(2, 12.57, 33.0, 14.0))


def feedback_frame(id: int, data: str = MIDDLE, faults: int = 0, mode: int = 2, host: int = HOST) -> Frames:
    return frame(EXTENDED | 2 << 24 | mode << 22 | faults << 16 | id << 8 | host, data)


def answer(id: int, index: int, value: bytes, flag: int = 0) -> Frames:
    return frame(EXTENDED | 0x11 << 24 | flag << 16 | id << 8 | HOST, index.to_bytes(4, "little") + value)


def test_the_command_carries_its_torque_in_the_id() -> None:
    made = motors().command(column(1, 0), column(0, 0), column(50, 0), column(1, 0), column(0, 14))
    assert wire(made) == [
        (0x017FFF7F, "8A 2E 7F FF 19 99 33 33"),
        (0x01FFFF01, "7F FF 7F FF 00 00 00 00"),
    ]
    assert (made["id"] & EXTENDED == EXTENDED).all()


@pytest.mark.parametrize(
    ("what", "id", "first"),
    [
        (ValuelessCommand.ENABLE, 0x0300FD7F, "00"),
        (ValuelessCommand.DISABLE, 0x0400FD7F, "00"),
        (ValuelessCommand.CLEAR, 0x0400FD7F, "01"),
        (ValuelessCommand.ZERO, 0x0600FD7F, "01"),
    ],
)
def test_special_frames(what: ValuelessCommand, id: int, first: str) -> None:
    made = motors().encode_valueless_command(0, what)
    assert wire(made) == [(id, first + " 00" * 7)]
    assert int(made["id"][0]) & EXTENDED


def test_requests_of_parameters() -> None:
    motor = motors()
    assert wire(motor.read(0, PARAMETERS["run_mode"])) == [(0x1100FD7F, "05 70 00 00 00 00 00 00")]
    ticks = (20000).to_bytes(4, "little")
    assert wire(motor.write(0, TIMEOUT, ticks)) == [(0x1200FD7F, "28 70 00 00 20 4E 00 00")]
    assert TIMEOUT.unit * 20000 == pytest.approx(1.0)
    assert wire(motor.read(1, PARAMETERS["mcu_low"])) == [(0x0000FD01, "00" + " 00" * 7)]
    with pytest.raises(ValueError, match="mechanical_position"):
        motor.write(0, POSITION, bytes(4))


def test_the_question_reads_place_and_speed_of_each() -> None:
    motor = motors()
    assert [(id, data[:5]) for id, data in wire(motor.make_position_request())] == [
        (0x1100FD7F, "19 70"),
        (0x1100FD01, "19 70"),
        (0x1100FD7F, "1B 70"),
        (0x1100FD01, "1B 70"),
    ]
    assert len(motor.make_position_request()) == motor.answers * len(IDS)


def test_answers_to_the_question_are_feedback_and_parameters() -> None:
    both = np.concatenate(
        [
            answer(1, POSITION.address, struct.pack("<f", -1.5)),
            answer(0x7F, VELOCITY.address, struct.pack("<f", 2.5)),
        ]
    )
    feedback, found = motors().feedback(both)
    assert found.all()
    assert list(feedback.rows) == [1, 0]
    assert feedback.position[0] == -1.5
    assert math.isnan(feedback.velocity[0])
    assert math.isnan(feedback.position[1])
    assert feedback.velocity[1] == 2.5
    assert np.isnan(feedback.effort).all()
    assert list(feedback.enabled) == list(feedback.fault) == [-1, -1]
    answers, found = motors().decode_register_replies(both)
    assert found.all()
    assert [each[:3] for each in answers] == [
        (1, 0x7019, struct.pack("<f", -1.5)),
        (0, 0x701B, struct.pack("<f", 2.5)),
    ]


@pytest.mark.parametrize("raw", ["00 00 C0 7F", "01 00 80 7F", "00 00 80 FF", "FF FF 7F 7F", "20 BC BE 4C"])
def test_a_float_that_is_no_reading_gives_nan(raw: str) -> None:
    feedback, found = motors().feedback(answer(1, POSITION.address, bytes.fromhex(raw)))
    assert found.all()
    assert math.isnan(feedback.position[0])


def test_feedback_is_read_field_by_field() -> None:
    feedback, found = motors().feedback(feedback_frame(1, "FF FF 00 00 FF FF 01 2C"))
    assert found.all()
    assert list(feedback.rows) == [1]
    assert (feedback.position[0], feedback.velocity[0], feedback.effort[0]) == pytest.approx(
        (12.57, -33.0, 14.0)
    )
    assert (feedback.temperature[0], feedback.enabled[0], feedback.fault[0]) == (30.0, 1, 0)
    cold, _ = motors().feedback(feedback_frame(1, "7F FF 7F FF 7F FF FF CE"))
    assert cold.temperature[0] == -5.0


def test_a_float_of_a_million_is_a_reading_and_none_beyond() -> None:
    for value, read in ((1e6, True), (-1e6, True), (1.0001e6, False), (-1.0001e6, False)):
        feedback, _ = motors().feedback(answer(1, VELOCITY.address, struct.pack("<f", value)))
        assert math.isnan(feedback.velocity[0]) is not read


def test_heat_is_in_tenths_of_a_degree_with_a_sign() -> None:
    for raw, celsius in (("7F FF", 3276.7), ("74 00", 2969.6), ("80 00", -3276.8), ("FF FF", -0.1)):
        feedback, _ = motors().feedback(feedback_frame(1, f"7F FF 7F FF 7F FF {raw}"))
        assert feedback.temperature[0] == pytest.approx(celsius)


def test_all_kinds_of_replies_among_foreign_frames_are_found() -> None:
    fault = frame(EXTENDED | 0x15 << 24 | 0x7F << 8 | HOST, "04 00 00 00 FF FF FF FF")
    received = np.concatenate(
        [
            feedback_frame(0xFF),
            feedback_frame(0x7F),
            fault,
            answer(1, POSITION.address, struct.pack("<f", 0.5)),
            answer(2, POSITION.address, struct.pack("<f", 0.5)),
            frame(EXTENDED | 0x15 << 24 | 2 << 8 | HOST, "04 00 00 00 00 00 00 00"),
            frame(EXTENDED | 0x7F << 8 | 0xFE, "01 02 03 04 05 06 07 08"),
        ]
    )
    feedback, found = motors().feedback(received)
    assert found.tolist() == [False, True, True, True, False, False, False]
    assert feedback.rows.tolist() == [0, 0, 1]
    assert feedback.fault.tolist() == [0, bits.VOLTAGE, -1]
    assert feedback.enabled.tolist() == [1, -1, -1]
    assert feedback.position[2] == 0.5 and math.isnan(feedback.position[1])
    answers, found = motors().decode_register_replies(received)
    assert found.tolist() == [False, False, False, True, False, False, True]
    assert [(each.row, each.address) for each in answers] == [(1, 0x7019), (0, 0), (0, 4)]


@pytest.mark.parametrize(
    ("id", "data"),
    [
        (EXTENDED | 2 << 8 | 0xFE, "01 02 03 04 05 06 07 08"),  # of another
        (EXTENDED | 0xFF << 8 | 0xFE, "01 02 03 04 05 06 07 08"),
        (EXTENDED | 1 << 8 | 0xFD, "01 02 03 04 05 06 07 08"),  # to the host alone
        (EXTENDED | 1 << 16 | 1 << 8 | 0xFE, "01 02 03 04 05 06 07 08"),  # with an error flag
        (EXTENDED | 1 << 8 | 0xFE, "01 02 03 04 05 06 07"),
        (1 << 8 | 0xFE, "01 02 03 04 05 06 07 08"),
    ],
)
def test_no_other_frame_is_the_number_of_a_processor(id: int, data: str) -> None:
    assert not motors().decode_register_replies(frame(id, data))[1].any()


@pytest.mark.parametrize("flag", [0x01, 0x80, 0xFF])
def test_each_bit_of_an_error_echo_makes_it_none_whatever_the_id(flag: int) -> None:
    motor = RobStrideCodec("can0", (0xFC, 0x80), ranges(2))
    for id in (0xFC, 0x80):
        assert motor.feedback(answer(id, POSITION.address, bytes(4)))[1].all()
        assert motor.decode_register_replies(answer(id, TIMEOUT.address, bytes(4)))[1].all()
        assert not motor.feedback(answer(id, POSITION.address, bytes(4), flag))[1].any()
        values, known = motor.decode_register_replies(answer(id, TIMEOUT.address, bytes(4), flag))
        assert (values, known.all()) == ([], True)


FAULTS = (bits.VOLTAGE, bits.ELECTRICAL, bits.HEAT, bits.ENCODER, bits.OVERLOAD, bits.UNCALIBRATED)


def test_every_pattern_of_fault_and_mode_bits() -> None:
    for faults in range(64):
        for mode, enabled in ((0, 0), (1, 1), (2, 1), (3, -1)):
            feedback, _ = motors().feedback(feedback_frame(0x7F, faults=faults, mode=mode))
            wanted = sum(meaning for bit, meaning in enumerate(FAULTS) if faults >> bit & 1)
            assert feedback.fault[0] == wanted | (bits.UNKNOWN if mode == 3 else 0)
            assert feedback.enabled[0] == enabled


def test_every_bit_of_a_fault_frame_is_a_fault() -> None:
    for bit in range(32):
        named = {0: bits.HEAT, 1: bits.ELECTRICAL, 2: bits.VOLTAGE, 3: bits.ENCODER}
        named |= {7: bits.UNCALIBRATED, 14: bits.OVERLOAD}
        made = frame(EXTENDED | 0x15 << 24 | 1 << 8 | HOST, (1 << bit).to_bytes(4, "little") + bytes(4))
        feedback, found = motors().feedback(made)
        assert found.all(), bit
        assert (feedback.rows[0], feedback.fault[0]) == (1, named.get(bit, bits.UNKNOWN)), bit
        assert feedback.enabled[0] == -1, bit
        assert math.isnan(feedback.position[0]), bit


def test_an_error_echo_is_no_value() -> None:
    for index in (POSITION.address, TIMEOUT.address):
        echo = answer(1, index, bytes(4), flag=1)
        assert not motors().feedback(echo)[1].any()
        assert motors().decode_register_replies(echo)[0] == []


def test_the_number_of_the_processor_comes_in_two_halves() -> None:
    made = frame(EXTENDED | 1 << 8 | 0xFE, "01 02 03 04 05 06 07 08")
    answers, found = motors().decode_register_replies(made)
    assert found.all()
    assert [each[:3] for each in answers] == [(1, 0, bytes([1, 2, 3, 4])), (1, 4, bytes([5, 6, 7, 8]))]
    assert not motors().feedback(made)[1].any()


def test_the_number_of_another_processor_among_other_replies_is_ignored() -> None:
    other = frame(EXTENDED | 3 << 8 | 0xFE, bytes(8))
    answers, found = motors().decode_register_replies(np.concatenate((other, feedback_frame(1))))
    assert (answers, found.tolist()) == ([], [False, False])


def test_the_number_of_a_parameter_has_two_bytes() -> None:
    [told], _ = motors().decode_register_replies(answer(1, 0x55_7005, bytes(4)))
    assert told.address == 0x7005


@pytest.mark.parametrize(
    "stranger",
    [
        feedback_frame(2),
        feedback_frame(1, host=0xFE),
        feedback_frame(1, host=0x1F),
        frame(0x0200FD01 & 0x7FF, MIDDLE),  # a standard frame
        frame(EXTENDED | ERROR | 2 << 24 | 1 << 8 | HOST, MIDDLE),
        frame(EXTENDED | REMOTE | 2 << 24 | 1 << 8 | HOST, b"", 8),
        frame(EXTENDED | 2 << 24 | 1 << 8 | HOST, "7F FF 7F FF 7F FF 01"),
        frame(EXTENDED | 0x18 << 24 | 1 << 8 | HOST, MIDDLE),  # its report: not documented
        frame(EXTENDED | 0x12 << 24 | 1 << 8 | HOST, MIDDLE),
    ],
    ids=range(9),
)
def test_foreign_frames_are_ignored(stranger: Frames) -> None:
    assert not motors().feedback(stranger)[1].any()
    assert not motors().decode_register_replies(stranger)[1].any()


def test_everything_of_ours_that_can_do_something_is_known() -> None:
    motor = motors()
    zero = np.zeros(2)
    made = motor.command(column(-12.57, 0.25), zero, zero, zero, column(14, -14))
    assert list(motor.commanded_rows(made)) == [0, 1]
    assert motor.decode_commanded_position(made) == pytest.approx([-12.57, 0.25], abs=2 * 12.57 / 65535)
    for row in range(2):
        for what in (
            ValuelessCommand.ENABLE,
            ValuelessCommand.DISABLE,
            ValuelessCommand.CLEAR,
            ValuelessCommand.ZERO,
        ):
            order = motor.encode_valueless_command(row, what)
            assert list(motor.commanded_rows(order)) == [row]
            assert np.isnan(motor.decode_commanded_position(order)).all()
        for parameter in PARAMETERS.values():
            assert list(motor.commanded_rows(motor.read(row, parameter))) == [-1]
            if parameter.writable:
                assert list(motor.commanded_rows(motor.write(row, parameter, bytes(4)))) == [row]
    assert np.isnan(motor.decode_commanded_position(frame(EXTENDED | 1 << 24 | 2, bytes(8)))).all()  # id 2
    for kind in (7, 22, 23, 24, 25, 31):  # new id, save, rate, report, another protocol, unknown
        assert list(motor.commanded_rows(frame(EXTENDED | kind << 24 | HOST << 8 | 1, bytes(8)))) == [1]
    assert (motor.commanded_rows(feedback_frame(1)) == -1).all()
    assert (motor.commanded_rows(frame(1, bytes(8))) == -1).all()


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF))
@examples(50)
def test_a_reported_position_can_be_commanded_within_one_count(position: int, torque: int) -> None:
    motor = RobStrideCodec("can0", [1], ranges(1, 12.57, 33.0, 14.0))
    data = struct.pack(">HHHH", position, 0, torque, 300)
    feedback, _ = motor.feedback(frame(EXTENDED | 2 << 24 | 2 << 22 | 1 << 8 | HOST, data))
    zero = np.zeros(1)
    made = motor.command(feedback.position, zero, zero, zero, feedback.effort)
    assert position - 1 <= int.from_bytes(made["data"][0, :2].tobytes(), "big") <= position
    assert torque - 1 <= int(made["id"][0]) >> 8 & 0xFFFF <= torque


def test_the_mode_is_motion_control_or_its_number_above_100() -> None:
    motor = motors()
    assert motor.operating_mode({"run_mode": 0.0}) == 1
    assert [motor.operating_mode({"run_mode": float(mode)}) for mode in (1, 2, 3, 5)] == [101, 102, 103, 105]
    assert motor.operating_mode({}) == 0


def test_identity_is_of_the_parameters() -> None:
    assert set(IDENTITY) <= set(PARAMETERS)
    assert motors().claims == set() and motors().answers == 2
    assert len({parameter.address for parameter in PARAMETERS.values()}) == len(PARAMETERS)
    assert PARAMETERS["run_mode"].kind is RegisterType.U8
    assert motors().watchdog is TIMEOUT


@pytest.mark.parametrize(
    ("ids", "host", "why"),
    [
        ((1, 1), HOST, "twice"),
        ((0, 1), HOST, "outside"),
        ((0xFE, 1), HOST, "outside"),
        ((0xFD, 1), HOST, "host"),
        ((1, 2), 0xFE, "host"),
        ((1, 2), -1, "host"),
        ((1, 2), 0x100, "host"),
    ],
)
def test_indistinguishable_ids_are_refused(ids: tuple[int, int], host: int, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        RobStrideCodec("can0", ids, ranges(2), host)


def test_another_host_id_is_used_both_ways() -> None:
    motor = RobStrideCodec("can0", IDS, ranges(2), host=0x1F)
    assert wire(motor.encode_valueless_command(1, ValuelessCommand.ENABLE))[0][0] == 0x03001F01
    assert motor.feedback(feedback_frame(1, host=0x1F))[1].all()
    assert not motor.feedback(feedback_frame(1))[1].any()


@pytest.mark.parametrize("host", [0, 0xFF])
def test_the_host_may_have_any_other_byte(host: int) -> None:
    assert RobStrideCodec("can0", IDS, ranges(2), host).feedback(feedback_frame(1, host=host))[1].all()


def test_a_motor_has_no_reboot_and_the_ranges_that_were_given() -> None:
    with pytest.raises(ValueError, match="id 127: a RobStride has no reboot"):
        motors().encode_valueless_command(0, ValuelessCommand.REBOOT)
    given = ranges(2)
    assert RobStrideCodec("can0", IDS, given).ranges is given
