import pytest
from virtual_host import Host

from twind_drivers.dynamixel import packet

IDS = [1, 2, 3, 4]


@pytest.mark.parametrize("short_way", [False, True])
def test_drop_loses_exactly_that_many_answers(short_way: bool) -> None:
    host, request = Host(IDS), packet.sync_read(IDS, 132, 4)
    if short_way:
        host.raw(request)
    host.bus.faults.drop(3)
    assert [each.id for each in host.ask(request)] == [4]
    assert len(host.ask(request)) == 4


def test_corrupt_breaks_the_crc_of_exactly_that_many_answers() -> None:
    host, request = Host(IDS), packet.sync_read(IDS, 132, 4)
    host.bus.faults.corrupt(1)
    raw = host.raw(request)
    assert len(raw) == 60
    assert [each.id for each in packet.Framer(status=True).feed(raw)] == [2, 3, 4]
    assert len(host.ask(request)) == 4


def test_foreign_puts_a_sound_status_before_an_answer() -> None:
    host = Host(IDS)
    host.bus.faults.foreign(1)
    assert [each.id for each in host.ask(packet.ping(2))] == [252, 2]
    assert [each.id for each in host.ask(packet.ping(2))] == [2]


def test_delay_makes_every_answer_late_until_it_is_taken_back() -> None:
    host = Host(IDS)
    host.bus.receive(packet.ping(1), 0.0)
    prompt = host.bus.due()
    host.bus.take(prompt)
    host.bus.faults.delay(0.02)
    host.bus.receive(packet.ping(1), 1.0)
    assert host.bus.due() == pytest.approx(1.0 + prompt + 0.02)


def test_a_silenced_servo_hears_nothing_and_its_watchdog_trips() -> None:
    host = Host(IDS)
    for id in IDS:
        host.write(id, 98, 5, 1)
        host.torque(id)
    host.bus.faults.silence(2)
    for _ in range(10):
        host.wait(0.05)
        host.raw(packet.ping(1))
    assert host.servos.tripped.tolist() == [False, True, False, False]


def test_a_brown_out_is_a_reboot_that_nobody_asked_for() -> None:
    host = Host(IDS)
    host.torque(3)
    host.wait(1.0)
    host.bus.faults.brown_out(3)
    assert host.ask(packet.ping(3)) == []
    host.wait(0.2)
    assert host.read(3, 64, 1) == 0
    assert host.read(3, 120, 2) < 200, "its clock went back"


def test_what_cannot_be_ordered_says_why() -> None:
    faults = Host(IDS).bus.faults
    with pytest.raises(KeyError, match=r"no servo with id 9; ids are \[1, 2, 3, 4\]"):
        faults.silence(9)
    for wrong in (lambda: faults.drop(-1), lambda: faults.delay(float("nan")), lambda: faults.damage(1, 64)):
        with pytest.raises(ValueError, match=r"outside|0 or more"):
            wrong()
