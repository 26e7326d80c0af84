"""Preparation for torque over CAN: faults that go late, orders that are lost, actuators left out."""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from tests.support.can_driver_rig import CanRig
from twind_drivers.bus import DeviceRefused, NoReply, ReadRequest, RequestReply, Script, WriteRequest
from twind_drivers.can.can_writer import CanWriter
from twind_drivers.can.odrive_codec import POSITION_GAIN, VELOCITY_GAINS
from twind_drivers.can.register_access import STATE, encode, parameter_of, state
from twind_drivers.ports.frame import Frames

AK = "AK70-10"  # nothing of it is read or written before torque
HERE = np.zeros(2, np.int64)


def report(*ids: int, waited: float = 0.25) -> RequestReply:
    """The state of these ids."""
    return RequestReply({id: state(0, 0) for id in ids}, {}, waited, 0)


def stiffness(rig: CanRig) -> list[float]:
    """kp of the next order of goals, by id in order."""
    count = len(rig.reader.ids)
    [write] = next(rig.writer.write_goals(np.zeros(count, np.int64))).writes
    return [struct.unpack("<5d", write.data[id])[2] for id in sorted(write.data)]


def to_its_end(script: Script[Any], reply: RequestReply, requests: list[Any] | None = None) -> None:
    """The same reply to each request, which is appended to `requests`."""
    while True:
        request = script.send(reply)
        if requests is not None:
            requests.append(request)


def without_a_word_of(id: int, rig: CanRig) -> None:
    """Prepare both of a bus, of which one does not tell its faults."""
    rig.registers.fault[:] = 0
    rig.registers.fault[id - 1] = 3
    script = rig.writer.prepare(HERE)
    next(script)
    with pytest.raises(NoReply) as missing:
        to_its_end(script, report(*{1, 2} - {id}))
    assert missing.value.ids == (id,)


def asked(rig: CanRig, script: Script[Any]) -> list[Any]:
    """The requests of a script that runs as in the loop."""
    requests: list[Any] = []

    def tapped() -> Script[Any]:
        request = next(script)
        while True:
            requests.append(request)
            reply = yield request
            try:
                request = script.send(reply)
            except StopIteration:
                return None

    rig.beside(tapped())
    return requests


def register(rig: CanRig, name: str, *values: float) -> RequestReply:
    """The value of one register of each actuator."""
    found = {
        id: encode(parameter_of(rig.reader.fleet, row, name), value)
        for row, (id, value) in enumerate(zip(rig.reader.ids, values, strict=True))
    }
    return RequestReply(found, {}, 0.002, 0)


# ------------------------------------------------------------------------------------- modes


@pytest.mark.parametrize(
    ("model", "name", "values", "mode"), [("DM4310", "mode", (1, 3), 3), ("RS01", "run_mode", (0, 5), 105)]
)
def test_an_actuator_in_a_mode_without_commands_is_refused_before_any_order(
    model: str, name: str, values: Sequence[int], mode: int
) -> None:
    rig = CanRig((model, model))
    script = rig.writer.prepare(HERE)
    assert next(script).ids == (1, 2)
    with pytest.raises(DeviceRefused, match=f"id 2: {name}: is {mode}, needs 1"):
        script.send(register(rig, name, *values))


# ------------------------------------------------------------------------------------- left out, silent


@pytest.mark.parametrize("barred", [False, True])
def test_an_actuator_that_is_left_out_is_barred_and_gets_no_order(barred: bool) -> None:
    rig = CanRig((AK, AK), watchdog=False)
    rig.reader.cyclic.barred[0] = barred
    [order] = next(rig.writer.prepare(HERE, np.array([True, False]))).writes
    assert list(order.data) == [1]
    assert rig.reader.cyclic.barred.tolist() == [False, True]


def test_a_silent_actuator_stays_soft_and_the_other_is_stiff_again() -> None:
    rig = CanRig((AK, AK), watchdog=False)
    without_a_word_of(2, rig)
    assert stiffness(rig) == [40.0, 40.0]
    next(rig.writer.damp())
    assert stiffness(rig) == [0.0, 0.0]
    without_a_word_of(2, rig)
    assert stiffness(rig) == [40.0, 0.0]


@pytest.mark.parametrize("barred", [[False, False], [False, True], [True, False], [True, True]])
def test_a_silent_actuator_stays_barred_if_it_was(barred: list[bool]) -> None:
    rig = CanRig((AK, AK), watchdog=False)
    rig.reader.cyclic.barred[:] = barred
    without_a_word_of(2, rig)
    assert rig.reader.cyclic.barred.tolist() == [False, barred[1]]


def test_each_actuator_that_is_missed_is_reported() -> None:
    rig = CanRig((AK, AK, AK), watchdog=False)
    rig.registers.fault[:] = 0, 3, 3
    script = rig.writer.prepare(np.zeros(3, np.int64))
    next(script)
    for _ in range(3):
        script.send(report(2))
    with pytest.raises(NoReply) as missing:
        to_its_end(script, report())
    assert missing.value.ids == (3, 2)


def test_of_silent_actuators_those_of_every_family_are_named() -> None:
    """They are asked family by family; whoever mends them learns of all at once."""
    rig = CanRig(("RS01", "DM4310", "DM4310"))
    here = rig.positions()
    for id in (1, 2):
        rig.faults.silence(id)
    with pytest.raises(NoReply, match=r"no reply to read of \w+ or read of \w+ from \[1, 2\]") as missing:
        rig.beside(rig.writer.prepare(here))
    assert missing.value.ids == (1, 2)


# ------------------------------------------------------------------------------------- damping


def test_damping_is_ordered_again_until_all_have_acknowledged_it() -> None:
    for replies in ([report(1, 2)], [report(1), report(2)], [report(), report(2), report(1)]):
        rig = CanRig(("DM4310", "DM4310"))
        script = rig.writer.damp()
        next(script)
        for reply in replies[:-1]:
            script.send(reply)
        with pytest.raises(StopIteration) as ended:
            script.send(replies[-1])
        assert ended.value.value == ()


def test_an_axis_that_acknowledges_nothing_gets_three_orders_to_be_soft_and_is_reported() -> None:
    rig = CanRig(("ODrive", "DM4310"))
    script = rig.writer.damp()
    next(script)
    for _ in range(2):
        script.send(report(1, 2))
    with pytest.raises(StopIteration) as ended:
        script.send(report(1, 2))
    assert ended.value.value == (1,)


def test_no_stiff_hold_is_left_in_the_next_request_after_damping() -> None:
    rig = CanRig(("DM4310",))
    rig.arm()
    rig.writer.goals(np.zeros(1, np.int64))
    next(rig.writer.damp())
    assert rig.reader.line.goals is None


# ------------------------------------------------------------------------------------- watchdogs, limits


def test_the_hold_begins_before_the_watchdogs_are_armed_and_its_time_anew_after_them() -> None:
    rig = CanRig(("DM4310",) * 2)
    here = rig.positions()
    script = rig.writer.prepare(here)
    held: list[Any] = []

    def tapped() -> Script[Any]:
        request = next(script)
        while True:
            if isinstance(request, WriteRequest):
                held.append(rig.reader.line.goals)
            reply = yield request
            try:
                request = script.send(reply)
            except StopIteration:
                return None

    rig.beside(tapped())
    assert held and held[0] is not None and held[0].kept
    last: Any = rig.reader.line.goals
    assert last.until == pytest.approx(rig.reader.line.sent + 0.5)
    assert last.until > held[0].until


def test_the_first_actuator_without_a_required_watchdog_is_named() -> None:
    rig = CanRig((AK, AK), watchdog=True)
    script = rig.writer.prepare(HERE)
    next(script)
    with pytest.raises(DeviceRefused, match="id 1: watchdog: cubemars has none"):
        script.send(report(1, 2))


def test_a_loop_too_slow_is_refused_in_the_name_of_the_first_actuator_with_a_watchdog() -> None:
    rig = CanRig(("DM4310", "DM4310"), rate_hz=10.0)
    with pytest.raises(DeviceRefused, match="id 1: watchdog: runs out after"):
        rig.beside(rig.writer.prepare(rig.positions()))


@pytest.mark.parametrize(
    ("models", "ids"), [(("DM4310", "DM4310"), None), (("DM4310", "ODrive"), "[2]"), ((AK, AK), "[1, 2]")]
)
def test_the_actuators_without_a_watchdog_are_warned_of_and_no_other(
    models: Sequence[str], ids: str | None
) -> None:
    rig = CanRig(models, watchdog=None if ids is None else False)
    here = rig.positions()
    before = rig.reader.transport.warning
    assert before == ""
    for _ in range(2):
        rig.beside(rig.writer.prepare(here))
    warning = rig.reader.transport.warning
    assert warning.startswith(f"ids {ids}: no watchdog") if ids else warning == ""
    assert warning.count("no watchdog") == (ids is not None)


def test_of_actuators_left_out_none_is_warned_of() -> None:
    rig = CanRig(("DM4310", "ODrive"), watchdog=False)
    rig.beside(rig.writer.prepare(rig.positions(), np.array([True, False])))
    assert rig.reader.transport.warning == ""


def test_a_watchdog_that_reads_otherwise_after_three_writes_is_refused() -> None:
    rig = CanRig(("DM4310", "DM4310"))
    script = rig.writer.prepare(HERE)
    next(script)
    script.send(register(rig, "mode", 1, 1))
    requests = [script.send(report(1, 2))]
    with pytest.raises(DeviceRefused, match="id 2: timeout: wrote 2000, reads 0"):
        to_its_end(script, register(rig, "timeout", 2000, 0), requests)
    assert [sorted(each.data) for each in requests if isinstance(each, WriteRequest)] == [[1, 2], [2], [2]]


def test_a_torque_limit_is_written_where_a_family_has_one_and_only_if_it_reads_otherwise() -> None:
    rig = CanRig(("DM4310", "RS01", "RS01"))
    rig.writer = CanWriter(
        rig.reader,
        lower=rig.lower,
        upper=rig.upper,
        kp=np.full(3, 40.0),
        kd=np.ones(3),
        torque_limits=np.array([3.0, 5.0, np.nan]),
        watchdog=rig.watchdog,
    )
    here = rig.positions()
    address = parameter_of(rig.reader.fleet, 1, "torque_limit").address
    before = rig.beside(rig.reader.read(3, "torque_limit")).value
    written = []
    for _ in range(2):
        requests = asked(rig, rig.writer.prepare(here))
        written.append(
            [
                sorted(each.data)
                for each in requests
                if isinstance(each, WriteRequest) and each.address == address
            ]
        )
        assert rig.beside(rig.reader.read(2, "torque_limit")).value == 5000
    assert written == [[[2]], []]
    assert rig.beside(rig.reader.read(3, "torque_limit")).value == before


# ------------------------------------------------------------------------------------- faults


def prepared_with_faults(*faults: int) -> tuple[CanRig, Any]:
    """Two actuators with these fault bits, and their preparation after its first order."""
    rig = CanRig((AK, AK), watchdog=False)
    rig.registers.fault[:] = faults
    script = rig.writer.prepare(HERE)
    next(script)
    return rig, script


def test_a_fault_that_is_gone_with_the_third_read_is_no_refusal() -> None:
    rig, script = prepared_with_faults(0, 3)
    reads = [script.send(report(2)) for _ in range(3)]
    assert reads == [ReadRequest((2,), STATE, len(state(0, 0)))] * 3
    rig.registers.fault[1] = 0
    with pytest.raises(StopIteration):
        script.send(report(2))


def test_a_fault_that_stays_is_refused_after_three_reads() -> None:
    rig, script = prepared_with_faults(1, 3)
    assert [script.send(report(1, 2)).ids for _ in range(2)] == [(1, 2)] * 2
    rig.registers.fault[0] = 0
    assert script.send(report(1, 2)).ids == (2,)
    with pytest.raises(DeviceRefused, match=r"id 2: fault: fault bits 0x3 stay though cleared"):
        script.send(report(2))


def test_an_actuator_that_does_not_tell_its_faults_is_reported_once_the_others_are_prepared() -> None:
    rig, script = prepared_with_faults(1, 3)
    for _ in range(3):
        script.send(report(1))
    [order] = script.send(report(1)).writes
    assert list(order.data) == [1]
    rig.registers.fault[0] = 0
    with pytest.raises(NoReply, match="no reply to read of its faults") as missing:
        script.send(report(1))
    assert (missing.value.ids, missing.value.waited) == ((2,), 0.75)


@pytest.mark.parametrize("phase", range(0, 12, 2))
def test_a_fault_of_an_axis_is_cleared_at_its_next_heartbeat(phase: int) -> None:
    """It comes ten times a second, and no read of an ODrive brings its faults."""
    rig = CanRig(("ODrive", "ODrive"))
    here = rig.positions()
    rig.faults.damage(1, 0x40)
    rig.ticks(60 + phase)
    assert (rig.registers.fault > 0).tolist() == [True, False]
    rig.beside(rig.writer.prepare(here))
    assert rig.registers.fault.tolist() == [0, 0]


@pytest.mark.parametrize(("rate_hz", "reads"), [(100.0, 30), (20.0, 6), (8.0, 3)])
def test_a_fault_of_an_axis_that_stays_is_refused_after_the_time_of_three_heartbeats(
    rate_hz: float, reads: int
) -> None:
    rig = CanRig(("ODrive", AK), rate_hz=rate_hz, watchdog=False)
    rig.registers.fault[0] = 0x10
    script = rig.writer.prepare(HERE)
    next(script)
    requests: list[Any] = []
    with pytest.raises(DeviceRefused, match="id 1: fault: fault bits 0x10 stay"):
        to_its_end(script, report(1), requests)
    assert requests == [ReadRequest((1,), STATE, len(state(0, 0)))] * reads


def test_another_actuator_of_the_bus_is_commanded_while_the_fault_of_an_axis_is_awaited() -> None:
    """A CubeMars gets no other frame, and its watchdog would let go what it holds."""
    rig = CanRig(("ODrive", AK), watchdog=False)
    rig.bus.nodes.each[1].watch.timeout = 0.1
    here = rig.arm()
    rig.faults.damage(1, 0x40)
    rig.ticks(30, here)
    steps = rig.stepped(rig.writer.prepare(here))
    for _ in range(29):
        rig.faults.damage(1, 0x40)
        next(steps)
        assert rig.energised()[1]


# ------------------------------------------------------------------------------------- gains


@pytest.mark.parametrize("lost", [POSITION_GAIN, VELOCITY_GAINS])
def test_an_axis_is_as_stiff_as_before_damping_although_an_order_of_gains_is_lost(
    lost: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = CanRig(("ODrive",))
    here = rig.arm()
    held = rig.bus.nodes.each[0].held  # type: ignore[attr-defined]
    stiff = held["position_gain"], held["velocity_gain"]
    rig.beside(rig.writer.damp())
    assert held["position_gain"] == 0.0
    sent: Any = rig.channel.send
    left = [lost]

    def send(frames: Frames, now: float) -> None:
        wanted = np.ones(len(frames), np.bool_)
        for place, id in enumerate(frames["id"].tolist()):
            if id & 0x1F in left:
                left.clear()
                wanted[place] = False
        sent(frames[wanted], now)

    monkeypatch.setattr(rig.channel, "send", send)
    rig.beside(rig.writer.prepare(here))
    assert not left
    assert (held["position_gain"], held["velocity_gain"]) == stiff


@pytest.mark.parametrize("damped", [False, True])
def test_an_axis_is_prepared_while_another_is_left_out_and_keeps_its_gains(damped: bool) -> None:
    rig = CanRig(("ODrive", "ODrive"))
    here = rig.arm()
    held = [each.held for each in rig.bus.nodes.each]  # type: ignore[attr-defined]
    stiff = [each["position_gain"] for each in held]
    if damped:
        rig.beside(rig.writer.damp())
    rig.beside(rig.writer.prepare(here, np.array([False, True])))
    assert [each["position_gain"] for each in held] == [0.0 if damped else stiff[0], stiff[1]]


def test_gains_are_ordered_of_an_axis_beside_actuators_whose_commands_carry_them() -> None:
    rig = CanRig(("DM4310", "ODrive"))
    here = rig.positions()
    held = rig.bus.nodes.each[1].held  # type: ignore[attr-defined]
    before = held["position_gain"]
    rig.beside(rig.writer.prepare(here))
    assert held["position_gain"] == pytest.approx(40.0) != before
