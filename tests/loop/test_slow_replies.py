"""A bus whose servos answer as late as they are delivered (return delay 250, 500 us)."""

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.eeprom_access import calibrate, calibrated
from twind import link
from twind.loop.bus.bus_port import PortState

FACTORY = 250  # counts of 2 us (e-manual, "Return Delay Time (9)")


def rig_of(make_rig: MakeRig, delay: int, firmware: int | None = None) -> Rig:
    rig = make_rig()
    for bus in rig.virtual.values():
        bus.servos["return_delay_time"][:] = delay
        if firmware is not None:
            bus.servos["firmware_version"][:] = firmware
    return rig


@pytest.fixture
def fresh(make_rig: MakeRig) -> Rig:
    return rig_of(make_rig, FACTORY)


@pytest.fixture
def old(make_rig: MakeRig) -> Rig:
    """Without fast reads 24 such answers take 14 ms: more than a tick."""
    return rig_of(make_rig, FACTORY, firmware=44)


def messages(rig: Rig) -> list[str]:
    return [f"{event.code} {event.message}" for event in rig.events()]


def test_servos_as_delivered_are_identified_and_read(fresh: Rig) -> None:
    fresh.seconds(1.0)
    assert fresh.loop.condition.state == "connected", messages(fresh)
    fresh.seconds(1.0)
    assert (fresh.loop.robot.measured.age <= 0.02).all()
    assert (fresh.loop.hardware.slow.torque == 0).all()


def test_the_log_names_the_return_delay_and_nothing_else(fresh: Rig) -> None:
    fresh.seconds(2.0)
    assert not fresh.events("DEVICE_MISSING")
    (slow,) = fresh.events("DEVICE_MISMATCH")
    assert slow.level == "warning"
    assert "answers slowly: return delay is 500 us, the robot file says 10" in slow.message
    assert "`twindctl register write main 1 return_delay_time 5`" in slow.message
    assert not [text for text in messages(fresh) if "None" in text or "two devices" in text]


@pytest.mark.parametrize("firmware", [46, 44])
def test_no_tick_ends_late(make_rig: MakeRig, firmware: int) -> None:
    rig = rig_of(make_rig, FACTORY, firmware)
    late = []
    for _ in range(300):
        rig.ticks(1)
        late.append(rig.clock.now() - rig.next_tick)  # the next tick's
    assert max(late) <= 0.0


def test_every_servo_is_read_again_after_a_missing_reply(fresh: Rig) -> None:
    """A plain reading, as others get it then, would take longer than a tick and never be whole."""
    fresh.seconds(1.0)
    servos = fresh.virtual["main"].servos
    servos["status_return_level"][5] = 0
    fresh.seconds(0.02)
    servos["status_return_level"][5] = 2
    fresh.seconds(0.5)
    assert (fresh.loop.robot.measured.age <= 0.02).all()
    servos["status_return_level"][5] = 0  # for longer: it is parked, the others are read
    fresh.seconds(1.0)
    assert (np.delete(fresh.loop.robot.measured.age, 5) <= 0.02).all()
    servos["status_return_level"][5] = 2
    fresh.seconds(1.5)
    assert (fresh.loop.robot.measured.age <= 0.02).all()


def test_the_remedy_that_is_printed_works(fresh: Rig) -> None:
    fresh.seconds(1.0)
    calibrate(fresh)
    for id in fresh.loop.hardware.ports[0].reader.ids:
        reply = fresh.call(link.WriteRegister, bus="main", id=id, name="return_delay_time", value=5)
        assert reply.error is None, reply
    calibrated(fresh)
    fresh.seconds(1.0)
    assert fresh.loop.condition.state == "connected"
    assert not fresh.loop.hardware.ports[0].resting
    assert fresh.register("return_delay_time").tolist() == [5] * 24


def test_a_reading_longer_than_a_tick_is_not_asked_and_named(old: Rig) -> None:
    old.seconds(3.0)
    (port,) = old.loop.hardware.ports
    assert (old.loop.condition.state, port.link) == ("identifying", PortState.IDENTIFYING)
    slow, *others = old.loop.identity.troubles
    assert len(others) == 23
    assert all("answers slowly: return delay is 500 us" in each.message for each in (slow, *others))
    assert not old.events("DEVICE_MISSING")
    assert (old.loop.hardware.slow.torque == 0).all()  # what tells of torque goes on


def test_the_return_delay_can_be_corrected_before_identification(old: Rig) -> None:
    old.seconds(1.0)
    calibrate(old)
    for id in old.loop.hardware.ports[0].reader.ids:
        reply = old.call(link.WriteRegister, bus="main", id=id, name="return_delay_time", value=5)
        assert reply.error is None, reply
    calibrated(old)
    old.seconds(2.0)
    assert old.loop.condition.state == "connected", messages(old)
    assert np.isfinite(old.loop.robot.measured.position).all()


def test_a_register_is_written_while_the_torque_of_another_servo_is_unknown(old: Rig) -> None:
    old.virtual["main"].servos["status_return_level"][1] = 0  # answers pings only: its torque is never read
    old.seconds(2.0)
    assert old.loop.hardware.slow.torque[1] == -1
    call = {"bus": "main", "name": "return_delay_time", "value": 5}
    calibrate(old)
    assert old.call(link.WriteRegister, id=3, **call).error is None
    reply = old.call(link.WriteRegister, id=2, **call)
    assert reply.error == "WrongState"
    assert "torque of id 2 on or not read" in reply.parameters["state"]


def test_a_register_is_not_written_while_torque_is_on(old: Rig) -> None:
    old.virtual["main"].servos["torque_enable"][2] = 1
    old.seconds(2.0)
    for id in (1, 3):
        reply = old.call(link.WriteRegister, bus="main", id=id, name="return_delay_time", value=5)
        assert reply.error == "WrongState"
        assert "torque on" in reply.parameters["state"]
    assert old.register("return_delay_time").tolist() == [FACTORY] * 24


def test_a_missing_servo_is_not_waited_for_repeatedly(make_rig: MakeRig) -> None:
    """Else each second without readings: of the others a mirror shows the pose."""
    rig = make_rig()
    rig.virtual["main"].servos["id"][4] = 99
    rig.seconds(2.0)
    ages = []
    for _ in range(300):
        rig.ticks(1)
        ages.append(np.delete(rig.loop.robot.measured.age, 4).max())
    assert rig.loop.condition.state == "identifying"
    assert max(ages) <= 0.05


# ------------------------------------------------------------------------- later than the daemon waits


@pytest.mark.parametrize("timer", [0.008, 0.016])
def test_replies_later_than_a_tick_has_room_for_are_called_late(make_rig: MakeRig, timer: float) -> None:
    """An adapter as delivered: 16 ms. Every reply comes, and is another device's turn each time."""
    rig = make_rig()
    rig.virtual["main"].faults.latency(timer)
    rig.seconds(4.0)
    assert rig.loop.identity.troubles
    for finding in rig.loop.identity.troubles:
        assert "two devices" not in finding.message
    (event,) = rig.events("DEVICE_MISSING")  # not one for each set of devices that was missed
    assert (
        "ms after their request, too late to be read: set the adapter's latency timer to 1 ms"
        in event.message
    )
    assert "the servos' return_delay_time" in event.message
    (bus,) = rig.loop.publisher.overview(rig.clock.now()).buses
    assert bus.late_reply_ms is not None
    assert 2.0 < bus.late_reply_ms <= 25.0


def test_late_replies_that_end_are_late_no_longer(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.virtual["main"].faults.latency(0.016)
    rig.seconds(2.0)
    rig.virtual["main"].faults.latency(0.001)
    rig.seconds(3.0)
    assert rig.loop.condition.state == "connected", messages(rig)
    (bus,) = rig.loop.publisher.overview(rig.clock.now()).buses
    assert bus.late_reply_ms is None
