"""Form of a bus port: the path of a serial port, or `can:INTERFACE:CHANNEL`. Pure.

Whether the port exists is checked by the loop.
"""

from twind.config.actuator_types import CAN, SERIAL

SCHEME = "can:"
EXAMPLES = "can:slcan:/dev/ttyACM0 or can:socketcan:can0"


def wrong_port(kind: str | None, port: str) -> str | None:
    """Return the error in the port of a bus of that kind (None: kind not known yet); None: no error."""
    if port.startswith(SCHEME):
        _, interface, channel = (*port.split(":", 2), "", "")[:3]
        if not interface or not channel:
            return f"{port}: a CAN port is can:INTERFACE:CHANNEL, as {EXAMPLES}"
        if kind == SERIAL:
            return f"{port}: a bus of kind {SERIAL} needs the path of a serial port, as /dev/ttyUSB0"
    elif kind == CAN:
        return f"{port}: a bus of kind can needs can:INTERFACE:CHANNEL, as {EXAMPLES}"
    return None


def virtual_port(kind: str, path: str) -> str:
    """The port behind the pseudo-terminal at `path` of a virtual bus of that kind."""
    return f"can:slcan:{path}" if kind == CAN else path
