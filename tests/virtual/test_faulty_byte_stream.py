"""The bytes between wire and host: bit errors, noise, babble, pieces, latency timer, echo, a stalled adapter.

Sources: e-manual, "Protocol 2.0", for what a servo answers to a broken packet; DynamixelSDK issue 511 and
pull request 116 for the latency timer (16 ms as delivered; 62 or 510 bytes fill a packet).
"""

import numpy as np
import pytest

from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import Framer
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import ServoSpec

IDS = [1, 2, 3, 4]


def listen(host: Host, seconds: float, step: float = 0.0005) -> bytes:
    """Return the bytes that the host receives in that time without a request."""
    out = b""
    end = host.clock.now() + seconds
    while host.clock.now() < end:
        host.clock.sleep_until(host.clock.now() + step)
        if host.bus.next_output_time() <= host.clock.now():
            out += host.bus.take(host.clock.now())
    return out


def ask(host: Host, request: bytes, seconds: float = 0.03) -> bytes:
    host.bus.receive(request, host.clock.now())
    return listen(host, seconds)


def sound(data: bytes) -> list[int]:
    return [each.id for each in Framer(status=True).feed(data)]


def test_bit_errors_towards_the_host_are_as_many_as_ordered() -> None:
    host = Host(IDS)
    request = packet.sync_read(IDS, 126, 10)
    clean = host.raw(request)
    host.bus.faults.bit_errors(0.01, to_servos=False)
    flipped = 0
    for _ in range(100):
        bits = np.frombuffer(host.raw(request), np.uint8) ^ np.frombuffer(clean, np.uint8)
        flipped += int(np.unpackbits(bits).sum())
    expected = 100 * len(clean) * 8 * 0.01
    assert abs(flipped - expected) < 5 * expected**0.5
    host.bus.faults.clear()
    assert host.raw(request) == clean


def test_a_packet_that_reached_the_servo_broken_is_answered_with_error_3_or_not_at_all() -> None:
    """e-manual, "Protocol 2.0", status packet, error 3."""
    host = Host([1])
    host.bus.faults.bit_errors(0.01, to_host=False)
    errors: set[int] = set()
    answers = 0
    for _ in range(300):
        found = host.ask(packet.write(1, 65, b"\1"))
        errors |= {each.error for each in found}
        answers += len(found)
    assert errors == {0, packet.StatusErrorCode.CRC}
    assert answers < 300, "an id or header that is broken meets nobody"


def test_the_same_seed_gives_the_same_bytes() -> None:
    def run(seed: int) -> bytes:
        host = Host(IDS)
        host.bus.faults.seed(seed)
        host.bus.faults.bit_errors(0.02)
        host.bus.faults.noise(0.002)
        return b"".join(ask(host, packet.sync_read(IDS, 126, 10)) for _ in range(5))

    assert run(7) == run(7)
    assert run(7) != run(8)


def test_a_burst_of_noise_fills_its_time_and_ends() -> None:
    host = Host(IDS)
    host.bus.faults.noise(0.005)
    heard = listen(host, 0.02)
    assert len(heard) == pytest.approx(0.005 * 200_000, rel=0.02)
    assert host.bus.next_output_time() == np.inf
    assert sound(ask(host, packet.sync_read(IDS, 132, 4))) == IDS


def test_replies_during_noise_are_not_decoded() -> None:
    host = Host(IDS)
    host.bus.faults.noise(0.01)
    assert sound(ask(host, packet.sync_read(IDS, 132, 4), 0.009)) == []


def test_noise_before_answers_leaves_the_answers_whole() -> None:
    host = Host(IDS)
    host.bus.faults.noise(0.001, count=2)
    heard = ask(host, packet.sync_read(IDS, 132, 4))
    assert len(heard) == 4 * 15 + 2 * 200
    assert sound(heard) == IDS
    assert len(ask(host, packet.sync_read(IDS, 132, 4))) == 4 * 15


def test_babble_never_ends_by_itself_and_is_bounded_at_every_look() -> None:
    host = Host(IDS)
    host.bus.faults.babble()
    listen(host, 0.001)
    for _ in range(50):
        host.clock.sleep_until(host.clock.now() + 60.0)
        assert 0 < len(host.bus.take(host.clock.now())) <= 4096
    assert host.bus.next_output_time() > host.clock.now(), (
        "a host that waits for the next bytes is not held fast"
    )
    assert sound(ask(host, packet.ping(1))) == []
    host.bus.faults.babble(False)
    assert sound(ask(host, packet.ping(1))) == [1]


def test_split_answers_come_in_small_pieces_and_lose_nothing() -> None:
    host = Host(IDS)
    request = packet.sync_read(IDS, 126, 10)
    clean = host.raw(request)
    host.bus.faults.split(3)
    host.bus.receive(request, host.clock.now())
    pieces = []
    while host.bus.next_output_time() < np.inf:
        host.clock.sleep_until(host.bus.next_output_time())
        pieces.append(host.bus.take(host.clock.now()))
    assert b"".join(pieces) == clean
    assert max(map(len, pieces)) == 3
    host.bus.receive(request, host.clock.now())
    host.bus.take(host.bus.next_output_time())
    host.bus.faults.split(0)
    assert len(listen(host, 0.01)) > 0, "what was kept comes at once"


@pytest.mark.parametrize(("timer", "payload"), [(0.016, 62), (0.001, 62), (0.016, 510)])
def test_the_latency_timer_holds_back_what_does_not_fill_a_packet(timer: float, payload: int) -> None:
    host = Host(list(range(1, 25)))
    request = packet.fast_sync_read(list(range(1, 25)), 126, 10)
    clean = host.raw(request)
    host.bus.faults.latency(timer, payload)
    begin = host.clock.now()
    host.bus.receive(request, begin)
    parts = []
    while host.bus.next_output_time() < np.inf:
        host.clock.sleep_until(host.bus.next_output_time())
        if part := host.bus.take(host.clock.now()):
            parts.append((host.clock.now() - begin, part))
    assert b"".join(part for _, part in parts) == clean
    assert all(len(part) % payload == 0 for _, part in parts[:-1])
    assert parts[-1][0] <= timer + len(clean) * 5e-6 + len(request) * 5e-6
    if (timer, payload) == (0.016, 62):  # 344 bytes on the wire are over before the timer is
        arrived = (len(request) + len(clean)) * 5e-6
        assert parts[0] == (pytest.approx(arrived), clean[: 5 * 62]), "full packets do not wait for the timer"
    if payload > len(clean):
        assert len(parts) == 1, "344 bytes never fill 510: each answer ends on the timer"


def test_an_adapter_with_a_timer_keeps_it_when_faults_are_healed() -> None:
    specs = [ServoSpec(1, "XM430-W350", {"baud_rate": 4})]
    muscles = FirstOrderPhysics(np.array([2048.0]))
    bus = VirtualBus("b", specs, muscles, adapter=SerialAdapter(echo=True, latency=0.016))
    bus.faults.clear()
    bus.receive(packet.ping(1), 0.001)
    assert bus.take(0.015) == b""
    assert bus.take(bus.next_output_time()).startswith(packet.ping(1)), "it echoes too"


def test_an_echoing_adapter_gives_back_what_was_sent_before_the_answer() -> None:
    host = Host(IDS)
    host.bus.faults.echo()
    heard = ask(host, packet.ping(2))
    assert heard.startswith(packet.ping(2))
    assert sound(heard) == [2]
    host.bus.faults.clear()
    assert len(ask(host, packet.ping(2))) == 14


def test_a_stalled_adapter_keeps_what_it_takes_and_sends_it_when_it_runs_again() -> None:
    host = Host(IDS)
    host.bus.faults.stall()
    assert ask(host, packet.ping(1) + packet.ping(2)) == b""
    assert host.bus.backlog == 20
    host.bus.faults.stall(False)
    assert sound(listen(host, 0.01)) == [1, 2]
    assert host.bus.backlog == 0


def test_bytes_flushed_from_a_stalled_adapter_are_never_sent() -> None:
    host = Host(IDS)
    host.bus.faults.stall()
    ask(host, packet.write(1, 65, b"\1"))
    host.bus.flush()
    host.bus.faults.clear()
    assert listen(host, 0.01) == b""
    assert host.read(1, 65, 1) == 0


def test_an_unplugged_adapter_drops_its_buffered_bytes() -> None:
    host = Host(IDS)
    host.bus.faults.stall()
    ask(host, packet.ping(1))
    host.bus.faults.unplug()
    host.bus.faults.replug()
    host.bus.faults.clear()
    assert listen(host, 0.01) == b""
    assert sound(ask(host, packet.ping(1))) == [1]


def test_orders_out_of_bounds_name_the_bound() -> None:
    faults = Host(IDS).bus.faults
    nan = float("nan")
    for wrong in (
        lambda: faults.bit_errors(nan),
        lambda: faults.bit_errors(0.6),
        lambda: faults.noise(nan),
        lambda: faults.noise(11.0),
        lambda: faults.split(-1),
        lambda: faults.latency(nan),
        lambda: faults.latency(0.001, 0),
        lambda: faults.seed(-1),
        lambda: faults.record(-1),
        lambda: faults.cut(1, -1),
        lambda: faults.corrupt(1, bits=0),
        lambda: faults.supply(nan),
    ):
        with pytest.raises(ValueError, match=r"outside|0 or more"):
            wrong()
