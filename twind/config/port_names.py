"""Form of a bus port: the path of a serial port, or `can:INTERFACE:CHANNEL`. Pure.

Whether the port exists is checked by the loop.
"""

from enum import StrEnum

SCHEME = "can:"
EXAMPLES = "can:slcan:/dev/ttyACM0 or can:socketcan:can0"


class Medium(StrEnum):
    """Content of a port: bytes, or CAN frames."""

    SERIAL = "serial"
    CAN = "can"


def wrong_port(medium: Medium | None, port: str, kind: str = "") -> str | None:
    """Return the error in the port of a bus of `kind`; None: no error. `medium` None: not known yet."""
    if port.startswith(SCHEME):
        _, interface, channel = (*port.split(":", 2), "", "")[:3]
        if not interface or not channel:
            return f"{port}: a CAN port is can:INTERFACE:CHANNEL, as {EXAMPLES}"
        if medium is Medium.SERIAL:
            return f"{port}: a bus of kind {kind} needs the path of a serial port, as /dev/ttyUSB0"
    elif medium is Medium.CAN:
        return f"{port}: a bus of kind {kind} needs can:INTERFACE:CHANNEL, as {EXAMPLES}"
    return None


def virtual_port(medium: Medium, path: str) -> str:
    """The port behind the pseudo-terminal at `path` of a virtual bus on that medium."""
    return f"can:slcan:{path}" if medium is Medium.CAN else path
