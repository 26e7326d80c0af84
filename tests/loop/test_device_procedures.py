"""Calls on single devices: who there is, what is in a register, and a clear answer where that cannot be."""

import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.eeprom_access import calibrate
from twind import link
from twind.robot.modes import Mode


@pytest.fixture
def split(make_rig: MakeRig) -> Rig:
    rig: Rig = make_rig("h24-split")
    return rig


@pytest.fixture
def mirror(make_rig: MakeRig) -> Rig:
    rig: Rig = make_rig(mode=Mode.MIRROR)
    return rig


def scan(rig: Rig, bus: str | None = None) -> list[link.Reply]:
    ticket = rig.send(link.Scan, bus=bus)
    for _ in range(200):
        rig.ticks(1)
        replies = rig.replies(ticket)
        if replies and not replies[-1].continues:
            return replies
    raise AssertionError("no last reply")


# ------------------------------------------------------------------------------------- which bus


def test_an_unknown_bus_is_answered_with_those_there_are(split: Rig) -> None:
    split.connect()
    known = [bus.name for bus in split.robot.buses]
    for reply in (
        split.call(link.ReadRegister, bus="main", id=1, name="led"),
        split.call(link.WriteRegister, bus="main", id=1, name="led", value=1),
        split.call(link.Reboot, bus="main", id=1),
        split.call(link.Scan, bus="main"),
    ):
        assert reply.error == "NotFound"
        assert reply.parameters == {"what": "bus", "name": "main", "known": known}


def test_without_a_name_the_only_bus_is_meant_and_of_several_none(live: Rig, split: Rig) -> None:
    live.connect()
    split.connect()
    assert scan(live)[-1].error is None
    (reply,) = scan(split)
    assert reply.error == "NotFound"


def test_a_bus_that_is_not_open_is_answered_with_the_reason(live: Rig) -> None:
    live.virtual["main"].faults.unplug()
    live.ticks(5)
    reply = live.call(link.ReadRegister, bus="main", id=1, name="led")
    assert reply.error == "BusFailed"
    assert reply.parameters["bus"] == "main"
    assert "no such port" in reply.parameters["message"]


def test_a_scan_reports_the_registers_read_by_identification(mirror: Rig) -> None:
    mirror.connect()
    told = [reply.parameters["settings"] for reply in scan(mirror, "main")]
    assert len(told) == 24
    wanted = {
        "return_delay_time": 5,
        "shutdown": 52,
        "min_voltage_limit": 95,
        "pwm_limit": 885,
        "torque_enable": 0,
    }
    assert all(each | wanted == each for each in told)


def test_in_sim_no_bus_is_open(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.SIM)
    reply = rig.call(link.Scan)
    assert reply.error == "BusFailed"


# ------------------------------------------------------------------------------------- registers


def test_a_register_is_read_in_mirror_too(mirror: Rig) -> None:
    mirror.connect()
    reply = mirror.call(link.ReadRegister, bus="main", id=7, name="Model Number")
    assert reply.parameters["register"] == {"name": "Model Number", "address": 0, "size": 2, "value": 1020}


def test_a_misspelt_register_is_answered_with_the_nearest(live: Rig) -> None:
    live.connect()
    reply = live.call(link.ReadRegister, bus="main", id=7, name="postion_p_gain")
    assert reply.error == "NotFound"
    assert reply.parameters["what"] == "register"
    assert reply.parameters["known"][0] == "position_p_gain"


def test_a_register_that_is_near_none_is_answered_without_names(live: Rig) -> None:
    live.connect()
    reply = live.call(link.ReadRegister, bus="main", id=7, name="zzzzzz")
    assert (reply.error, reply.parameters["known"]) == ("NotFound", [])


def test_a_bus_without_replies_is_distinguished_from_a_failing_bus(live: Rig) -> None:
    live.connect()
    for id in live.virtual["main"].ids():
        live.virtual["main"].faults.silence(id)
    reply = live.call(link.Scan, bus="main")
    assert (reply.error, reply.parameters["silent"]) == ("BusFailed", True)


def test_a_device_that_is_not_of_this_bus_is_answered_with_those_that_are(live: Rig) -> None:
    live.connect()
    reply = live.call(link.ReadRegister, bus="main", id=99, name="led")
    assert reply.error == "NotFound"
    assert (reply.parameters["what"], reply.parameters["known"][:3]) == ("id on bus main", ["1", "2", "3"])


def test_a_silent_device_is_an_answer_and_not_a_wait(live: Rig) -> None:
    live.connect()
    live.virtual["main"].faults.silence(7)
    reply = live.call(link.ReadRegister, bus="main", id=7, name="led", ticks=20)
    assert reply.error == "BusFailed"
    assert "[7]" in reply.parameters["message"]


def test_a_lost_bus_ends_the_call(live: Rig) -> None:
    live.connect()
    ticket = live.send(link.Scan)
    live.ticks(2)
    live.virtual["main"].faults.unplug()
    live.ticks(3)
    (reply,) = live.replies(ticket)
    assert reply.error == "BusFailed"
    assert "unplugged" in reply.parameters["message"]
    assert not reply.parameters.get("silent")


def test_a_value_that_a_register_cannot_hold_is_refused_and_not_written(live: Rig) -> None:
    live.connect()
    reply = live.call(link.WriteRegister, bus="main", id=7, name="led", value=2)
    assert reply.error == "BusFailed"
    assert "2" in reply.parameters["message"]
    assert live.call(link.ReadRegister, bus="main", id=7, name="led").parameters["register"]["value"] == 0


def test_registers_reserved_for_procedures_are_not_written(live: Rig) -> None:
    live.connect()
    calibrate(live)
    for name in ("torque_enable", "goal_position", "id", "baud_rate"):
        reply = live.call(link.WriteRegister, bus="main", id=7, name=name, value=1)
        assert reply.error == "BusFailed"
        assert "is not written here" in reply.parameters["message"]


def test_a_register_write_is_logged_with_its_client(live: Rig) -> None:
    live.connect()
    reply = live.call(link.WriteRegister, bus="main", id=7, name="led", value=1)
    assert reply.parameters["register"]["value"] == 1
    (event,) = live.events("REGISTER")
    assert event.message == "test: main/7 led := 1 is written"


@pytest.mark.parametrize(
    ("kind", "more"), [(link.WriteRegister, {"name": "led", "value": 1}), (link.Reboot, {})]
)
def test_in_mirror_nothing_is_written(mirror: Rig, kind: type[link.Command], more: dict[str, object]) -> None:
    mirror.connect()
    reply = mirror.call(kind, bus="main", id=7, **more)
    assert reply.error == "WrongState"
    assert reply.parameters["state"] == "mode mirror"
    led = mirror.call(link.ReadRegister, bus="main", id=7, name="led")
    assert led.parameters["register"]["value"] == 0


def test_while_any_servo_has_torque_no_device_is_restarted(armed: Rig) -> None:
    reply = armed.call(link.Reboot, bus="main", id=7)
    assert reply.error == "WrongState"
    assert "torque on" in reply.parameters["state"]
    assert armed.register("torque_enable").tolist() == [1] * 24


# ------------------------------------------------------------------------------------- restart and scan


def test_a_rebooted_device_regains_its_settings_and_every_device_is_identified_again(live: Rig) -> None:
    live.connect()
    for name, value in (("led", 1), ("position_p_gain", 640)):
        live.call(link.WriteRegister, bus="main", id=7, name=name, value=value)
    reply = live.call(link.Reboot, bus="main", id=7)
    assert reply.error is None
    assert reply.parameters == {
        "state": "connected",
        "restored": ["LED = 1", "Position P Gain = 640"],
        "differing": [],
    }
    (event,) = live.events("REBOOT")
    assert event.message == "test: main/7 restarted; restored LED = 1, Position P Gain = 640"
    gain = live.call(link.ReadRegister, bus="main", id=7, name="position_p_gain")
    assert gain.parameters["register"]["value"] == 640
    live.ticks(60)
    assert live.loop.hardware.connected
    assert live.register("torque_enable").tolist() == [0] * 24


def test_a_reboot_with_nothing_to_restore_is_reported_as_such(live: Rig) -> None:
    live.connect()
    reply = live.call(link.Reboot, bus="main", id=7)
    assert (reply.parameters["restored"], reply.parameters["differing"]) == ([], [])
    assert len(live.events("REBOOT")) == 1


def test_a_device_that_does_not_come_back_is_an_answer(live: Rig) -> None:
    live.connect()
    live.virtual["main"].faults.silence(7)
    reply = live.call(link.Reboot, bus="main", id=7)
    assert reply.error == "BusFailed"
    assert "[7]" in reply.parameters["message"]


def test_a_scan_sends_one_device_per_reply_and_marks_the_last(live: Rig) -> None:
    live.connect()
    live.virtual["main"].faults.silence(7)
    replies = scan(live)
    assert [reply.parameters["id"] for reply in replies] == [id for id in range(1, 25) if id != 7]
    assert [reply.continues for reply in replies] == [True] * 22 + [False]
    assert {reply.parameters["model_name"] for reply in replies} == {"XM430-W350"}
    assert {reply.parameters["bus"] for reply in replies} == {"main"}


def test_a_scan_of_a_bus_without_power_names_who_was_asked(live: Rig) -> None:
    live.connect()
    for id in range(1, 25):
        live.virtual["main"].faults.silence(id)
    (reply,) = scan(live)
    assert reply.error == "BusFailed"
    assert "no reply to ping from [1, 2, 3," in reply.parameters["message"]


def test_calls_on_devices_do_not_stop_the_motion_of_the_loop(armed: Rig) -> None:
    armed.call(link.ReadRegister, bus="main", id=7, name="led")
    scan(armed)
    assert armed.loop.robot.measured.heard.all()
    assert armed.loop.condition.state == "armed"
    assert armed.loop.figures.missed == 0


def test_a_servo_shut_down_by_its_hardware_error_is_restarted_with_its_settings(live: Rig) -> None:
    # e-manual, Shutdown (63): only a reboot restores it
    live.connect()
    live.call(link.WriteRegister, bus="main", id=7, name="position_p_gain", value=640)
    live.virtual["main"].servos.inject_error(6, 0x20)
    live.ticks(30)
    reply = live.call(link.Reboot, bus="main", id=7)
    assert reply.parameters["restored"] == ["Position P Gain = 640"]
    assert live.register("hardware_error_status")[6] == 0
    live.ticks(60)
    assert live.loop.hardware.connected


# ------------------------------------------------------------------------------------- writes without reply


def written_then(rig: Rig, name: str, value: int) -> int:
    """Write a register of id 7 until the servo has the value, which nothing has confirmed yet."""
    ticket = rig.send(link.WriteRegister, bus="main", id=7, name=name, value=value)
    for _ in range(20):
        rig.ticks(1)
        if rig.register(name)[6] == value:
            return ticket
    raise AssertionError(f"{name} was not written: {rig.replies(ticket)}")


def test_a_kept_register_is_judged_before_the_next_arming_if_a_stop_ends_its_write(live: Rig) -> None:
    live.connect()
    calibrate(live)
    ticket = written_then(live, "homing_offset", 300)
    live.send(link.EStop, level="settle", reason="")
    live.seconds(1.0)
    (reply,) = live.replies(ticket)
    assert reply.error == "BusFailed"
    (event,) = live.events("REGISTER")
    assert event.message.endswith("homing_offset := 300 is not confirmed")
    assert live.call(link.Reset).error is None
    live.seconds(1.0)
    live.lease()
    refused = live.call(link.Arm)
    assert refused.error == "Refused"
    (found,) = refused.parameters["findings"]
    assert (found["code"], found["joint"], found["value"]) == ("CALIB_MISMATCH", 6, 300.0)
