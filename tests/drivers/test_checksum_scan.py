"""A scan of a wire with servos of the framing `FF FF`: both families, which no packet tells apart."""

from collections.abc import Sequence

import numpy as np
import pytest

from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel1 import dynamixel1_tools
from twind_drivers.dynamixel1.virtual_dynamixel1_bus import VirtualDynamixel1Bus
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.feetech import feetech_tools
from twind_drivers.feetech.virtual_feetech_bus import VirtualFeetechBus
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.servo_tools.bus_scan import (
    ECHO,
    FOREIGN,
    BaudRateScan,
    ScanFaultKind,
    estimate,
    scan,
    scan_rate,
)
from twind_drivers.servo_tools.prober import PortProber
from twind_drivers.servo_tools.scan_protocol import ScanProtocol
from twind_drivers.virtual.checksum_bus import ChecksumBus
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.serial_loopback import Loopback
from twind_drivers.virtual.servo_physics import FirstOrderPhysics

MILLION = 1_000_000
FEETECH = feetech_tools.PROTOCOL
DYNAMIXEL1 = dynamixel1_tools.PROTOCOL


class ChecksumBench:
    """Virtual servos of one family on one wire."""

    def __init__(
        self, *specs: FeetechServoSpec | Dynamixel1ServoSpec, adapter: SerialAdapter | None = None
    ) -> None:
        self.clock = FakeClock(20.0)
        muscles = FirstOrderPhysics(1000.0 - 90.0 * np.arange(len(specs)))
        of_feetech = [each for each in specs if isinstance(each, FeetechServoSpec)]
        of_dynamixel = [each for each in specs if isinstance(each, Dynamixel1ServoSpec)]
        self.bus: ChecksumBus
        if of_feetech:
            self.bus = VirtualFeetechBus("bench", of_feetech, muscles, now=20.0, adapter=adapter)
        else:
            self.bus = VirtualDynamixel1Bus(
                "bench", of_dynamixel, muscles, baud=MILLION, now=20.0, adapter=adapter
            )

    def rate(
        self, protocol: ScanProtocol, baud: int = MILLION, ids: Sequence[int] | None = None
    ) -> BaudRateScan:
        self.bus.line(baud)
        return scan_rate(PortProber(Loopback(self.bus, self.clock), self.clock, baud, protocol), ids)

    def scan(self, protocol: ScanProtocol) -> set[tuple[int, int, str | None, int | None]]:
        def at(baud: int) -> PortProber:
            self.bus.line(baud)
            return PortProber(Loopback(self.bus, self.clock), self.clock, baud, protocol)

        rates = scan(at, protocol.bauds)
        return {(each.baud, each.id, each.model_name, each.firmware) for rate in rates for each in rate.found}


def feetech(id: int, model: str = "STS3215", **settings: int) -> FeetechServoSpec:
    return FeetechServoSpec(id, model, settings)


def dynamixel1(id: int, model: str = "AX-12A", **settings: int) -> Dynamixel1ServoSpec:
    return Dynamixel1ServoSpec(id, model, settings)


def test_feetech_servos_of_every_map_and_rate_are_found() -> None:
    bench = ChecksumBench(feetech(1), feetech(9), feetech(253, "SCS0009"), feetech(3, "HLS3915", baud_rate=4))
    assert bench.scan(FEETECH) == {
        (MILLION, 1, "STS3215", 310),
        (MILLION, 9, "STS3215", 310),
        (MILLION, 253, "SCS0009", 20),
        (115_200, 3, "HLS3915", 343),
    }


def test_dynamixels_of_protocol_1_are_found_at_their_rates() -> None:
    bench = ChecksumBench(dynamixel1(1), dynamixel1(0, "MX-28(1.0)", baud_rate=34), dynamixel1(250, "EX-106"))
    assert bench.scan(DYNAMIXEL1) == {
        (MILLION, 1, "AX-12A", 24),
        (57_600, 0, "MX-28(1.0)", 36),
        (MILLION, 250, "EX-106", 24),
    }


@pytest.mark.parametrize("id", [1, 2, 3, 5, 9, 10, 12, 250])
def test_no_servo_is_taken_for_one_of_the_other_family(id: int) -> None:
    """Id 9 of an STS3215 stands in both places: its model number begins with 9."""
    assert not ChecksumBench(feetech(id)).rate(DYNAMIXEL1, ids=[id]).found
    assert not ChecksumBench(dynamixel1(id, return_delay_time=id)).rate(FEETECH, ids=[id]).found


@pytest.mark.parametrize("id", [1, 7, 9])
def test_a_servo_of_an_unknown_model_is_found_by_the_place_of_its_id(id: int) -> None:
    odd = FeetechServoSpec(id, firmware=(9, 9, 0))
    (found,) = ChecksumBench(odd).rate(FEETECH, ids=[id]).found
    assert (found.model, found.model_name, found.firmware, found.torque) == (777, None, 909, None)
    assert not ChecksumBench(odd).rate(DYNAMIXEL1, ids=[id]).found


@pytest.mark.parametrize("protocol", [FEETECH, DYNAMIXEL1])
def test_two_servos_with_one_id_are_named(protocol: ScanProtocol) -> None:
    one = feetech if protocol is FEETECH else dynamixel1
    found = {each.id: each for each in ChecksumBench(one(3), one(5), one(5), one(8)).rate(protocol).found}  # type: ignore[operator]
    assert sorted(found) == [3, 5, 8]
    assert found[5].trouble is not None and found[5].trouble.kind is ScanFaultKind.CLASH
    assert found[3].trouble is None and found[8].trouble is None


@pytest.mark.parametrize("protocol", [FEETECH, DYNAMIXEL1])
def test_an_echo_makes_no_servos_and_hides_none(protocol: ScanProtocol) -> None:
    """The echo of a ping is equal to a status."""
    one = feetech if protocol is FEETECH else dynamixel1
    rate = ChecksumBench(one(2), adapter=SerialAdapter(echo=True)).rate(protocol)  # type: ignore[operator]
    assert rate.troubles == (ECHO,)
    assert [(each.id, each.trouble) for each in rate.found] == [(2, None)]


def test_torque_and_errors_are_reported() -> None:
    bench = ChecksumBench(feetech(1), feetech(2, max_voltage_limit=60))
    assert isinstance(bench.bus, VirtualFeetechBus)
    bench.bus.servos.put(0, "torque_enable", 1)
    one, two = bench.rate(FEETECH).found
    assert (one.torque, one.hardware_error) == (True, 0)
    assert (two.torque, two.hardware_error) == (False, 1)
    assert FEETECH.explain(1) == "supply voltage"


def test_a_dynamixel_that_answers_only_pings_is_found() -> None:
    (found,) = ChecksumBench(dynamixel1(4, status_return_level=0)).rate(DYNAMIXEL1).found
    assert (found.id, found.model, found.torque, found.trouble) == (4, None, None, None)


def test_garbage_at_a_wrong_rate_is_named() -> None:
    bench = ChecksumBench(feetech(2))
    bench.bus.faults.garble()
    assert bench.rate(FEETECH, 500_000).troubles == (FOREIGN,)
    assert [each.id for each in bench.rate(FEETECH).found] == [2]


def test_the_estimate_is_within_a_tenth_of_the_duration() -> None:
    bench = ChecksumBench(feetech(4))
    for baud in (MILLION, 38_400):
        started = bench.clock.now()
        bench.rate(FEETECH, baud)
        assert bench.clock.now() - started == pytest.approx(estimate(FEETECH, baud), rel=0.1)
