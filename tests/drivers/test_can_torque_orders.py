"""Orders of torque over CAN: to whom they go again, what is awaited by reading, what ends in a refusal."""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from tests.support.can_driver_rig import CanRig
from tests.support.driver_rig import both
from twind_drivers.bus import (
    DeviceRefused,
    GroupWriteBatch,
    NoReply,
    ReadRequest,
    Request,
    RequestReply,
    Script,
)
from twind_drivers.can.actuator_family import SILENCE, ValuelessCommand
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.register_access import ADDRESS, COMMAND, STATE

DM = ("DM4310",) * 3
ENABLE, DISABLE, CLEAR = (
    ADDRESS[each] for each in (ValuelessCommand.ENABLE, ValuelessCommand.DISABLE, ValuelessCommand.CLEAR)
)
WAITED = 0.002  # s, of each request


def aimed(models: Sequence[str], barred: Sequence[int] = ()) -> CanRig:
    """A rig with a goal to hold, 100 counts, whose torque can be ordered; `barred`: ids."""
    rig = CanRig(models)
    rig.reader.cyclic.barred[[id - 1 for id in barred]] = True
    next(rig.writer.write_goals(np.full(rig.m, 100)))
    return rig


def played(rig: CanRig, script: Script[None], *reported: Sequence[int]) -> list[Request]:
    """The requests of a script; after each of them these torque states (m,) have been reported."""
    requests = [next(script)]
    for torque in reported:
        rig.registers.torque[:] = torque
        try:
            requests.append(script.send(RequestReply({}, {}, WAITED, 0)))
        except StopIteration:
            break
    return requests


def orders(request: Request) -> list[tuple[int, list[int]]]:
    """The addresses that a batch writes, and the ids each."""
    assert isinstance(request, GroupWriteBatch)
    return [(write.address, sorted(write.data)) for write in request.writes]


def read(*ids: int) -> ReadRequest:
    return ReadRequest(ids, STATE, 3)


def stiffness(request: Any) -> list[float]:
    """The stiffness of each command in a batch, N·m/rad."""
    return [struct.unpack("<5d", data)[2] for data in request.writes[-1].data.values()]


# ------------------------------------------------------------------------------------- on


def test_torque_and_a_soft_command_go_again_to_those_alone_that_do_not_report_it() -> None:
    rig = aimed(DM)
    requests = played(rig, rig.writer.torque(True), [1, -1, 0], [1, -1, 1], [1, 1, 1])
    assert [orders(each) for each in requests] == [
        [(ENABLE, [1, 2, 3]), (COMMAND, [1, 2, 3])],
        [(ENABLE, [2, 3]), (COMMAND, [2, 3])],
        [(ENABLE, [2]), (COMMAND, [2])],
        [(COMMAND, [1, 2, 3])],
    ]
    assert [stiffness(each) for each in requests] == [[0.0] * 3, [0.0] * 2, [0.0], [40.0] * 3]


def test_an_actuator_that_had_torque_is_commanded_again_and_not_enabled() -> None:
    rig = aimed(DM)
    rig.registers.torque[:] = [1, 0, 1]
    requests = played(rig, rig.writer.torque(True), [-1, -1, 1])
    assert [orders(each) for each in requests] == [
        [(ENABLE, [2]), (COMMAND, [1, 2, 3])],
        [(ENABLE, [2]), (COMMAND, [1, 2])],
    ]
    assert [stiffness(each) for each in requests] == [[40.0, 0.0, 40.0], [40.0, 0.0]]


@pytest.mark.parametrize("model", ["AK70-10", "DM4310", "RS01"])
def test_an_actuator_that_missed_its_first_order_has_torque_when_the_script_ends(model: str) -> None:
    """A CubeMars answers a command without torque just as with it."""
    rig = CanRig((model,) * 2)
    here = rig.positions()
    rig.beside(both(rig, here))
    script = rig.stepped(rig.writer.torque(True))
    rig.faults.silence(2)
    next(script)
    rig.faults.silence(2, False)
    for _ in script:
        pass
    assert rig.registers.torque.tolist() == [1, 1]
    assert rig.energised().tolist() == [True, True]


def test_a_barred_actuator_gets_no_order_and_counts_in_no_check() -> None:
    rig = aimed(DM, barred=[1])
    rig.reader.cyclic.place[:] = 0.0
    script = rig.writer.torque(True)
    next(script)
    rig.reader.cyclic.place[0] = 1.0
    rig.registers.torque[:] = [-1, 1, 1]
    last = script.send(RequestReply({}, {}, WAITED, 0))
    assert orders(last) == [(COMMAND, [2, 3])]


def test_a_barred_cubemars_is_not_taken_for_one_that_holds() -> None:
    rig = CanRig(("AK70-10",) * 2)
    here = rig.positions()
    rig.reader.cyclic.barred[1] = True
    rig.beside(rig.writer.write_goals(here))
    rig.beside(rig.writer.torque(True))
    assert rig.registers.torque.tolist() == [1, -1]
    assert rig.energised().tolist() == [True, False]


def test_a_cubemars_that_was_switched_off_beside_a_silent_one_is_enabled_at_the_next_torque_on() -> None:
    rig = CanRig(("AK70-10", "AK70-10", "DM4310"))
    here = rig.positions()
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here))
    rig.faults.silence(3)
    script = rig.writer.torque(True)
    request = next(script)
    for _ in range(4):
        request = script.send(rig.transact(request))
    assert rig.energised().tolist() == [True, True, False]
    rig.faults.drop(1, 2)  # of its answers to the orders off one is missing
    with pytest.raises(NoReply, match=r"\[3\]"):
        script.send(rig.transact(request))
    assert rig.energised().tolist() == [False, False, False]
    assert rig.registers.torque.tolist() == [0, -1, -1]
    rig.faults.silence(3, False)
    rig.ticks(5)
    rig.beside(both(rig, here))
    rig.beside(rig.writer.torque(True))
    assert rig.energised().tolist() == [True, True, True]


def test_torque_without_a_goal_is_refused_in_the_name_of_the_first_actuator() -> None:
    with pytest.raises(DeviceRefused, match="write its aim") as refused:
        next(CanRig(DM).writer.torque(True))
    assert refused.value.id == 1


# ------------------------------------------------------------------------------------- awaited by reading


def test_axes_that_answer_no_order_are_read_until_each_reports_its_torque() -> None:
    rig = aimed(("DM4310", "ODrive", "ODrive"))
    requests = played(rig, rig.writer.torque(True), [1, -1, -1], [1, 0, 1], [1, 1, 1])
    assert requests[1:3] == [read(2, 3), read(2)]
    assert orders(requests[3]) == [(COMMAND, [1, 2, 3])]


def test_axes_are_read_after_three_further_orders_to_an_actuator_without_a_reply() -> None:
    rig = aimed(("DM4310", "ODrive"))
    requests = played(rig, rig.writer.torque(True), *[[-1, -1]] * 4, [-1, 1])
    assert [orders(each) for each in requests[1:4]] == [[(ENABLE, [1]), (COMMAND, [1])]] * 3
    assert requests[4] == read(2)
    assert orders(requests[5]) == [(DISABLE, [1, 2])] * 2, "of the failure"


def test_torque_that_an_axis_reports_in_the_last_of_sixty_reads_counts() -> None:
    rig = aimed(("ODrive",))
    requests = played(rig, rig.writer.torque(True), *[[0]] * 60, [1])
    assert requests[1:-1] == [read(1)] * 60
    assert orders(requests[-1]) == [(COMMAND, [1])]


def test_torque_that_an_axis_does_not_report_in_sixty_reads_is_switched_off_and_reported() -> None:
    rig = aimed(("ODrive",))
    script = rig.writer.torque(True)
    requests = played(rig, script, *[[-1]] * 61)
    assert requests[1:-1] == [read(1)] * 60
    assert orders(requests[-1]) == [(DISABLE, [1])] * 2
    with pytest.raises(NoReply, match="torque on") as missing:
        script.send(RequestReply({}, {}, WAITED, 0))
    assert missing.value.waited == pytest.approx(61 * WAITED)


def test_an_axis_that_is_read_is_ordered_off_again_each_twelfth_time() -> None:
    rig = CanRig(("DM4310", "ODrive", "ODrive"))
    script = rig.writer.torque(False)
    requests = played(rig, script, *[[0, 1, 0]] * 60)
    with pytest.raises(DeviceRefused, match="ordered off, reads on") as refused:
        script.send(RequestReply({}, {}, WAITED, 0))
    assert refused.value.id == 2
    assert orders(requests[0]) == [(DISABLE, [1, 2, 3])] * 2
    ordered = [at for at, request in enumerate(requests) if isinstance(request, GroupWriteBatch)]
    assert ordered == [0, 12, 24, 36, 48, 60]
    assert all(orders(requests[at]) == [(DISABLE, [2])] * 2 for at in ordered[1:])
    assert all(request == read(2) for at, request in enumerate(requests) if at not in ordered)


@pytest.mark.parametrize("model", ["AK70-10", "DM4310", "RS01", "ODrive"])
def test_an_actuator_that_missed_both_orders_off_is_without_torque_when_the_script_ends(model: str) -> None:
    rig = CanRig((model,) * 2)
    rig.ticks(20, rig.arm())
    script = rig.stepped(rig.writer.torque(False))
    rig.faults.silence(2)
    next(script)
    rig.faults.silence(2, False)
    assert rig.energised().tolist() == [False, True]
    for _ in script:
        pass
    assert rig.registers.torque.tolist() == [0, 0]
    assert not rig.energised().any()


# ------------------------------------------------------------------------------------- off


def test_with_the_order_off_nothing_is_held_any_more() -> None:
    rig = CanRig(("DM4310", "ODrive"))
    rig.arm()
    assert rig.reader.line.goals is not None
    next(rig.writer.torque(False))
    assert rig.reader.line.goals is None
    assert not rig.reader.cyclic.energised.any()


def test_a_lost_master_is_cleared_between_two_further_orders_off() -> None:
    """An actuator that reports its torque already keeps its fault."""
    rig = CanRig(DM)
    rig.registers.fault[:] = [SILENCE, SILENCE, 0]
    requests = played(rig, rig.writer.torque(False), [0, -1, -1], [0, 0, 0])
    assert [orders(each) for each in requests] == [
        [(DISABLE, [1, 2, 3])] * 2,
        [(DISABLE, [2, 3]), (CLEAR, [2]), (DISABLE, [2, 3])],
    ]


# ------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(("on", "words"), [(True, "ordered on, reads off"), (False, "ordered off, reads on")])
def test_the_first_actuator_that_reports_the_other_state_is_refused(on: bool, words: str) -> None:
    rig = aimed(("DM4310",) * 4)
    other = int(not on)
    with pytest.raises(DeviceRefused, match=words) as refused:
        played(rig, rig.writer.torque(on), *[[int(on), other, other, other]] * 5)
    assert (refused.value.id, refused.value.what) == (2, "torque")


def test_a_barred_actuator_is_not_missed_beside_one_that_refuses_torque() -> None:
    rig = aimed(DM, barred=[1])
    with pytest.raises(DeviceRefused, match="ordered on, reads off") as refused:
        played(rig, rig.writer.torque(True), *[[-1, 1, 0]] * 5)
    assert refused.value.id == 3


def test_those_alone_are_missed_that_report_no_torque_at_all() -> None:
    rig = CanRig(("DM4310",) * 4)
    with pytest.raises(NoReply, match="torque off") as missed:
        played(rig, rig.writer.torque(False), *[[1, -1, 0, -1]] * 5)
    assert missed.value.ids == (2, 4)
    assert missed.value.waited == pytest.approx(4 * WAITED)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_position_may_change_by_a_twentieth_of_a_radian_at_torque_on(side: float) -> None:
    for moved, most in ((0.05, True), (float(np.nextafter(0.05, 1.0)), False)):
        rig = aimed(DM)
        rig.reader.cyclic.place[:] = 0.0
        script = rig.writer.torque(True)
        next(script)
        rig.reader.cyclic.place[1] = side * moved
        rig.registers.torque[:] = 1
        following = script.send(RequestReply({}, {}, WAITED, 0))
        assert orders(following) == ([(COMMAND, [1, 2, 3])] if most else [(DISABLE, [1, 2, 3])] * 2)


@pytest.mark.parametrize(("place", "same"), [(100 * COUNT, True), (100 * COUNT + 0.06, False)])
def test_an_actuator_whose_position_was_unknown_is_expected_at_its_goal(place: float, same: bool) -> None:
    rig = aimed(DM)
    script = rig.writer.torque(True)
    next(script)
    rig.reader.cyclic.place[:] = [100 * COUNT, place, 100 * COUNT]
    rig.registers.torque[:] = 1
    following = script.send(RequestReply({}, {}, WAITED, 0))
    assert orders(following)[0][0] == (COMMAND if same else DISABLE)
    if not same:
        with pytest.raises(DeviceRefused, match="turn changed") as refused:
            script.send(RequestReply({}, {}, WAITED, 0))
        assert refused.value.id == 2
