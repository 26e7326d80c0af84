"""A gamepad whose events come through a pipe, as the kernel writes them: `struct input_event`."""

import os
import struct

from evdev import AbsInfo, InputDevice, ecodes

_EVENT = struct.Struct("llHHi")  # struct input_event of 64-bit Linux
STICK = AbsInfo(value=0, min=-32768, max=32767, fuzz=16, flat=128, resolution=0)
PAD = AbsInfo(value=0, min=-1, max=1, fuzz=0, flat=0, resolution=0)
TRIGGER = AbsInfo(value=0, min=0, max=255, fuzz=0, flat=0, resolution=0)
AXES = {ecodes.ABS_X: STICK, ecodes.ABS_Y: STICK, ecodes.ABS_Z: TRIGGER, ecodes.ABS_HAT0Y: PAD}
BUTTONS = [ecodes.BTN_SOUTH, ecodes.BTN_EAST, ecodes.BTN_TL]


class PipeGamepad(InputDevice):  # type: ignore[misc]  # not read by mypy
    """evdev's device on a pipe: its own code reads the bytes. A pipe answers no ioctl, so this class does."""

    def __init__(self, **values: int) -> None:
        """`values`: where axes stand, by name."""
        self.fd, self._writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self.path = "pipe"
        self.name = "Test pad"
        self._values = {ecodes.ecodes[name]: value for name, value in values.items()}

    def capabilities(self, *_: object, **__: object) -> dict[int, list[object]]:
        return {ecodes.EV_KEY: list(BUTTONS), ecodes.EV_ABS: list(AXES.items())}

    def absinfo(self, axis_num: int) -> AbsInfo:
        return AXES[axis_num]._replace(value=self._values.get(axis_num, 0))

    def write_events(self, *events: tuple[int, int, int]) -> None:
        """Write events (type, code, value), and the report that ends them."""
        for kind, code, value in (*events, (ecodes.EV_SYN, ecodes.SYN_REPORT, 0)):
            os.write(self._writer, _EVENT.pack(0, 0, kind, code, value))

    def key(self, name: str, value: int) -> None:
        """Press (1) or release (0) a button."""
        self.write_events((ecodes.EV_KEY, ecodes.ecodes[name], value))

    def axis(self, name: str, value: int) -> None:
        """Move an axis."""
        self.write_events((ecodes.EV_ABS, ecodes.ecodes[name], value))

    def unplug(self) -> None:
        """End the pipe."""
        os.close(self._writer)
        self._writer = -1

    def close(self) -> None:
        """Close both ends."""
        for end in (self.fd, self._writer):
            if end >= 0:
                os.close(end)
        self.fd = -1
        self._writer = -1
