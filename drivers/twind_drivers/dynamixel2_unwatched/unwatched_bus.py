"""Bus of XL-320 or PRO -R of a robot in its two halves: reader (mirror and live) and writer (live only)."""

from twind.config.driver_family import BusDriver, BusSetup
from twind_drivers.bus import BusReader
from twind_drivers.bus_writer import BusWriter
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.dynamixel2_unwatched.unwatched_reader import UnwatchedReader
from twind_drivers.dynamixel2_unwatched.unwatched_servo_type import UnwatchedServoType
from twind_drivers.dynamixel2_unwatched.unwatched_writer import UnwatchedWriter


def _reader(setup: BusSetup, port: ByteTransport) -> BusReader:
    kinds = _types(setup)
    return UnwatchedReader(
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
    assert isinstance(reader, UnwatchedReader)
    kinds = _types(setup)
    return UnwatchedWriter(
        reader,
        lower=setup.lower,
        upper=setup.upper,
        gains=[kind.gains.registers() for kind in kinds],
        torque_limits=[kind.torque_limit for kind in kinds],
    )


def _types(setup: BusSetup) -> list[UnwatchedServoType]:
    return [joint.type for joint in setup.joints if isinstance(joint.type, UnwatchedServoType)]


DRIVER = BusDriver(reader=_reader, writer=_writer)
