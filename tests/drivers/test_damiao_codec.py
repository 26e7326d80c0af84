"""Damiao: golden frames, every status, registers that never pass for feedback, strangers left alone."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.can_codec_frames import column, frame, noise, ranges, wire
from tests.support.examples import examples
from twind_drivers.bus import WireRangeError
from twind_drivers.can import actuator_family as bits
from twind_drivers.can.actuator_family import FamilyRegister, RegisterType, ValuelessCommand
from twind_drivers.can.damiao_codec import IDENTITY, PARAMETERS, TIMEOUT, DamiaoCodec
from twind_drivers.ports.frame import ERROR, EXTENDED, REMOTE, Frames

# the third shares a master id, not a low nibble
IDS = (1, 2, 0x15)
MASTERS = (0x11, 0x12, 0x11)
MIDDLE = "7F FF 7F F7 FF"  # D1 to D5: nothing moves, nothing pulls


def damiao() -> DamiaoCodec:
    return DamiaoCodec("can0", IDS, ranges(3), MASTERS)


def reply(
    master: int, status: int, id: int, fields: str = MIDDLE, heat: tuple[int, int] = (30, 40)
) -> Frames:
    return frame(master, bytes([status << 4 | id & 0xF, *bytes.fromhex(fields), *heat]))


def test_the_command_has_the_bytes_of_the_manual() -> None:
    made = damiao().command(
        column(0, 1, -np.pi), column(0, 0, 5), column(0, 50, 100), column(0, 1, 2.5), column(0, 0, -3.5)
    )
    assert wire(made) == [
        (1, "7F FF 7F F0 00 00 07 FF"),
        (2, "8A 3C 7F F1 99 33 37 FF"),
        (0x15, "5F D4 95 43 33 7F F5 32"),
    ]


@pytest.mark.parametrize(
    ("what", "last"), [("ENABLE", "FC"), ("DISABLE", "FD"), ("ZERO", "FE"), ("CLEAR", "FB")]
)
def test_special_frames(what: str, last: str) -> None:
    assert wire(damiao().encode_valueless_command(2, ValuelessCommand[what])) == [
        (0x15, "FF FF FF FF FF FF FF " + last)
    ]


def test_the_question_asks_each_for_one_frame() -> None:
    assert wire(damiao().make_position_request()) == [
        (0x7FF, "01 00 CC 00 00 00 00 00"),
        (0x7FF, "02 00 CC 00 00 00 00 00"),
        (0x7FF, "15 00 CC 00 00 00 00 00"),
    ]


def test_requests_of_registers() -> None:
    motor = damiao()
    assert wire(motor.read(2, TIMEOUT)) == [(0x7FF, "15 00 33 09 00 00 00 00")]
    assert wire(motor.write(0, TIMEOUT, (2000).to_bytes(4, "little"))) == [(0x7FF, "01 00 55 09 D0 07 00 00")]
    assert TIMEOUT.unit * 2000 == pytest.approx(0.1)


def test_only_what_may_be_written_is_written() -> None:
    for name in ("esc_id", "master_id", "position_range", "serial_number", "can_rate"):
        with pytest.raises(ValueError, match=name):
            damiao().write(0, PARAMETERS[name], bytes(4))
    with pytest.raises(ValueError, match="2 bytes"):
        damiao().write(0, TIMEOUT, bytes(2))


def test_identity_is_of_the_parameters_and_holds_what_the_checks_need() -> None:
    assert set(IDENTITY) <= set(PARAMETERS)
    numbers = {PARAMETERS[name].address for name in IDENTITY}
    assert numbers == {0, 2, 7, 8, 9, 10, 13, 14, 15, 21, 22, 23, 29}
    whole = {7, 8, 9, 10, 13, 14, 15, 35}
    for parameter in PARAMETERS.values():
        assert (parameter.kind is RegisterType.U32) == (parameter.address in whole)


STATUS = {
    0x0: (0, 0),
    0x1: (1, 0),
    0x8: (0, bits.VOLTAGE),
    0x9: (0, bits.VOLTAGE),
    0xA: (0, bits.ELECTRICAL),
    0xB: (0, bits.HEAT),
    0xC: (0, bits.HEAT),
    0xD: (-1, bits.SILENCE),
    0xE: (0, bits.OVERLOAD),
}


@pytest.mark.parametrize("status", range(16))
def test_every_status_gives_torque_and_fault(status: int) -> None:
    feedback, told = damiao().feedback(reply(0x12, status, 2))
    assert told.all()
    assert (feedback.enabled[0], feedback.fault[0]) == STATUS.get(status, (-1, bits.UNKNOWN))


def test_feedback_is_read_field_by_field() -> None:
    received = np.concatenate(
        [reply(0x11, 1, 0x15, "FF FF 00 00 00", (55, 44)), reply(0x11, 0, 1, "00 00 FF FF FF", (1, 200))]
    )
    feedback, told = damiao().feedback(received)
    assert told.all()
    assert list(feedback.rows) == [2, 0]
    assert feedback.position == pytest.approx([12.5, -12.5])
    assert feedback.velocity == pytest.approx([-30.0, 30.0])
    assert feedback.effort == pytest.approx([-10.0, 10.0])
    assert list(feedback.temperature) == [55.0, 200.0]  # the hotter of power stage and winding
    assert np.isnan(feedback.voltage).all()


def test_several_replies_of_one_actuator_keep_their_order() -> None:
    received = np.concatenate([reply(0x12, 1, 2, "90 00 7F F7 FF"), reply(0x12, 1, 2, "A0 00 7F F7 FF")])
    feedback, _ = damiao().feedback(received)
    assert list(feedback.rows) == [1, 1]
    assert feedback.position[1] > feedback.position[0]


@pytest.mark.parametrize("order", [0x33, 0x55, 0xAA, 0xCC])
@pytest.mark.parametrize("register", [0, 9, 23, 81])
def test_register_traffic_never_passes_for_feedback(order: int, register: int) -> None:
    received = frame(0x12, bytes([2, 0, order, register, 1, 2, 3, 4]))
    feedback, told = damiao().feedback(received)
    assert not told.any()
    assert len(feedback.rows) == 0
    answers, answered = damiao().decode_register_replies(received)
    assert answered.all() == (order in (0x33, 0x55))
    if answered.all():
        assert answers[0] == (1, register, bytes([1, 2, 3, 4]), order == 0x55)


def test_feedback_that_resembles_a_register_reply_is_decoded() -> None:
    at_rest = frame(0x12, "12 00 55 7F F7 FF 1E 1E")  # velocity 0: D3 is no register
    feedback, told = damiao().feedback(at_rest)
    assert told.all()
    assert feedback.position[0] == pytest.approx(-12.468, abs=1e-3)


@pytest.mark.parametrize(
    "stranger",
    [
        reply(0x13, 1, 3),  # another master id
        reply(0x12, 1, 3),  # our master id, another actuator
        reply(0x11, 1, 2),  # of actuator 2, but not on its id
        reply(0x12 | EXTENDED, 1, 2),
        reply(0x12 | ERROR, 1, 2),
        frame(0x12 | REMOTE, b"", 8),
        frame(0x12, "12 7F FF 7F F7 FF 1E"),  # too short
        reply(2, 1, 2),  # its command id
        reply(0x7FF, 1, 2),
    ],
    ids=range(9),
)
def test_foreign_frames_are_ignored(stranger: Frames) -> None:
    assert not damiao().feedback(stranger)[1].any()
    assert not damiao().decode_register_replies(stranger)[1].any()


def test_an_answer_must_name_its_sender_in_full() -> None:
    for id in ("05 00", "15 01", "25 00"):
        assert not damiao().decode_register_replies(frame(0x11, f"{id} 33 09 00 00 00 00"))[1].any()
    assert damiao().decode_register_replies(frame(0x11, "15 00 33 09 00 00 00 00"))[1].all()


@given(noise((*IDS, *MASTERS)))
@examples(30)
def test_nothing_is_both_feedback_and_a_register(frames: Frames) -> None:
    motor = damiao()
    assert not (motor.feedback(frames)[1] & motor.decode_register_replies(frames)[1]).any()


def test_everything_of_ours_that_can_do_something_is_known() -> None:
    motor = damiao()
    zero = np.zeros(3)
    assert list(motor.commanded_rows(motor.command(zero, zero, zero, zero, zero))) == [0, 1, 2]
    for row in range(3):
        for what in (
            ValuelessCommand.ENABLE,
            ValuelessCommand.DISABLE,
            ValuelessCommand.ZERO,
            ValuelessCommand.CLEAR,
        ):
            assert list(motor.commanded_rows(motor.encode_valueless_command(row, what))) == [row]
        for parameter in PARAMETERS.values():
            assert list(motor.commanded_rows(motor.read(row, parameter))) == [-1]
            if parameter.writable:
                assert list(motor.commanded_rows(motor.write(row, parameter, bytes(4)))) == [row]
    assert (motor.commanded_rows(motor.make_position_request()) == -1).all()
    stored = frame(0x7FF, "15 00 AA 01 00 00 00 00")
    others = np.concatenate([frame(base + 2, bytes(8)) for base in (0x100, 0x200, 0x300)])
    assert list(motor.commanded_rows(np.concatenate([stored, others]))) == [2, 1, 1, 1]
    foreign = np.concatenate([frame(3, bytes(8)), frame(0x7FF, "03 00 55 09 00 00 00 00")])
    assert (motor.commanded_rows(foreign) == -1).all()


def test_the_position_of_a_command_is_read_back() -> None:
    motor = damiao()
    zero = np.zeros(3)
    wanted = column(-12.5, 0.3, 12.5)
    made = motor.command(wanted, zero, zero, zero, zero)
    assert motor.decode_commanded_position(made) == pytest.approx(wanted, abs=25 / 65535)
    assert np.isnan(
        motor.decode_commanded_position(motor.encode_valueless_command(0, ValuelessCommand.ENABLE))
    ).all()
    assert np.isnan(motor.decode_commanded_position(motor.make_position_request())).all()
    assert np.isnan(
        motor.decode_commanded_position(frame(0x101, bytes(8)))
    ).all()  # another mode: no MIT fields


def test_ranges_that_were_read_replace_those_that_were_given() -> None:
    motor = damiao()
    motor.learn(1, {"position_range": 3.0, "velocity_range": 8.0, "torque_range": 28.0, "timeout": 0.0})
    feedback, _ = motor.feedback(
        np.concatenate([reply(0x12, 1, 2, "FF FF FF FF FF"), reply(0x11, 1, 1, "FF FF FF FF FF")])
    )
    assert feedback.position == pytest.approx([3.0, 12.5])
    assert feedback.velocity == pytest.approx([8.0, 30.0])
    assert feedback.effort == pytest.approx([28.0, 10.0])
    assert list(motor.ranges.position) == [12.5, 3.0, 12.5]
    zero = np.zeros(3)
    with pytest.raises(WireRangeError) as clamp:
        motor.command(column(0, 3.1, 0), zero, zero, zero, zero)
    assert (clamp.value.id, clamp.value.value) == (2, 3.1)
    assert (clamp.value.lower, clamp.value.upper) == (-3.0, 3.0)


@pytest.mark.parametrize("reported_range", [0.0, -12.5, float("nan"), float("inf")])
def test_a_range_that_is_none_is_refused_and_changes_nothing(reported_range: float) -> None:
    motor = damiao()
    with pytest.raises(ValueError, match="position"):
        motor.learn(1, {"position_range": reported_range})
    assert list(motor.ranges.position) == [12.5, 12.5, 12.5]


def test_the_mode_is_register_10() -> None:
    motor = damiao()
    assert [motor.operating_mode({"mode": float(mode)}) for mode in (1, 2, 3, 4)] == [1, 2, 3, 4]
    assert motor.operating_mode({}) == 0


def test_replies_among_foreign_frames_are_found() -> None:
    received = np.concatenate([reply(0x13, 1, 3), reply(0x12, 0xF, 0xF), reply(0x12, 0xA, 2)])
    feedback, told = damiao().feedback(received)
    assert told.tolist() == [False, False, True]
    assert (feedback.rows.tolist(), feedback.fault.tolist()) == ([1], [bits.ELECTRICAL])


def test_an_unnamed_status_of_any_id_is_unknown() -> None:
    motor = DamiaoCodec("can0", (0xF,), ranges(1), (0x20,))
    feedback, _ = motor.feedback(reply(0x20, 0xF, 0xF))
    assert (feedback.enabled[0], feedback.fault[0]) == (-1, bits.UNKNOWN)


def test_one_frame_answers_a_question_and_these_frames_are_those_of_the_actuators() -> None:
    assert damiao().answers == 1
    modes = {base + id for base in (0, 0x100, 0x200, 0x300) for id in IDS}
    assert damiao().claims == modes | {0x11, 0x12, 0x7FF}


def test_a_bus_without_damiao_actuators_has_no_frames_of_theirs() -> None:
    empty = DamiaoCodec("can0", (), ranges(0), ())
    assert empty.claims == set()
    for some in (frame(0, bytes(8)), frame(0x7FF, "00 00 55 09 00 00 00 00"), frame(1, bytes(8))):
        assert list(empty.commanded_rows(some)) == [-1]
        assert np.isnan(empty.decode_commanded_position(some)).all()
        assert not empty.feedback(some)[1].any()
        assert not empty.decode_register_replies(some)[1].any()


def test_actuators_with_a_master_id_each_are_distinguished_by_it() -> None:
    """Their own ids have every low nibble that there is."""
    ids = (0xF, 0x10, 0x2F)
    motor = DamiaoCodec("can0", ids, ranges(3), (0, 0x7FD, 0x7FE))
    received = np.concatenate([reply(0, 1, 0xF), reply(0x7FD, 1, 0), reply(0x7FE, 1, 0xF)])
    assert list(motor.feedback(received)[0].rows) == [0, 1, 2]
    others = np.concatenate([reply(0x7FE | EXTENDED, 1, 0xF), reply(0x7FF, 1, 0xF), reply(1, 1, 0xF)])
    assert not motor.feedback(others)[1].any()


def test_an_order_to_an_id_beyond_ff_is_to_none_of_these() -> None:
    assert list(damiao().commanded_rows(frame(0x7FF, "01 01 55 09 00 00 00 00"))) == [-1]


def test_indistinguishable_actuators_are_refused() -> None:
    for ids, masters, why in (
        ((1, 1), (0x11, 0x12), "twice"),
        ((0, 2), (0x11, 0x12), "outside"),
        ((1, 0x100), (0x11, 0x12), "outside"),
        ((1, 0x11), (0x20, 0x20), "appear alike"),
        ((1, 2), (0x11, 1), "no id of its own"),
        ((1, 2), (0x11, 0x7FF), "no id of its own"),
        ((1, 2), (0x11,), "1 master ids for 2"),
        ((1, 2), (0x11, -1), "no id of its own"),
    ):
        with pytest.raises(ValueError, match=why):
            DamiaoCodec("can0", ids, ranges(2), masters)


@given(st.floats(-1e6, 1e6, width=32))
@examples(40)
def test_a_float_register_comes_back_as_its_four_bytes(value: float) -> None:
    made = frame(0x12, b"\x02\x00\x33\x15" + struct.pack("<f", value))
    (answer,), _ = damiao().decode_register_replies(made)
    parameter: FamilyRegister = PARAMETERS["position_range"]
    assert answer.address == parameter.address
    assert struct.unpack(parameter.kind.value, answer.data)[0] == value


@pytest.mark.parametrize(
    ("data", "traffic"),
    [
        ("02 0F 33 51 00 00 00 00", True),  # the last id and the last register that there are
        ("02 10 33 51 00 00 00 00", False),
        ("02 0F 33 52 00 00 00 00", False),
        ("02 0F 34 51 00 00 00 00", False),
    ],
)
def test_register_replies_and_feedback_are_separated_at_the_documented_values(
    data: str, traffic: bool
) -> None:
    assert damiao().feedback(frame(0x12, data))[1].all() != traffic


@given(st.sets(st.integers(1, 0x1F), min_size=1, max_size=8))
@examples(50)
def test_actuators_with_a_master_id_each_never_appear_alike(ids: set[int]) -> None:
    own = sorted(ids)
    motors = DamiaoCodec("can0", own, ranges(len(own)), [0x100 + id for id in own])
    heard = [motors.feedback(frame(0x100 + id, bytes((id & 0xF,)) + bytes(7)))[1].any() for id in own]
    assert all(heard)


def test_actuators_whose_low_bits_differ_by_8_do_not_appear_alike() -> None:
    DamiaoCodec("can0", (1, 9), ranges(2), (0x11, 0x19))
