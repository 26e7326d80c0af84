"""Values that a CAN actuator reports never pass for those that it does not report."""

import numpy as np

from tests.support.can_driver_rig import CanRig
from twind_drivers.bus import ReadRequest
from twind_drivers.can.can_writer import CanWriter
from twind_drivers.virtual.can.can_message import CanMessage

MODELS = ("DM4310", "DM4340", "DM8009")


def test_the_acknowledgement_of_a_write_is_no_reading_of_the_register() -> None:
    rig = CanRig(MODELS)
    rig.positions()
    timeout = rig.reader.fleet.families[0][0].parameters["timeout"]
    rig.reader.begin(ReadRequest((1,), timeout.address, 4), rig.clock.now())
    forged = bytes([1, 0, 0x55, timeout.address]) + (2000).to_bytes(4, "little")
    rig.bus.controller.receive_frame(CanMessage(0x11, forged), rig.clock.now())
    rig.wait()
    reply = rig.reader.answer(rig.clock.now())
    assert reply.data == {1: bytes(4)}, "a watchdog that is off reads as armed"
    assert rig.registers.watchdog[0] == 0


def test_an_effort_not_reported_is_unknown() -> None:
    rig = CanRig(("RS01", "RS02", "DM4310"))
    rig.positions()
    assert rig.tick().effort_told.tolist() == [False, False, True]
    here = rig.arm()
    rig.ticks(3, here)
    assert rig.tick(here).effort_told is None
    rig.faults.silence(3)
    assert rig.tick(here).effort_told.tolist() == [True, True, False]


def test_the_health_age_of_an_actuator_without_health_data_is_that_of_its_feedback() -> None:
    rig = CanRig(("ODrive", "DM4310"))
    rig.positions()
    for _ in range(30):
        rig.tick()
        age = rig.clock.now() - rig.registers.health_time
        assert (age < 0.25).all(), age


def test_a_writer_drives_its_channel_as_long_as_it_lives() -> None:
    rig = CanRig(MODELS)
    owners: list[object] = []
    rig.channel.drive = owners.append  # type: ignore[method-assign]
    m = len(MODELS)
    writer = CanWriter(rig.reader, lower=rig.lower, upper=rig.upper, kp=np.ones(m), kd=np.ones(m))
    assert owners == [writer]


def test_an_identified_device_has_the_described_model_name() -> None:
    rig = CanRig(MODELS)
    rig.positions()
    assert [device.model_name for device in rig.identify()] == list(MODELS)


def test_the_torque_of_a_cubemars_that_was_away_while_armed_is_not_known_until_it_is_ordered_anew() -> None:
    rig = CanRig(("AK70-10",) * 2)
    here = rig.arm()
    rig.ticks(20, here)
    rig.faults.brown_out(1)
    rig.ticks(60, here)
    assert rig.energised().tolist() == [False, True]
    assert rig.registers.torque.tolist() == [-1, 1]
    rig.beside(rig.writer.torque(False))
    rig.ticks(3)
    assert rig.registers.torque.tolist() == [0, 0]
    rig.ticks(20, rig.arm())
    assert rig.registers.torque.tolist() == [1, 1]


def test_a_lost_reply_changes_no_torque_state_of_a_cubemars() -> None:
    rig = CanRig(("AK70-10",) * 2)
    here = rig.arm()
    for _ in range(10):
        rig.faults.drop(2, 1)
        rig.ticks(8, here)
        assert rig.registers.torque.tolist() == [1, 1]
