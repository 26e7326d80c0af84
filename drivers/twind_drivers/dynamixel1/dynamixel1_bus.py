"""Bus of Protocol 1.0 of a robot in its two halves: reader (mirror and live) and writer (live only)."""

from twind.config.driver_family import BusDriver, BusSetup
from twind_drivers.bus import BusReader
from twind_drivers.bus_writer import BusWriter
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.dynamixel1.dynamixel1_reader import Dynamixel1Reader
from twind_drivers.dynamixel1.dynamixel1_type import Dynamixel1Gains, Dynamixel1Type
from twind_drivers.dynamixel1.dynamixel1_writer import PID, SLOPES, Dynamixel1Writer


def _reader(setup: BusSetup, port: ByteTransport) -> BusReader:
    kinds = _types(setup)
    return Dynamixel1Reader(
        setup.bus.name,
        port,
        setup.ids,
        [kind.device for kind in kinds],
        baud=setup.bus.baud,
        return_delay_us=max(kind.return_delay_us for kind in kinds),
        rate_hz=setup.rate_hz,
        one_write=setup.bus.one_write,
    )


def _writer(setup: BusSetup, reader: BusReader) -> BusWriter:
    assert isinstance(reader, Dynamixel1Reader)
    kinds = _types(setup)
    return Dynamixel1Writer(
        reader,
        lower=setup.lower,
        upper=setup.upper,
        gains=[_registers(kind.gains) for kind in kinds],
        torque_limits=[kind.torque_limit for kind in kinds],
    )


def _registers(gains: Dynamixel1Gains) -> dict[str, int]:
    """Return the gain registers that the robot file sets."""
    rows = (*zip(PID, (gains.p, gains.i, gains.d), strict=True), *((name, gains.slope) for name in SLOPES))
    return {name: value for name, value in rows if value is not None}


def _types(setup: BusSetup) -> list[Dynamixel1Type]:
    return [joint.type for joint in setup.joints if isinstance(joint.type, Dynamixel1Type)]


DRIVER = BusDriver(reader=_reader, writer=_writer)
