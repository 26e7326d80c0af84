"""Timeline of recorded servos: registers of their own, values changed without a write, silence."""

from collections.abc import Sequence

import pytest

from twind.exceptions import OperationFailed
from twind.flight import EntryKind, FlightContents, FlightEntry
from twind.observe.replaying.device_state_tracker import (
    CHANGED,
    DAMAGED,
    HEARD,
    READ,
    SILENT,
    BusTimeline,
    story,
)
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.control_tables import number_of

ID = 5
MODEL = number_of("XM430-W350")
TORQUE = 64
FAULT = 70
DOG = 98
POSITION = 132


def asked(time: float, address: int, data: bytes, *, error: int = 0) -> list[FlightEntry]:
    """A read that is answered."""
    return [
        FlightEntry(time, EntryKind.OUT, 0, packet.read(ID, address, len(data))),
        FlightEntry(time + 0.001, EntryKind.IN, 0, packet.status(ID, error, data)),
    ]


def silent(time: float) -> list[FlightEntry]:
    return [FlightEntry(time, EntryKind.OUT, 0, packet.read(ID, POSITION, 4))]


def wrote(time: float, address: int, data: bytes) -> list[FlightEntry]:
    return [
        FlightEntry(time, EntryKind.OUT, 0, packet.write(ID, address, data)),
        FlightEntry(time + 0.001, EntryKind.IN, 0, packet.status(ID, 0)),
    ]


WHO = asked(0.0, 0, MODEL.to_bytes(2, "little") + bytes(4) + b"\x2f")


def timeline(*parts: Sequence[FlightEntry], kept: Sequence[FlightEntry] = ()) -> BusTimeline:
    return story("main", 0, FlightContents({0: tuple(kept)}, tuple(each for part in parts for each in part)))


def happened(made: BusTimeline, what: int, address: int | None = None) -> list[tuple[float, bytes]]:
    turns = [each for each in made.turns() if each.what == what]
    return [(each.time, each.data) for each in turns if address in (None, each.address)]


def test_torque_that_its_host_switched_is_no_doing_of_the_servo() -> None:
    made = timeline(WHO, asked(1.0, TORQUE, b"\0"), wrote(1.5, TORQUE, b"\1"), asked(2.0, TORQUE, b"\1"))
    assert happened(made, CHANGED, TORQUE)[1:] == [], "but for how it was at the beginning"


def test_torque_that_went_by_itself_went_between_the_two_looks() -> None:
    made = timeline(WHO, wrote(1.5, TORQUE, b"\1"), asked(2.0, TORQUE, b"\1"), asked(2.1, TORQUE, b"\0"))
    assert happened(made, CHANGED, TORQUE) == [(pytest.approx(2.05), b"\0")]


def test_a_value_first_read_later_applies_from_the_beginning() -> None:
    made = timeline(WHO, asked(1.0, DOG, b"\5"))
    ((time, value),) = happened(made, CHANGED, DOG)
    assert time < 0.0 and value == b"\5"


def test_between_an_old_identification_and_the_recording_anything_may_have_been_written() -> None:
    made = timeline(asked(100.0, TORQUE, b"\1"), kept=[*WHO, *asked(0.5, TORQUE, b"\0")])
    times = [time for time, value in happened(made, CHANGED, TORQUE) if value == b"\1"]
    assert times == [pytest.approx(100.0, abs=0.01)], "not half-way between the two"


def test_a_servo_is_silent_from_the_first_question_that_it_leaves_open() -> None:
    made = timeline(
        WHO, asked(1.0, POSITION, b"abcd"), silent(1.01), silent(1.02), asked(1.03, POSITION, b"efgh")
    )
    assert [time for time, _ in happened(made, SILENT)] == [1.01]
    once = timeline(WHO, asked(1.0, POSITION, b"abcd"), silent(1.01), asked(1.02, POSITION, b"efgh"))
    assert happened(once, SILENT) == [], "one answer that was lost is no silence"
    assert [time for time, _ in happened(made, HEARD)] == [0.0, 1.03]
    assert [data for _, data in happened(made, READ, POSITION)] == [b"abcd", b"efgh"]


def test_a_hardware_error_holds_since_the_first_alert() -> None:
    alert = asked(1.2, POSITION, b"efgh", error=packet.ALERT)
    made = timeline(
        WHO, asked(1.0, POSITION, b"abcd"), alert, asked(1.23, FAULT, b"\x20", error=packet.ALERT)
    )
    assert happened(made, DAMAGED) == [(1.2, b"\x20")]
    again = timeline(WHO, alert, *[asked(2.0 + k, FAULT, b"\x20", error=packet.ALERT) for k in range(3)])
    assert len(happened(again, DAMAGED)) == 1


def test_a_port_is_gone_between_its_loss_and_shortly_before_it_was_opened() -> None:
    lost = FlightEntry(2.0, EntryKind.PORT, 0, b"lost: gone")
    opened = FlightEntry(3.0, EntryKind.PORT, 0, b"opened /dev/ttyX")
    made = timeline(WHO, asked(1.99, POSITION, b"abcd"), [lost], [opened], asked(3.1, POSITION, b"abcd"))
    assert made.plugged(1.995) and not made.plugged(2.0) and not made.plugged(2.9) and made.plugged(2.98)


def test_a_port_that_took_something_not_was_there() -> None:
    refused = FlightEntry(2.0, EntryKind.PORT, 0, b"refused 30 bytes: /dev/ttyX: 90 bytes wait")
    lost = FlightEntry(1.0, EntryKind.PORT, 0, b"lost: gone")
    assert timeline(WHO, asked(0.99, POSITION, b"abcd"), [refused]).plugs == ()
    assert not timeline(WHO, asked(0.99, POSITION, b"abcd"), [lost], [refused]).plugged(2.5)


def test_a_model_that_no_table_has_cannot_be_played() -> None:
    strange = asked(0.0, 0, b"\xfe\xfe" + bytes(4) + b"\1")
    with pytest.raises(OperationFailed, match="model number 65278"):
        timeline(strange).turns()
