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
