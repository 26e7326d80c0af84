"""The wire of virtual CAN actuators: bits of a frame, arbitration, time, acknowledgement."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.support.virtual_can_host import LIMP, CanHost, mit
from twind_drivers.ports.frame import EXTENDED, REMOTE
from twind_drivers.virtual.can.can_controller import CanAdapter
from twind_drivers.virtual.can.can_message import CanMessage, as_frames, bits, messages, rank
from twind_drivers.virtual.can.node_spec import NodeSpec

ids = st.one_of(
    st.integers(0, 0x7FF),
    st.integers(0, 0x1FFFFFFF).map(lambda id: id | EXTENDED),
    st.integers(0, 0x7FF).map(lambda id: id | REMOTE),
    st.integers(0, 0x1FFFFFFF).map(lambda id: id | EXTENDED | REMOTE),
)
frames = st.builds(CanMessage, ids, st.binary(max_size=8))


def spelled(message: CanMessage) -> list[int]:
    """The stuffed part of a frame, bit by bit as ISO 11898-1 lists it: start, id, control, data, CRC."""
    id, data = message
    remote = int(bool(id & REMOTE))
    whole = id & 0x1FFFFFFF

    def word(value: int, width: int) -> list[int]:
        return [value >> place & 1 for place in reversed(range(width))]

    if id & EXTENDED:
        line = [0, *word(whole >> 18, 11), 1, 1, *word(whole & 0x3FFFF, 18), remote, 0, 0]
    else:
        line = [0, *word(whole, 11), remote, 0, 0]
    line += word(len(data), 4)
    for byte in b"" if remote else data:
        line += word(byte, 8)
    crc = 0
    for bit in line:
        turn = bit ^ crc >> 14 & 1
        crc = crc << 1 & 0x7FFF ^ (0x4599 if turn else 0)
    return line + word(crc, 15)


@given(frames)
def test_a_frame_takes_its_own_bits_and_its_own_stuff_bits(message: CanMessage) -> None:
    line = spelled(message)
    sent = []
    for bit in line:
        sent.append(bit)
        if len(sent) >= 5 and len(set(sent[-5:])) == 1 and stuffable(sent):
            sent.append(1 - bit)
    assert bits(message) == len(sent) + 13


def stuffable(sent: list[int]) -> bool:
    """Five equal bits since the run began: a run longer than five cannot be, its sixth is a stuff bit."""
    run = 0
    for bit in reversed(sent):
        if bit != sent[-1]:
            break
        run += 1
    return run == 5


@given(frames)
def test_the_length_of_a_frame_of_eight_bytes_is_within_the_computed_range(message: CanMessage) -> None:
    """Facts 7: 111 to 135 bits, with 29-bit ids 131 to 160."""
    whole = CanMessage(message.id & ~REMOTE, message.data.ljust(8, b"\0"))
    low, high = (131, 160) if whole.id & EXTENDED else (111, 135)
    assert low <= bits(whole) <= high


@given(frames, frames)
def test_the_first_recessive_bit_loses(one: CanMessage, other: CanMessage) -> None:
    def field(id: int) -> list[int]:
        return spelled(CanMessage(id))[: 34 if id & EXTENDED else 14]

    mine = field(one.id)
    others = field(other.id)
    if mine != others:
        assert (rank(one.id) < rank(other.id)) == (mine < others)


@given(st.lists(frames))
def test_frames_and_messages_are_the_same(listed: list[CanMessage]) -> None:
    assert messages(as_frames(listed)) == listed


def nodes(*ids: int) -> list[NodeSpec]:
    return [NodeSpec(id, "DM4310", feedback_id=0x10 + id) for id in ids]


def test_answers_compete_with_commands_by_their_ids() -> None:
    """Commands 1, 2, 3 and answers 11, 12, 13: every command goes before every answer."""
    host = CanHost(nodes(1, 2, 3))
    host.bus.take_host_frames(as_frames([CanMessage(id, LIMP) for id in (3, 2, 1)]), 0.0)
    assert [each.id for each in host.wait(0.01)] == [0x11, 0x12, 0x13]
    low = CanHost([NodeSpec(id, "DM4310", feedback_id=id - 0x20) for id in (0x21, 0x22, 0x23)])
    assert [each.id for each in low.ask(*[(id, LIMP) for id in (0x23, 0x22, 0x21)])] == [3, 2, 1]


def test_a_command_and_its_answer_take_their_bits_and_no_more() -> None:
    host = CanHost(nodes(1))
    host.bus.take_host_frames(as_frames([CanMessage(1, LIMP)]), 0.0)
    while np.isfinite(due := host.bus.next_output_time()):
        host.bus.advance(due)
        if host.bus.controller.inbox:
            break
    answer = host.bus.controller.inbox[0]
    assert due == (bits(CanMessage(1, LIMP)) + bits(answer)) / 1e6


def test_due_is_never_late_and_comes_to_an_end() -> None:
    host = CanHost(nodes(1, 2, 3, 4))
    host.bus.take_host_frames(as_frames([CanMessage(id, LIMP) for id in (1, 2, 3, 4)]), 0.0)
    heard = 0
    rounds = 0
    while (due := host.bus.next_output_time()) < np.inf:
        assert not host.bus.give_host_frames(np.nextafter(due, 0.0)).size
        heard += len(host.bus.give_host_frames(due))
        rounds += 1
    assert heard == 4
    assert rounds < 30


def test_without_power_nothing_leaves_and_all_of_it_leaves_when_power_returns() -> None:
    """Facts 8, no acknowledger: retransmitted for ever, and replayed."""
    host = CanHost(nodes(1, 2))
    assert [each.data[0] >> 4 for each in host.ask((1, mit(0xFC)), (2, mit(0xFC)))] == [1, 1]
    host.faults.power(False)
    far = bytes.fromhex("BFFF7FF1993337FF")
    for _ in range(10):
        assert host.ask((1, mit(0xFC)), (1, far)) == []
    assert host.bus.controller.backlog() == 20
    host.faults.power(True)
    heard = host.wait(1.0)
    assert host.bus.controller.backlog() == 0
    assert {each.id for each in heard} == {0x11}
    assert host.truth()["torque"], "enabled by an order of long ago"
    assert host.truth()["position"] > 1000, "and on its way to a goal of long ago"
    assert not host.truth(1)["torque"]


def test_a_full_queue_refuses_and_a_purge_empties_it() -> None:
    host = CanHost(nodes(1), adapter=CanAdapter(queue=5))
    host.faults.power(False)
    refused = host.bus.take_host_frames(as_frames([CanMessage(1, LIMP)] * 8), 0.0)
    assert (refused, host.bus.controller.backlog()) == (3, 5)
    host.bus.controller.purge()
    host.faults.power(True)
    assert host.wait(1.0) == []


def test_another_node_acknowledges_in_place_of_a_silent_one() -> None:
    host = CanHost(nodes(1, 2))
    host.faults.silence(1)
    assert host.ask((1, LIMP)) == []
    assert host.bus.controller.backlog() == 0, "sent, and heard by nobody whom it was for"
    host.faults.silence(2)
    host.ask((2, LIMP))
    assert host.bus.controller.backlog() == 1


def test_a_controller_at_another_rate_neither_receives_nor_sends() -> None:
    host = CanHost([NodeSpec(3, "ODrive", settings={"heartbeat": 0.01})])
    host.bus.controller.rate = 500_000
    assert host.ask((3 << 5 | 9, b"")) == []
    assert host.bus.controller.backlog() == 1
