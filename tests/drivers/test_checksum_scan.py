"""A scan of a wire with servos of the framing `FF FF`: both families, which no packet tells apart."""

from collections.abc import Sequence

import pytest

from tests.support.checksum_bench import MILLION, ChecksumBench, dynamixel1, feetech
from twind_drivers.dynamixel1 import dynamixel1_tools
from twind_drivers.feetech import feetech_tools
from twind_drivers.feetech.virtual_feetech_bus import VirtualFeetechBus
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.servo_tools.bus_scan import (
    ECHO,
    BaudRateScan,
    ScanFaultKind,
    estimate,
    scan,
    scan_rate,
)
from twind_drivers.servo_tools.prober import PortProber
from twind_drivers.servo_tools.scan_protocol import ScanProtocol
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter

FEETECH = feetech_tools.PROTOCOL
DYNAMIXEL1 = dynamixel1_tools.PROTOCOL


def rate(
    bench: ChecksumBench, protocol: ScanProtocol, baud: int = MILLION, ids: Sequence[int] | None = None
) -> BaudRateScan:
    bench.bus.line(baud)
    return scan_rate(PortProber(bench.port, bench.clock, baud, protocol), ids)


def found_by(bench: ChecksumBench) -> set[tuple[int, int, str | None, int | None]]:
    rates = scan(bench.at, bench.tools.protocol.bauds)
    return {(each.baud, each.id, each.model_name, each.firmware) for rate in rates for each in rate.found}


def test_feetech_servos_of_every_map_and_rate_are_found() -> None:
    bench = ChecksumBench(feetech(1), feetech(9), feetech(253, "SCS0009"), feetech(3, "HLS3915", baud_rate=4))
    assert found_by(bench) == {
        (MILLION, 1, "STS3215", 310),
        (MILLION, 9, "STS3215", 310),
        (MILLION, 253, "SCS0009", 20),
        (115_200, 3, "HLS3915", 343),
    }


def test_dynamixels_of_protocol_1_are_found_at_their_rates() -> None:
    bench = ChecksumBench(dynamixel1(1), dynamixel1(0, "MX-28(1.0)", baud_rate=34), dynamixel1(250, "EX-106"))
    assert found_by(bench) == {
        (MILLION, 1, "AX-12A", 24),
        (57_600, 0, "MX-28(1.0)", 36),
        (MILLION, 250, "EX-106", 24),
    }


@pytest.mark.parametrize("id", [1, 2, 3, 5, 9, 10, 12, 250])
def test_no_servo_is_taken_for_one_of_the_other_family(id: int) -> None:
    """Id 9 of an STS3215 stands in both places: its model number begins with 9."""
    assert not rate(ChecksumBench(feetech(id)), DYNAMIXEL1, ids=[id]).found
    assert not rate(ChecksumBench(dynamixel1(id, return_delay_time=id)), FEETECH, ids=[id]).found


@pytest.mark.parametrize("id", [1, 7, 9])
def test_a_servo_of_an_unknown_model_is_found_by_the_place_of_its_id(id: int) -> None:
    odd = FeetechServoSpec(id, firmware=(9, 9, 0))
    (found,) = rate(ChecksumBench(odd), FEETECH, ids=[id]).found
    assert (found.model, found.model_name, found.firmware, found.torque) == (777, None, 909, None)
    assert not rate(ChecksumBench(odd), DYNAMIXEL1, ids=[id]).found


@pytest.mark.parametrize("protocol", [FEETECH, DYNAMIXEL1])
def test_two_servos_with_one_id_are_named(protocol: ScanProtocol) -> None:
    one = feetech if protocol is FEETECH else dynamixel1
    found = {each.id: each for each in rate(ChecksumBench(one(3), one(5), one(5), one(8)), protocol).found}  # type: ignore[operator]
    assert sorted(found) == [3, 5, 8]
    assert found[5].trouble is not None and found[5].trouble.kind is ScanFaultKind.CLASH
    assert found[3].trouble is None and found[8].trouble is None


@pytest.mark.parametrize("protocol", [FEETECH, DYNAMIXEL1])
def test_an_echo_makes_no_servos_and_hides_none(protocol: ScanProtocol) -> None:
    """The echo of a ping is equal to a status."""
    one = feetech if protocol is FEETECH else dynamixel1
    line = rate(ChecksumBench(one(2), adapter=SerialAdapter(echo=True)), protocol)  # type: ignore[operator]
    assert line.troubles == (ECHO,)
    assert [(each.id, each.trouble) for each in line.found] == [(2, None)]


def test_torque_and_errors_are_reported() -> None:
    bench = ChecksumBench(feetech(1), feetech(2, max_voltage_limit=60))
    assert isinstance(bench.bus, VirtualFeetechBus)
    bench.bus.servos.put(0, "torque_enable", 1)
    one, two = rate(bench, FEETECH).found
    assert (one.torque, one.hardware_error) == (True, 0)
    assert (two.torque, two.hardware_error) == (False, 1)
    assert FEETECH.explain(1) == "supply voltage"


def test_a_dynamixel_that_answers_only_pings_is_found() -> None:
    (found,) = rate(ChecksumBench(dynamixel1(4, status_return_level=0)), DYNAMIXEL1).found
    assert (found.id, found.model, found.torque, found.trouble) == (4, None, None, None)


def test_the_estimate_is_within_a_tenth_of_the_duration() -> None:
    bench = ChecksumBench(feetech(4))
    for baud in (MILLION, 38_400):
        started = bench.clock.now()
        rate(bench, FEETECH, baud)
        assert bench.clock.now() - started == pytest.approx(estimate(FEETECH, baud), rel=0.1)
