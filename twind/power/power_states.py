"""States of relay and button, as the power process reports them. Pure."""

from enum import IntEnum


class RelayState(IntEnum):
    """State of the supply relay."""

    UNKNOWN = 0  # the process has not reported yet
    OPEN = 1  # as the loop asks
    CLOSED = 2
    TRIPPED = 3  # open, since the loop did not complete a tick in time
    FAILED = 4  # the relay's device cannot be used


class ButtonState(IntEnum):
    """State of the stop button."""

    UNKNOWN = 0
    RELEASED = 1
    PRESSED = 2
    UNPLUGGED = 3  # its device or its signal is gone, which stops the robot too
