"""Reader and writer of Protocol 1.0 on the virtual bus: what differs from the contract of all drivers."""

from typing import Any

import numpy as np
import pytest

from tests.support.driver_rig import both
from tests.support.dynamixel1_rig import QUICK, Dynamixel1Rig
from twind_drivers.bus import DeviceRefused, NoReply, WireRangeError, WriteRequest
from twind_drivers.dynamixel1.dynamixel1_budget import Dynamixel1Cycle
from twind_drivers.dynamixel1.dynamixel1_models import models
from twind_drivers.dynamixel1.dynamixel1_packet import BULK_READ, bulk_read, explain
from twind_drivers.dynamixel1.dynamixel1_writer import Dynamixel1Writer
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.half_duplex import checksum_packet as p
from twind_drivers.half_duplex.checksum_reply import ChecksumReply
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter

MX = "MX-28(1.0)"
GOLDEN = [  # e-manual, "Protocol 1.0", but for the last two
    (p.instruction(1, p.PING), "FF FF 01 02 01 FB"),
    (p.read(1, 0x2B, 1), "FF FF 01 04 02 2B 01 CC"),
    (p.write(p.BROADCAST, 3, b"\1"), "FF FF FE 04 03 03 01 F6"),
    (bulk_read((1,), 0x1E, 2)[:-1], "FF FF FE 06 92 00 02 01 1E"),
    (
        p.sync_write(
            30,
            {
                0: bytes.fromhex("10005001"),
                1: bytes.fromhex("20026003"),
                2: bytes.fromhex("30007001"),
                3: bytes.fromhex("20028003"),
            },
        ),
        "FF FF FE 18 83 1E 04 00 10 00 50 01 01 20 02 60 03 02 30 00 70 01 03 20 02 80 03 12",
    ),
    (p.read(1, 36, 2), "FF FF 01 04 02 24 02 D2"),
    (p.write(p.BROADCAST, 24, b"\0"), "FF FF FE 04 03 18 00 E2"),
]


def rig_of(model: str = MX, settings: dict[str, int] | None = None, **spec: Any) -> Dynamixel1Rig:
    own = QUICK | (settings or {})
    return Dynamixel1Rig([Dynamixel1ServoSpec(id, model, own, **spec) for id in (1, 2, 3)])


def moves(rig: Dynamixel1Rig) -> None:
    """Armed, everybody follows."""
    here = rig.arm()
    for cycle in range(30):
        rig.tick(here + 4 * cycle)
    rig.ticks(40, here + 116)
    assert abs(rig.places() - here - 116).max() <= 2


# ---------------------------------------------------------------------------- packets


@pytest.mark.parametrize(("made", "printed"), GOLDEN, ids=[text for _, text in GOLDEN])
def test_packets_are_the_printed_ones(made: bytes, printed: str) -> None:
    assert made == bytes.fromhex(printed)


def test_a_refusal_is_an_answer_without_data() -> None:
    made = ChecksumReply((1, 2), 6, refusals=True)
    data = p.instruction(1, 0, b"123456") + p.instruction(2, 0x08)
    made.receive_buffer()[: len(data)] = data
    made.take(len(data))
    made.end()
    assert made.heard.tolist() == [True, False]
    assert made.answered.tolist() == [True, True]
    assert made.error.tolist() == [0, 0x08]
    assert (made.strays, list(made.unasked)) == (0, [])
    assert "range" in explain(0x08)


# ---------------------------------------------------------------------------- lines and models


def test_an_echo_adapter_is_recognised_and_no_echo_passes_for_a_reply() -> None:
    for model in (MX, "AX-12A"):
        servos = [Dynamixel1ServoSpec(id, model, QUICK) for id in (1, 2, 3)]
        rig = Dynamixel1Rig(servos, adapter=SerialAdapter(echo=True))
        assert len(rig.perform(rig.reader.identify())) == 3
        assert rig.reader.line.echo
        moves(rig)
        assert not any(sample.discarded or sample.foreign for sample in rig.ticks(5))
        rig.faults.silence(2)
        with pytest.raises(NoReply):
            rig.beside(rig.reader.read(2, "present_position"))


def test_a_mixed_bus_reads_mx_together_and_ax_one_by_one() -> None:
    rig = Dynamixel1Rig(
        [
            Dynamixel1ServoSpec(1, MX, QUICK),
            Dynamixel1ServoSpec(2, "AX-18A", QUICK),
            Dynamixel1ServoSpec(3, MX, QUICK, bulk_read=False),
            Dynamixel1ServoSpec(4, "MX-106(1.0)", QUICK),
        ]
    )
    rig.perform(rig.reader.identify())
    assert rig.reader.cyclic.grouped == {1: True, 2: False, 3: False, 4: True}
    here = rig.arm()
    rig.ticks(60, here + np.array([90, -90, 90, -90]))
    assert abs(rig.places() - here - np.array([90, -90, 90, -90])).max() <= 2


@pytest.mark.parametrize("gone", [(1,), (20,), (1, 2), (7, 13)])
def test_a_silent_servo_in_a_bulk_read_silences_the_others_for_a_few_cycles_only(
    gone: tuple[int, ...],
) -> None:
    rig = Dynamixel1Rig([Dynamixel1ServoSpec(id, MX, QUICK) for id in range(1, 21)])
    rig.positions()
    for id in gone:
        rig.faults.silence(id)
    samples = rig.ticks(30)
    others = np.array([id not in gone for id in rig.reader.ids])
    missed = [int((~sample.heard[others]).any()) for sample in samples]
    assert sum(missed) <= 3 + 3 * len(gone), missed
    assert not any(missed[12:])
    with pytest.raises(NoReply) as told:
        rig.beside(rig.reader.collect(rig.reader.ids, 24, 1))
    assert told.value.ids == gone


def test_a_chain_waits_for_its_last_reply_alone_until_the_latest_time() -> None:
    rig = Dynamixel1Rig([Dynamixel1ServoSpec(id, "AX-18A", QUICK) for id in (1, 2, 3)])
    for silent in (1, 3):
        rig.faults.silence(silent)
        begun = rig.clock.now()
        rig.reader.request(begun, begun + 0.02)
        while not rig.reader.feed(rig.clock.now()) and rig.clock.now() < rig.reader.deadline:
            rig.clock.wait([rig.reader.transport], rig.reader.deadline)
        sample = rig.reader.finish(rig.clock.now())
        assert sample.heard.tolist() == [id != silent for id in (1, 2, 3)]
        assert rig.clock.now() == pytest.approx(begun + 0.02)
        rig.faults.silence(silent, on=False)


def test_a_factory_return_delay_is_found_and_waited_for() -> None:
    servos = [Dynamixel1ServoSpec(id, MX) for id in (1, 2, 3)]
    rig = Dynamixel1Rig(servos)
    rig.reader.line.return_delay_s = 0.00005  # the robot file says 0
    devices = rig.perform(rig.reader.identify(patient=True))
    assert devices[0].settings["return_delay_time"] == 250
    assert rig.reader.line.return_delay_s == pytest.approx(0.00055)
    assert all(sample.heard.all() for sample in rig.ticks(5))


def test_identification_reports_model_firmware_and_settings() -> None:
    rig = rig_of("AX-12A", {"min_position_limit": 100})
    device = rig.perform(rig.reader.identify())[0]
    assert (device.model_number, device.model_name, device.firmware) == (12, "AX-12A", 24)
    assert device.settings["min_position_limit"] == 100
    assert device.settings["operating_mode"] == 0
    assert device.unique_id is None


@pytest.mark.parametrize(
    ("settings", "firmware", "reason"),
    [
        ({"max_position_limit": 0}, None, "wheel"),
        ({"min_position_limit": 4095}, None, "multi-turn"),
        ({"resolution_divider": 2}, None, "divider"),
        ({"shutdown": 4}, None, "overload or overheating"),
        ({"status_return_level": 1}, None, "confirms no write"),
        ({"max_voltage_limit": 100}, None, "supply voltage"),
        ({"max_torque": 0}, None, "not move"),
        ({}, 40, "dynamixel2"),
    ],
)
def test_what_must_not_get_torque_is_refused(
    settings: dict[str, int], firmware: int | None, reason: str
) -> None:
    rig = rig_of(settings=settings, firmware=firmware)
    with pytest.raises(DeviceRefused, match=reason):
        rig.beside(rig.writer.prepare(np.full(3, 2048)))
    assert not rig.energised().any()


# ---------------------------------------------------------------------------- positions


@pytest.mark.parametrize("model", [MX, "AX-12A"])
def test_no_wrong_position_passes_bit_errors(model: str) -> None:
    rig = rig_of(model)
    here = rig.positions()
    rig.faults.bit_errors(0.002)
    samples = rig.ticks(400)
    wrong = [sample for sample in samples if (abs(sample.position - here) > 200)[sample.heard].any()]
    assert not wrong
    assert any(not sample.heard.all() for sample in samples), "nothing was disturbed"


def test_speed_and_load_have_their_direction_in_bit_10() -> None:
    rig = rig_of()
    here = rig.arm()
    up = max(int(rig.tick(here + 600).velocity.max()) for _ in range(20))
    rig.ticks(100, here + 600)
    down = min(int(rig.tick(here).velocity.min()) for _ in range(20))
    assert up == -down == pytest.approx(55.0 / 0.114, rel=0.02), "no-load speed at 12 V"


# ---------------------------------------------------------------------------- torque


@pytest.mark.parametrize("model", [MX, "AX-12A"])
def test_an_alarm_sets_the_torque_limit_to_0_and_preparing_ends_that(model: str) -> None:
    rig = rig_of(model)
    here = rig.arm()
    rig.faults.lock(2)
    samples = rig.ticks(400, here + 300)
    assert rig.servos.get(1, "torque_limit") == 0
    assert any(sample.error[1] == 0x80 for sample in samples)
    assert rig.registers.fault[1] == 0x80, "the error is over, the servo stays without torque"
    assert rig.registers.torque.tolist() == [1, 0, 1]
    assert rig.energised()[1], "its torque switch still reads on"
    rig.faults.free(2)
    rig.ticks(20, here)
    assert abs(rig.places()[1] - here[1]) < 2, "it lies where it was"
    rig.beside(both(rig, rig.tick().position))
    assert not rig.energised()[1], "it begins limp"
    rig.beside(rig.writer.torque(True))
    assert rig.servos.get(1, "torque_limit") == 1023
    rig.ticks(20)
    assert rig.registers.fault[1] == 0


def test_torque_begins_low_and_ends_at_the_full_limit() -> None:
    rig = rig_of(settings={"max_torque": 900})
    rig.beside(both(rig, rig.positions()))
    assert [rig.servos.get(row, "torque_limit") for row in range(3)] == [270] * 3
    rig.beside(rig.writer.torque(True))
    assert [rig.servos.get(row, "torque_limit") for row in range(3)] == [900] * 3


def test_damping_is_taken_back_by_preparing() -> None:
    for model, name, usual, soft in (
        (MX, "position_p_gain", 32, 4),
        ("AX-12A", "cw_compliance_slope", 32, 128),
    ):
        rig = rig_of(model)
        here = rig.arm()
        assert rig.beside(rig.writer.damp()) == ()
        assert (rig.servos.get(0, "torque_limit"), rig.servos.get(0, name)) == (306, soft)
        rig.beside(rig.writer.prepare(here))
        assert (rig.servos.get(0, "torque_limit"), rig.servos.get(0, name)) == (1023, usual)


def test_a_servo_that_a_goal_arms_holds_where_it_is() -> None:
    rig = rig_of(goal_arms=True)
    rig.beside(rig.writer.prepare(rig.positions()))
    rig.ticks(10)
    rig.writer.goals(np.full(3, 2500))
    rig.ticks(10)
    assert (rig.places() == 2048).all(), "a goal without torque left"


def test_it_holds_its_last_goal_when_the_master_is_gone() -> None:
    """There is no watchdog: that is what the daemon must deal with."""
    rig = rig_of()
    here = rig.arm()
    rig.ticks(5, here + 50)
    rig.clock.sleep_until(rig.clock.now() + 5.0)
    rig.bus.advance(rig.clock.now())
    assert rig.energised().all()
    assert abs(rig.places() - here - 50).max() <= 2
    assert (rig.registers.watchdog == -1).all()


def test_a_new_writer_takes_over_torque_that_another_left() -> None:
    rig = rig_of()
    here = rig.arm()
    rig.writer = Dynamixel1Writer(rig.reader, lower=rig.lower, upper=rig.upper)
    rig.ticks(10)
    rig.beside(rig.writer.prepare(here))
    rig.ticks(60, here + 50)
    assert abs(rig.places() - here - 50).max() <= 2


def test_there_is_no_restart() -> None:
    rig = rig_of()
    rig.positions()
    with pytest.raises(DeviceRefused, match="no restart"):
        rig.beside(rig.writer.reboot(2))


# ---------------------------------------------------------------------------- registers


def test_eeprom_is_written_with_torque_off_and_the_lock_open() -> None:
    rig = rig_of()
    rig.positions()
    assert rig.beside(rig.writer.write(2, "return_delay_time", 4)).value == 4
    assert rig.servos.eeprom[1][5] == 4
    rig.servos.put(1, "lock", 1)
    with pytest.raises(DeviceRefused, match="lock"):
        rig.beside(rig.writer.write(2, "return_delay_time", 6))
    rig.servos.put(1, "lock", 0)
    rig.arm()
    with pytest.raises(DeviceRefused, match="disarm"):
        rig.beside(rig.writer.write(2, "return_delay_time", 6))
    for name in ("id", "lock", "goal_position", "present_position"):
        with pytest.raises(ValueError):
            rig.beside(rig.writer.write(2, name, 1))


@pytest.mark.parametrize(
    ("address", "data"),
    [(3, b"\7"), (6, b"\0\0"), (30, b"\xff\x1f"), (24, b"\2"), (36, b"\0\0"), (100, b"\0"), (47, b"\1\1")],
)
def test_the_last_check_lets_no_other_write_out(address: int, data: bytes) -> None:
    rig = rig_of()
    before = rig.sent()
    with pytest.raises(WireRangeError):
        rig.writer.begin(WriteRequest({1: data}, address), 0.0)
    with pytest.raises(WireRangeError):
        rig.writer.begin(WriteRequest({9: b"\0"}, BULK_READ), 0.0)
    assert rig.sent() == before


# ---------------------------------------------------------------------------- strength and rate


@pytest.mark.parametrize("name", [name for name, each in models().items() if each.figures is not None])
def test_a_servo_is_as_fast_as_its_page_says(name: str) -> None:
    rig = rig_of(name)
    here = rig.arm()
    own = models()[name]
    speeds = [rig.tick(np.minimum(here + 1500, own.counts - 1)).velocity.max() for _ in range(30)]
    strength = own.strength(own.volts)
    assert strength is not None
    assert max(speeds) * own.rpm == pytest.approx(strength[1] * 30.0 / np.pi, rel=0.02)


@pytest.mark.parametrize(
    ("alone", "delay_us", "hz"),
    [(0, 0, 240 / 1.24), (0, 500, None), (20, 0, None)],
)
def test_a_cycle_counts_the_bytes_of_goals_and_reading(alone: int, delay_us: int, hz: float | None) -> None:
    found = Dynamixel1Cycle(20, alone, 1_000_000, delay_us * 1e-6)
    assert found.bytes == (375 if not alone else 468)
    if hz is not None:
        assert 1.0 / found.seconds > hz
        assert found.refusal(100.0, 0.001) is None
    else:
        reason = found.refusal(100.0, 0.001)
        assert reason is not None
        assert "Remedy" in reason
