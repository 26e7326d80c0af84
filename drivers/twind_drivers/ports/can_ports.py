"""Names of CAN ports, `can:INTERFACE:CHANNEL`, and what they open: `can:socketcan:can0`,
`can:slcan:/dev/ttyACM0`, for a real UART with its rate `can:slcan:/dev/ttyUSB0@2000000`.
"""

from pathlib import Path
from typing import NamedTuple

from twind.exceptions import InvalidInput
from twind_drivers.bus import PortError
from twind_drivers.ports.can_interface_control import present as link_present
from twind_drivers.ports.channel import CanChannel
from twind_drivers.ports.serial_port import SerialTransport
from twind_drivers.ports.slcan_channel import SlcanChannel

PREFIX = "can:"
BAUD = 115_200  # of a serial adapter; one with its own USB does not care
FORM = "a CAN port is can:INTERFACE:CHANNEL, such as can:socketcan:can0 or can:slcan:/dev/ttyACM0"


class CanPortName(NamedTuple):
    """Parsed name of a CAN port."""

    interface: str  # socketcan, slcan, or another of python-can's
    channel: str  # can0, /dev/ttyACM0; may contain colons
    baud: int = BAUD  # bit/s of the serial side; slcan only


def is_can(port: str) -> bool:
    """Return True for the name of a CAN port, valid or not."""
    return port.startswith(PREFIX)


def parse(port: str) -> CanPortName:
    """The parts of a port's name. Raises InvalidInput."""
    _, _, rest = port.partition(":")
    interface, colon, channel = rest.partition(":")
    if not is_can(port) or not interface or not colon or not channel:
        raise InvalidInput(FORM, where=port)
    if interface != "slcan":
        return CanPortName(interface, channel)
    path, at, rate = channel.rpartition("@")
    if not at:
        return CanPortName(interface, channel)
    if not (path and rate.isascii() and rate.isdigit() and int(rate)):
        raise InvalidInput(f"after @ stands the adapter's baud rate, such as {channel}@{BAUD}", where=port)
    return CanPortName(interface, path, int(rate))


def present(port: str) -> bool:
    """Return True if its device is present, or if that cannot be determined. Raises ValueError."""
    interface, channel, _ = parse(port)
    if interface == "slcan":
        return Path(channel).exists()
    return interface != "socketcan" or link_present(channel)


def open_channel(port: str, bitrate: int, *, by_signal: bool = False) -> CanChannel:
    """Open a port by its name, at `bitrate` (bit/s). Raises PortError with the remedy.

    `by_signal`: as in `SerialTransport`, whose search of other processes is left out for an interface too.
    """
    try:
        interface, channel, baud = parse(port)
    except InvalidInput as error:
        raise PortError(port, error.reason) from None
    if interface != "slcan":
        # Importing python-can takes 0.1 s, so it is done only for its adapters.
        from twind_drivers.ports.python_can_channel import PythonCanChannel  # noqa: PLC0415

        return PythonCanChannel(interface, channel, bitrate, search=not by_signal)
    transport = SerialTransport(channel, baud, by_signal=by_signal)
    try:
        return SlcanChannel(transport, bitrate)
    except PortError:
        transport.close()
        raise
