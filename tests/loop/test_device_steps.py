"""Calls on single devices, each step alone: what is refused, asked of a bus, replied and reported."""

from collections.abc import Mapping
from typing import Any

import pytest

from tests.support.device_rig import ROUNDS, DeviceRig
from twind import link
from twind.exceptions import InvalidInput
from twind.loop.ipc.call_outcome import CallFailure
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.robot.modes import Mode
from twind_drivers.bus import BusError, DeviceRefused, IdentifiedDevice, NoReply
from twind_drivers.device_registers import RegisterAddress, RestartResult

SILENT = NoReply("upper", (7,), 0.004, "read")
REFUSED = DeviceRefused("upper", 7, "LED", "is read-only")
UNKNOWN = InvalidInput("id 7 has no register 'lde'", near=["led", "id"])
LED = RegisterAddress("LED", 65, 1, 1)
OFFSET = RegisterAddress("Homing Offset", 20, 4, -3, eeprom=True)
LIMP = RegisterAddress("Torque Enable", 64, 1, 0)
STIFF = RegisterAddress("Torque Enable", 64, 1, 1)


@pytest.fixture
def rig() -> DeviceRig:
    return DeviceRig()


def waits() -> Procedure:
    while True:
        yield


CALLS = (link.ReadRegister, link.WriteRegister, link.Reboot, link.Scan)
CHANGES = (link.WriteRegister, link.Reboot)
DONE: Mapping[Any, tuple[str, Any]] = {
    link.ReadRegister: ("read 7 led", LED),
    link.WriteRegister: ("write 7 led 1", LED),
    link.Reboot: ("reboot 7", RestartResult()),
    link.Scan: ("scan", (IdentifiedDevice(7, 1020, None, 45),)),
}


# ------------------------------------------------------------------------------------------- which port


@pytest.mark.parametrize("kind", CALLS)
def test_each_call_asks_its_bus_once_and_is_answered_when_that_has_ended(rig: DeviceRig, kind: Any) -> None:
    text, result = DONE[kind]
    rig.upper.ends[text] = result
    ticket = rig.send(kind)
    rig.ticks(ROUNDS)
    assert rig.replies(ticket) == []
    assert rig.end(ticket).error is None
    assert rig.upper.asked[0] == text and rig.lower.asked == []


@pytest.mark.parametrize("kind", CALLS)
def test_no_call_reaches_a_bus_that_is_unknown_closed_or_busy(rig: DeviceRig, kind: Any) -> None:
    for bus, name in (("other", "other"), (None, "")):
        reply = rig.call(kind, bus=bus)
        assert (reply.error, reply.parameters) == (
            "NotFound",
            {"what": "bus", "name": name, "known": ["lower", "upper"]},
        )
    rig.upper.full = True
    assert (reply := rig.call(kind)).error == "Busy" and reply.parameters == {"what": "bus upper"}
    rig.upper.full = False
    assert rig.own(Priority.ARM, waits)
    assert rig.call(kind).error == "Busy"
    rig.procedures.abandon()
    rig.upper.reader = None
    reply = rig.call(kind)
    assert (reply.error, reply.parameters) == (
        "BusFailed",
        {"bus": "upper", "message": "the bus is not open"},
    )
    rig.upper.trouble = "no such port"
    assert rig.call(kind).parameters["message"] == "no such port"
    assert rig.upper.asked == [] and rig.book.events == []


@pytest.mark.parametrize("kind", CALLS[:3])
def test_a_device_that_is_not_of_the_bus_is_answered_with_those_that_are(rig: DeviceRig, kind: Any) -> None:
    reply = rig.call(kind, bus="lower")
    assert reply.error == "NotFound"
    assert reply.parameters == {"what": "id on bus lower", "name": "7", "known": ["1", "2"]}


def test_the_only_bus_needs_no_name(rig: DeviceRig) -> None:
    rig.hardware.ports = [rig.upper]
    rig.upper.ends["read 7 led"] = LED
    assert rig.call(link.ReadRegister, bus=None).error is None
    assert rig.call(link.ReadRegister, bus="lower").error == "NotFound"


# ------------------------------------------------------------------------------------------- registers


def test_the_reply_has_the_register_with_its_value(rig: DeviceRig) -> None:
    rig.upper.ends |= {"read 7 led": LED, "write 7 led 1": LED}
    wanted = {"register": {"name": "LED", "address": 65, "size": 1, "value": 1}}
    assert rig.call(link.ReadRegister).parameters == wanted
    assert rig.call(link.WriteRegister).parameters == wanted
    assert rig.texts() == [("info", "REGISTER", "ann: upper/7 led := 1 is written")]
    assert "identify" not in rig.upper.asked


@pytest.mark.parametrize("kind", [link.ReadRegister, link.WriteRegister])
@pytest.mark.parametrize(
    ("error", "reply", "parameters"),
    [
        (UNKNOWN, "NotFound", {"what": "register", "name": "led", "known": ["led", "id"]}),
        (KeyError("led"), "NotFound", {"what": "register", "name": "led", "known": []}),
        (ValueError("1 is too much"), "BusFailed", {"bus": "upper", "message": "1 is too much"}),
        (SILENT, "BusFailed", {"bus": "upper", "message": str(SILENT)}),
    ],
)
def test_an_error_of_the_bus_is_the_reply(
    rig: DeviceRig, kind: Any, error: Exception, reply: str, parameters: Any
) -> None:
    rig.upper.ends[DONE[kind][0]] = error
    found = rig.call(kind)
    assert (found.error, found.parameters) == (reply, parameters)


@pytest.mark.parametrize(
    ("end", "keeping", "done", "identified"),
    [
        (OFFSET, True, "is written", True),
        (OFFSET, False, "is written", True),  # over CAN no write is refused for being kept
        (LED, False, "is written", False),
        (LED, True, "is written", False),
        (UNKNOWN, True, "was refused", False),
        (KeyError("led"), True, "was refused", False),
        (REFUSED, False, "was refused", False),
        (REFUSED, True, "was refused", True),  # it may hold another value
        (SILENT, False, "is not confirmed", True),
        (BusError("dropped"), True, "is not confirmed", True),
        (BusError("dropped"), False, "is not confirmed", False),  # by arming, which must not wait for it
    ],
)
def test_a_write_after_which_a_device_may_be_another_is_followed_by_an_identification(
    rig: DeviceRig, end: Any, keeping: bool, done: str, identified: bool
) -> None:
    rig.upper.keeping = keeping
    rig.upper.ends["write 7 led 1"] = end
    rig.call(link.WriteRegister)
    assert rig.texts() == [("info", "REGISTER", f"ann: upper/7 led := 1 {done}")]
    assert rig.upper.asked == ["write 7 led 1", *["identify"] * identified]


def test_whether_a_register_is_kept_is_judged_with_the_time_of_the_call(rig: DeviceRig) -> None:
    rig.upper.ends["write 7 led 1"] = LED
    now = rig.clock.now()
    first = rig.send(link.WriteRegister)
    rig.upper.keeping = True
    second = rig.send(link.WriteRegister)
    rig.upper.known = False
    third = rig.send(link.WriteRegister)
    assert rig.kept == [(first, False, now), (second, True, now), (third, False, now)]
    rig.calibrating.refusal = CallFailure("WrongState", {"state": "connected"})
    assert rig.call(link.WriteRegister).parameters == {"state": "connected"}
    assert rig.upper.asked == ["write 7 led 1"] * 3


# ------------------------------------------------------------------------------------------- what denies it


@pytest.mark.parametrize("kind", CHANGES)
def test_a_device_is_changed_in_live_alone(rig: DeviceRig, kind: Any) -> None:
    what = {link.WriteRegister: "write a register", link.Reboot: "reboot a device"}[kind]
    rig.condition.mode = Mode.MIRROR
    wanted = {"state": "mode mirror", "allowed": [f"mode live, to {what}"]}
    reply = rig.call(kind)
    assert (reply.error, reply.parameters) == ("WrongState", wanted)
    rig.condition.mode = Mode.LIVE
    rig.upper.writer = None
    assert rig.call(kind).parameters["state"] == "mode live"
    assert rig.upper.asked == []


@pytest.mark.parametrize("kind", CHANGES)
def test_a_device_that_a_search_restores_is_left_to_it(rig: DeviceRig, kind: Any) -> None:
    rig.searching["upper", 7] = "an end-stop search restores id 7"
    reply = rig.call(kind)
    assert (reply.error, reply.parameters) == ("Busy", {"what": "an end-stop search restores id 7"})
    rig.searching = {("lower", 7): "another", ("upper", 1): "another"}
    rig.upper.ends[DONE[kind][0]] = DONE[kind][1]
    assert rig.call(kind).error is None


@pytest.mark.parametrize("kind", CHANGES)
def test_no_device_is_changed_while_torque_is_on(rig: DeviceRig, kind: Any) -> None:
    rig.hardware.slow.torque[:] = (0, 1, 0)
    rig.read(age=rig.robot.measured.age + 10.0)  # read on once, and silent since
    wanted = {"state": "connected, torque on", "allowed": ["disarmed"]}
    reply = rig.call(kind)
    assert (reply.error, reply.parameters) == ("WrongState", wanted)
    rig.hardware.slow.torque[:] = 0
    rig.torque.begin_energising()
    assert rig.call(kind).parameters == wanted
    assert rig.upper.asked == []


def test_a_bus_that_is_closed_does_not_count(rig: DeviceRig) -> None:
    rig.hardware.slow.torque[:] = (1, -1, 0)
    rig.read(age=rig.robot.measured.age + 10.0)
    rig.hardware.away[:] = (True, True, False)
    for kind in CHANGES:
        rig.upper.ends[DONE[kind][0]] = DONE[kind][1]
        assert rig.call(kind).error is None


def test_a_reboot_needs_known_torque_of_every_device(rig: DeviceRig) -> None:
    rig.hardware.slow.torque[:] = (-1, 0, 0)
    wanted = {"state": "connected, torque not read yet", "allowed": ["disarmed"]}
    assert rig.call(link.Reboot).parameters == wanted
    assert rig.upper.asked == []


# ------------------------------------------------------------------------------------------- unknown torque


def unknown(rig: DeviceRig, end: Any = LIMP) -> None:
    """Torque of a device of the other bus was never read; that of device 7 is read before its write."""
    rig.hardware.slow.torque[:] = (-1, 0, 0)
    rig.upper.ends |= {"read 7 torque_enable": end, "write 7 led 1": LED}


def test_a_write_reads_the_torque_of_its_device_first_where_another_is_unknown(rig: DeviceRig) -> None:
    unknown(rig)
    assert rig.call(link.WriteRegister).error is None
    assert rig.upper.asked == ["read 7 torque_enable", "write 7 led 1"]


@pytest.mark.parametrize(
    "end", [STIFF, None, SILENT, KeyError("torque_enable"), ValueError("no such"), UNKNOWN]
)
def test_a_device_whose_torque_does_not_read_off_is_not_written(rig: DeviceRig, end: Any) -> None:
    unknown(rig, end)
    wanted = {"state": "connected, torque of id 7 on or not read", "allowed": ["disarmed"]}
    reply = rig.call(link.WriteRegister)
    assert (reply.error, reply.parameters) == ("WrongState", wanted)
    assert rig.upper.asked == ["read 7 torque_enable"] and rig.book.events == []


@pytest.mark.parametrize("what", ["procedure", "torque", "calibrating", "nothing kept"])
def test_what_changes_while_the_torque_is_read_denies_the_write(rig: DeviceRig, what: str) -> None:
    unknown(rig)
    rig.upper.keeping = what != "nothing kept"
    ticket = rig.send(link.WriteRegister)
    rig.tick()
    wanted: dict[str, Any] = {"ticket": ticket}
    if what == "procedure":
        assert rig.own(Priority.ARM, waits)
        wanted = {"what": "bus upper"}
    elif what == "torque":
        rig.hardware.slow.torque[0] = 1
        wanted = {"state": "connected, torque on", "allowed": ["disarmed"]}
    else:
        rig.calibrating.on = False
    reply = rig.end(ticket)
    if what == "nothing kept":
        assert reply.error is None
        return
    assert (reply.error, reply.parameters) == ("Busy" if what == "procedure" else "WrongState", wanted)
    assert rig.upper.asked == ["read 7 torque_enable"]


# ------------------------------------------------------------------------------------------- restart and scan


def test_a_restart_replies_and_reports_what_it_restored_and_is_followed_by_an_identification(
    rig: DeviceRig,
) -> None:
    gain = RegisterAddress("Position P Gain", 84, 2, 640)
    rig.upper.ends["reboot 7"] = RestartResult((gain, LED), ((OFFSET, 5),))
    restored = ["Position P Gain = 640", "LED = 1"]
    differing = ["Homing Offset is -3, was 5"]
    wanted = {"state": "connected", "restored": restored, "differing": differing}
    assert rig.call(link.Reboot).parameters == wanted
    text = "restored Position P Gain = 640, LED = 1; differing Homing Offset is -3, was 5"
    assert rig.texts() == [("warning", "REBOOT", f"ann: upper/7 restarted; {text}")]
    assert rig.upper.asked == ["reboot 7", "identify"]


def test_a_restart_without_a_difference_is_no_warning(rig: DeviceRig) -> None:
    rig.upper.ends["reboot 7"] = RestartResult()
    assert rig.call(link.Reboot).parameters == {"state": "connected", "restored": [], "differing": []}
    assert rig.texts() == [("info", "REBOOT", "ann: upper/7 restarted; nothing to restore")]


def test_a_restart_that_fails_is_no_event(rig: DeviceRig) -> None:
    rig.upper.ends["reboot 7"] = SILENT
    assert rig.call(link.Reboot).error == "BusFailed"
    assert rig.texts() == [] and rig.upper.asked == ["reboot 7"]


def test_a_scan_replies_for_each_device_and_marks_the_last(rig: DeviceRig) -> None:
    found = [IdentifiedDevice(1, 1020, "XM430-W350", 45, {"led": 1}, "a7"), IdentifiedDevice(2, 9, None, 3)]
    rig.lower.ends["scan"] = tuple(found)
    ticket = rig.send(link.Scan, bus="lower")
    rig.ticks(2 * ROUNDS)
    replies = rig.replies(ticket)
    assert [reply.continues for reply in replies] == [True, False]
    assert [reply.parameters for reply in replies] == [
        {
            "bus": "lower",
            "id": each.id,
            "model": each.model_number,
            "model_name": each.model_name,
            "firmware": each.firmware,
            "settings": each.settings,
            "unique_id": each.unique_id,
        }
        for each in found
    ]


def test_a_scan_without_a_device_reports_whether_the_bus_is_silent(rig: DeviceRig) -> None:
    rig.lower.ends["scan"] = ()
    reply = rig.call(link.Scan, bus="lower")
    assert (reply.error, reply.parameters["bus"], reply.parameters["silent"]) == ("BusFailed", "lower", True)
    assert reply.parameters["message"] == "lower: no reply to ping from [1, 2] within 0.0 ms"
    ticket = rig.send(link.Scan, bus="lower")
    rig.ticks(ROUNDS)
    rig.lower.reader, rig.lower.trouble = None, "unplugged"  # after its last reply
    assert rig.end(ticket).parameters == {"bus": "lower", "message": "unplugged", "silent": False}


@pytest.mark.parametrize("error", [SILENT, KeyError("led"), ValueError("a model without a table")])
def test_a_scan_that_fails_is_answered_with_its_error_and_fails_no_tick(
    rig: DeviceRig, error: Exception
) -> None:
    rig.upper.ends["scan"] = error
    reply = rig.call(link.Scan)
    assert (reply.error, reply.parameters) == ("BusFailed", {"bus": "upper", "message": str(error)})
