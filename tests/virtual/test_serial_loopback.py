import pytest

from tests.support.virtual_serial_host import Host
from twind_drivers.bus import PortError
from twind_drivers.dynamixel import packet
from twind_drivers.virtual.serial_loopback import Loopback


def test_the_clock_jumps_to_the_answer_and_not_beyond() -> None:
    host = Host([1])
    port = Loopback(host.bus, host.clock)
    port.write(packet.ping(1))
    host.clock.wait([port], 1.0)
    assert host.clock.now() == pytest.approx(24 * 10 / 2e6)
    buffer = bytearray(64)
    assert port.read_into(memoryview(buffer)) == 14
    assert buffer[:14] == packet.status(1, 0, host.servos.registers.identity(0))
    host.clock.wait([port], 1.0)
    assert host.clock.now() == 1.0
    assert port.read_into(memoryview(buffer)) == 0


def test_a_small_buffer_takes_the_rest_later() -> None:
    host = Host([1])
    port = Loopback(host.bus, host.clock)
    port.write(packet.ping(1))
    host.clock.wait([port], 1.0)
    small = memoryview(bytearray(8))
    assert [port.read_into(small), port.arrival() == host.clock.now(), port.read_into(small)] == [8, True, 6]


def test_drain_throws_away_what_has_come_only() -> None:
    host = Host([1])
    port = Loopback(host.bus, host.clock)
    port.write(packet.ping(1))
    assert port.drain() == 0
    host.clock.sleep_until(1.0)
    assert port.drain() == 14
    assert port.fileno() == -1


def test_the_backlog_of_a_stalled_adapter_is_reported_and_bounded() -> None:
    host = Host([1])
    port = Loopback(host.bus, host.clock)
    port.write(packet.ping(1))
    assert port.backlog() == 0
    host.bus.faults.stall()
    port.write(packet.ping(1))
    assert port.backlog() == 10
    with pytest.raises(PortError, match="0 of 4090 bytes taken") as caught:
        port.write(bytes(4090))
    assert not caught.value.lost
    assert port.backlog() == 10
    port.flush()
    assert port.backlog() == 0
    host.bus.faults.unplug()
    for use in (port.backlog, port.flush):
        with pytest.raises(PortError, match="unplugged"):
            use()


def test_an_unplugged_loopback_wakes_its_reader_and_is_lost() -> None:
    host = Host([1])
    port = Loopback(host.bus, host.clock)
    port.write(packet.ping(1))
    host.bus.faults.unplug()
    host.clock.wait([port], 1.0)
    assert host.clock.now() == 0.0
    for use in (lambda: port.write(b"x"), lambda: port.read_into(memoryview(bytearray(9))), port.drain):
        with pytest.raises(PortError, match="unplugged") as caught:
            use()
        assert caught.value.lost
    host.bus.faults.replug()
    again = Loopback(host.bus, host.clock)
    again.write(packet.ping(1))
    host.clock.wait([again], 1.0)
    assert again.read_into(memoryview(bytearray(64))) == 14
    again.close()
    again.close()
    with pytest.raises(PortError, match="closed"):
        again.write(b"x")
