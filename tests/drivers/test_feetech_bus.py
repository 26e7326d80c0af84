"""Reader and writer of Feetech servos on the virtual bus: what differs from the contract of all drivers."""

from typing import Any

import numpy as np
import pytest

from tests.support.driver_rig import both
from tests.support.feetech_rig import FeetechRig
from twind.config.robot_file import load_robot
from twind_drivers.bus import (
    DeviceRefused,
    IdentifiedDevice,
    NoReply,
    ReadRequest,
    Script,
    WireRangeError,
    WriteRequest,
)
from twind_drivers.feetech.feetech_identification import BLOCKS
from twind_drivers.feetech.feetech_packet import FeetechInstruction
from twind_drivers.feetech.feetech_type import FeetechType
from twind_drivers.feetech.feetech_writer import FeetechWriter
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.half_duplex.position_plausibility import ZERO
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter


def rig_of(**spec: Any) -> FeetechRig:
    return FeetechRig([FeetechServoSpec(id, **spec) for id in (1, 2, 3)])


def moves(rig: FeetechRig) -> None:
    """Armed, everybody follows."""
    here = rig.arm()
    for cycle in range(30):
        rig.tick(here + 4 * cycle)
    rig.ticks(30, here + 116)
    assert abs(rig.places() - here - 116).max() <= 2


# ---------------------------------------------------------------------------- lines and firmware


def test_an_echo_adapter_is_recognised_and_no_echo_passes_for_a_reply() -> None:
    rig = FeetechRig(adapter=SerialAdapter(echo=True))
    assert len(rig.perform(rig.reader.identify())) == 4
    assert rig.reader.line.echo
    moves(rig)
    assert not any(sample.discarded or sample.foreign for sample in rig.ticks(5))
    rig.faults.silence(2)
    with pytest.raises(NoReply):
        rig.beside(rig.reader.read(2, "present_position"))


def test_servos_without_sync_read_are_read_one_by_one() -> None:
    rig = rig_of(sync_read=False)
    assert len(rig.perform(rig.reader.identify())) == 3
    assert not any(rig.reader.cyclic.grouped.values())
    moves(rig)


def test_a_mixed_bus_has_byte_order_and_group_reads_of_each_servo() -> None:
    rig = FeetechRig(
        [
            FeetechServoSpec(1),
            FeetechServoSpec(2, "SCS0009", volts=6.0),
            FeetechServoSpec(3, sync_read=False),
            FeetechServoSpec(4),
        ]
    )
    rig.perform(rig.reader.identify())
    assert rig.reader.cyclic.grouped == {1: True, 2: False, 3: False, 4: True}
    here = rig.arm()
    rig.ticks(60, here + np.array([90, -90, 90, -90]))
    assert abs(rig.places() - here - np.array([90, -90, 90, -90])).max() <= 2


def test_identification_reports_model_firmware_and_settings() -> None:
    rig = rig_of(settings={"homing_offset": -5})
    device = rig.perform(rig.reader.identify())[0]
    assert (device.model_number, device.model_name, device.firmware) == (777, "STS3215", 310)
    assert device.settings["homing_offset"] == -5
    assert device.unique_id is None


@pytest.mark.parametrize("block", BLOCKS)
def test_a_servo_silent_while_its_settings_are_read_is_not_identified(block: tuple[int, int]) -> None:
    """Defaults would stand for what was not read, and nothing would read it again."""
    rig = rig_of()

    def script() -> Script[tuple[IdentifiedDevice, ...]]:
        identification = rig.reader.identify()
        reply = None
        while True:
            try:
                request = identification.send(reply) if reply else next(identification)
            except StopIteration as stop:
                found: tuple[IdentifiedDevice, ...] = stop.value
                return found
            assert isinstance(request, ReadRequest)
            rig.faults.silence(2, (request.address, request.size) == block)
            reply = yield request

    assert [device.id for device in rig.perform(script())] == [1, 3]


def test_an_unknown_firmware_is_read_and_not_armed() -> None:
    rig = rig_of(firmware=(3, 60, 0))
    rig.perform(rig.reader.identify())
    with pytest.raises(DeviceRefused, match="only read"):
        rig.beside(rig.writer.prepare(np.full(3, 2048)))
    assert not rig.energised().any()


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"operating_mode": 1}, "wheel"),
        ({"phase": 28}, "bit 4"),
        ({"shutdown": 5}, "overload or temperature"),
        ({"status_return_level": 0}, "confirms no write"),
        ({"max_voltage_limit": 70}, "supply voltage"),
    ],
)
def test_what_must_not_get_torque_is_refused(settings: dict[str, int], reason: str) -> None:
    rig = rig_of(settings=settings)
    with pytest.raises(DeviceRefused, match=reason):
        rig.beside(rig.writer.prepare(np.full(3, 2048)))
    assert not rig.energised().any()


def test_a_model_with_other_registers_than_expected_is_refused() -> None:
    rig = rig_of(firmware=(3, 43, 0))
    with pytest.raises(DeviceRefused, match="STS"):
        rig.beside(rig.writer.prepare(np.full(3, 2048)))


# ---------------------------------------------------------------------------- positions


def test_a_position_0_from_nowhere_is_not_believed() -> None:
    rig = rig_of()
    rig.positions()
    servos = rig.servos
    servos.frozen[1] = 0
    assert rig.tick().heard.tolist() == [True, False, True]
    servos.frozen[1] = None
    assert [bool(rig.tick().heard[1]) for _ in range(3)] == [False, True, True]
    for _ in range(2):
        servos.frozen[1] = 0
        assert rig.tick().heard.tolist() == [True, False, True], "one before a good reading is no witness"
        assert rig.tick().heard.tolist() == [True, False, True]
        servos.frozen[1] = None
        assert [bool(rig.tick().heard[1]) for _ in range(2)] == [False, True]
    servos.frozen[1] = 0
    heard = [bool(rig.tick().heard[1]) for _ in range(ZERO)]
    assert heard == [False] * (ZERO - 1) + [True], "it really stands there"


def test_no_wrong_position_passes_bit_errors() -> None:
    rig = rig_of()
    rig.positions()
    rig.faults.bit_errors(0.002, to_servos=False)
    samples = rig.ticks(400)
    wrong = [sample for sample in samples if (abs(sample.position - 2048) > 200)[sample.heard].any()]
    assert not wrong
    assert any(not sample.heard.all() for sample in samples), "nothing was disturbed"


def test_positions_of_several_turns_are_read_and_commanded() -> None:
    turns = {"min_position_limit": 0, "max_position_limit": 0, "phase": 28}
    rig = rig_of(settings=turns)
    rig.writer.set_goal_limits(np.full(3, -9000), np.full(3, 9000))
    here = rig.arm()
    goal = here
    for _ in range(300):
        goal = np.maximum(goal - 20, -3000)
        sample = rig.tick(goal)
    assert abs(sample.position + 3000).max() <= 2


@pytest.mark.parametrize(("lower", "upper", "fine"), [(0, 4095, True), (-1, 4095, False), (0, 4096, False)])
def test_goals_of_more_than_one_turn_need_limits_of_0(lower: int, upper: int, fine: bool) -> None:
    rig = rig_of()
    rig.writer.set_goal_limits(np.full(3, lower), np.full(3, upper))
    if fine:
        rig.beside(rig.writer.prepare(rig.positions()))
        return
    with pytest.raises(DeviceRefused, match=r"limits .* must be 0 for more than one turn"):
        rig.beside(rig.writer.prepare(rig.positions()))


# ---------------------------------------------------------------------------- torque


def test_torque_begins_low_and_ends_at_the_full_limit() -> None:
    rig = rig_of(settings={"max_torque": 900})
    rig.beside(both(rig, rig.positions()))
    assert [rig.servos.get(row, "torque_limit") for row in range(3)] == [300] * 3
    rig.beside(rig.writer.torque(True))
    assert [rig.servos.get(row, "torque_limit") for row in range(3)] == [900] * 3


def test_damping_is_taken_back_by_preparing() -> None:
    rig = rig_of()
    here = rig.arm()
    assert rig.beside(rig.writer.damp()) == ()
    assert (rig.servos.get(0, "torque_limit"), rig.servos.get(0, "position_p_gain")) == (300, 4)
    assert rig.servos.eprom[0][21] == 32, "gains are changed in RAM alone"
    rig.beside(rig.writer.prepare(here))
    assert (rig.servos.get(0, "torque_limit"), rig.servos.get(0, "position_p_gain")) == (1000, 32)


def test_a_servo_that_a_goal_arms_holds_where_it_is() -> None:
    rig = rig_of(goal_arms=True)
    rig.beside(rig.writer.prepare(rig.positions()))
    rig.ticks(10)
    assert (rig.places() == 2048).all()
    rig.writer.goals(np.full(3, 2500))
    rig.ticks(10)
    assert (rig.places() == 2048).all(), "a goal without torque left"


def test_a_servo_that_another_writer_armed_follows_once_it_is_prepared() -> None:
    rig = rig_of()
    here = rig.arm()
    rig.writer = FeetechWriter(rig.reader, lower=rig.lower, upper=rig.upper)
    rig.ticks(10, here + 40)
    assert (rig.places() == here).all(), "no goal before"
    rig.beside(rig.writer.prepare(here))
    rig.ticks(30, here + 40)
    assert abs(rig.places() - here - 40).max() <= 2


def test_a_servo_that_lost_its_supply_gets_no_goals_until_it_is_prepared() -> None:
    rig = FeetechRig([FeetechServoSpec(id, goal_arms=True) for id in (1, 2, 3)])
    here = rig.arm()
    rig.ticks(5, here)
    rig.faults.brown_out(2)
    rig.ticks(150, here)
    assert rig.tick(here).heard.all()
    assert rig.energised().tolist() == [True, False, True]
    assert rig.registers.torque.tolist() == [1, 0, 1]


def test_it_holds_its_last_goal_when_the_master_is_gone() -> None:
    """There is no watchdog: that is what the daemon must deal with."""
    rig = rig_of()
    here = rig.arm()
    rig.ticks(5, here + 50)
    rig.clock.sleep_until(rig.clock.now() + 5.0)
    rig.bus.advance(rig.clock.now())
    assert rig.energised().all()
    assert abs(rig.places() - here - 50).max() <= 2
    assert (rig.registers.watchdog == -1).all()


def test_a_held_servo_that_refuses_to_be_prepared_is_left_out_and_the_others_are_prepared() -> None:
    rig = rig_of()
    here = rig.arm()
    rig.faults.damage(2, 0x01)
    rig.ticks(5, here)
    with pytest.raises(NoReply, match="supply voltage") as left_out:
        rig.beside(rig.writer.prepare(here))
    assert left_out.value.ids == (2,)
    rig.ticks(30, here + 40)
    others = rig.places() - here
    assert abs(np.delete(others, 1) - 40).max() <= 2


def test_a_servo_without_torque_that_refuses_ends_the_preparation() -> None:
    rig = rig_of()
    here = rig.arm()
    rig.beside(rig.writer.torque(on=False))
    rig.faults.damage(2, 0x01)
    rig.ticks(5)
    with pytest.raises(DeviceRefused, match="supply voltage"):
        rig.beside(rig.writer.prepare(here))


def test_an_error_is_a_state_and_not_a_latch() -> None:
    rig = rig_of()
    here = rig.arm()
    rig.faults.damage(2, 0x20)
    assert rig.ticks(10, here)[-1].error.tolist() == [0, 0x80, 0]
    assert rig.registers.fault[1] == 0x20
    for own, named in ((0x02, 0x08), (0x08, 0x20), (0x05, 0x05)):  # encoder, current, voltage and temperature
        rig.faults.damage(2, own)
        rig.ticks(10, here)
        assert rig.registers.fault[1] == named
    rig.faults.damage(2, 0)
    assert rig.ticks(10, here)[-1].error.tolist() == [0, 0, 0]
    assert rig.registers.fault[1] == 0


def test_a_blocked_shaft_is_unloaded_and_reported() -> None:
    rig = rig_of()
    here = rig.arm()
    rig.faults.lock(2)
    rig.ticks(300, here + 400)
    assert rig.registers.fault[1] == 0x20


@pytest.mark.parametrize("latches", [False, True])
def test_an_overload_ends_with_torque_off_unless_only_a_restart_ends_it(latches: bool) -> None:
    rig = rig_of(latches=latches)
    here = rig.arm()
    rig.faults.lock(2)
    rig.ticks(300, here + 400)
    rig.faults.free(2)
    rig.beside(rig.writer.torque(False))
    rig.ticks(10)
    assert rig.registers.fault[1] == (0x20 if latches else 0)
    if latches:
        with pytest.raises(DeviceRefused, match="overload"):
            rig.beside(rig.writer.prepare(rig.positions()))
        rig.beside(rig.writer.reboot(2))
    rig.arm()
    assert rig.registers.fault[1] == 0


def test_torque_of_a_servo_that_boots_with_it_is_seen_and_taken_back() -> None:
    rig = rig_of(boots_armed=True)
    rig.ticks(10)
    assert rig.registers.torque.tolist() == [1, 1, 1]
    rig.beside(rig.writer.torque(False))
    assert not rig.energised().any()
    rig.beside(rig.writer.reboot(2))
    assert not rig.energised().any(), "the one that booted with torque, too"


def test_an_hls_without_goal_torque_is_refused() -> None:
    rig = rig_of(model="HLS3955")
    rig.positions()
    rig.servos.put(1, "goal_torque", 0)
    with pytest.raises(DeviceRefused, match="not move"):
        rig.beside(rig.writer.prepare(np.full(3, 2048)))
    assert not rig.energised().any()


def test_a_restart_waits_for_the_boot_loader() -> None:
    rig = rig_of()
    rig.positions()
    before = rig.clock.now()
    rig.beside(rig.writer.reboot(2))
    assert rig.clock.now() - before >= 0.8
    assert not rig.energised().any()


# ---------------------------------------------------------------------------- registers


def test_eprom_is_unlocked_written_read_back_and_locked() -> None:
    rig = rig_of()
    rig.positions()
    assert rig.beside(rig.writer.write(2, "homing_offset", -100)).value == -100
    assert rig.servos.eprom[1][31:33] == bytes((100, 8)), "sign and magnitude, stored"
    assert rig.servos.get(1, "lock") == 1


def test_an_equal_value_is_not_written_to_eprom() -> None:
    rig = rig_of()
    rig.positions()
    before = rig.sent()
    rig.perform(rig.writer.write(2, "position_p_gain", 32))
    assert rig.sent() - before == 8, "one read"


def test_eprom_is_refused_under_torque_and_what_is_not_its_to_write() -> None:
    rig = rig_of()
    rig.arm()
    with pytest.raises(DeviceRefused, match="disarm"):
        rig.beside(rig.writer.write(2, "homing_offset", 3))
    for name in ("operating_mode", "id", "lock", "goal_position", "present_position"):
        with pytest.raises(ValueError):
            rig.beside(rig.writer.write(2, name, 1))


@pytest.mark.parametrize(("name", "value"), [("acceleration", 50), ("homing_offset", -100)])
def test_a_value_that_a_servo_ignores_is_noticed_by_reading_back(name: str, value: int) -> None:
    rig = rig_of()
    rig.positions()
    rig.servos.write = lambda *_: None  # type: ignore[method-assign]
    with pytest.raises(DeviceRefused, match="reads"):
        rig.beside(rig.writer.write(2, name, value))


@pytest.mark.parametrize(
    ("address", "data"),
    [(5, b"\7"), (31, b"\0\0"), (42, b"\xff\x7f"), (40, b"\x80"), (56, b"\0\0"), (200, b"\0"), (41, b"\0\0")],
)
def test_the_last_check_lets_no_other_write_out(address: int, data: bytes) -> None:
    rig = rig_of()
    before = rig.sent()
    with pytest.raises(WireRangeError):
        rig.writer.begin(WriteRequest({1: data}, address), 0.0)
    with pytest.raises(WireRangeError):
        rig.writer.begin(WriteRequest({9: b"\0"}, FeetechInstruction.READ), 0.0)
    assert rig.sent() == before


# ---------------------------------------------------------------------------- strength


@pytest.mark.parametrize(("volts", "rpm"), [(7.4, 52.0), (12.0, 45.0), (6.0, 42.0)])
def test_an_sts3215_is_as_fast_as_its_page_says(volts: float, rpm: float) -> None:
    rig = rig_of(volts=volts)
    here = rig.arm()
    speeds = [rig.tick(here + 1500).velocity.max() for _ in range(30)]
    assert max(speeds) == pytest.approx(rpm / 60.0 * 4096, rel=0.01)


def test_the_supply_sets_the_speed() -> None:
    rig = rig_of(volts=7.4)
    here = rig.arm()
    rig.faults.supply(6.0)
    speeds = [rig.tick(here + 1500).velocity.max() for _ in range(30)]
    assert max(speeds) == pytest.approx(52.0 / 60.0 * 4096 * 6.0 / 7.4, rel=0.01)


def test_a_described_arm_has_the_strength_of_its_supply() -> None:
    arm = load_robot("so101")
    kind = arm.joints[1].type
    assert isinstance(kind, FeetechType)
    assert kind.strength == pytest.approx((1.912, 5.445), rel=1e-3)
