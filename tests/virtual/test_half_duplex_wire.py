"""Wire time: 10 bits a byte; replies after the return delay, one after the other."""

import pytest

from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet, serial_cycle_budget

IDS = list(range(1, 25))


def cycle(host: Host, request: bytes) -> float:
    """Seconds from the first byte of `request` to the last byte of the answer."""
    begin = host.clock.now()
    assert host.raw(request)
    return host.clock.now() - begin


@pytest.mark.parametrize("baud_rate", [3, 4, 5])
@pytest.mark.parametrize("delay_us", [0, 50, 500])
@pytest.mark.parametrize("fast", [True, False])
def test_a_cycle_of_24_servos_takes_the_computed_time(baud_rate: int, delay_us: int, fast: bool) -> None:
    host = Host(IDS, settings={"baud_rate": baud_rate, "return_delay_time": delay_us // 2})
    baud = (1_000_000, 2_000_000, 3_000_000)[baud_rate - 3]
    host.bus.line(baud)
    goals = packet.sync_write(116, {id: (2048).to_bytes(4, "little") for id in IDS})
    read = (packet.fast_sync_read if fast else packet.sync_read)(IDS, 126, 10)
    plan = serial_cycle_budget.budget(24, baud, fast=fast, return_delay_us=delay_us)
    for _ in range(2):  # the first goes the long way, the second is remembered
        assert cycle(host, goals + read) == pytest.approx(plan.seconds, rel=1e-9)


def test_an_answer_is_not_there_before_its_last_byte() -> None:
    host = Host([1], settings={"return_delay_time": 250})
    host.bus.receive(packet.ping(1), 0.0)
    whole = 10 * 10 / 2e6 + 500e-6 + 14 * 10 / 2e6
    assert host.bus.next_output_time() == pytest.approx(whole)
    assert host.bus.take(whole - 1e-9) == b""
    assert len(host.bus.take(whole + 1e-9)) == 14


def test_a_reply_read_early_contains_only_completed_statuses() -> None:
    host = Host(IDS)
    host.bus.receive(packet.sync_read(IDS, 132, 4), 0.0)
    each = 15 * 10 / 2e6
    request = 38 * 10 / 2e6
    assert len(host.bus.take(request + 7.5 * each)) == 7 * 15
    assert len(host.bus.take(host.bus.next_output_time())) == 17 * 15


def test_without_timing_the_answer_is_there_at_once() -> None:
    host = Host(IDS, wire_timing=False)
    host.bus.receive(packet.sync_read(IDS, 132, 4), 3.0)
    assert host.bus.next_output_time() == 3.0
    assert len(host.bus.take(3.0)) == 24 * 15


def test_two_requests_in_one_write_are_served_one_after_the_other() -> None:
    host = Host([1, 2])
    host.bus.receive(packet.ping(1) + packet.ping(2), 0.0)
    assert host.bus.next_output_time() == pytest.approx(24 * 10 / 2e6)  # request and answer of the first
    assert len(host.bus.take(1.0)) == 28
