"""Packets in, packets out: golden bytes, broadcast rules, group reads long way and short way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import Instruction


def hexed(text: str) -> bytes:
    return bytes.fromhex(text)


# ---------------------------------------------------------------------- single packets


def test_golden_bytes_of_the_manual() -> None:
    """e-manual "Protocol 2.0", examples of ping, read, write and sync write; own vectors for the errors."""
    host = Host([1, 2], model="XM430-W210", firmware=38, start=166.0)
    assert host.raw(hexed("FF FF FD 00 01 03 00 01 19 4E")) == hexed(
        "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"
    )
    assert host.raw(hexed("FF FF FD 00 FE 03 00 01 31 42")) == hexed(
        "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D"
    )
    assert host.raw(hexed("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15")) == hexed(
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"
    )
    write = hexed("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89")
    assert host.raw(write) == hexed("FF FF FD 00 01 04 00 55 00 A1 0C")
    assert host.read(1, 116, 4) == 512
    assert host.raw(hexed("FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87")) == b""
    assert [host.read(id, 116, 4) for id in (1, 2)] == [150, 170]
    host.torque(1)
    assert host.raw(packet.write(1, 7, b"\x05")) == hexed("FF FF FD 00 01 04 00 55 07 B0 8C")
    assert host.raw(packet.write(1, 64, b"\x05")) == hexed("FF FF FD 00 01 04 00 55 04 BA 8C")


def test_golden_fast_sync_read_of_3_7_4() -> None:
    host = Host([3, 7, 4])
    for row, position in enumerate((166, 2079, 1023)):
        host.muscles.position[row] = position
    host.wait(0.01)
    request = hexed("FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2")
    reply = hexed(
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E"
    )
    assert host.raw(request) == reply, "long way"
    assert host.raw(request) == reply, "short way"


def test_golden_fast_bulk_read_of_3_7_4() -> None:
    host = Host([3, 7, 4])
    host.keep_readings()
    raw = host.servos.memory.raw
    raw[0, 132:136] = (0xA6, 0, 0, 0)
    raw[1, 124:126] = (0xA5, 0x01)
    raw[2, 146] = 0x1F
    request = hexed("FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00 DA 2D")
    assert host.raw(request) == hexed(
        "FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4 00 07 A5 01 24 74 00 04 1F D9 C1"
    )


def test_golden_bulk_read_of_1_and_2() -> None:
    host = Host([1, 2])
    host.keep_readings()
    raw = host.servos.memory.raw
    raw[0, 144:146] = (119, 0)
    raw[1, 146] = 36
    request = hexed("FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05")
    assert host.raw(request) == hexed(
        "FF FF FD 00 01 06 00 55 00 77 00 C3 69 FF FF FD 00 02 05 00 55 00 24 8B A9"
    )


@pytest.mark.parametrize(
    "request_",
    [
        packet.read(packet.BROADCAST, 132, 4),
        packet.write(packet.BROADCAST, 65, b"\x01"),
        packet.sync_write(65, {1: b"\x01", 2: b"\x01"}),
        packet.instruction(
            packet.BROADCAST, Instruction.BULK_WRITE, hexed("01 41 00 01 00 01 02 41 00 01 00 01")
        ),
        packet.instruction(packet.BROADCAST, 0x77),
        packet.read(9, 132, 4),
        packet.status(1, 0, b"\x00\x00"),
    ],
)
def test_broadcasts_and_group_writes_are_never_answered(request_: bytes) -> None:
    assert Host([1, 2]).raw(request_) == b""


def test_group_and_broadcast_writes_are_carried_out() -> None:
    host = Host([1, 2])
    host.raw(packet.write(packet.BROADCAST, 65, b"\x01"))
    assert host.servos.memory.raw[:, 65].tolist() == [1, 1]
    host.raw(packet.sync_write(65, {1: b"\x00", 9: b"\x00"}))
    assert host.servos.memory.raw[:, 65].tolist() == [0, 1]
    bulk = hexed("01 41 00 01 00 01 02 54 00 02 00 10 02")
    host.raw(packet.instruction(packet.BROADCAST, Instruction.BULK_WRITE, bulk))
    assert (host.read(1, 65, 1), host.read(2, 84, 2)) == (1, 528)


def test_an_unknown_instruction_is_error_2_and_a_broken_one_error_3() -> None:
    """e-manual "Protocol 2.0", Error: 2 instruction, 3 CRC."""
    host = Host([1])
    for code in (0x77, 0x00, 0xFF):
        (answer,) = host.ask(packet.instruction(1, code, b"\x01"))
        assert answer.error == 2
    good = packet.ping(1)
    (answer,) = host.ask(good[:-1] + bytes((good[-1] ^ 1,)))
    assert answer.error == 3


def test_status_return_level_decides_who_answers() -> None:
    """e-manual, Status Return Level (68): 0 ping only, 1 ping and read, 2 all."""
    for level, expected in ((0, (1, 0, 0)), (1, (1, 1, 0)), (2, (1, 1, 1))):
        host = Host([1])
        host.ask(packet.write(1, 68, bytes((level,))))
        answers = (packet.ping(1), packet.sync_read([1], 132, 4), packet.write(1, 65, b"\x01"))
        assert tuple(len(host.ask(each)) for each in answers) == expected
        assert host.servos.memory.raw[0, 65] == 1, "carried out all the same"


def test_a_reg_write_waits_for_its_action() -> None:
    host = Host([1])
    (answer,) = host.ask(packet.instruction(1, Instruction.ACTION))
    assert answer.error == 2, "nothing is stored"
    host.ask(packet.instruction(1, Instruction.REG_WRITE, hexed("74 00 C8 00 00 00")))
    assert (host.read(1, 69, 1), host.read(1, 116, 4)) == (1, 2048)
    host.ask(packet.instruction(1, Instruction.ACTION))
    assert (host.read(1, 69, 1), host.read(1, 116, 4)) == (0, 200)


def test_a_wrong_baud_rate_is_silence_until_it_is_right() -> None:
    host = Host([1])
    host.bus.line(57_600)
    assert host.raw(packet.ping(1)) == b""
    host.bus.line(2_000_000)
    assert len(host.ask(packet.ping(1))) == 1
    host.write(1, 8, 3, 1)
    assert host.raw(packet.ping(1)) == b"", "now at 1 Mbaud"
    host.bus.line(1_000_000)
    assert len(host.ask(packet.ping(1))) == 1


@examples(60)
@given(st.binary(max_size=60), st.lists(st.integers(1, 40), max_size=6))
def test_noise_and_split_chunks_never_cost_more_than_the_packet_they_hit(
    noise: bytes, cuts: list[int]
) -> None:
    host = Host([1])
    data = noise + packet.ping(1) * 2
    place = 0
    for cut in cuts:
        host.bus.receive(data[place : place + cut], 0.0)
        place += cut
    host.bus.receive(data[place:] + bytes(2048) + packet.ping(1), 0.0)
    found = packet.Framer(status=True).feed(host.bus.take(1e9))
    assert any(each.data == host.servos.registers.identity(0) for each in found)


# ---------------------------------------------------------------------- group reads


@examples(40)
@given(
    st.lists(st.integers(0, 252), min_size=1, max_size=24, unique=True),
    st.lists(st.integers(-(2**31), 2**31 - 1), min_size=24, max_size=24),
    st.lists(st.sampled_from([-1, -3, 0, 5, -131073]), min_size=24, max_size=24),
    st.booleans(),
)
def test_a_group_read_equals_its_packet_by_packet_replies(
    ids: list[int], positions: list[int], velocities: list[int], alert: bool
) -> None:
    """Plain rows stuffed where they must be, fast ones never, CRCs cumulative."""
    host = Host(ids)
    if alert:
        host.bus.faults.damage(ids[0], 1)
    fast = packet.fast_sync_read(ids, 128, 8)
    plain = packet.sync_read(ids, 128, 8)
    host.raw(fast)
    host.raw(plain)  # both are remembered now
    raw = host.servos.memory.raw
    for row in range(len(ids)):
        raw[row, 128:132] = np.frombuffer(velocities[row].to_bytes(4, "little", signed=True), np.uint8)
        raw[row, 132:136] = np.frombuffer(positions[row].to_bytes(4, "little", signed=True), np.uint8)
    host.keep_readings()
    rows = [(0x80 if alert and not row else 0, id, raw[row, 128:136].tobytes()) for row, id in enumerate(ids)]
    assert fast in host.bus.group_reads
    assert host.raw(fast) == b"".join(packet.fast_status(rows, 12 * len(ids) + 1))
    assert host.raw(plain) == b"".join(packet.status(id, error, data) for error, id, data in rows)


def test_a_silent_servo_is_missing_in_a_plain_read_and_ends_a_fast_one() -> None:
    ids = [4, 5, 6, 7]
    host = Host(ids)
    whole = host.raw(packet.fast_sync_read(ids, 132, 4))
    host.bus.faults.silence(6)
    for _ in range(2):
        assert [each.id for each in host.ask(packet.sync_read(ids, 132, 4))] == [4, 5, 7]
        assert host.raw(packet.fast_sync_read(ids, 132, 4)) == whole[: 8 + 2 * 8]
    host.bus.faults.silence(4)
    assert host.raw(packet.fast_sync_read(ids, 132, 4)) == b"", "the first one sends the header"
    host.bus.faults.clear()
    assert host.raw(packet.fast_sync_read(ids, 132, 4)) == whole


@pytest.mark.parametrize(
    ("model", "firmware", "answers"),
    [
        ("XM430-W350", 45, True),
        ("XM430-W350", 44, False),
        ("2XL430-W250", 47, False),
        ("XL330-M288", 45, False),
    ],
)
def test_fast_reads_need_the_firmware_for_them(model: str, firmware: int, answers: bool) -> None:
    host = Host([1], model=model, firmware=firmware)
    assert bool(host.raw(packet.fast_sync_read([1], 132, 4))) is answers


def test_a_servo_that_answers_no_reads_ends_a_common_reply_like_a_missing_one() -> None:
    """Status Return Level (68) 0: ping only. Those behind it have nothing to go on with."""
    ids = [4, 5, 6]
    host = Host(ids)
    whole = host.raw(packet.fast_sync_read(ids, 132, 4))
    host.raw(packet.write(5, 68, b"\0"))
    for _ in range(2):
        assert host.raw(packet.fast_sync_read(ids, 132, 4)) == whole[: 8 + 8]
        assert [each.id for each in host.ask(packet.sync_read(ids, 132, 4))] == [4, 6]


def test_sync_write_goals_reach_all_servos_although_one_is_silenced() -> None:
    host = Host([1, 2, 3])
    for id in (1, 2, 3):
        host.torque(id)
    host.bus.faults.silence(2)
    for ticks in (2100, 2200):
        host.raw(packet.sync_write(116, {id: (ticks + id).to_bytes(4, "little") for id in (1, 2, 3)}))
    assert host.servos["goal_position"].tolist() == [2201, 2048, 2203]


def test_a_sync_write_with_a_wrong_crc_changes_nothing() -> None:
    host = Host([1, 2])
    good = packet.sync_write(116, {1: (2100).to_bytes(4, "little"), 2: (2200).to_bytes(4, "little")})
    for place in range(4, len(good)):
        bad = bytearray(good)
        bad[place] ^= 0x04
        host.bus.receive(bytes(bad), host.clock.now())
        host.bus.receive(bytes(300), host.clock.now())
    assert host.servos["goal_position"].tolist() == [2048, 2048]


@pytest.mark.parametrize("ask", [packet.fast_sync_read, packet.sync_read])
def test_a_late_cached_read_does_not_prevent_a_watchdog_trip(ask) -> None:
    """e-manual, "Bus Watchdog": it trips by itself, though nobody looks before the next packet."""
    host = Host([1])
    host.write(1, 98, 5, 1)
    host.torque(1)
    for late, tripped in ((0.09, False), (0.09, False), (0.11, True)):
        host.raw(ask([1], 98, 1))
        host.clock.sleep_until(host.clock.now() + late)
        host.raw(ask([1], 98, 1))
        assert host.servos.tripped[0] == tripped


def test_goals_beyond_a_limit_are_dropped_one_by_one() -> None:
    host = Host([1, 2, 3])
    goals = {1: 2100, 2: 5000, 3: 2300}
    host.raw(packet.sync_write(116, {id: ticks.to_bytes(4, "little") for id, ticks in goals.items()}))
    assert host.servos["goal_position"].tolist() == [2100, 2048, 2300]


@pytest.mark.parametrize(("address", "size"), [(120, 4), (124, 2), (136, 8), (120, 16)])
def test_rarely_read_registers_are_as_fresh_as_position_and_velocity(address: int, size: int) -> None:
    """Within the same millisecond as a read of 126..135: tick, moving, PWM, trajectories."""
    block = packet.fast_sync_read([1, 2], 126, 10)
    rare = packet.fast_sync_read([1, 2], address, size)
    heard = []
    for before in ([], [block]):
        host = Host([1, 2], wire_timing=False)
        host.write(1, 112, 50, 4)
        host.torque(1)
        host.goal(1, 3500)
        host.raw(block)
        stale = host.raw(rare)  # both are remembered from here on
        host.wait(0.1)
        for request in before:
            host.raw(request)
        heard.append(host.raw(rare))
    assert heard[0] == heard[1] != stale


def test_readings_are_as_of_the_end_of_the_request() -> None:
    host = Host([1])
    host.torque(1)
    host.goal(1, 4000)
    seen = []
    for _ in range(5):
        host.wait(0.02)
        seen.append(host.present(1))
    assert seen == sorted(set(seen))
    assert seen[0] > 2060
