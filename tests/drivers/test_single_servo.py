"""One servo of a bus driven by itself: weak, fenced by its own packets, and given back as it was."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.dynamixel_rig import LIMITS, Bench
from tests.support.examples import examples
from twind_drivers.bus import (
    DeviceRefused,
    GroupWriteBatch,
    ReadRequest,
    RequestReply,
    WireRangeError,
    WriteRequest,
)
from twind_drivers.dynamixel.control_tables import table
from twind_drivers.dynamixel.packet import Instruction
from twind_drivers.dynamixel.single_servo import SavedSettings, SingleServoControl

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


def entered(bus: Bench, profile: int = PROFILE) -> tuple[SingleServoControl, SavedSettings]:
    """In its mode, and bounded."""
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=profile)
    kept = bus.run(alone.look())
    bus.run(alone.enter_current_mode(kept))
    alone.set_goal_limits(1500, 2500)
    return alone, kept


def driven(bus: Bench) -> tuple[SingleServoControl, SavedSettings]:
    """Entered, bounded, prepared, with torque."""
    alone, kept = entered(bus)
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


@pytest.mark.parametrize("id", [HERE, OTHER])
@pytest.mark.parametrize("goal", [-1, 0, 1])
def test_before_its_window_is_known_no_goal_of_any_servo_passes(id: int, goal: int) -> None:
    bus = bench()
    bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    with pytest.raises(WireRangeError) as refused:
        bus.writer.begin(WriteRequest({id: goal.to_bytes(4, "little", signed=True)}, 116), 0.0)
    error = refused.value
    assert (error.id, error.value, error.lower, error.upper) == (id, goal, 0, -1)


def test_a_refused_goal_leaves_none_pending() -> None:
    bus = bench()
    alone, _ = driven(bus)
    alone.goal(2100)
    with pytest.raises(WireRangeError):
        alone.goal(2501)
    bus.cycle()
    assert bus.servos.get(HERE, 116, 4) == 2000


def test_before_its_window_is_known_no_goal_leaves() -> None:
    bus = bench()
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    with pytest.raises(WireRangeError) as refused:
        alone.goal(2000)
    assert (refused.value.lower, refused.value.upper) == (0, -1)
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
    alone, kept = entered(bus)
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


def test_a_mode_that_is_not_taken_is_refused_when_it_is_entered() -> None:
    bus = bench()
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    bus.servos.frozen[HERE] = {11}
    with pytest.raises(DeviceRefused, match=r"Operating Mode \(11\): wrote 5, reads 3"):
        bus.run(alone.enter_current_mode(bus.run(alone.look())))


def test_a_write_without_status_is_judged_by_its_value_read_back() -> None:
    bus = bench()
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    script = alone.enter_current_mode(bus.run(alone.look()))
    assert next(script) == WriteRequest({HERE: bytes((5,))}, 11)
    assert script.send(RequestReply({}, {}, 0.0, 0)) == ReadRequest((HERE,), 11, 1)
    with pytest.raises(StopIteration):
        script.send(RequestReply({HERE: bytes((5,))}, {HERE: 0}, 0.0, 0))


def test_gains_are_those_of_the_writer_and_profile_and_force_are_not_those_of_before() -> None:
    bus = bench(gains=[(1, 2, 3), (0x0321, 0x0123, 0x0213), (1, 2, 3)])
    bus.servos.put(HERE, 100, 300, 2)
    driven(bus)
    assert [bus.servos.get(HERE, address, 2) for address in (84, 82, 80)] == [0x0321, 0x0123, 0x0213]
    assert bus.servos.get(HERE, 100, 2) == LIMITS[36]
    assert bus.servos.get(HERE, 108, 4) == 0


def test_the_watchdog_is_cleared_before_the_goal_and_armed_after_it() -> None:
    bus = bench()
    driven(bus)
    written = [each.params for each in bus.servos.seen if each.instruction == Instruction.WRITE]
    places = [int.from_bytes(params[:2], "little") for params in written]
    assert places[:2] == [11, 98] and written[1][2:] == b"\0"
    assert places.index(116) < places.index(98, 2) < places.index(64)


def test_a_servo_whose_torque_comes_on_during_preparation_is_refused() -> None:
    bus = bench()
    alone, kept = entered(bus)
    bus.servos.put(HERE, 64, 1, 1)
    with pytest.raises(DeviceRefused, match=r"Torque Enable \(64\): wrote 0, reads 1"):
        bus.run(alone.prepare(kept, 2000))


@pytest.mark.parametrize(("address", "size", "name"), [(102, 2, "Goal Current"), (98, 1, "Bus Watchdog")])
def test_torque_is_refused_to_a_servo_that_lost_its_cap_or_its_watchdog(
    address: int, size: int, name: str
) -> None:
    """It restarted after its preparation."""
    bus = bench()
    alone, kept = entered(bus)
    bus.run(alone.prepare(kept, 2000))
    bus.servos.put(HERE, address, 0, size)
    with pytest.raises(DeviceRefused, match=rf"{name} \({address}\): wrote \d+, reads 0"):
        bus.run(alone.energise())


def test_torque_counts_as_unknown_from_its_order_on() -> None:
    bus = bench()
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    bus.reader.registers.torque[:] = 0
    script = alone.energise()
    assert next(script) == ReadRequest((HERE,), 11, 1)
    assert script.send(RequestReply({HERE: bytes((5,))}, {HERE: 0}, 0.0, 0)) == WriteRequest(
        {HERE: b"\1"}, 64
    )
    assert bus.reader.registers.torque.tolist() == [0, -1, 0]


def test_beside_a_cap_that_stays_another_difference_is_an_error() -> None:
    bus = bench(modes=[3, 5, 3], current_caps=[None, 500, None])
    alone, kept = driven(bus)
    bus.writer.end_single_device()
    bus.servos.frozen[HERE] = set(range(112, 116))
    with pytest.raises(DeviceRefused, match=rf"Profile Velocity \(112\): was 55, reads {PROFILE}"):
        bus.run(alone.give_back(kept))


def test_a_profile_that_its_register_does_not_hold_is_refused_before_torque() -> None:
    bus = bench()
    alone, kept = entered(bus, 10**6)
    with pytest.raises(ValueError, match="1000000"):
        bus.run(alone.prepare(kept, 2000))
    assert bus.servos.get(HERE, 112, 4) == 55


def test_a_gripper_without_drive_mode_is_driven_and_restored() -> None:
    gripper = 35074
    bus = Bench(
        models=[1020, gripper, 1020],
        modes=[3, 5, 3],
        current_caps=[None, 500, None],
        gains=[(1, 2, 3)] * 3,
        lower=np.array([1000, 0, 1000]),
        upper=np.array([3000, 1150, 3000]),
    )
    profile = table(gripper)["profile_velocity"]
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    kept = bus.run(alone.look())
    alone.set_goal_limits(100, 200)
    bus.run(alone.prepare(kept, 150))
    bus.run(alone.energise())
    assert bus.servos.get(HERE, profile.address, profile.size) == PROFILE
    bus.writer.end_single_device()
    bus.run(alone.give_back(kept))
    assert bus.servos.get(HERE, profile.address, profile.size) == 0


@pytest.mark.parametrize("error", [1, 7])
def test_a_write_refused_by_the_servo_is_reported_with_its_register(error: int) -> None:
    bus = bench()
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    kept = bus.run(alone.look())
    bus.servos.error[HERE] = error  # Result Fail, Access Error
    with pytest.raises(DeviceRefused, match=r"Operating Mode \(11\) = 5"):
        bus.run(alone.enter_current_mode(kept))


def test_what_a_search_changes_is_described_with_the_former_mode() -> None:
    bus = bench(modes=[3, 4, 3])
    alone = bus.writer.begin_single_device(HERE, cap=CAP, profile=PROFILE)
    left = alone.describe_leftovers(bus.run(alone.look()))
    assert left == "Operating Mode (11) 5 (was 4) and gains, profile and Goal Current of a search"


def test_a_reversed_servo_is_driven_with_its_profile_as_a_speed() -> None:
    bus = bench()
    bus.servos.put(HERE, 10, 1, 1)
    driven(bus)
    assert bus.servos.get(HERE, 112, 4) == PROFILE


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
