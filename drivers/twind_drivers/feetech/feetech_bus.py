"""Feetech bus of a robot in its two halves: reader (mirror and live) and writer (live only)."""

from twind.config.driver_family import BusDriver, BusSetup
from twind_drivers.bus import BusReader
from twind_drivers.bus_writer import BusWriter
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.feetech.feetech_reader import FeetechReader
from twind_drivers.feetech.feetech_type import FeetechType
from twind_drivers.feetech.feetech_writer import FeetechWriter


def _reader(setup: BusSetup, port: ByteTransport) -> BusReader:
    return FeetechReader(
        setup.bus.name,
        port,
        setup.ids,
        [kind.device for kind in _types(setup)],
        baud=setup.bus.baud,
        rate_hz=setup.rate_hz,
        one_write=setup.bus.one_write,
    )


def _writer(setup: BusSetup, reader: BusReader) -> BusWriter:
    assert isinstance(reader, FeetechReader)
    kinds = _types(setup)
    return FeetechWriter(
        reader,
        lower=setup.lower,
        upper=setup.upper,
        gains=[(kind.gains.p, kind.gains.i, kind.gains.d) for kind in kinds],
        torque_limits=[kind.torque_limit for kind in kinds],
    )


def _types(setup: BusSetup) -> list[FeetechType]:
    return [joint.type for joint in setup.joints if isinstance(joint.type, FeetechType)]


DRIVER = BusDriver(reader=_reader, writer=_writer)
