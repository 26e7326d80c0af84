"""Scripts of the CAN writer: what each requests, what it takes for an answer, and when it gives up."""

import struct
from typing import Any

import numpy as np
import pytest

from tests.support.can_driver_rig import CanRig
from twind_drivers.bus import (
    DeviceRefused,
    GroupWriteBatch,
    NoReply,
    ReadRequest,
    RebootRequest,
    RequestReply,
    Script,
    WireRangeError,
    WriteRequest,
)
from twind_drivers.can.actuator_family import ValuelessCommand
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.can_writer import CanWriter
from twind_drivers.can.register_access import ADDRESS, COMMAND, STATE, state
from twind_drivers.device_registers import RestartResult

DM = ("DM4310",) * 3
STATE_OF = {"address": STATE, "size": len(state(0, 0))}


def report(*ids: int, waited: float = 0.002) -> RequestReply:
    """The state of these ids."""
    return RequestReply({id: state(0, 0) for id in ids}, {}, waited, 0)


def ended(script: Script[Any], *replies: RequestReply) -> tuple[list[Any], Any]:
    """The requests of a script that gets these replies, and its result."""
    requests = [next(script)]
    for reply in replies:
        try:
            requests.append(script.send(reply))
        except StopIteration as stop:
            return requests, stop.value
    raise AssertionError(f"it asks on: {requests[-1]}")


def commanded(order: Any) -> list[int]:
    """The ids that an order of goals goes to."""
    assert isinstance(order, GroupWriteBatch)
    [write] = order.writes
    assert write.address == COMMAND
    return sorted(write.data)


# ------------------------------------------------------------------------------------- orders


def test_a_writer_declares_to_its_channel_that_it_drives_motors() -> None:
    """Only then may a link go down to be emptied."""
    rig = CanRig(DM)
    drivers: list[object] = []
    rig.channel.drive = drivers.append  # type: ignore[method-assign]
    writer = CanWriter(rig.reader, lower=rig.lower, upper=rig.upper, kp=np.full(3, 40.0), kd=np.ones(3))
    assert drivers == [writer]


@pytest.mark.parametrize(
    ("model", "order", "words"),
    [
        ("AK80-9", RebootRequest(1), "has no reboot"),
        ("AK80-9", WriteRequest({1: bytes(4)}, 0x20), "has no register 0x20"),
        ("DM4310", WriteRequest({9: b""}, ADDRESS[ValuelessCommand.ENABLE]), "9"),
    ],
)
def test_an_order_that_cannot_be_made_is_refused_in_the_name_of_the_bus(
    model: str, order: Any, words: str
) -> None:
    rig = CanRig((model,))
    with pytest.raises(DeviceRefused, match=words) as refused:
        rig.writer.begin(order, rig.clock.now())
    found = refused.value
    assert (found.port, found.id, found.what) == ("arm", -1, "order")
    assert rig.sent() == 0


def test_nothing_but_an_order_is_begun() -> None:
    rig = CanRig(DM)
    with pytest.raises(TypeError, match="a writer does not read"):
        rig.writer.begin(ReadRequest((1,), **STATE_OF), rig.clock.now())  # type: ignore[arg-type]
    assert rig.sent() == 0


def test_an_actuator_is_not_driven_alone() -> None:
    with pytest.raises(ValueError, match="arm: id 2: a CAN actuator is not driven against a stop"):
        CanRig(DM).writer.begin_single_device(2, cap=100, profile=5)


@pytest.mark.parametrize("script", ["prepare", "write_goals"])
def test_a_script_refuses_goals_beyond_the_bounds_before_anything_is_commanded(script: str) -> None:
    rig = CanRig(DM)
    rig.positions()
    before = rig.sent()
    goals = np.array([0, int(rig.upper[1]) + 1, 0])
    with pytest.raises(WireRangeError) as refused:
        next(getattr(rig.writer, script)(goals))
    assert refused.value.id == 2
    assert rig.reader.line.goals is None
    assert rig.sent() == before
    with pytest.raises(DeviceRefused, match="aim"):
        next(rig.writer.torque(True))


def test_a_script_refuses_goals_of_another_shape() -> None:
    rig = CanRig(DM)
    with pytest.raises(ValueError, match=r"\(2,\) goals for 3 actuators"):
        next(rig.writer.write_goals(np.zeros(2, np.int64)))
    assert rig.reader.line.goals is None


# ------------------------------------------------------------------------------------- goals


def test_goals_are_ordered_again_of_those_alone_that_have_not_acknowledged_them() -> None:
    rig = CanRig(DM)
    requests, _ = ended(rig.writer.write_goals(np.zeros(3, np.int64)), report(3), report(), report(1, 2))
    assert [commanded(each) for each in requests] == [[1, 2, 3], [1, 2], [1, 2]]


def test_a_goal_is_ordered_with_the_gains_and_without_speed_and_torque() -> None:
    rig = CanRig(DM)
    [write] = next(rig.writer.write_goals(np.array([0, 500, 0]))).writes
    assert struct.unpack("<5d", write.data[2]) == pytest.approx((500 * COUNT, 0.0, 40.0, 1.0, 0.0))


def test_torque_holds_the_goals_that_were_written_last() -> None:
    rig = CanRig(DM)
    here = rig.positions()
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here + 100))
    rig.beside(rig.writer.torque(True))
    rig.ticks(30)
    assert abs(rig.places() - here - 100).max() < 10


def test_a_barred_actuator_is_ordered_no_goal_and_none_is_missed_of_it() -> None:
    rig = CanRig(DM)
    rig.reader.cyclic.barred[1] = True
    requests, _ = ended(rig.writer.write_goals(np.zeros(3, np.int64)), report(1, 3))
    assert [commanded(each) for each in requests] == [[1, 3]]


def test_goals_of_an_axis_that_acknowledges_none_count_once_it_is_present() -> None:
    rig = CanRig(("DM4310", "ODrive", "ODrive"))
    requests, _ = ended(
        rig.writer.write_goals(np.zeros(3, np.int64)), report(1), report(2), report(), report(3)
    )
    assert [commanded(each) for each in requests[::2]] == [[1, 2, 3], [3]]
    assert requests[1::2] == [ReadRequest((2, 3), **STATE_OF), ReadRequest((3,), **STATE_OF)]


def test_goals_that_an_actuator_beside_present_axes_does_not_acknowledge_are_ordered_again() -> None:
    rig = CanRig(("DM4310", "ODrive"))
    requests, _ = ended(rig.writer.write_goals(np.zeros(2, np.int64)), report(), report(2), report(1))
    assert requests[1] == ReadRequest((2,), **STATE_OF)
    assert [commanded(each) for each in requests[::2]] == [[1, 2], [1]]


def test_missing_acknowledgements_are_reported_with_all_the_time_that_was_waited() -> None:
    rig = CanRig(("DM4310", "ODrive"))
    silent = [report(waited=0.25) for _ in range(6)]
    with pytest.raises(NoReply, match="reply to goal") as missing:
        ended(rig.writer.write_goals(np.zeros(2, np.int64)), *silent)
    assert missing.value.ids == (1, 2)
    assert missing.value.waited == pytest.approx(0.75), "of the orders"


def test_goals_are_read_once_each_actuator_that_is_not_barred_was_sent_one() -> None:
    rig = CanRig(DM)
    rig.reader.cyclic.barred[1] = True
    with pytest.raises(NoReply, match=r"goal: none was sent") as missing:
        rig.perform(rig.writer.read_goals())
    assert (missing.value.ids, missing.value.waited) == ((1, 3), 0.0)
    rig.read(np.array([5, 6, 7]))
    assert rig.perform(rig.writer.read_goals())[[0, 2]].tolist() == [5, 7]
    rig.reader.cyclic.barred[1] = False
    with pytest.raises(NoReply) as missing:
        rig.perform(rig.writer.read_goals())
    assert missing.value.ids == (2,)


def test_a_hold_is_sent_in_each_request_until_goals_come() -> None:
    rig = CanRig(DM)
    here = rig.arm()
    for _ in range(3):
        rig.read()
        assert rig.reader.line.goals is not None
    rig.read(here + 5)
    assert rig.reader.line.goals is None


# ------------------------------------------------------------------------------------- cuts, faults


@pytest.mark.parametrize(
    ("cut", "ids"), [(False, [2, 2]), (True, [1, 1, 2, 2, 2, 2, 3, 3])], ids=["alone", "after_a_cut"]
)
def test_torque_that_fails_is_cut_of_those_that_had_none_beside_a_waiting_cut_of_all(
    cut: bool, ids: list[int]
) -> None:
    rig = CanRig(DM)
    here = rig.arm()
    rig.ticks(3, here)
    rig.faults.silence(2)
    rig.ticks(20, here)
    rig.faults.silence(2, False)
    rig.ticks(20, here)
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here))
    script = rig.writer.torque(True)
    next(script)
    for _ in range(3):
        script.send(report())
    if cut:
        rig.writer.cut()
    assert script.send(report()).writes[0].data == {2: b""}
    assert rig.reader.line.goals is None
    rig.channel.trains.clear()
    rig.read()
    off = rig.reader.fleet.encode_valueless_command(0, ValuelessCommand.DISABLE)[0]["data"].tobytes()
    sent = [int(frame["id"]) for frame in rig.channel.trains[0] if frame["data"].tobytes() == off]
    assert sorted(sent) == ids
    assert rig.energised().tolist() == [not cut, False, not cut]


def test_faults_are_cleared_of_those_that_can_be_and_the_others_are_reported() -> None:
    rig = CanRig(("DM4310", "AK70-10", "DM4310"), watchdog=False)
    here = rig.positions()
    rig.faults.damage(1, 0xC)
    rig.faults.damage(2, 3)
    rig.ticks(3)
    rig.channel.trains.clear()
    with pytest.raises(DeviceRefused, match="stay though cleared") as refused:
        rig.beside(rig.writer.prepare(here))
    assert refused.value.id == 2
    cleared = [
        int(frame["id"])
        for train in rig.channel.trains
        for frame in train
        if frame["data"].tobytes() == b"\xff" * 7 + b"\xfb"
    ]
    assert cleared == [1]
    assert rig.registers.fault[0] == 0


def test_no_order_to_clear_goes_out_where_none_is_known() -> None:
    rig = CanRig(("AK70-10",))
    here = rig.positions()
    rig.faults.damage(1, 3)
    rig.ticks(3)
    with pytest.raises(DeviceRefused, match="stay though cleared"):
        rig.beside(rig.writer.prepare(here))


# ------------------------------------------------------------------------------------- registers, restart


def test_a_register_is_written_and_read_back_and_a_bad_value_is_refused_before() -> None:
    rig = CanRig(DM)
    rig.positions()
    found = rig.beside(rig.writer.write(2, "over_temperature", 90_000))
    assert (found.name, found.value) == ("over_temperature", 90_000)
    assert rig.beside(rig.reader.read(2, "over_temperature")).value == 90_000
    assert rig.beside(rig.reader.read(1, "over_temperature")).value != 90_000
    before = rig.sent()
    with pytest.raises(ValueError, match=r"serial_number.* is not written by this driver"):
        next(rig.writer.write(1, "serial_number", 5))
    assert rig.sent() == before


def restart(rig: CanRig, **more: Any) -> Script[RestartResult]:
    script: Script[RestartResult] = rig.writer.reboot(1, **more)
    return script


def test_a_restart_is_one_order_and_then_state_reads_until_the_reply() -> None:
    rig = CanRig(("ODrive", "ODrive"))
    requests, found = ended(restart(rig), report(), report(), report(2), report(1))
    assert requests == [RebootRequest(1), *[ReadRequest((1,), **STATE_OF)] * 3]
    assert found == RestartResult()


def test_a_restart_without_a_reply_is_given_up_after_two_hundred_reads() -> None:
    rig = CanRig(("ODrive",))
    script = restart(rig)
    next(script)
    script.send(report(waited=7.0))
    for _ in range(199):
        script.send(report(waited=0.01))
    with pytest.raises(NoReply, match=r"no reply to restart from \[1\]") as missing:
        script.send(report(waited=0.01))
    assert missing.value.waited == pytest.approx(2.0)


def test_an_axis_that_reports_no_torque_is_restarted_at_once() -> None:
    rig = CanRig(("ODrive",))
    rig.ticks(60)
    assert rig.registers.torque.tolist() == [0]
    assert next(restart(rig)) == RebootRequest(1)


def test_nothing_that_an_axis_reported_before_its_restart_is_believed_after_it() -> None:
    rig = CanRig(("ODrive", "ODrive"))
    rig.ticks(60)
    assert (rig.registers.torque == 0).all()
    script = restart(rig)
    next(script)
    assert (rig.registers.torque == 0).all()
    script.send(report())
    assert rig.registers.torque.tolist() == [-1, 0]
    assert np.isnan(rig.registers.voltage).tolist() == [True, False]
