"""One servo of a bus driven by itself: weak, fenced by its own packets, and given back as it was."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.dynamixel_rig import LIMITS, Bench
from tests.support.examples import examples
from twind_drivers.bus import DeviceRefused, GroupWriteBatch, WireRangeError, WriteRequest
from twind_drivers.dynamixel.single_servo import SingleServoControl

HERE = 2
OTHER = 3
CAP = 100
PROFILE = 17
HELD = {
    65: (1, 1),
    84: (777, 2),
    80: (5, 2),
    102: (900, 2),
    108: (44, 4),
    112: (55, 4),
    48: (3500, 4),
    52: (500, 4),
}


def bench(**more: object) -> Bench:
    bus = Bench(**more)
    for address, (value, size) in HELD.items():
        bus.servos.put(HERE, address, value, size)
    return bus


def driven(bus: Bench) -> tuple[SingleServoControl, object]:
    """Entered, bounded, prepared, with torque."""
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    kept = bus.run(alone.look())
    bus.run(alone.enter_current_mode(kept))
    alone.set_goal_limits(1500, 2500)
    bus.run(alone.prepare(kept, 2000))
    bus.run(alone.energise())
    return alone, kept


def memory(bus: Bench, id: int) -> bytes:
    return bytes(bus.servos.memory[id])


def test_a_single_servo_is_prepared_and_read_back_and_no_other_is_written() -> None:
    bus = bench()
    others = {id: memory(bus, id) for id in bus.ids if id != HERE}
    driven(bus)
    got = {address: bus.servos.get(HERE, address, size) for address, size in ((11, 1), (64, 1), (98, 1))}
    assert got == {11: 5, 64: 1, 98: 5}
    assert bus.servos.get(HERE, 102, 2) == CAP and bus.servos.get(HERE, 112, 4) == PROFILE
    assert bus.servos.get(HERE, 116, 4) == 2000 and bus.servos.get(HERE, 100, 2) == LIMITS[36]
    assert {id: memory(bus, id) for id in others} == others


@given(st.integers(-5000, 9000))
@examples(60)
def test_no_goal_outside_its_window_ever_leaves(tick: int) -> None:
    bus = bench()
    alone, _ = driven(bus)
    before = len(bus.wire.writes)
    if 1500 <= tick <= 2500:
        alone.goal(tick)
        bus.cycle()
        assert bus.servos.get(HERE, 116, 4) == tick
        assert len(bus.wire.writes) == before + 1, "goal and question leave in one call"
    else:
        with pytest.raises(WireRangeError):
            alone.goal(tick)
        bus.cycle()
        assert bus.servos.get(HERE, 116, 4) == 2000


@pytest.mark.parametrize(
    "order",
    [
        WriteRequest({HERE: (2600).to_bytes(4, "little")}, 116),  # a goal outside its window
        WriteRequest({HERE: (CAP + 1).to_bytes(2, "little")}, 102),  # more current than its cap
        WriteRequest({HERE: (1).to_bytes(4, "little")}, 104),  # a speed
        WriteRequest({OTHER: (2000).to_bytes(4, "little")}, 116),  # somebody else
        WriteRequest({HERE: (2000).to_bytes(4, "little"), OTHER: (2000).to_bytes(4, "little")}, 116),
    ],
)
def test_the_last_look_lets_nothing_else_pass(order: WriteRequest) -> None:
    bus = bench()
    driven(bus)
    for each in (order, GroupWriteBatch((order,))):
        with pytest.raises(WireRangeError):
            bus.writer.begin(each, 0.0)
    with pytest.raises(WireRangeError):
        bus.writer.goals(np.full(3, 2000))
    bus.writer.end_single_device()
    bus.writer.goals(np.full(3, 2000))


def test_before_its_window_is_known_no_goal_leaves() -> None:
    bus = bench()
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    with pytest.raises(WireRangeError):
        alone.goal(2000)
    with pytest.raises(WireRangeError):
        bus.run(alone.prepare(bus.run(alone.look()), 2000))


def test_torque_off_for_all_is_never_held_up() -> None:
    bus = bench()
    driven(bus)
    bus.run(bus.writer.torque(False))
    assert [bus.servos.get(id, 64, 1) for id in bus.ids] == [0, 0, 0]


@pytest.mark.parametrize("energised", [True, False])
def test_a_single_servo_is_restored_to_its_former_registers(energised: bool) -> None:
    bus = bench()
    before = memory(bus, HERE)
    _, kept = driven(bus)
    if not energised:
        bus.run(bus.writer.torque(False))
    for address, size in ((80, 2), (84, 2), (102, 2), (108, 4), (112, 4)):  # what the change of mode resets
        bus.servos.put(HERE, address, 9, size)
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    bus.writer.end_single_device()
    bus.run(alone.give_back(kept))
    after = memory(bus, HERE)
    assert {at for at in range(len(before)) if before[at] != after[at]} <= set(range(116, 120)), (
        "not the goal"
    )
    assert (bus.servos.get(HERE, 64, 1), bus.servos.get(HERE, 98, 1)) == (0, 0)


def test_a_register_that_cannot_be_restored_is_named_with_both_values() -> None:
    bus = bench()
    alone, kept = driven(bus)
    bus.writer.end_single_device()
    bus.servos.frozen[HERE] = {11}
    with pytest.raises(DeviceRefused, match=r"Operating Mode \(11\): was 3, reads 5"):
        bus.run(alone.give_back(kept))
    bus.servos.frozen[HERE] = {84, 85}
    bus.servos.put(HERE, 84, 1, 2)
    with pytest.raises(DeviceRefused, match=r"Position P Gain \(84\): was 777, reads 1"):
        bus.run(alone.give_back(kept))
    bus.servos.put(HERE, 64, 1, 1)
    bus.servos.frozen[HERE] = {64}
    with pytest.raises(DeviceRefused, match=r"Torque Enable \(64\).*cut its supply"):
        bus.run(alone.give_back(kept))


@pytest.mark.parametrize(
    ("address", "value", "why"),
    [(64, 1, "is on: disarm"), (70, 32, "0x20"), (10, 8, "bits 1 and 3"), (10, 2, "bits 1 and 3")],
)
def test_a_servo_unfit_for_single_control_is_refused_before_any_write(
    address: int, value: int, why: str
) -> None:
    bus = bench()
    bus.servos.put(HERE, address, value, 1)
    before = memory(bus, HERE)
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    with pytest.raises(DeviceRefused, match=why):
        bus.run(alone.look())
    assert memory(bus, HERE) == before


@pytest.mark.parametrize("address", [11, 98, 102, 84, 112, 116, 64])
def test_a_servo_that_does_not_take_a_register_gets_no_torque(address: int) -> None:
    bus = bench()
    bus.servos.frozen[HERE] = {address}
    with pytest.raises(DeviceRefused):
        driven(bus)
    assert bus.servos.get(HERE, 64, 1) == 0


@pytest.mark.parametrize("prepared", [False, True])
def test_a_servo_that_is_in_another_mode_by_then_gets_no_torque(prepared: bool) -> None:
    bus = bench()
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    kept = bus.run(alone.look())
    bus.run(alone.enter_current_mode(kept))
    alone.set_goal_limits(1500, 2500)
    if prepared:
        bus.run(alone.prepare(kept, 2000))
    bus.servos.put(HERE, 11, 3, 1)
    with pytest.raises(DeviceRefused, match=r"Operating Mode \(11\): wrote 5, reads 3"):
        bus.run(alone.energise() if prepared else alone.prepare(kept, 2000))
    assert bus.servos.get(HERE, 64, 1) == 0


def test_a_servo_that_is_in_that_mode_already_stays_in_it() -> None:
    bus = bench(modes=[3, 5, 3], current_caps=[None, 500, None])
    bus.servos.put(HERE, 102, 500, 2)
    alone, kept = driven(bus)
    assert bus.servos.get(HERE, 102, 2) == CAP
    bus.writer.end_single_device()
    bus.run(alone.give_back(kept))
    assert bus.servos.get(HERE, 11, 1) == 5 and bus.servos.get(HERE, 64, 1) == 0
    assert bus.servos.get(HERE, 102, 2) == 500


def test_a_goal_current_of_power_on_above_the_cap_of_its_mode_does_not_fail_its_restoring() -> None:
    """It is the current limit then. `prepare` sets the cap anew; until then that of the search stays."""
    bus = bench(modes=[3, 5, 3], current_caps=[None, 500, None])
    bus.servos.put(HERE, 102, LIMITS[38], 2)
    alone, kept = driven(bus)
    bus.writer.end_single_device()
    restored = bus.run(alone.give_back(kept))
    assert [(each.name, each.value, was) for each, was in restored.differing] == [
        ("Goal Current", CAP, LIMITS[38])
    ]
    assert bus.servos.get(HERE, 102, 2) == CAP and bus.servos.get(HERE, 64, 1) == 0


def test_a_write_refused_by_the_servo_is_reported_with_its_register() -> None:
    bus = bench()
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    kept = bus.run(alone.look())
    bus.servos.error[HERE] = 7  # Access Error
    with pytest.raises(DeviceRefused, match=r"Operating Mode \(11\) = 5"):
        bus.run(alone.enter_current_mode(kept))


def test_what_a_search_changes_is_described_with_the_former_mode() -> None:
    bus = bench(modes=[3, 4, 3])
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    left = alone.describe_leftovers(bus.run(alone.look()))
    assert left == "Operating Mode (11) 5 (was 4) and gains, profile and Goal Current of a search"


def test_a_time_based_profile_is_left_out() -> None:
    bus = bench()
    bus.servos.put(HERE, 10, 4, 1)
    driven(bus)
    assert bus.servos.get(HERE, 112, 4) == 0


def test_impossible_single_servo_control_raises_an_error_at_once() -> None:
    with pytest.raises(ValueError, match="has no id 9"):
        bench().writer.begin_single_device(9, cap=CAP, profile=PROFILE)
    with pytest.raises(ValueError, match="cap"):
        bench().writer.begin_single_device(HERE, cap=0, profile=PROFILE)
    small = bench(models=[1060, 1060, 1060])  # XL430: it measures no current
    with pytest.raises(ValueError, match="mode 5"):
        small.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    spinning = bench(modes=[3, 1, 3], lower=np.array([1000, -10, 1000]), upper=np.array([3000, 10, 3000]))
    with pytest.raises(ValueError, match="no positions"):
        spinning.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
