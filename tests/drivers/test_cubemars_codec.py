"""CubeMars AK: golden frames, replies of 6 and 8 bytes, every error code, and what it cannot do."""

import numpy as np
import pytest

from tests.support.can_codec_frames import column, frame, ranges, wire
from twind_drivers.can import actuator_family as bits
from twind_drivers.can.actuator_family import FamilyRegister, RegisterType, ValuelessCommand
from twind_drivers.can.cubemars_codec import CubeMarsCodec
from twind_drivers.ports.frame import ERROR, EXTENDED, REMOTE, Frames

IDS = (1, 0x68)
MIDDLE = "7F FF 7F F7 FF"


def drive() -> CubeMarsCodec:
    return CubeMarsCodec("can0", IDS, ranges(2))


def test_the_command_has_the_bytes_of_the_manual() -> None:
    made = drive().command(column(0, 1), column(0, 0), column(0, 50), column(0, 1), column(0, 0))
    assert wire(made) == [(1, "7F FF 7F F0 00 00 07 FF"), (0x68, "8A 3C 7F F1 99 33 37 FF")]


@pytest.mark.parametrize(("what", "last"), [("ENABLE", "FC"), ("DISABLE", "FD"), ("ZERO", "FE")])
def test_special_frames(what: str, last: str) -> None:
    assert wire(drive().encode_valueless_command(1, ValuelessCommand[what])) == [
        (0x68, "FF FF FF FF FF FF FF " + last)
    ]


def test_a_cubemars_has_no_registers_and_no_requests() -> None:
    register = FamilyRegister("any", 1, RegisterType.U32, writable=True)
    for order in (lambda: drive().read(0, register), lambda: drive().write(0, register, bytes(4))):
        with pytest.raises(ValueError, match="no registers"):
            order()
    assert len(drive().make_position_request()) == 0
    assert drive().answers == 0
    assert drive().watchdog is None
    assert drive().replies.all()
    assert drive().operating_mode({}) == 1


@pytest.mark.parametrize("id", [0, 0x68])
def test_a_reply_is_read_on_its_own_id_and_on_0(id: int) -> None:
    feedback, told = drive().feedback(frame(id, "68 FF FF 00 0F FF 2A 00"))
    assert told.all()
    assert list(feedback.rows) == [1]
    assert (feedback.position[0], feedback.velocity[0], feedback.effort[0]) == pytest.approx(
        (12.5, -30.0, 10.0)
    )
    assert (feedback.temperature[0], feedback.fault[0], feedback.enabled[0]) == (42.0, 0, -1)
    assert np.isnan(feedback.voltage[0])


def test_a_short_reply_leaves_temperature_and_fault_unknown() -> None:
    feedback, told = drive().feedback(frame(0, f"01 {MIDDLE}"))
    assert told.all()
    assert np.isnan(feedback.temperature[0])
    assert feedback.fault[0] == -1


def test_replies_among_foreign_frames_are_found() -> None:
    received = np.concatenate(
        [frame(0, f"02 {MIDDLE} 1E 00"), frame(0, f"68 {MIDDLE} 21 01"), frame(1, f"01 {MIDDLE}")]
    )
    feedback, told = drive().feedback(received)
    assert told.tolist() == [False, True, True]
    assert list(feedback.rows) == [1, 0]
    assert feedback.temperature.tolist() == pytest.approx([33.0, np.nan], nan_ok=True)


def test_frames_on_its_ids_and_on_0_are_those_of_a_drive() -> None:
    assert drive().claims == {0, 1, 0x68}
    assert CubeMarsCodec("can0", (), ranges(0)).claims == set()


def test_no_frame_is_an_answer_of_a_register() -> None:
    answers, found = drive().decode_register_replies(np.concatenate([frame(0, f"01 {MIDDLE}")] * 2))
    assert answers == [] and found.tolist() == [False, False]


@pytest.mark.parametrize("what", [ValuelessCommand.REBOOT, ValuelessCommand.CLEAR])
def test_an_order_that_a_cubemars_has_not_is_refused(what: ValuelessCommand) -> None:
    with pytest.raises(ValueError, match=f"can0: id 104: a CubeMars AK has no {what.name.lower()}"):
        drive().encode_valueless_command(1, what)


@pytest.mark.parametrize(("ids", "fine"), [((1, 0xFF), True), ((0, 2), False), ((1, 0x100), False)])
def test_ids_of_drives_are_1_to_255(ids: tuple[int, int], fine: bool) -> None:
    if fine:
        last = CubeMarsCodec("can0", ids, ranges(2))
        assert list(last.commanded_rows(frame(0xFF, bytes(8)))) == [1]
        return
    with pytest.raises(ValueError, match="outside"):
        CubeMarsCodec("can0", ids, ranges(2))


def test_a_command_to_no_drive_has_no_position() -> None:
    both = np.concatenate([frame(2, bytes(8)), frame(1, bytes(8))])
    assert drive().decode_commanded_position(both).tolist() == pytest.approx([np.nan, -12.5], nan_ok=True)


def test_long_and_short_replies_go_together() -> None:
    both = np.concatenate([frame(0, f"01 {MIDDLE}"), frame(0, f"68 {MIDDLE} 21 01")])
    feedback, _ = drive().feedback(both)
    assert list(feedback.rows) == [0, 1]
    assert list(feedback.fault) == [-1, bits.HEAT]
    assert feedback.temperature[1] == 33.0


FAULTS = {
    0: 0,
    1: bits.HEAT,
    2: bits.ELECTRICAL,
    3: bits.VOLTAGE,
    4: bits.VOLTAGE,
    5: bits.ENCODER,
    6: bits.HEAT,
}
FAULTS |= {7: bits.OVERLOAD}


def test_every_error_code_is_a_fault_but_0() -> None:
    for code in range(256):
        feedback, _ = drive().feedback(frame(0, bytes.fromhex(f"01 {MIDDLE}") + bytes([30, code])))
        assert feedback.fault[0] == FAULTS.get(code, bits.UNKNOWN)


def test_cold_is_not_taken_for_heat_nor_heat_for_cold() -> None:
    told = {0: 0.0, 127: 127.0, 128: 128.0, 215: 215.0, 216: -40.0, 236: -20.0, 255: -1.0}
    for octet, celsius in told.items():
        feedback, _ = drive().feedback(frame(0, bytes.fromhex(f"01 {MIDDLE}") + bytes([octet, 0])))
        assert feedback.temperature[0] == celsius


@pytest.mark.parametrize(
    "stranger",
    [
        frame(0, f"02 {MIDDLE} 1E 00"),
        frame(1, f"68 {MIDDLE} 1E 00"),  # ours both, but not of one drive
        frame(0x68 | EXTENDED, f"68 {MIDDLE} 1E 00"),
        frame(0 | ERROR, f"68 {MIDDLE} 1E 00"),
        frame(0x68 | REMOTE, b"", 8),
        frame(0, f"68 {MIDDLE} 1E"),
        frame(0, "68 7F FF"),
    ],
    ids=range(7),
)
def test_foreign_frames_are_ignored(stranger: Frames) -> None:
    assert not drive().feedback(stranger)[1].any()


def test_everything_of_ours_that_can_do_something_is_known() -> None:
    motors = drive()
    zero = np.zeros(2)
    made = motors.command(column(3.0, -3.0), zero, zero, zero, zero)
    assert list(motors.commanded_rows(made)) == [0, 1]
    assert motors.decode_commanded_position(made) == pytest.approx([3.0, -3.0], abs=25 / 65535)
    for what in (ValuelessCommand.ENABLE, ValuelessCommand.DISABLE, ValuelessCommand.ZERO):
        assert list(motors.commanded_rows(motors.encode_valueless_command(1, what))) == [1]
        assert np.isnan(motors.decode_commanded_position(motors.encode_valueless_command(1, what))).all()
    assert list(motors.commanded_rows(frame(2, bytes(8)))) == [-1]
