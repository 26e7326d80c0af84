"""Two on the wire at once: servos with one id, a host that talks into an answer, a late answer, another rate.

The manual does not say what is heard then; on a half-duplex line that idles high it is the lower level.
"""

import pytest

from tests.support.virtual_serial_host import FAST, Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import HEADER, Framer, Instruction

BYTE = 10 / 2e6  # s


def twins(first_delay: int = 0, second_delay: int = 0, *, apart: float = 500.0) -> Host:
    """Ids 1, 2, 2, 3; the second 2 stands elsewhere. Delays in units of 2 us."""
    host = Host([1, 2, 4, 3])
    host.write(2, 9, first_delay, 1)
    host.write(4, 9, second_delay, 1)
    host.muscles.position[2] += apart
    host.write(4, 7, 2, 1)
    return host


def ids(data: bytes) -> list[int]:
    return [each.id for each in Framer(status=True).feed(data)]


def test_twins_that_answer_at_the_same_time_garble_what_differs() -> None:
    host = twins()
    assert ids(host.raw(packet.ping(2))) == [2], "of the same bytes nobody can tell that there are two"
    assert ids(host.raw(packet.read(2, 132, 4))) == []
    assert ids(host.raw(packet.read(1, 132, 4))) == [1]


@pytest.mark.parametrize("slower", [1, 3, 9])
def test_twins_that_overlap_in_part_are_sound_up_to_there(slower: int) -> None:
    host = twins(0, slower)
    heard = host.raw(packet.read(2, 132, 4))
    assert ids(heard) == []
    whole = packet.status(2, 0, (2048).to_bytes(4, "little"))
    alone = int(slower * 2e-6 / BYTE)
    assert heard[:alone] == whole[:alone]


def test_replies_of_duplicate_ids_far_apart_in_time_are_received_one_after_the_other() -> None:
    found = Framer(status=True).feed(twins(0, 100).raw(packet.read(2, 132, 4)))
    assert [(each.id, int.from_bytes(each.data, "little")) for each in found] == [(2, 2048), (2, 2548)]


def test_in_a_sync_read_with_duplicate_ids_the_other_servos_are_received() -> None:
    assert ids(twins().raw(packet.sync_read([1, 2, 3], 132, 4))) == [1, 3]
    assert ids(twins(0, 100).raw(packet.sync_read([1, 2, 3], 132, 4))) == [1, 2, 2, 3]


def test_in_a_joint_answer_twins_break_their_own_block() -> None:
    """Each block's CRC is over all bytes before it (e-manual, "Fast Sync Read"): as they were heard."""
    host = twins()
    heard = host.raw(packet.fast_sync_read([1, 2, 3], 132, 4))
    alone = Host([1, 2, 3]).raw(packet.fast_sync_read([1, 2, 3], 132, 4))
    assert heard[: 8 + 8] == alone[: 8 + 8], "the header and the block before them are sound"
    assert heard[16:24] != alone[16:24]
    host.muscles.position[2] = 2048.0
    host.wait(0.01)
    assert host.raw(packet.fast_sync_read([1, 2, 3], 132, 4)) == alone


def test_a_request_during_a_reply_is_served_after_it_unless_collisions_are_on() -> None:
    request = packet.sync_read([1, 2, 3], 126, 10)
    middle = (len(request) + 30) * BYTE
    for on, expected in ((False, [1, 2, 3, 1]), (True, [1, 3])):
        host = Host([1, 2, 3])
        host.bus.faults.collide(on)
        host.bus.receive(request, 0.0)
        host.bus.receive(packet.ping(1), middle)
        assert ids(host.bus.take(1.0)) == expected


def test_packets_that_do_not_meet_are_whole_with_collisions_on() -> None:
    host = Host([1, 2, 3])
    host.bus.faults.collide()
    for fast in (packet.sync_read, packet.fast_sync_read):
        assert len(host.raw(fast([1, 2, 3], 132, 4))) == len(Host([1, 2, 3]).raw(fast([1, 2, 3], 132, 4)))
        host.wait(0.01)
    assert ids(host.raw(packet.sync_read([1, 2, 3], 132, 4))) == [1, 2, 3]


def test_an_answer_that_is_late_meets_the_next_one() -> None:
    host = Host([1, 2])
    host.bus.faults.collide()
    host.bus.faults.delay(0.01, id=1)
    host.bus.receive(packet.ping(1), 0.0)
    host.bus.receive(packet.ping(2), 0.01 - 5 * BYTE)
    assert ids(host.bus.take(1.0)) == []
    host.bus.receive(packet.ping(2), 2.0)
    assert ids(host.bus.take(3.0)) == [2]


def test_at_a_wrong_rate_a_servo_sends_nothing_or_noise_on_request() -> None:
    """The e-manual does not say what servos do at a rate that is not theirs."""
    host = Host([1, 2], settings=FAST | {"baud_rate": 3})  # 1 Mbaud
    assert host.bus.servos.baud == 2_000_000
    assert host.raw(packet.ping(1)) == b""
    host.bus.faults.garble()
    heard = host.raw(packet.ping(1))
    assert heard
    assert HEADER not in heard
    host.bus.line(1_000_000)
    assert ids(host.raw(packet.ping(1))) == [1]


def test_servos_with_duplicate_ids_receive_the_same_goal_and_both_move() -> None:
    host = twins()
    for _ in range(2):
        host.raw(packet.instruction(254, Instruction.SYNC_WRITE, bytes((64, 0, 1, 0, 2, 1))))
        host.raw(packet.sync_write(116, {2: (1800).to_bytes(4, "little")}))
    host.wait(3.0)
    assert [round(place) for place in host.muscles.position] == [2048, 1800, 1800, 2048]
