"""Dynamixel bus of a robot in its two halves: reader (mirror and live) and writer (live only)."""

from twind.config.driver_family import BusDriver, BusSetup
from twind_drivers.bus import BusReader
from twind_drivers.bus_writer import BusWriter
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.dynamixel.control_tables import number_of
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.servo_command_settings import RawGains
from twind_drivers.dynamixel.servo_type import ServoType


def _reader(setup: BusSetup, port: ByteTransport) -> BusReader:
    kinds = _types(setup)
    return DynamixelReader(
        setup.bus.name,
        port,
        setup.ids,
        [number_of(kind.device) for kind in kinds],
        baud=setup.bus.baud,
        return_delay_us=max(kind.return_delay_us for kind in kinds),
        rate_hz=setup.rate_hz,
        one_write=setup.bus.one_write,
        sensors=setup.sensors,
    )


def _writer(setup: BusSetup, reader: BusReader) -> BusWriter:
    assert isinstance(reader, DynamixelReader)
    return DynamixelWriter(
        reader,
        lower=setup.lower,
        upper=setup.upper,
        gains=[RawGains(kind.gains.p, kind.gains.i, kind.gains.d) for kind in _types(setup)],
        modes=[joint.operating_mode for joint in setup.joints],
        current_caps=[joint.current_cap for joint in setup.joints],
    )


def _types(setup: BusSetup) -> list[ServoType]:
    return [joint.type for joint in setup.joints if isinstance(joint.type, ServoType)]


DRIVER = BusDriver(reader=_reader, writer=_writer)
