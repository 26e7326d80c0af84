"""ODrive over CANSimple: golden frames, both heartbeats, gains that make a spring, every command number."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.can_codec_frames import column, frame, ranges, wire
from tests.support.examples import examples
from twind_drivers.bus import WireRangeError
from twind_drivers.can import actuator_family as bits
from twind_drivers.can.actuator_family import FamilyRegister, ValuelessCommand
from twind_drivers.can.odrive_codec import PARAMETERS, ODriveCodec
from twind_drivers.ports.frame import ERROR, EXTENDED, REMOTE, Frames

IDS = (3, 0x3F)
TURN = 2.0 * math.pi


def axes(torque: float = 40.0, velocity: float = 300.0) -> ODriveCodec:
    """The first is an ODrive 3.x, the second a later board."""
    return ODriveCodec("can0", IDS, ranges(2, 600.0, velocity, torque), [False, True])


def command(position: float, velocity: float = 0.0, torque: float = 0.0) -> Frames:
    zero = np.zeros(2)
    return axes().command(column(position, 0), column(velocity, 0), zero, zero, column(torque, 0))


def beat(node: int, errors: int = 0, state: int = 8, flags: tuple[int, int, int] = (0, 0, 0)) -> Frames:
    return frame(node << 5 | 1, struct.pack("<IBBBB", errors, state, *flags))


def test_the_command_has_the_bytes_of_the_csv() -> None:
    assert wire(command(1.5 * TURN, 0.25 * TURN, -0.1)) == [
        (0x06C, "00 00 C0 3F FA 00 9C FF"),
        (0x7EC, "00 00 00 00 00 00 00 00"),
    ]


@pytest.mark.parametrize(
    ("what", "id", "data"),
    [
        (ValuelessCommand.ENABLE, 0x067, "08 00 00 00"),
        (ValuelessCommand.DISABLE, 0x067, "01 00 00 00"),
        (ValuelessCommand.CLEAR, 0x078, "00 00 00 00 00 00 00 00"),
        (ValuelessCommand.ZERO, 0x079, "00 00 00 00"),
        (ValuelessCommand.REBOOT, 0x076, "00 00 00 00 00 00 00 00"),
    ],
)
def test_special_frames(what: ValuelessCommand, id: int, data: str) -> None:
    assert wire(axes().encode_valueless_command(0, what)) == [(id, data)]


def test_the_question_is_a_remote_frame_for_the_estimates() -> None:
    asked = axes().make_position_request()
    assert wire(asked) == [(0x069 | REMOTE & 0x1FFF_FFFF, ""), (0x7E9, "")]
    assert (asked["id"] & REMOTE == REMOTE).all()


def test_the_gains_make_a_damped_spring() -> None:
    kp = column(50.0, 20.0)
    kd = column(2.0, 0.5)
    made = wire(axes().gains(kp, kd))
    assert made[:2] == [(0x06B, "03 00 00 00 01 00 00 00"), (0x7EB, "03 00 00 00 01 00 00 00")]
    assert [id for id, _ in made] == [0x06B, 0x7EB, 0x07A, 0x7FA, 0x07B, 0x7FB]
    for row in range(2):
        (outer,) = struct.unpack("<f", bytes.fromhex(made[2 + row][1]))
        inner, integrator = struct.unpack("<ff", bytes.fromhex(made[4 + row][1]))
        # One radian off is 1/TURN rev: rev/s by the outer gain, N·m by the inner one.
        assert inner * outer / TURN == pytest.approx(float(kp[row]), rel=1e-6)
        assert inner / TURN == pytest.approx(float(kd[row]), rel=1e-6)
        assert integrator == 0.0


@pytest.mark.parametrize("kd", [0.0, -1.0, math.nan, 6.0])
def test_a_spring_without_damping_cannot_be_set(kd: float) -> None:
    with pytest.raises(WireRangeError, match="id 63: kd"):
        axes().gains(column(1, 1), column(1, kd))


def test_a_value_beyond_its_field_is_refused() -> None:
    most = 32.767
    for velocity, torque, what in (
        (most * TURN * 1.001, 0.0, "velocity"),
        (0.0, most * 1.001, "torque"),
        (0.0, -most * 1.001, "torque"),
    ):
        with pytest.raises(WireRangeError, match=f"id 3: {what}"):
            command(0.0, velocity, torque)
    for position in (600.1, -600.1, math.nan, math.inf):
        with pytest.raises(WireRangeError, match="id 3: position"):
            command(position)
    assert wire(command(600.0, most * TURN, -most))[0][1].endswith("FF 7F 01 80")
    zero = np.zeros(2)
    with pytest.raises(WireRangeError, match=r"torque 5.1 outside -5.0..5.0"):  # narrower than the field
        axes(torque=5.0).command(zero, zero, zero, zero, column(5.1, 0))
    with pytest.raises(WireRangeError, match="kp"):  # looked at, though not sent
        axes().command(zero, zero, column(math.nan, 0), zero, zero)
    with pytest.raises(ValueError):
        axes().command(np.zeros(1), zero, zero, zero, zero)
    with pytest.raises(ValueError, match=r"\(5, 1\) values for \(5, 2\)"):
        axes().command(*[np.zeros(1)] * 5)


@given(st.floats(-600.0, 600.0), st.floats(-200.0, 200.0), st.floats(-32.0, 32.0))
@examples(50)
def test_a_command_is_within_half_a_thousandth(position: float, velocity: float, torque: float) -> None:
    data = bytes.fromhex(wire(command(position, velocity, torque))[0][1])
    turns, fed, pulled = struct.unpack("<fhh", data)
    assert turns == pytest.approx(position / TURN, rel=1e-6, abs=1e-30)
    assert abs(fed / 1000.0 - velocity / TURN) <= 0.0005 + 1e-9
    assert abs(pulled / 1000.0 - torque) <= 0.0005 + 1e-9


def test_estimates_are_place_and_speed() -> None:
    feedback, told = axes().feedback(frame(0x7E9, struct.pack("<ff", -0.5, 2.0)))
    assert told.all()
    assert (feedback.rows[0], feedback.enabled[0], feedback.fault[0]) == (1, -1, -1)
    assert feedback.position[0] == pytest.approx(-math.pi)
    assert feedback.velocity[0] == pytest.approx(2.0 * TURN)
    assert np.isnan([feedback.effort[0], feedback.temperature[0], feedback.voltage[0]]).all()


@pytest.mark.parametrize("raw", ["00 00 C0 7F", "01 00 80 7F", "00 00 80 FF", "FF FF 7F 7F"])
def test_a_float_that_is_no_reading_gives_nan(raw: str) -> None:
    feedback, _ = axes().feedback(frame(0x069, bytes.fromhex(raw + "00 00 80 3F")))
    assert math.isnan(feedback.position[0])
    assert feedback.velocity[0] == pytest.approx(TURN)


def test_a_float_of_a_million_is_a_reading_and_none_beyond() -> None:
    for value, read in ((1e6, True), (-1e6, True), (1.0001e6, False), (-1.0001e6, False), (0.95e6, True)):
        feedback, _ = axes().feedback(frame(0x069, struct.pack("<ff", value, 0.0)))
        assert math.isnan(feedback.position[0]) is not read


def test_estimates_heartbeats_and_supplies_among_foreign_frames_are_found() -> None:
    received = np.concatenate(
        [
            frame(5 << 5 | 0x17, struct.pack("<ff", 9.0, 9.0)),
            frame(0x077, struct.pack("<ff", 24.5, 1.25)),
            beat(0x3F, state=1),
            frame(0x069, struct.pack("<ff", 0.5, 0.0)),
            frame(3 << 5 | 31, bytes(8)),
        ]
    )
    feedback, found = axes().feedback(received)
    assert found.tolist() == [False, True, True, True, False]
    assert feedback.rows.tolist() == [0, 1, 0]
    assert feedback.voltage.tolist() == pytest.approx([24.5, np.nan, np.nan], nan_ok=True)
    assert feedback.position.tolist() == pytest.approx([np.nan, np.nan, math.pi], nan_ok=True)
    assert feedback.enabled.tolist() == [-1, 0, -1]
    answers, found = axes().decode_register_replies(received)
    assert found.tolist() == [False, True, False, False, False]
    assert [(each.row, each.address) for each in answers] == [(0, 0x17), (0, 0x117)]


def test_all_commands_of_its_nodes_are_those_of_an_axis() -> None:
    assert axes().claims == {*range(0x60, 0x80), *range(0x7E0, 0x800)}
    assert axes().answers == 1
    assert ODriveCodec("can0", (2,), ranges(1), [True]).claims == {*range(0x40, 0x60)}


def test_the_ranges_are_those_that_were_given() -> None:
    given = ranges(2)
    assert ODriveCodec("can0", IDS, given, [False, True]).ranges is given


@pytest.mark.parametrize(("ids", "fine"), [((0, 0x3F), True), ((-1, 2), False), ((1, 0x40), False)])
def test_nodes_are_0_to_63(ids: tuple[int, int], fine: bool) -> None:
    if fine:
        both = np.concatenate([frame(0x00C, bytes(8)), frame(0x7EC, bytes(8))])
        made = ODriveCodec("can0", ids, ranges(2), [False, False])
        assert list(made.commanded_rows(both)) == [0, 1]
        return
    with pytest.raises(ValueError, match="outside"):
        ODriveCodec("can0", ids, ranges(2), [False, False])


@pytest.mark.parametrize(("velocity", "most"), [(30.0, 30.0), (300.0, 32.767 * TURN)])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_speed_is_within_its_range_and_what_the_field_holds(
    velocity: float, most: float, side: float
) -> None:
    zero = np.zeros(2)
    axis = axes(velocity=velocity)
    axis.command(zero, column(0.0, side * most), zero, zero, zero)
    with pytest.raises(WireRangeError) as refused:
        axis.command(zero, column(0.0, side * most * 1.001), zero, zero, zero)
    assert (refused.value.lower, refused.value.upper) == pytest.approx((-most, most))


@pytest.mark.parametrize("node", IDS)
def test_every_state_but_idle_has_torque(node: int) -> None:
    for state in range(256):
        feedback, told = axes().feedback(beat(node, state=state))
        assert told.all()
        assert feedback.enabled[0] == {0: -1, 1: 0}.get(state, 1)
        assert feedback.fault[0] == 0
        assert math.isnan(feedback.position[0])


FIRST = {1: bits.VOLTAGE, 2: bits.VOLTAGE, 3: bits.ELECTRICAL, 4: bits.ELECTRICAL, 5: bits.ELECTRICAL}
FIRST |= {6: bits.ELECTRICAL, 8: bits.ENCODER, 11: bits.SILENCE, 18: bits.HEAT, 19: bits.UNCALIBRATED}
LATER = {3: bits.ENCODER, 5: bits.ELECTRICAL, 8: bits.VOLTAGE, 9: bits.VOLTAGE, 10: bits.ELECTRICAL}
LATER |= {11: bits.ELECTRICAL, 12: bits.OVERLOAD, 13: bits.HEAT, 14: bits.HEAT, 24: bits.SILENCE}
LATER |= {26: bits.ENCODER, 27: bits.ELECTRICAL, 28: bits.HEAT, 30: bits.UNCALIBRATED}


def test_every_error_bit_is_a_fault_of_its_board() -> None:
    for bit in range(32):
        for node, named in ((3, FIRST), (0x3F, LATER)):
            feedback, _ = axes().feedback(beat(node, errors=1 << bit))
            assert feedback.fault[0] == named.get(bit, bits.UNKNOWN), bit


@pytest.mark.parametrize(
    ("flags", "fault"),
    [((1, 0, 0), bits.ELECTRICAL), ((0, 1, 0), bits.ENCODER), ((0, 0, 1), bits.UNKNOWN), ((0, 0, 0x80), 0)],
)
def test_the_flags_of_a_heartbeat_are_faults_on_the_first_boards_alone(
    flags: tuple[int, int, int], fault: int
) -> None:
    assert axes().feedback(beat(3, flags=flags))[0].fault[0] == fault
    assert axes().feedback(beat(0x3F, flags=flags))[0].fault[0] == 0


def test_the_supply_is_feedback_and_two_parameters() -> None:
    made = frame(0x077, struct.pack("<ff", 24.5, 1.25))
    feedback, told = axes().feedback(made)
    assert told.all()
    assert feedback.voltage[0] == 24.5
    answers, found = axes().decode_register_replies(made)
    assert found.all()
    assert [each[:3] for each in answers] == [
        (0, 0x17, struct.pack("<f", 24.5)),
        (0, 0x117, struct.pack("<f", 1.25)),
    ]


@pytest.mark.parametrize("name", sorted(PARAMETERS))
def test_a_parameter_is_asked_for_and_found_in_the_answer(name: str) -> None:
    parameter = PARAMETERS[name]
    asked = axes().read(0, parameter)
    assert int(asked["id"][0]) & REMOTE
    answers, _ = axes().decode_register_replies(
        frame(int(asked["id"][0]) & ~REMOTE, "01 02 03 04 05 06 07 08")
    )
    assert [answer.data for answer in answers if answer.address == parameter.address] == [
        bytes([5, 6, 7, 8] if parameter.address > 0xFF else [1, 2, 3, 4])
    ]


@pytest.mark.parametrize("name", ["motor_error", "encoder_error", "controller_error"])
def test_a_later_board_is_not_asked_for_unknown_parameters(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        axes().read(1, PARAMETERS[name])


def test_a_later_board_is_asked_for_its_supply() -> None:
    assert axes().read(1, PARAMETERS["bus_voltage"])["id"] == 0x7F7 | REMOTE


def test_nothing_can_be_written_and_no_watchdog_read() -> None:
    with pytest.raises(ValueError, match="bus_voltage"):
        axes().write(0, PARAMETERS["bus_voltage"], bytes(4))
    watchdog: FamilyRegister | None = axes().watchdog
    assert watchdog is None
    assert axes().operating_mode({}) == 1
    assert not axes().replies.any()


@pytest.mark.parametrize(
    "stranger",
    [
        frame(0x089, bytes(8)),  # node 4
        frame(0x069 | EXTENDED, bytes(8)),
        frame(0x069 | ERROR, bytes(8)),
        frame(0x069 | REMOTE, b"", 8),  # the question itself
        frame(0x069, bytes(7)),
        frame(0x06C, bytes(8)),  # a command
    ],
    ids=range(6),
)
def test_foreign_frames_are_ignored(stranger: Frames) -> None:
    assert not axes().feedback(stranger)[1].any()
    assert not axes().decode_register_replies(stranger)[1].any()


def test_everything_of_ours_that_can_do_something_is_known() -> None:
    axis = axes()
    zero = np.zeros(2)
    made = axis.command(column(1.0, -599.0), zero, zero, zero, zero)
    assert list(axis.commanded_rows(made)) == [0, 1]
    assert axis.decode_commanded_position(made) == pytest.approx([1.0, -599.0], rel=1e-6)
    assert np.isnan(axis.decode_commanded_position(frame(0x08C, bytes(8)))).all()  # node 4
    assert list(axis.commanded_rows(axis.gains(column(1, 1), column(1, 1)))) == [0, 1] * 3
    for row in range(2):
        for what in ValuelessCommand:
            order = axis.encode_valueless_command(row, what)
            assert list(axis.commanded_rows(order)) == [row]
            assert np.isnan(axis.decode_commanded_position(order)).all()
    for parameter in PARAMETERS.values():
        assert list(axis.commanded_rows(axis.read(0, parameter))) == [-1]
    assert (axis.commanded_rows(axis.make_position_request()) == -1).all()
    assert (axis.commanded_rows(beat(3)) == -1).all()


def test_every_command_number_counts_as_a_command_unless_it_only_reports() -> None:
    telling = {0x01, 0x03, 0x05, 0x09, 0x0A, 0x14, 0x15, 0x17, 0x1C, 0x1D}
    for number in range(32):
        remote, data = (
            axes().commanded_rows(made)[0]
            for made in (frame(3 << 5 | number | REMOTE), frame(3 << 5 | number, bytes(8)))
        )
        assert (remote == -1) == (data == -1) == (number in telling or number == 0x04)
    for size in (1, 8):  # writes an endpoint on later boards
        assert axes().commanded_rows(frame(0x3F << 5 | 4, bytes(size)))[0] == 1
    assert axes().commanded_rows(frame(0x3F << 5 | 4 | REMOTE))[0] == -1
