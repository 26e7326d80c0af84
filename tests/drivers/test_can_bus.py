"""Rules of a CAN bus beyond the contract of all drivers: stale goals, turns, masters, watchdogs."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.can_driver_rig import EDGE, CanRig
from tests.support.driver_rig import is_output_full
from tests.support.examples import examples
from twind_drivers.bus import DeviceRefused, GroupWriteBatch, PortError, WireRangeError, WriteRequest
from twind_drivers.can.actuator import CanActuatorIdentity
from twind_drivers.can.actuator_family import HEAT, ValuelessCommand
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.can_writer import CanWriter
from twind_drivers.can.register_access import ADDRESS, COMMAND, STATE, whole_command
from twind_drivers.ports.channel import CanErrorState
from twind_drivers.virtual.can.can_controller import CanAdapter

MODELS = ("DM4310", "DM4340", "DM8009")
REPLYING = ("DM4310", "RS01")


def sent_to(rig: CanRig, row: int) -> list[float]:
    """Positions (rad) that one was commanded to, in order."""
    found: list[float] = []
    for train in rig.channel.trains:
        own = train[rig.reader.fleet.commanded_rows(train) == row]
        place = rig.reader.fleet.decode_commanded_position(own)
        found += place[~np.isnan(place)].tolist()
    return found


# ------------------------------------------------------------------------------------- stale goals


@pytest.mark.parametrize("keeps", [False, True])
@pytest.mark.parametrize("models", [MODELS, ("RS01", "RS02"), ("ODrive", "ODrive")])
def test_power_that_returns_while_goals_flow_moves_nothing(models: Sequence[str], keeps: bool) -> None:
    rig = CanRig(models, adapter=CanAdapter(keeps=keeps))
    here = rig.arm()
    rig.ticks(20, here + 100)
    rig.faults.power(False)
    for _ in range(60):
        rig.tick(here + 100)
    rig.muscles.position[:] = 1.0  # it sagged
    rig.faults.power(True)
    before = rig.places()
    for _ in range(60):
        rig.tick(here + 100)
    assert not rig.energised().any()
    assert abs(rig.places() - before).max() <= 2


def test_answers_to_what_an_adapter_kept_are_late_and_no_other_masters() -> None:
    rig = CanRig(MODELS, adapter=CanAdapter(keeps=True))
    here = rig.arm()
    rig.ticks(20, here)
    rig.faults.power(False)
    rig.ticks(40, here)
    rig.faults.power(True)
    back = rig.ticks(100, here)
    assert any(sample.discarded for sample in back), "nothing that it kept went out: this shows nothing"
    assert not sum(sample.foreign for sample in back)
    rig.ticks(100)
    rig.faults.foreign(3)
    assert sum(sample.foreign for sample in rig.ticks(5)) >= 3, "that excuse ends"


def test_a_bus_cut_for_longer_than_a_watchdog_gets_no_goal_until_it_is_prepared() -> None:
    rig = CanRig(MODELS)
    here = rig.arm()
    rig.ticks(10, here)
    rig.faults.unacknowledged()
    lines = [rig.tick(here + 500).line for _ in range(40)]
    assert lines[-1] == CanErrorState.OFF
    rig.faults.unacknowledged(False)
    before = len(rig.channel.trains)
    places = rig.places()
    samples = rig.ticks(40, here + 500)
    assert samples[-1].heard.all()
    assert samples[-1].line == CanErrorState.ACTIVE
    late = [rig.reader.fleet.commanded_rows(train) for train in rig.channel.trains[before:]]
    assert not any((rows >= 0).any() for rows in late), "a goal left after the line was dead"
    assert abs(rig.places() - places).max() <= 3
    assert (rig.registers.watchdog == 255).all()
    rig.arm()
    rig.ticks(60, here)
    assert abs(rig.places() - here).max() < 40


def test_an_actuator_absent_beyond_its_watchdog_is_not_commanded_again() -> None:
    rig = CanRig(MODELS)
    here = rig.arm()
    rig.ticks(10, here)
    rig.faults.silence(2)
    rig.ticks(15, here)
    rig.faults.silence(2, False)
    rig.ticks(10, here)
    assert rig.registers.watchdog.tolist() == [100, 255, 100]
    count = len(sent_to(rig, 1)), len(sent_to(rig, 0))
    rig.ticks(5, here)
    assert (len(sent_to(rig, 1)), len(sent_to(rig, 0))) == (count[0], count[1] + 5)


def test_a_goal_that_found_the_port_full_is_never_sent_later() -> None:
    rig = CanRig(MODELS)
    here = rig.arm()
    rig.ticks(20, here)
    before = rig.places()
    full = 0
    rig.faults.stall()
    for step in range(4):
        rig.writer.goals(here + 300 + step)
        try:
            rig.reader.request(rig.clock.now())
        except PortError as error:
            full += is_output_full(error)
            assert rig.reader.line.goals is None
        rig.clock.sleep_until(rig.clock.now() + 0.01)
    assert full >= 1
    rig.faults.stall(False)
    rig.ticks(5)
    assert abs(rig.places() - before).max() <= 5


def test_a_cut_that_was_thrown_away_with_the_queue_is_sent_again() -> None:
    rig = CanRig(MODELS)
    here = rig.arm()
    rig.ticks(5, here)
    rig.faults.stall()
    rig.writer.cut()
    rig.ticks(4)
    assert rig.energised().all(), "the adapter kept it back"
    rig.faults.stall(False)
    rig.ticks(4)
    assert not rig.energised().any()


# ------------------------------------------------------------------------------------- torque


def test_torque_comes_soft_first_and_only_then_stiff() -> None:
    rig = CanRig(MODELS)
    here = rig.positions()
    rig.beside(rig.writer.prepare(here))
    before = len(rig.channel.trains)
    rig.perform(rig.writer.torque(True))
    first = rig.channel.trains[before]
    enable = rig.reader.fleet.encode_valueless_command(0, ValuelessCommand.ENABLE)
    assert first[0].tobytes() == enable[0].tobytes()
    gains = [int(frame["data"][3] & 0xF) << 8 | int(frame["data"][4]) for frame in first[3:6]]
    assert gains == [0, 0, 0], "stiffness before anybody has said where he is"
    last = rig.channel.trains[-1]
    assert all(int(frame["data"][3] & 0xF) << 8 | int(frame["data"][4]) for frame in last)


def test_torque_without_aim_is_refused() -> None:
    rig = CanRig(MODELS)
    rig.positions()
    with pytest.raises(DeviceRefused, match="aim"):
        rig.beside(rig.writer.torque(True))


def test_a_hold_ends_by_itself_when_no_goal_follows() -> None:
    rig = CanRig(MODELS)
    rig.arm()
    before = len(sent_to(rig, 0))
    rig.ticks(100)
    assert 20 <= len(sent_to(rig, 0)) - before <= 52


def test_damped_commands_have_no_stiffness_until_prepared_anew() -> None:
    rig = CanRig(("DM4310",) * 2)
    here = rig.arm()
    rig.ticks(3, here)
    assert rig.beside(rig.writer.damp()) == ()

    def stiffness() -> int:
        data = rig.channel.trains[-2]["data"]  # the last is upkeep
        return int((data[:, 3] & 0xF).max()) << 8 | int(data[:, 4].max())

    rig.tick(here + 50)
    assert stiffness() == 0
    rig.beside(rig.writer.prepare(here))
    rig.tick(here)
    assert stiffness() > 0


# ------------------------------------------------------------------------------------- watchdogs, faults


def test_an_actuator_without_a_watchdog_is_refused_unless_allowed_and_then_reported() -> None:
    for model in ("ODrive", "AK80-9"):
        rig = CanRig((model,), watchdog=True)
        here = rig.positions()
        with pytest.raises(DeviceRefused, match="watchdog"):
            rig.beside(rig.writer.prepare(here))
        rig = CanRig((model,), watchdog=False)
        rig.beside(rig.writer.prepare(rig.positions()))
        assert "no watchdog" in rig.reader.transport.warning
        assert "[1]" in rig.reader.transport.warning


def test_a_tripped_actuator_reads_so_and_is_no_hardware_error() -> None:
    rig = CanRig(MODELS)
    rig.arm()
    rig.clock.sleep_until(rig.clock.now() + 0.5)
    sample = rig.ticks(3)[-1]
    assert not sample.error.any()
    assert (rig.registers.watchdog == 255).all()
    rig.beside(rig.writer.torque(False))
    assert (rig.registers.torque == 0).all()


def test_a_fault_alerts_and_is_read_by_its_name_and_cleared_by_prepare() -> None:
    rig = CanRig(MODELS)
    here = rig.positions()
    rig.faults.damage(2, 0xC)
    assert rig.tick().error.tolist() == [0, 0x80, 0]
    assert rig.beside(rig.reader.read(2, "hardware_error_status")).value == HEAT
    rig.beside(rig.writer.prepare(here))
    assert not rig.tick().error.any()


def test_watchdogs_are_read_twenty_times_a_second_and_voltage_five() -> None:
    rig = CanRig(("RS01",) * 6)
    here = rig.arm()
    rig.ticks(10, here)
    worst = np.zeros(2)
    for _ in range(100):
        rig.tick(here)
        ages = rig.clock.now() - rig.registers.status_time, rig.clock.now() - rig.registers.health_time
        worst = np.maximum(worst, [each.max() for each in ages])
    assert worst[0] <= 0.05 + 0.011
    assert worst[1] <= 0.2 + 0.011


# ------------------------------------------------------------------------------------- masters and strangers


@pytest.mark.parametrize("fault", ["master", "twin"])
def test_frames_of_another_master_or_of_a_second_node_with_one_id_are_foreign(fault: str) -> None:
    rig = CanRig(MODELS)
    rig.positions()
    assert sum(sample.foreign for sample in rig.ticks(20)) == 0
    getattr(rig.faults, fault)(2)
    assert sum(sample.foreign for sample in rig.ticks(20)) >= 3


def test_a_late_reply_is_discarded_and_not_counted_as_foreign() -> None:
    rig = CanRig(MODELS)
    rig.positions()
    rig.faults.delay(0.011, 2)
    samples = rig.ticks(2)
    assert not samples[0].heard[1]
    assert sum(sample.foreign for sample in rig.ticks(10)) == 0


# ------------------------------------------------------------------------------------- goals and registers


def test_speed_beside_a_goal_is_its_step_and_a_jump_has_none() -> None:
    rig = CanRig(("DM4310",) * 2)
    rig.writer.goals(np.array([0, 0]))
    rig.read()
    rig.writer.goals(np.array([10, 0]))
    frames = rig.reader.line.goals.frames
    fields = [int(data[2]) << 4 | int(data[3]) >> 4 for data in frames["data"]]
    speed = [field * 60.0 / 4095 - 30.0 for field in fields]
    assert speed[0] == pytest.approx(10 * COUNT * 100, abs=0.015)
    assert speed[1] == pytest.approx(0.0, abs=0.015)
    rig.read()
    rig.writer.goals(np.array([3000, 0]))
    assert int(rig.reader.line.goals.frames["data"][0, 2]) << 4 >> 4 == 0x7F, "a jump of 115 rad/s"


@examples(60)
@given(st.lists(st.integers(-EDGE, EDGE), min_size=4, max_size=4))
def test_every_goal_within_bounds_passes_the_wire_check_and_decodes_to_its_value(ticks: list[int]) -> None:
    rig = CanRig(("DM4310", "RS02", "AK70-10", "ODrive"))
    goal = np.array(ticks)
    rig.writer.goals(goal)
    frames = rig.reader.line.goals.frames
    place = rig.reader.fleet.decode_commanded_position(frames) / COUNT
    assert abs(place - goal[rig.reader.fleet.commanded_rows(frames)]).max() <= 1.0


def test_the_wire_check_refuses_a_command_out_of_bounds_or_without_an_addressee() -> None:
    rig = CanRig(MODELS)
    rig.positions()
    before = rig.sent()
    outside = whole_command(np.array([(EDGE + 3) * COUNT, 0, 10, 1, 0]))
    with pytest.raises(WireRangeError):
        rig.writer.begin(WriteRequest({1: outside}, COMMAND), rig.clock.now())
    with pytest.raises(DeviceRefused, match="99"):
        rig.writer.begin(
            GroupWriteBatch((WriteRequest({99: b""}, ADDRESS[ValuelessCommand.ENABLE]),)), rig.clock.now()
        )
    with pytest.raises(DeviceRefused):
        rig.writer.begin(WriteRequest({1: b""}, STATE), rig.clock.now())
    assert rig.sent() == before


def test_registers_are_read_and_written_by_name_and_the_scripts_keep_theirs() -> None:
    rig = CanRig(MODELS)
    rig.positions()
    assert rig.beside(rig.reader.read(1, "position range")).value == 12500
    assert rig.beside(rig.reader.read(1, "serial_number")).value == 10001
    assert rig.beside(rig.writer.write(1, "over_temperature", 90_000)).value == 90_000
    for name in ("timeout", "mode", "master_id", "esc_id", "can_rate"):
        with pytest.raises(ValueError, match="not written here"):
            rig.beside(rig.writer.write(1, name, 1))
    with pytest.raises(ValueError):
        rig.beside(rig.writer.write(1, "serial_number", 5))


@pytest.mark.parametrize("model", ["DM4310", "RS01", "ODrive"])
def test_each_register_of_the_identification_is_answered(model: str) -> None:
    rig = CanRig((model,))
    rig.positions()
    [(family, _)] = rig.reader.fleet.families
    for name in family.identity:
        assert rig.beside(rig.reader.read(1, name)).name == name


def test_reported_ranges_are_used_and_appear_in_the_limits() -> None:
    rig = CanRig(MODELS)
    rig.faults.ranges(2, 6.25, 30.0, 10.0)
    rig.faults.brown_out(2)
    rig.clock.sleep_until(rig.clock.now() + 1.0)
    found = rig.identify()
    assert found[1].settings["max_position_limit"] == -found[1].settings["min_position_limit"]
    assert found[1].settings["max_position_limit"] == round(6.25 / COUNT)
    assert found[1].settings["pmax_milli"] == 6250
    sample = rig.ticks(3)[-1]
    assert abs(sample.position - rig.places()).max() <= 2


def test_a_bus_that_cannot_be_is_refused() -> None:
    rig = CanRig(MODELS)
    twice = [rig.actuators[0], rig.actuators[0]]
    for actuators in ([], twice):
        with pytest.raises(ValueError):
            CanReader("arm", rig.channel, actuators, bitrate=1_000_000)
    with pytest.raises(KeyError):
        CanReader("arm", rig.channel, [CanActuatorIdentity(1, 17, "DM99", 12.5, 30, 10)], bitrate=1_000_000)
    three = np.full(3, 10.0)
    for bad in (
        {"lower": np.zeros(2, np.int64)},
        {"lower": np.full(3, 9), "upper": np.full(3, 8)},
        {"kp": np.full(3, 501.0)},
        {"kd": np.full(3, np.nan)},
    ):
        given = {"lower": np.zeros(3, np.int64), "upper": np.ones(3, np.int64), "kp": three, "kd": three / 10}
        with pytest.raises(ValueError):
            CanWriter(rig.reader, **(given | bad))  # type: ignore[arg-type]


def test_a_lost_port_is_opened_anew_and_nothing_of_before_leaves() -> None:
    rig = CanRig(MODELS)
    here = rig.arm()
    rig.ticks(3, here)
    rig.writer.goals(here + 300)
    rig.faults.unplug()
    with pytest.raises(PortError):
        rig.read()
    rig.clock.sleep_until(rig.clock.now() + 0.3)
    rig.faults.replug()
    rig.open()
    before = rig.places()
    rig.ticks(10)
    assert rig.tick().heard.all()
    assert sent_to(rig, 0) == []
    assert abs(rig.places() - before).max() <= 3


def test_an_actuator_with_late_replies_is_not_treated_as_absent() -> None:
    rig = CanRig(MODELS)
    here = rig.arm()
    rig.ticks(5, here)
    rig.faults.delay(0.0125, 2)
    samples = rig.ticks(30, here)
    assert not any(sample.heard[1] for sample in samples[:3])
    assert (rig.registers.watchdog == 100).all()


@pytest.mark.parametrize("models", [("ODrive",), ("ODrive",) * 3])
def test_a_heartbeat_that_comes_before_the_position_does_not_end_a_reading(models: Sequence[str]) -> None:
    """After a common power cycle all phases coincide, and the lower id of a heartbeat wins arbitration."""
    rig = CanRig(models)
    for phase in range(10):
        rig.ticks(20)
        rig.faults.power(False)
        rig.ticks(30)
        rig.clock.sleep_until(rig.clock.now() + 0.0001 * phase)
        rig.faults.power(True)
        rig.ticks(50)
        assert all(sample.heard.all() for sample in rig.ticks(50)), phase
