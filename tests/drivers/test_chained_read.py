"""Servos that are read one by one: a request leaves when the one before is answered, or has had its time."""

import numpy as np
import pytest

from tests.support.feetech_rig import FeetechRig
from tests.support.half_duplex_rig import ScriptedPort
from twind_drivers.feetech.feetech_packet import sync_read
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.half_duplex.chained_read import chained_read
from twind_drivers.half_duplex.checksum_packet import find_packets, instruction, read
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor


@pytest.mark.parametrize("ids", [(1, 2, 3, 4), (4, 3, 2, 1)])
def test_a_late_reply_of_a_servo_that_was_passed_does_not_end_the_time_of_the_next(ids: tuple[int]) -> None:
    """A request that leaves then would meet the reply under way: both would be lost."""
    port = ScriptedPort()
    line = HalfDuplexTransactor(
        "main", port, baud=1_000_000, return_delay_s=0.0, slack=0.002, find_packets=find_packets
    )
    chain = chained_read(ids, 56, 6, lambda _: False, sync_read)
    reply = chain.reply
    assert reply is not None
    answers = [instruction(id, 0, bytes(6)) for id in ids]
    requests = [read(id, 56, 6) for id in ids]
    line.send(chain, 0.0)
    now = line.deadline
    assert not line.feed(now)
    assert port.output == b"".join(requests[:2])
    for arrived, sent in zip(answers, (2, 3, 4, 4), strict=True):
        port.input = arrived
        line.feed(now)
        assert port.output == b"".join(requests[:sent])
    assert line.feed(now)
    line.end()
    assert reply.whole


def test_a_third_silent_servo_ends_the_chain() -> None:
    port = ScriptedPort()
    line = HalfDuplexTransactor(
        "main", port, baud=1_000_000, return_delay_s=0.0, slack=0.002, find_packets=find_packets
    )
    chain = chained_read((1, 2, 3, 4), 56, 6, lambda _: False, sync_read)
    line.send(chain, 0.0)
    for _ in range(5):
        line.feed(line.deadline)
    assert port.output == b"".join(read(id, 56, 6) for id in (1, 2, 3))


@pytest.mark.parametrize("silent", [1, 2, 3, 4])
def test_a_mixed_bus_reads_the_others_past_a_silent_servo(silent: int) -> None:
    rig = FeetechRig([FeetechServoSpec(id, sync_read=id % 2 == 0) for id in (1, 2, 3, 4)])
    rig.perform(rig.reader.identify())
    rig.ticks(5)
    rig.faults.silence(silent)
    others = np.array([1, 2, 3, 4]) != silent
    assert all(sample.heard[others].all() for sample in rig.ticks(20))


def asked(ids: tuple[int, ...], grouped: tuple[int, ...]) -> list[bytes]:
    """Requests of a read of 2 bytes at 56."""
    chain = chained_read(ids, 56, 2, grouped.__contains__, sync_read)
    return [chain.packet, *(request for _, request in chain.then)]


def test_two_or_more_servos_with_group_reads_are_asked_together_and_one_alone_like_the_others() -> None:
    single = {id: read(id, 56, 2) for id in (1, 2, 3)}
    assert asked((1, 2, 3), (1, 3)) == [sync_read((1, 3), 56, 2), single[2]]
    assert asked((1, 2, 3), (2,)) == [single[1], single[2], single[3]]
    assert asked((1, 2), (1, 2)) == [sync_read((1, 2), 56, 2)]
    assert asked((1,), (1,)) == asked((1,), ()) == [single[1]]


def test_the_echo_of_a_single_read_of_two_bytes_is_no_reply() -> None:
    """It has the form of a status with an error."""
    for ids, grouped in (((1,), ()), ((1, 2, 3), (2, 3))):
        reply = chained_read(ids, 56, 2, grouped.__contains__, sync_read).reply
        assert reply is not None
        echo = read(1, 56, 2)
        reply.receive_buffer()[: len(echo)] = echo
        assert not reply.take(len(echo))
        reply.end()
        assert not reply.heard.any()


@pytest.mark.parametrize("refusals", [None, True])
def test_an_error_alone_is_an_answer_where_the_family_says_so(refusals: bool | None) -> None:
    more = {} if refusals is None else {"refusals": refusals}
    reply = chained_read((1,), 56, 2, lambda _: False, sync_read, **more).reply
    assert reply is not None
    error = instruction(1, 0x20)
    reply.receive_buffer()[: len(error)] = error
    reply.take(len(error))
    reply.end()
    assert reply.answered.tolist() == [refusals is True]
