"""An adapter that returns what is sent: a damaged echo is noise, whatever was sent, and ends with it."""

import pytest

from tests.support.feetech_rig import FeetechRig
from tests.support.half_duplex_rig import ScriptedPort
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.replies import StatusReply
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.half_duplex import checksum_packet
from twind_drivers.half_duplex.chained_read import chained_read
from twind_drivers.half_duplex.checksum_reply import CAPACITY
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter


def damage_next_bytes(rig: FeetechRig) -> None:
    """Flip a bit of the first byte that the host receives next."""
    read = rig.port.read_into

    def damaged(buffer: memoryview) -> int:
        count = read(buffer)
        if count:
            buffer[0] ^= 0x10
            rig.port.read_into = read  # type: ignore[method-assign]
        return count

    rig.port.read_into = damaged  # type: ignore[method-assign]


@pytest.mark.parametrize("sync_read", [True, False])
def test_a_flipped_bit_in_an_echo_is_no_foreign_traffic_and_the_echo_is_known_again(sync_read: bool) -> None:
    """FOREIGN_TRAFFIC: the echoes of reads one by one have the form of replies nobody asked for."""
    rig = FeetechRig(
        [FeetechServoSpec(id, sync_read=sync_read) for id in range(1, 9)], adapter=SerialAdapter(echo=True)
    )
    rig.perform(rig.reader.identify())
    goal = rig.arm()
    rig.clock.sleep_until(rig.clock.now() + 1.2)  # what identification has missed is forgotten
    rig.ticks(3, goal)
    damage_next_bytes(rig)
    damaged, *after = rig.ticks(6, goal)
    assert damaged.heard.all()
    assert damaged.discarded > 0
    assert [each.foreign for each in (damaged, *after)] == [0] * 6
    assert [each.discarded for each in after] == [0] * 5
    assert rig.reader.line.echo


@pytest.fixture
def line() -> HalfDuplexTransactor:
    return HalfDuplexTransactor(
        "main", ScriptedPort(), baud=10_000, return_delay_s=0.0, slack=0.002, find_packets=p.find_packets
    )


def test_a_damaged_echo_of_several_packets_that_wait_for_the_next_request_is_no_foreign_traffic(
    line: HalfDuplexTransactor,
) -> None:
    port = line.transport
    assert isinstance(port, ScriptedPort)
    ping = SerialTransaction(p.ping(1), StatusReply((1,), 3), 1)
    answer = p.status(1, 0, b"\1\2\3")
    writes = p.sync_write(64, {1: b"\0", 2: b"\0"}) + p.sync_write(116, {1: bytes(4), 2: bytes(4)})
    order = SerialTransaction(writes, None, 0)
    port.answer(line, ping, ping.packet + answer)
    assert line.echo
    line.send(order, 0.0)
    line.end()
    port.input = b"\0" + writes[1:]
    port.answer(line, ping, ping.packet + answer)
    assert line.foreign == 0
    line.send(order, 0.0)
    line.end()
    port.input = b"\0" + writes[1:] + writes  # the same packets once more were sent by another
    port.answer(line, ping, ping.packet + answer)
    assert line.foreign > 0


def test_a_damaged_echo_behind_a_full_buffer_of_noise_ends_no_tick() -> None:
    port = ScriptedPort()
    line = HalfDuplexTransactor(
        "main",
        port,
        baud=1_000_000,
        return_delay_s=0.0,
        slack=0.002,
        find_packets=checksum_packet.find_packets,
    )
    chain = chained_read((1, 2), 56, 6, lambda _: False, checksum_packet_group)
    answer = checksum_packet.instruction(1, 0, bytes(6))
    line.echo = True
    line.send(chain, 0.0)
    port.input = chain.packet + bytes(CAPACITY - 3 - len(answer)) + answer
    while port.input:
        line.feed(0.0)
    assert chain.then[0][1] in port.output
    port.input = b"\0" * 8
    assert not line.feed(0.0)
    line.end()
    assert chain.reply is not None
    assert chain.reply.heard.tolist() == [True, False]


def checksum_packet_group(ids: object, address: int, size: int) -> bytes:
    """Nobody here answers group reads."""
    raise AssertionError((ids, address, size))
