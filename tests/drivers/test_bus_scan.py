"""A scan of a wire that nobody has described: who is there at which rate, and what is wrong with it.

Duplicate ids: facts of users, "Id conflict / fresh servo / id not found" (emanual #683, DynamixelSDK #11);
registers: e-manual, control table of the X series, 7 (id), 8 (baud rate), 9 (return delay), 64, 70.
"""

from collections.abc import Callable, Sequence
from math import inf

import numpy as np
import pytest

from tests.support.dynamixel_responder import Servos, Wire
from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.dynamixel_tools import PROTOCOL
from twind_drivers.servo_tools.bus_scan import (
    ECHO,
    FOREIGN,
    NOISE,
    TALK,
    BaudRateScan,
    ScanFault,
    ScanFaultKind,
    ScannedDevice,
    estimate,
    scan,
    scan_rate,
)
from twind_drivers.servo_tools.prober import PortProber
from twind_drivers.servo_tools.scan_protocol import OLD_PING
from twind_drivers.virtual.register_columns import RegisterColumns
from twind_drivers.virtual.serial_loopback import Loopback
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import ServoSpec

MILLION = 1_000_000
BAUDS = PROTOCOL.bauds
CODES = {
    9_600: 0,
    57_600: 1,
    115_200: 2,
    1_000_000: 3,
    2_000_000: 4,
    3_000_000: 5,
    4_000_000: 6,
    4_500_000: 7,
}


class Bench:
    """Virtual servos that were plugged together on one wire."""

    def __init__(self, *servos: ServoSpec, apart: float = 100.0) -> None:
        self.clock = FakeClock(20.0)
        positions = 1000.0 + apart * np.arange(len(servos))
        self.bus = VirtualBus("bench", servos, FirstOrderPhysics(positions), baud=MILLION, now=20.0)

    def at(self, baud: int) -> PortProber:
        self.bus.line(baud)
        return PortProber(Loopback(self.bus, self.clock), self.clock, baud, PROTOCOL)

    def scan(self, bauds: Sequence[int] = BAUDS, *, thorough: bool = False) -> dict[int, BaudRateScan]:
        return {rate.baud: rate for rate in scan(self.at, bauds, thorough=thorough)}

    def rate(self, baud: int = MILLION, *, thorough: bool = False) -> BaudRateScan:
        return scan_rate(self.at(baud), thorough=thorough)


def servo(id: int, baud: int = MILLION, model: str = "XM430-W350", delay: int = 250) -> ServoSpec:
    return ServoSpec(id, model, {"baud_rate": CODES[baud], "return_delay_time": delay})


def wired(change: Callable[[bytes], bytes], *ids: int) -> PortProber:
    """A prober on scripted servos whose answers are bent."""
    wire = Wire(Servos(ids))
    wire.change = change
    return PortProber(wire, FakeClock(), MILLION, PROTOCOL)


# ------------------------------------------------------------------------------------- who is there


def clashes(found: ScannedDevice) -> bool:
    return found.trouble is not None and found.trouble.kind is ScanFaultKind.CLASH


def test_servos_of_different_rates_and_models_on_one_wire_are_all_found() -> None:
    servos = [servo(1, 57_600), servo(2), servo(252), servo(0, 4_500_000), servo(9, 9_600, "XL330-M288")]
    rates = Bench(*servos).scan()
    found = {(baud, each.id): each.model_name for baud, rate in rates.items() for each in rate.found}
    assert found == {
        (57_600, 1): "XM430-W350",
        (MILLION, 2): "XM430-W350",
        (MILLION, 252): "XM430-W350",
        (4_500_000, 0): "XM430-W350",
        (9_600, 9): "XL330-M288",
    }
    assert list(rates) == list(BAUDS)
    assert not any(rate.troubles or any(each.trouble for each in rate.found) for rate in rates.values())


def test_torque_and_hardware_errors_are_reported_by_the_scan() -> None:
    bench = Bench(servo(1), servo(2))
    bench.bus.servos.torque(0, True)
    bench.bus.faults.damage(2, 0b100000)
    one, two = bench.rate().found
    assert (one.torque, one.hardware_error) == (True, 0)
    assert (two.torque, two.hardware_error) == (False, 0b100000)
    assert (one.model, two.trouble) == (1020, None)


def test_an_unknown_model_is_found_without_its_registers() -> None:
    servos = Servos((5,), model=4711)
    (found,) = scan_rate(PortProber(Wire(servos), FakeClock(), MILLION, PROTOCOL)).found
    assert (found.id, found.model, found.model_name, found.torque, found.trouble) == (
        5,
        4711,
        None,
        None,
        None,
    )


def test_a_device_that_answers_only_pings_is_found() -> None:
    bench = Bench(servo(3))
    bench.bus.receive(packet.write(3, 68, b"\0"), bench.clock.now())  # status return level
    (found,) = bench.rate().found
    assert (found.id, found.model_name, found.torque, found.trouble) == (3, "XM430-W350", None, None)


def test_nothing_is_ever_written() -> None:
    servos = Servos((1, 2, 3))
    scan_rate(PortProber(Wire(servos), FakeClock(), MILLION, PROTOCOL), thorough=True)
    assert {each.instruction for each in servos.seen} <= {packet.Instruction.PING, packet.Instruction.READ}
    assert len(servos.seen) > 253


def test_only_requested_ids_are_reported() -> None:
    bench = Bench(servo(4), servo(40))
    assert [each.id for each in scan_rate(bench.at(MILLION), range(0, 20)).found] == [4]
    started = bench.clock.now()
    scan_rate(bench.at(MILLION), range(0, 20))
    assert bench.clock.now() - started < 0.2


def test_an_answer_that_is_lost_once_is_found_by_asking_thoroughly() -> None:
    bench = Bench(servo(4), servo(7))
    bench.at(MILLION)
    bench.bus.faults.drop(1)
    rate = scan_rate(bench.at(MILLION), thorough=True)
    assert [each.id for each in rate.found] == [4, 7]


def test_eight_rates_take_about_a_dozen_seconds_and_each_step_is_reported() -> None:
    bench = Bench(servo(4))
    told = []
    started = bench.clock.now()
    list(scan(bench.at, BAUDS, tell=lambda baud, what: told.append((baud, what))))
    assert bench.clock.now() - started < 13.0
    assert [baud for baud, what in told if what == "searching"] == list(BAUDS)
    assert (MILLION, "reading id 4") in told


def test_the_scan_estimate_is_within_a_tenth_of_the_duration() -> None:
    bench = Bench(servo(4))
    for thorough in (False, True):
        started = bench.clock.now()
        bench.rate(thorough=thorough)
        said = estimate(PROTOCOL, MILLION, thorough=thorough)
        assert bench.clock.now() - started == pytest.approx(said, rel=0.1)


# ------------------------------------------------------------------------------------- two with one id


@pytest.mark.parametrize(("first", "second"), [(250, 250), (250, 0), (0, 250), (0, 10)])
def test_two_servos_of_one_model_with_one_id_are_named(first: int, second: int) -> None:
    bench = Bench(servo(3), servo(5, delay=first), servo(5, delay=second), servo(8))
    found = {each.id: each for each in bench.rate().found}
    assert sorted(found) == [3, 5, 8]
    assert clashes(found[5]) and "two devices" in str(found[5].trouble)
    assert "disconnect one" in str(found[5].trouble)
    assert found[3].trouble is None and found[8].trouble is None


@pytest.mark.parametrize(("first", "second"), [(250, 250), (250, 0), (0, 10)])
def test_two_models_with_one_id_are_named(first: int, second: int) -> None:
    bench = Bench(servo(1, delay=first), servo(1, model="XL330-M288", delay=second))
    (found,) = bench.rate().found
    assert found.id == 1
    assert clashes(found) and "two devices" in str(found.trouble)


@pytest.mark.parametrize("delay", [0.0032, 0.006, 0.02])
def test_a_late_servo_is_no_pair_of_servos(delay: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reply cut by the end of one window begins the next one: garbled, as of two devices."""
    monkeypatch.setattr(RegisterColumns, "delays", lambda self, rows: [delay for _ in rows])
    (found,) = Bench(servo(5)).rate().found
    assert not clashes(found)
    assert delay < 0.0035 or (found.trouble is not None and found.trouble.kind is ScanFaultKind.LATE)


@pytest.mark.parametrize("rate", [1e-4, 1e-3])
def test_a_noisy_line_makes_no_duplicates(rate: float) -> None:
    bench = Bench(*(servo(id) for id in range(1, 13)))
    bench.at(MILLION)
    bench.bus.faults.bit_errors(rate)
    found = bench.rate().found
    assert [(each.id, each.trouble) for each in found] == [(id, None) for id in range(1, 13)]


def test_a_very_noisy_line_is_named() -> None:
    bench = Bench(*(servo(id) for id in range(1, 13)))
    bench.at(MILLION)
    bench.bus.faults.bit_errors(3e-3)
    assert NOISE in bench.rate().troubles


def test_a_dozen_servos_as_delivered_are_one_id_with_the_remedy() -> None:
    (found,) = Bench(*(servo(1, 57_600) for _ in range(12))).rate(57_600).found
    assert (found.id, found.model_name) == (1, "XM430-W350")
    assert clashes(found) and "give the other a free id" in str(found.trouble)


def test_an_id_with_only_corrupt_replies_is_reported_as_unsound() -> None:
    def garble(reply: bytes) -> bytes:
        at = reply.find(packet.HEADER + b"\x09")
        return reply if at < 0 else reply[: at + 10] + bytes((reply[at + 10] ^ 8,)) + reply[at + 11 :]

    rate = scan_rate(wired(garble, 2, 9))
    assert [each.id for each in rate.found] == [2, 9]
    assert clashes(rate.found[1]) and "no sound answer" in str(rate.found[1].trouble)
    assert rate.found[1].model is None


def test_two_devices_of_an_unknown_model_are_distinguished_by_their_two_replies() -> None:
    def twice(reply: bytes) -> bytes:
        return reply + packet.status(5, 0, (4712).to_bytes(2, "little") + b"\1") if reply else reply

    servos = Servos((5,), model=4711)
    wire = Wire(servos)
    wire.change = twice
    (found,) = scan_rate(PortProber(wire, FakeClock(), MILLION, PROTOCOL)).found
    assert (found.id, found.model_name) == (5, None)
    assert clashes(found) and "two devices" in str(found.trouble)


def test_an_id_whose_first_answer_alone_is_garbled_is_asked_until_one_is_clear() -> None:
    garbled: list[bytes] = []

    def garble(reply: bytes) -> bytes:
        asked = servos.seen[-1].id if servos.seen else packet.BROADCAST
        if asked != 9 or len(garbled) > 2:
            return b"" if asked == packet.BROADCAST else reply
        garbled.append(reply)
        return reply[:-1] + b"\0"

    servos = Servos((2, 9))
    wire = Wire(servos)
    wire.change = garble
    rate = scan_rate(PortProber(wire, FakeClock(), MILLION, PROTOCOL), range(12), thorough=True)
    assert [(each.id, each.trouble) for each in rate.found] == [(2, None), (9, None)]
    assert len(garbled) == 3


# ------------------------------------------------------------------------------------- the line itself


def test_corrupt_bytes_after_every_request_mean_another_rate_or_noise() -> None:
    rate = scan_rate(wired(lambda reply: b"\x13\x77\xff"))
    assert (rate.found, rate.troubles) == ((), (FOREIGN,))


def test_servos_that_send_corrupt_bytes_at_other_rates_are_found_at_their_own() -> None:
    bench = Bench(servo(2), servo(9))
    bench.bus.faults.garble()
    rates = bench.scan()
    assert [each.id for each in rates.pop(MILLION).found] == [2, 9]
    assert all((rate.found, rate.troubles) == ((), (FOREIGN,)) for rate in rates.values())


@pytest.mark.parametrize("timer", [0.001, 0.016])
def test_a_slow_latency_timer_hides_no_servo(timer: float) -> None:
    bench = Bench(servo(2), servo(9))
    bench.at(MILLION)
    bench.bus.faults.latency(timer)
    prober = PortProber(Loopback(bench.bus, bench.clock), bench.clock, MILLION, PROTOCOL, timer=timer)
    rate = scan_rate(prober, range(20), thorough=True)
    assert [(each.id, each.trouble) for each in rate.found] == [(2, None), (9, None)]


def test_an_echoing_adapter_is_named_and_every_servo_is_found() -> None:
    wire = Wire(Servos((2, 9)))
    answer = wire.write

    def write(data: bytes) -> None:
        wire.inbox += data
        answer(data)

    wire.write = write  # type: ignore[method-assign]
    rate = scan_rate(PortProber(wire, FakeClock(), MILLION, PROTOCOL))
    assert [(each.id, each.trouble) for each in rate.found] == [(2, None), (9, None)]
    assert rate.troubles == (ECHO,)


def test_devices_of_protocol_1_are_named() -> None:
    wire = Wire(Servos(()))
    answer = wire.write

    def write(data: bytes) -> None:
        answer(data)
        if data == OLD_PING:
            wire.inbox += bytes.fromhex("ffff 11 02 00 ec")  # e-manual, protocol 1.0: sum inverted

    wire.write = write  # type: ignore[method-assign]
    (trouble,) = scan_rate(PortProber(wire, FakeClock(), MILLION, PROTOCOL)).troubles
    assert (trouble.kind, trouble.ids) == (ScanFaultKind.OLD, (17,))
    assert "protocol 1.0 (ids 17)" in str(trouble)


def test_unsolicited_traffic_is_named_and_causes_no_duplicates() -> None:
    wire = Wire(Servos((2,)))
    wire.arrival = lambda: inf  # type: ignore[method-assign]
    drain = wire.drain

    def babbling(thrown: bytearray | None = None) -> int:
        count = drain(thrown)
        wire.inbox += packet.sync_read((1, 2), 126, 10)
        return count

    wire.drain = babbling  # type: ignore[method-assign]
    rate = scan_rate(PortProber(wire, FakeClock(), MILLION, PROTOCOL))
    assert TALK in rate.troubles
    assert len(rate.found) <= 1


def test_a_rate_refused_by_the_adapter_is_reported_and_the_others_are_scanned() -> None:
    bench = Bench(servo(4))

    def at(baud: int) -> PortProber:
        if baud > 4_000_000:
            raise PortError("bench", f"baud rate {baud} is not supported")
        return bench.at(baud)

    rates = {rate.baud: rate for rate in scan(at, BAUDS)}
    assert rates[4_500_000].troubles == (ScanFault(ScanFaultKind.RATE, "baud rate 4500000 is not supported"),)
    assert [each.id for each in rates[MILLION].found] == [4]


def test_a_port_that_goes_away_ends_the_scan() -> None:
    bench = Bench(servo(4))
    rates = scan(bench.at, BAUDS)
    next(rates)
    bench.bus.faults.unplug()
    with pytest.raises(PortError, match="unplugged"):
        next(rates)


def test_a_port_that_is_gone_when_its_rate_is_set_ends_the_scan_too() -> None:
    def at(baud: int) -> PortProber:
        raise PortError("bench", "adapter unplugged?", kind=PortErrorCause.LOST)

    with pytest.raises(PortError, match="unplugged"):
        next(scan(at, BAUDS))
