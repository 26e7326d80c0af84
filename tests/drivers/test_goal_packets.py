"""The goal packet: equal to a sync write, stuffed where needed, and judged by its own bytes (WIRE_CLAMP)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind_drivers.bus import WireRangeError
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.device_layout import RegisterBlock
from twind_drivers.dynamixel.goal_packets import GoalPacket, Goals, goal_packets

IDS = (1, 252, 7)
WIDE = 2**31 - 1
GOAL = RegisterBlock(116, 4)


def goals(lower: int = -WIDE, upper: int = WIDE, ids: tuple[int, ...] = IDS) -> GoalPacket:
    return GoalPacket("bus", ids, GOAL, np.full(len(ids), lower), np.full(len(ids), upper))


@given(
    st.lists(
        st.one_of(st.integers(-WIDE, WIDE), st.sampled_from([-131073, -3, 0xFDFFFF])), min_size=3, max_size=3
    )
)
@examples(200)
def test_the_goal_packet_equals_a_sync_write_of_the_same_goals(ticks: list[int]) -> None:
    data = goals().encode(np.array(ticks))
    assert data == p.sync_write(
        116, {id: tick.to_bytes(4, "little", signed=True) for id, tick in zip(IDS, ticks, strict=True)}
    )
    [found] = p.Framer(status=False).feed(data)
    assert len(found.params) == 4 + 5 * 3


def test_the_one_goal_that_needs_stuffing_is_stuffed() -> None:
    data = goals(ids=(1,)).encode(np.array([-131073]))
    assert b"\xff\xff\xfd\xfd\xff" in data
    assert len(p.sync_write(116, {1: bytes(4)})) + 1 == len(data)


def test_a_pattern_across_two_rows_is_stuffed() -> None:
    data = goals(ids=(1, 0xFD - 1)).encode(np.array([-1, 0]))
    assert b"\xff\xff\xfc" in data
    edge = goals(ids=(1, 2)).encode(np.array([-3, 5]))  # FD FF FF FF | 02: none
    assert p.STUFFED not in edge


@pytest.mark.parametrize("tick", [999, 3001, -1, 2**31, 2**32 + 2000, -(2**40), 2**62])
def test_a_goal_outside_is_not_encoded_and_named(tick: int) -> None:
    packet = goals(1000, 3000)
    with pytest.raises(WireRangeError, match=rf"id 252: goal {tick} outside 1000..3000"):
        packet.encode(np.array([2000, tick, 2000]))
    packet.encode(np.array([1000, 3000, 2000]))  # the edges are inside


def test_a_stuffed_goal_is_judged_too() -> None:
    with pytest.raises(WireRangeError, match="-131073"):
        goals(0, 4095).encode(np.array([0, -131073, 0]))


@pytest.mark.parametrize("ticks", [np.array([1, 2]), np.array([1.0, 2.0, np.nan]), np.array([[1, 2, 3]])])
def test_anything_but_one_whole_tick_per_device_is_refused(ticks: np.ndarray) -> None:
    with pytest.raises(ValueError, match="whole ticks"):
        goals().encode(ticks)


@pytest.mark.parametrize("at", [7, 8, 10, 12, 17])  # instruction, address, length, ids
def test_a_packet_whose_frame_was_damaged_in_memory_is_not_handed_out(at: int) -> None:
    packet = goals()
    packet.packet[at] ^= 1
    with pytest.raises(WireRangeError):
        packet.encode(np.array([1, 2, 3]))


def test_bounds_must_be_ordered_and_of_the_right_number() -> None:
    with pytest.raises(ValueError, match="must not be above"):
        goals(2, 1)
    with pytest.raises(ValueError, match="bounds of 2"):
        GoalPacket("bus", (1, 2), GOAL, np.zeros(3, int), np.zeros(2, int))


def test_a_packet_handed_out_is_not_changed_by_the_next() -> None:
    packet = goals()
    first = packet.encode(np.array([1, 2, 3]))
    copy = bytes(first)
    packet.encode(np.array([4, 5, 6]))
    assert first == copy


def test_a_goal_that_ends_in_the_pattern_is_stuffed() -> None:
    tick = int.from_bytes(b"\x00\xff\xff\xfd", "little", signed=True)
    data = goals(ids=(1,)).encode(np.array([tick]))
    assert data == p.sync_write(116, {1: b"\x00\xff\xff\xfd"})
    assert p.STUFFED in data


# ------------------------------------------------------------------------- goals in different registers

CURRENT = RegisterBlock(102, 2)


def test_devices_that_keep_their_goals_in_one_register_get_one_packet() -> None:
    low = np.full(3, -5)
    high = np.full(3, 5)
    packet = goal_packets("bus", IDS, (GOAL, GOAL, GOAL), low, high)
    assert isinstance(packet, GoalPacket)
    assert packet.encode(np.array([1, 2, 3])) == goals(-5, 5).encode(np.array([1, 2, 3]))
    alone = goal_packets("bus", (7,), (GOAL,), low[:1], high[:1])
    assert alone.encode(np.array([4])) == goals(-5, 5, (7,)).encode(np.array([4]))


def mixed(lower: tuple[int, ...] = (-10, -20, -30), upper: tuple[int, ...] = (10, 20, 30)) -> Goals:
    return goal_packets("bus", IDS, (GOAL, CURRENT, GOAL), np.array(lower), np.array(upper))


def test_goals_in_two_registers_are_two_packets_each_with_its_own_devices() -> None:
    packet = mixed()
    assert packet.encode(np.array([10, -20, 30])) == p.sync_write(
        116, {1: (10).to_bytes(4, "little"), 7: (30).to_bytes(4, "little")}
    ) + p.sync_write(102, {252: (-20).to_bytes(2, "little", signed=True)})
    assert (packet.lower.tolist(), packet.upper.tolist()) == ([-10, -20, -30], [10, 20, 30])


@pytest.mark.parametrize(("place", "id"), list(enumerate(IDS)))
def test_each_goal_is_held_to_the_bounds_of_its_own_device(place: int, id: int) -> None:
    ticks = np.array([10, 20, 30])
    ticks[place] += 1
    with pytest.raises(WireRangeError, match=f"id {id}: goal {ticks[place]} "):
        mixed().encode(ticks)


@pytest.mark.parametrize("ticks", [np.array([1, 2]), np.array([1.0, 2.0, 3.0]), np.array([[1, 2, 3]])])
def test_mixed_goals_need_one_whole_tick_per_device_too(ticks: np.ndarray) -> None:
    with pytest.raises(ValueError, match="3 whole ticks"):
        mixed().encode(ticks)


def test_a_reversed_pair_of_bounds_is_refused() -> None:
    with pytest.raises(ValueError, match="must not be above"):
        mixed((-10, 21, -30))
    assert mixed((10, 20, 30)).encode(np.array([10, 20, 30]))  # equal bounds leave one goal
    with pytest.raises(ValueError, match="must not be above"):
        GoalPacket("bus", (1, 2), GOAL, np.array([0, 5]), np.array([1, 4]))
    with pytest.raises(ValueError, match="bounds of 3"):
        mixed(upper=(1, 2))
    with pytest.raises(ValueError, match="bounds of 3"):
        mixed(lower=(1, 2))
