import numpy as np
import pytest

from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import Framer
from twind_drivers.virtual.shown_position_log import ShownPositionLog

IDS = [1, 2, 3, 4]


def test_one_of_two_servos_with_one_id_is_silenced_by_its_number() -> None:
    host = Host([1, 1, 2])
    host.bus.faults.silence(1, number=2)
    assert [each.id for each in host.ask(packet.ping(1))] == [1]
    host.bus.faults.silence(1, number=1)
    assert host.ask(packet.ping(1)) == []
    with pytest.raises(KeyError, match="id 1 has 2"):
        host.bus.faults.silence(1, number=3)


@pytest.mark.parametrize("short_way", [False, True])
def test_drop_loses_exactly_that_many_answers(short_way: bool) -> None:
    host = Host(IDS)
    request = packet.sync_read(IDS, 132, 4)
    if short_way:
        host.raw(request)
    host.bus.faults.drop(3)
    assert [each.id for each in host.ask(request)] == [4]
    assert len(host.ask(request)) == 4


def test_corrupt_breaks_the_crc_of_exactly_that_many_answers() -> None:
    host = Host(IDS)
    request = packet.sync_read(IDS, 132, 4)
    host.bus.faults.corrupt(1)
    raw = host.raw(request)
    assert len(raw) == 60
    assert [each.id for each in Framer(status=True).feed(raw)] == [2, 3, 4]
    assert len(host.ask(request)) == 4


def test_foreign_puts_a_sound_status_before_an_answer() -> None:
    host = Host(IDS)
    host.bus.faults.foreign(1)
    assert [each.id for each in host.ask(packet.ping(2))] == [252, 2]
    assert [each.id for each in host.ask(packet.ping(2))] == [2]


def test_delay_makes_every_answer_late_until_it_is_taken_back() -> None:
    host = Host(IDS)
    host.bus.receive(packet.ping(1), 0.0)
    prompt = host.bus.next_output_time()
    host.bus.take(prompt)
    host.bus.faults.delay(0.02)
    host.bus.receive(packet.ping(1), 1.0)
    assert host.bus.next_output_time() == pytest.approx(1.0 + prompt + 0.02)


def test_a_silenced_servo_receives_nothing_and_its_watchdog_trips() -> None:
    host = Host(IDS)
    for id in IDS:
        host.write(id, 98, 5, 1)
        host.torque(id)
    host.bus.faults.silence(2)
    for _ in range(10):
        host.wait(0.05)
        host.raw(packet.ping(1))
    assert host.servos.tripped.tolist() == [False, True, False, False]


def test_a_brown_out_acts_as_an_unrequested_reboot() -> None:
    host = Host(IDS)
    host.torque(3)
    host.wait(1.0)
    host.bus.faults.brown_out(3)
    assert host.ask(packet.ping(3)) == []
    host.wait(0.2)
    assert host.read(3, 64, 1) == 0
    assert host.read(3, 120, 2) < 200, "its clock went back"


def test_a_fault_of_one_id_spares_the_others() -> None:
    host = Host(IDS)
    request = packet.sync_read(IDS, 132, 4)
    faults = host.bus.faults
    faults.drop(1, id=2)
    faults.corrupt(1, id=3, bits=5)
    assert [each.id for each in host.ask(request)] == [1, 4]
    assert [each.id for each in host.ask(request)] == IDS
    faults.foreign(1, id=4)
    assert [each.id for each in host.ask(request)] == [1, 2, 3, 252, 4]


def test_a_doubled_answer_comes_twice() -> None:
    host = Host(IDS)
    host.bus.faults.duplicate(1, id=2)
    assert [each.id for each in host.ask(packet.sync_read(IDS, 132, 4))] == [1, 2, 2, 3, 4]


def test_a_slow_servo_answers_into_the_next_exchange_and_delays_no_other() -> None:
    host = Host(IDS)
    request = packet.sync_read(IDS, 132, 4)
    host.bus.faults.delay(0.01, id=2)
    found = Framer(status=True)
    host.bus.receive(request, 0.0)
    assert [each.id for each in found.feed(host.bus.take(0.005))] == [1, 3, 4]
    host.bus.faults.clear()
    host.bus.receive(packet.ping(4), 0.009)
    assert [each.id for each in found.feed(host.bus.take(0.02))] == [4, 2]


def test_a_slow_link_holds_up_a_joint_answer() -> None:
    host = Host(IDS)
    request = packet.fast_sync_read(IDS, 132, 4)
    clean = host.raw(request)
    begin = host.clock.now()
    host.bus.faults.delay(0.01, id=3)
    host.bus.receive(request, begin)
    assert host.bus.take(begin + 0.009) == clean[: 8 + 2 * 8]
    assert host.bus.take(begin + 0.02) == clean[8 + 2 * 8 :]


def test_a_cut_joint_answer_ends_there_and_a_cut_status_spares_the_next() -> None:
    host = Host(IDS)
    clean = host.raw(packet.fast_sync_read(IDS, 132, 4))
    host.bus.faults.cut(1, 3, id=2)
    assert host.raw(packet.fast_sync_read(IDS, 132, 4)) == clean[: 16 + 3]
    host.bus.faults.cut(1, 9, id=2)
    assert [each.id for each in host.ask(packet.sync_read(IDS, 132, 4))] == [1, 3, 4]
    assert host.raw(packet.fast_sync_read(IDS, 132, 4)) == clean


def test_with_a_fault_ordered_the_sound_answers_take_as_long_as_without() -> None:
    for read in (packet.sync_read, packet.fast_sync_read):
        host = Host(IDS, settings={"return_delay_time": 25})
        took = []
        for _ in range(3):
            begin = host.clock.now()
            data = host.raw(read(IDS, 132, 4))
            took.append((round(host.clock.now() - begin, 9), data))
            host.bus.faults.drop(1, id=4) if len(took) == 1 else host.bus.faults.clear()
            host.wait(0.01)
        assert took[0] == took[2]
        assert took[0][1].startswith(took[1][1])


def test_servos_without_power_do_not_answer_and_reboot_with_it() -> None:
    """e-manual, "Operating Mode" note: torque, RAM and turns are lost."""
    host = Host(IDS)
    host.torque(3)
    host.bus.faults.power(False)
    host.bus.faults.clear()
    host.wait(100.0)
    host.bus.faults.brown_out(2)
    host.wait(1.0)
    assert host.ask(packet.sync_read(IDS, 132, 4)) == []
    assert not host.servos["torque_enable"].any()
    host.bus.faults.power(True)
    assert host.ask(packet.ping(1)) == []
    host.wait(0.2)
    assert [each.id for each in host.ask(packet.sync_read(IDS, 132, 4))] == IDS
    assert host.read(3, 64, 1) == 0


def test_a_reply_under_way_at_an_unplug_never_arrives() -> None:
    host = Host(IDS)
    host.bus.receive(packet.ping(2), host.clock.now())
    host.bus.faults.unplug()
    host.bus.faults.replug()
    host.wait(0.01)
    assert host.bus.take(host.clock.now()) == b""
    assert [each.id for each in host.ask(packet.ping(3))] == [3]


def test_all_connectors_pulled_and_plugged_in() -> None:
    host = Host(IDS)
    request = packet.sync_read(IDS, 132, 4)
    host.bus.faults.silence()
    assert host.ask(request) == []
    host.bus.faults.silence(on=False)
    assert len(host.ask(request)) == 4


def test_a_locked_shaft_does_not_turn_and_a_free_one_does() -> None:
    host = Host(IDS)
    host.torque(2)
    host.bus.faults.lock(2)
    host.goal(2, 2500)
    host.wait(0.3)
    assert host.present(2) == 2048
    host.bus.faults.free(2)
    host.wait(3.0)
    assert host.present(2) == pytest.approx(2500, abs=2)


def test_a_frozen_encoder_repeats_its_value_while_the_shaft_turns() -> None:
    host = Host(IDS)
    host.torque(2)
    host.bus.faults.freeze(2)
    host.goal(2, 2500)
    host.wait(3.0)
    assert host.present(2) == 2048
    assert host.muscles.position[1] == pytest.approx(2500, abs=2)
    host.bus.faults.freeze(2, False)
    host.wait(0.1)
    assert host.present(2) == pytest.approx(2500, abs=2)


def test_supply_and_heat_are_what_the_registers_show() -> None:
    host = Host(IDS)
    host.bus.faults.supply(10.4)
    host.bus.faults.heat(3, 55.0)
    host.wait(1.0)
    assert [host.read(id, 144, 2) for id in IDS] == [104] * 4
    assert [host.read(id, 146, 1) for id in IDS] == [25, 25, 55, 25]


def test_a_thin_cable_takes_voltage_from_one_servo_alone() -> None:
    host = Host(IDS)
    host.bus.faults.sag(3, 1.5)
    host.wait(1.0)
    assert [host.read(id, 144, 2) for id in IDS] == [120, 120, 105, 120]
    host.bus.faults.sag(3, 0.0)
    host.wait(1.0)
    assert host.read(3, 144, 2) == 120
    with pytest.raises(ValueError, match=r"outside 0\.\.60 V"):
        host.bus.faults.sag(3, -1.0)


def test_the_record_holds_every_value_that_a_position_register_showed() -> None:
    host = Host(IDS)
    assert host.servos.history is None, "nothing is kept unasked"
    host.bus.faults.record(1000)
    host.torque(2)
    host.goal(2, 3000)
    seen = []
    for _ in range(50):
        host.wait(0.005)
        seen.append((host.clock.now(), host.present(2)))
    assert host.servos.history is not None
    times, places = host.servos.history.readings()
    shown = dict(zip(places[:, 1].tolist(), times.tolist(), strict=True))
    assert len({place for _, place in seen}) > 10
    for when, place in seen:
        assert when <= shown[place] <= when + 0.001 or place == seen[-1][1]
    assert (times[1:] >= times[:-1]).all()


def test_the_history_keeps_the_newest_readings() -> None:
    history = ShownPositionLog(1, 3)
    for at in range(5):
        history.note(float(at), np.array([at * 10]))
    times, places = history.readings()
    assert times.tolist() == [2.0, 3.0, 4.0]
    assert places.ravel().tolist() == [20, 30, 40]


def test_an_impossible_fault_command_raises_an_error_with_the_cause() -> None:
    faults = Host(IDS).bus.faults
    with pytest.raises(KeyError, match=r"no servo with id 9; ids are \[1, 2, 3, 4\]"):
        faults.silence(9)
    for wrong in (lambda: faults.drop(-1), lambda: faults.delay(float("nan")), lambda: faults.damage(1, 64)):
        with pytest.raises(ValueError, match=r"outside|0 or more"):
            wrong()


def test_a_forged_answer_is_sound_and_not_what_was_asked() -> None:
    host = Host(IDS)
    host.bus.faults.forge(20, 2)
    found = [host.ask(packet.read(2, 132, 4))[0] for _ in range(20)]
    assert {(each.id, len(each.data)) for each in found} == {(252, 4), (2, 3)}
    assert [(each.id, len(each.data)) for each in host.ask(packet.read(2, 132, 4))] == [(2, 4)]


def test_mangle_breaks_exactly_that_many_writes_and_only_their_beginning() -> None:
    host = Host(IDS)
    ping = packet.ping(1)
    host.bus.faults.mangle(2, bits=3, bytes=len(ping))
    for _ in range(2):
        assert [each.id for each in host.ask(ping + packet.ping(2))][-1:] == [2]
    assert [each.id for each in host.ask(ping + packet.ping(2))] == [1, 2]


def test_a_temperature_spike_is_shown_for_its_duration_and_warms_no_servo() -> None:
    host = Host(IDS)
    host.bus.faults.spike(3, 120.0, 0.2)
    host.wait(0.01)
    assert host.read(3, 146, 1) == 120
    host.wait(0.3)
    assert host.read(3, 146, 1) == 25
    assert host.servos.protection.celsius[2] == pytest.approx(25.0)
