"""Virtual CAN actuators, family by family: their bytes and their oddities, each with its source named."""

import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_can_host import LIMP, CanHost, mit
from twind_drivers.ports.frame import EXTENDED, REMOTE
from twind_drivers.virtual.can.bit_fields import fraction, mit_command, mit_state, pack, unpack
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.node_spec import NodeSpec

SPANS = (12.5, 30.0, 10.0)


# --------------------------------------------------------------------------------------- MIT fields


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("7F FF 7F F0 00 00 07 FF", (0.0, 0.0, 0.0, 0.0, 0.0)),
        ("8A 3C 7F F1 99 33 37 FF", (1.0, 0.0, 50.0, 1.0, 0.0)),
        ("5F D4 95 43 33 7F F5 32", (-3.14159265, 5.0, 100.0, 2.5, -3.5)),
    ],
)
def test_golden_commands_decode_to_their_documented_values(text: str, meant: tuple[float, ...]) -> None:
    """Facts 2: computed, ranges 12.5 / 30 / 10. Each is cut off by less than one step of its field."""
    found = mit_command(bytes.fromhex(text), SPANS)
    steps = (25 / 65535, 60 / 4095, 500 / 4095, 5 / 4095, 20 / 4095)
    for value, wish, step in zip(found, meant, steps, strict=True):
        assert 0.0 <= wish - value + 1e-9 < step + 1e-9


def test_zero_is_a_little_below_zero() -> None:
    """Facts 2: 7FFF and 7FF read back as -0.00019 rad, -0.0073 rad/s, -0.0024 N·m."""
    assert mit_state(0.0, 0.0, 0.0, SPANS).hex() == "7fff7ff7ff"
    assert unpack(0x7FFF, 12.5, 16) == pytest.approx(-0.00019, abs=1e-5)
    assert unpack(0x7FF, 30.0, 12) == pytest.approx(-0.0073, abs=1e-4)
    assert unpack(0x7FF, 10.0, 12) == pytest.approx(-0.0024, abs=1e-4)


@examples(50)
@example(64.40926618812955, 0.0, 12)
@example(64.40926618812955, 0.0, 16)
@given(st.floats(0.1, 200), st.floats(-1, 1), st.sampled_from([12, 16]))
def test_a_field_keeps_a_value_to_one_step_and_never_above_it(span: float, share: float, bits: int) -> None:
    value = span * share
    back = unpack(pack(value, span, bits), span, bits)
    assert -1e-9 <= value - back <= 2 * span / ((1 << bits) - 1) + 1e-9
    assert pack(10 * span, span, bits) == (1 << bits) - 1
    assert fraction((1 << bits) - 1, span, bits) == pytest.approx(span, rel=1e-12)  # the last bit may round


# --------------------------------------------------------------------------------------- Damiao


def damiao(**settings: float) -> CanHost:
    return CanHost([NodeSpec(1, "DM4310", feedback_id=0x11, settings=settings)])


def register(order: int, number: int, value: bytes = bytes(4), id: int = 1) -> tuple[int, bytes]:
    return 0x7FF, bytes([id, 0, order, number]) + value


def test_a_damiao_is_disabled_until_it_is_enabled() -> None:
    host = damiao()
    [told] = host.ask((1, bytes.fromhex("8A3C7FF1993337FF")), wait=0.2)
    assert (told.id, told.data.hex()) == (0x11, "017fff7ff7ff1919"), "status 0, id 1, 25 °C twice"
    assert host.truth()["position"] == 0.0
    [told] = host.ask((1, mit(0xFC)))
    assert told.data[0] == 0x11, "status 1"
    host.ask((1, bytes.fromhex("8A3C7FF1993337FF")), wait=0.3)
    assert host.truth()["position"] * 6.283185 / 16384 == pytest.approx(1.0, abs=0.02)
    [told] = host.ask((1, mit(0xFD)))
    assert told.data[0] == 0x01
    assert not host.truth()["torque"]


def test_a_damiao_answers_registers_on_its_master_id_and_they_look_like_feedback() -> None:
    """Facts 2.3: `[id, 00, 55, rid ...]` decodes to -12.468 rad."""
    host = damiao()
    [told] = host.ask(register(0x55, 9, (2000).to_bytes(4, "little")))
    assert (told.id, told.data.hex()) == (0x11, "01005509d0070000")
    assert unpack(told.data[1] << 8 | told.data[2], 12.5, 16) == pytest.approx(-12.468, abs=1e-3)
    [told] = host.ask(register(0x33, 9))
    assert told.data.hex() == "01003309d0070000"


@pytest.mark.parametrize(
    ("number", "held"), [(7, 0x11), (8, 1), (9, 0), (10, 1), (21, 12.5), (22, 30.0), (23, 10.0), (35, 4)]
)
def test_a_damiao_reports_its_scaling_and_settings(number: int, held: float) -> None:
    [told] = damiao().ask(register(0x33, number))
    assert struct.unpack("<f" if number in (21, 22, 23) else "<I", told.data[4:])[0] == held


def test_a_damiao_reads_its_fields_by_the_ranges_in_its_registers() -> None:
    host = CanHost([NodeSpec(1, "DM4310", 0x11, position=12.5)])
    host.ask((1, mit(0xFC)))
    host.ask(register(0x55, 21, struct.pack("<f", 6.25)))
    host.ask((1, bytes.fromhex("BFFF7FF1993337FF")), wait=0.4)
    assert host.truth()["position"] * 6.283185 / 16384 == pytest.approx(3.125, abs=0.02)


@pytest.mark.parametrize(
    "sent",
    [
        (0x7FF, bytes([2, 0, 0x33, 9, 0, 0, 0, 0])),  # of another
        (0x7FF, bytes([1, 0, 0x33, 99, 0, 0, 0, 0])),  # no such register
        (0x7FF, bytes([1, 0, 0x44, 9, 0, 0, 0, 0])),
        (0x7FF, b"\x01\x00"),
        (2, LIMP),
        (1, LIMP[:7]),
        (1 | EXTENDED, LIMP),
        (1 | REMOTE, b""),
    ],
)
def test_a_damiao_does_not_answer_foreign_or_invalid_frames(sent: tuple[int, bytes]) -> None:
    assert damiao().ask(sent) == []


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0, -5.0])
def test_a_damiao_keeps_its_range_when_a_senseless_one_is_written(value: float) -> None:
    [told] = damiao().ask(register(0x55, 21, struct.pack("<f", value)))
    assert struct.unpack("<f", told.data[4:]) == (12.5,)


def test_a_damiao_refresh_is_answered_by_feedback_and_moves_nothing() -> None:
    host = damiao()
    assert host.ask((0x7FF, bytes.fromhex("0100CC0000000000")))[0].data.hex() == "017fff7ff7ff1919"


def test_a_damiao_watchdog_is_off_as_delivered() -> None:
    """Facts 2.2: register 9 in ticks of 50 us, 0 = off."""
    host = damiao()
    host.ask((1, mit(0xFC)))
    host.wait(10.0)
    assert host.truth()["torque"]


@pytest.mark.parametrize("ticks", [200, 2000, 4321])
def test_a_damiao_trips_by_its_own_timeout_and_reports_it(ticks: int) -> None:
    host = damiao(timeout=ticks)
    host.ask((1, mit(0xFC)))
    host.wait(ticks * 50e-6 - 0.006)
    assert host.truth()["torque"]
    host.wait(0.01)
    truth = host.truth()
    assert (truth["torque"], truth["tripped"]) == (False, True)
    assert truth["trip_delay"] == pytest.approx(ticks * 50e-6, abs=1e-9)
    [told] = host.ask((1, mit(0xFC)))
    assert told.data[0] == 0xD1, "communication lost, until it is cleared"
    host.ask((1, mit(0xFB)))
    [told] = host.ask((1, mit(0xFC)))
    assert told.data[0] == 0x11


def test_any_frame_to_a_damiao_feeds_its_watchdog_and_those_to_others_do_not() -> None:
    """The harsher case of an open question: a reader keeps a dead writer's motor alive."""
    host = CanHost([NodeSpec(id, "DM4310", 0x10 + id, settings={"timeout": 2000}) for id in (1, 2)])
    host.ask((1, mit(0xFC)), (2, mit(0xFC)))
    for _ in range(20):
        host.ask(register(0x33, 9), wait=0.02)
    assert [host.truth(row)["tripped"] for row in (0, 1)] == [False, True]


def test_a_damiao_loses_unsaved_settings_at_a_reboot() -> None:
    host = damiao()
    host.ask(register(0x55, 9, (2000).to_bytes(4, "little")))
    host.faults.brown_out(1)
    host.wait(1.0)
    assert host.ask(register(0x33, 9))[0].data[4:] == bytes(4)
    host.ask(register(0x55, 9, (2000).to_bytes(4, "little")), (0x7FF, bytes.fromhex("0100AA0100000000")))
    host.faults.brown_out(1)
    host.wait(1.0)
    assert host.ask(register(0x33, 9))[0].data[4:6] == (2000).to_bytes(2, "little")


def test_a_damiao_keeps_its_zero_over_a_power_cut_and_loses_its_turns() -> None:
    host = CanHost([NodeSpec(1, "DM4310", 0x11)], start=0.5)
    host.ask((1, mit(0xFE)))
    assert host.truth()["position"] == 0.0
    host.muscles.position[0] += 6.283185307 + 0.1
    host.wait(0.01)
    assert host.truth()["position"] == pytest.approx(16384 * (1 + 0.1 / 6.283185307))
    host.faults.brown_out(1)
    host.wait(1.0)
    assert host.truth()["position"] == pytest.approx(16384 * 0.1 / 6.283185307)


def test_in_another_mode_a_damiao_takes_no_mit_commands() -> None:
    host = damiao(mode=2)
    host.ask((1, mit(0xFC)), (1, bytes.fromhex("8A3C7FF1993337FF")), wait=0.3)
    assert host.truth()["position"] == 0.0


# --------------------------------------------------------------------------------------- CubeMars


def test_a_cubemars_answers_with_its_own_id_and_reports_its_error() -> None:
    """Facts 2.1: id, place, speed, current, temperature, error."""
    host = CanHost([NodeSpec(3, "AK70-10", position=12.5, velocity=50.0, torque=25.0)])
    [told] = host.ask((3, LIMP))
    assert (told.id, told.data.hex()) == (3, "037fff7ff7ff1900")
    host.ask((3, mit(0xFC)))
    host.faults.damage(3, 2)
    assert host.ask((3, LIMP))[0].data[7] == 2
    assert not host.truth()["torque"]
    host.ask((3, mit(0xFC)))
    assert host.truth()["torque"], "entering motor mode again forgets it"


def test_a_cubemars_watchdog_is_its_own_and_cannot_be_asked() -> None:
    host = CanHost([NodeSpec(3, "AK70-10", settings={"timeout": 0.1})])
    host.ask((3, mit(0xFC)))
    host.wait(0.2)
    truth = host.truth()
    assert (truth["tripped"], truth["torque"], truth["watchdog"]) == (True, False, -1)
    assert truth["trip_delay"] == pytest.approx(0.1)


# --------------------------------------------------------------------------------------- RobStride


def robstride(**more: float) -> CanHost:
    return CanHost([NodeSpec(0x7F, "RS00", position=12.57, velocity=33.0, torque=14.0, settings=more)])


def private(text: str, data: str = "00" * 8) -> tuple[int, bytes]:
    return int(text, 16) | EXTENDED, bytes.fromhex(data)


def test_the_golden_frames_of_a_robstride() -> None:
    """Facts 3: enable, a motion command, stop; feedback has the mode in bits 22-23, the motor in 8-15."""
    host = robstride()
    assert host.ask(private("017FFF7F", "8A2E7FFF19993333"))[0].id == 0x02007FFD | EXTENDED
    assert host.truth()["position"] == 0.0
    [told] = host.ask(private("0300FD7F"))
    assert (told.id, told.data.hex()) == (0x02807FFD | EXTENDED, "7fff7fff7fff00fa")
    host.ask(private("017FFF7F", "8A2E7FFF19993333"), wait=0.5)
    assert host.truth()["position"] * 6.283185 / 16384 == pytest.approx(1.0, abs=0.01)
    [told] = host.ask(private("0400FD7F"))
    assert told.id == 0x02007FFD | EXTENDED


def test_a_robstride_reads_and_writes_parameters() -> None:
    host = robstride()
    [told] = host.ask(private("1100FD7F", "0570000000000000"))
    assert (told.id, told.data.hex()) == (0x11007FFD | EXTENDED, "0570000000000000")
    [told] = host.ask(private("1200FD7F", "28700000204E0000"))
    assert told.id == 0x02007FFD | EXTENDED, "a write is answered by feedback"
    assert host.ask(private("1100FD7F", "2870000000000000"))[0].data.hex() == "28700000204e0000"
    place = host.ask(private("1100FD7F", "1970000000000000"))[0].data
    assert struct.unpack("<f", place[4:]) == (0.0,)


def test_a_parameter_that_a_robstride_lacks_is_echoed_with_a_mark() -> None:
    [told] = robstride().ask(private("1100FD7F", "3412000000000000"))
    assert (told.id >> 16 & 0xFF, told.data.hex()) == (1, "3412000000000000")


def test_a_robstride_answers_the_host_that_asked() -> None:
    assert robstride().ask(private("0300107F"))[0].id & 0xFF == 0x10
    [told] = robstride().ask(private("0000FD7F"))
    assert (told.id, len(told.data)) == (0x7FFE | EXTENDED, 8)


def test_faults_of_a_robstride_stand_in_the_id_until_a_stop_clears_them() -> None:
    host = robstride()
    host.ask(private("0300FD7F"))
    host.faults.damage(0x7F, 1 << 2 | 1 << 4)
    told = host.wait(0.01)
    assert told[0].id == 0x15007FFD | EXTENDED
    [told] = host.ask(private("0300FD7F"))
    assert (told.id >> 16 & 0x3F, told.id >> 22 & 3) == (0b10100, 0), "and it is not enabled"
    host.ask(private("0400FD7F", "0100000000000000"))
    assert host.ask(private("0300FD7F"))[0].id >> 22 & 3 == 2


def test_a_robstride_timeout_is_off_as_delivered_and_trips_by_ticks_of_50_us() -> None:
    """Facts 3: 20000 ticks = 1 s, off by default."""
    host = robstride()
    host.ask(private("0300FD7F"))
    host.wait(5.0)
    assert host.truth()["torque"]
    host.ask(private("1200FD7F", "28700000D0070000"))
    host.wait(0.2)
    assert host.truth()["trip_delay"] == pytest.approx(0.1)
    assert not host.truth()["torque"]


def test_run_mode_cannot_change_while_enabled_and_another_takes_no_motion() -> None:
    host = robstride()
    host.ask(private("1200FD7F", "0570000005000000"))
    host.ask(private("0300FD7F"), private("017FFF7F", "8A2E7FFF19993333"), wait=0.3)
    assert host.truth()["position"] == 0.0
    host.ask(private("1200FD7F", "0570000000000000"))
    assert host.ask(private("1100FD7F", "0570000000000000"))[0].data[4] == 5


@pytest.mark.parametrize("forgets", [False, True])
def test_a_cybergear_loses_its_zero_with_its_power(forgets: bool) -> None:
    spec = NodeSpec(1, "CyberGear", forgets_zero=forgets)
    host = CanHost([spec], start=0.7)
    host.ask(private("0600FD01", "0100000000000000"))
    assert host.truth()["position"] == 0.0
    host.faults.power(False)
    host.faults.power(True)
    host.wait(1.0)
    lost = 0.7 * 16384 / 6.283185307
    assert host.truth()["position"] == pytest.approx(lost if forgets else 0.0)


def test_a_robstride_sends_periodic_reports_when_enabled() -> None:
    host = robstride()
    assert host.ask(private("1800FD7F", "0102030405060108"), wait=0.0949)
    assert len(host.wait(0.1)) == 10
    host.ask(private("1800FD7F", "0102030405060008"))
    assert host.wait(0.1) == []


def test_the_torque_limit_of_a_robstride_is_the_most_it_pulls() -> None:
    host = robstride(torque_limit=2.0)
    host.faults.lock(0x7F)
    host.ask(private("0300FD7F"), private("017FFF7F", "BFFF7FFFFFFF3333"), wait=0.1)
    assert host.truth()["effort"] == pytest.approx(2000)


# --------------------------------------------------------------------------------------- ODrive

SLOW = {"heartbeat": 0.0, "estimates": 0.0}


def odrive(**more: float) -> CanHost:
    return CanHost([NodeSpec(3, "ODrive", torque=20.0, settings=more)])


def test_an_odrive_sends_heartbeats_and_estimates_periodically() -> None:
    """Facts 4: heartbeat every 100 ms, estimates every 10 ms."""
    host = odrive()
    heard = host.wait(10.0)
    assert 98 <= sum(each.id == 0x61 for each in heard) <= 102
    assert 998 <= sum(each.id == 0x69 for each in heard) <= 1002
    assert next(each for each in heard if each.id == 0x61).data.hex() == "0000000001000080"


def test_the_golden_frames_of_an_odrive() -> None:
    """Facts 4: node 3, position 1.5 rev is 06C, closed loop is 067."""
    host = odrive(position_gain=20.0, velocity_gain=6.0, torque_constant=2.0, velocity_limit=10.0)
    host.ask((0x06C, bytes.fromhex("0000C03F00000000")), wait=0.3)
    assert host.truth()["position"] == 0.0
    host.ask((0x067, bytes.fromhex("08000000")))
    host.ask((0x06C, bytes.fromhex("0000C03F00000000")), wait=2.0)
    assert host.truth()["position"] == pytest.approx(1.5 * 16384, abs=100)
    place = struct.unpack("<f", next(e for e in host.wait(0.05) if e.id == 0x69).data[:4])[0]
    assert place == pytest.approx(1.5, abs=0.01)


@pytest.mark.parametrize("command", [0x03, 0x04, 0x05, 0x09, 0x0A, 0x14, 0x17, 0x1D])
@pytest.mark.parametrize("flag", [REMOTE, 0])
def test_an_odrive_is_asked_by_a_remote_frame_or_an_empty_one(command: int, flag: int) -> None:
    host = odrive(**SLOW)
    host.wait(1.0)
    [told] = host.ask((0x60 | command | flag, b""))
    assert told.id == 0x60 | command


def test_an_odrive_watchdog_is_off_as_delivered_and_any_frame_feeds_it() -> None:
    """Facts 4: `do_command` feeds it for remote reads too."""
    host = odrive(**SLOW)
    host.ask((0x067, b"\x08\0\0\0"))
    host.wait(5.0)
    assert host.truth()["torque"]
    host = odrive(watchdog_timeout=0.1, **SLOW)
    host.ask((0x067, b"\x08\0\0\0"))
    for _ in range(10):
        host.ask((0x069 | REMOTE, b""), wait=0.05)
    assert host.truth()["torque"], "a reader alone keeps it going"
    host.wait(0.2)
    truth = host.truth()
    assert (truth["torque"], truth["tripped"]) == (False, True)
    assert truth["trip_delay"] == pytest.approx(0.1)
    beat = host.ask((0x061 | REMOTE, b""))[0].data
    assert (beat[:4].hex(), beat[4]) == ("00080000", 1), "watchdog expired, idle"


def test_an_odrive_with_an_error_refuses_closed_loop_until_it_is_cleared() -> None:
    host = odrive(**SLOW)
    host.ask((0x062, b""))
    host.ask((0x067, b"\x08\0\0\0"))
    assert not host.truth()["torque"]
    host.ask((0x078, b""), (0x067, b"\x08\0\0\0"))
    assert host.truth()["torque"]


def test_the_speed_limit_of_an_odrive_holds_on_the_way() -> None:
    host = odrive(position_gain=20.0, velocity_gain=6.0, torque_constant=2.0, **SLOW)
    host.ask((0x06F, struct.pack("<ff", 1.0, 5.0)), (0x067, b"\x08\0\0\0"))
    host.ask((0x06C, struct.pack("<fhh", 3.0, 0, 0)), wait=1.0)
    assert host.truth()["velocity"] / 16384 == pytest.approx(0.83, abs=0.02), "less what friction takes"
    host.wait(4.0)
    assert host.truth()["position"] == pytest.approx(3 * 16384, abs=200)


def test_an_odrive_restarts_on_order() -> None:
    host = odrive()
    host.ask((0x067, b"\x08\0\0\0"), (0x076, b""), wait=0.02)
    assert host.wait(0.2) == []
    assert host.wait(1.0)
    assert not host.truth()["torque"]


def test_a_later_board_has_another_heartbeat_and_reports_its_disarm_reason() -> None:
    host = CanHost([NodeSpec(3, "ODrive-S1", settings=SLOW)])
    host.wait(0.5)
    host.ask((0x062, b""))
    assert host.ask((0x061 | REMOTE, b""))[0].data.hex() == "0000000201000100"
    assert host.ask((0x063 | REMOTE, b""))[0].data.hex() == "0000000200000002"


def test_a_senseless_number_moves_no_odrive() -> None:
    host = odrive(**SLOW)
    host.ask((0x067, b"\x08\0\0\0"), (0x06C, struct.pack("<fhh", float("nan"), 0, 0)), wait=0.3)
    assert host.truth()["position"] == pytest.approx(0.0, abs=1.0)


# --------------------------------------------------------------------------------------- all


def test_settings_that_are_none_and_models_that_are_not_simulated_are_refused() -> None:
    for model in ("DM4310", "RS01", "ODrive"):
        with pytest.raises(ValueError, match=r"node 1: no .* 'spin'; there are"):
            CanHost([NodeSpec(1, model, settings={"spin": 1})])
    with pytest.raises(ValueError, match="node 1: 'XM430' is not simulated; families are damiao"):
        CanHost([NodeSpec(1, "XM430")])


ONE_OF_EACH = [
    NodeSpec(1, "DM4310", 0x11, settings={"timeout": 2000}),
    NodeSpec(2, "AK70-10", settings={"timeout": 0.1}),
    NodeSpec(0x7F, "RS01", settings={"timeout": 2000}),
    NodeSpec(5, "ODrive", settings={"watchdog_timeout": 0.1}),
]


@examples(50)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([1, 2, 5 << 5 | 7, 5 << 5 | 12, 5 << 5 | 15, 0x7FF, 0x7F | EXTENDED]),
            st.integers(0, 0x1F),
            st.binary(max_size=8),
        ),
        max_size=20,
    )
)
def test_no_bytes_break_a_node(sent: list[tuple[int, int, bytes]]) -> None:
    host = CanHost(ONE_OF_EACH)
    for id, kind, data in sent:
        whole = id | kind << 24 | 0xFD00 if id & EXTENDED else id
        host.ask((whole, data), wait=0.002)
    for row in range(4):
        truth = host.truth(row)
        assert all(abs(truth[key]) < 1e9 for key in ("position", "velocity", "effort"))
    assert isinstance(host.wait(0.1), list)
    assert all(isinstance(each, CanMessage) for each in host.errors)
