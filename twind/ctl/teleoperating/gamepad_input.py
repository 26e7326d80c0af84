"""A gamepad as the input of teleoperation, by Linux' evdev.

Axes run from -1 to 1, triggers from 0. An axis beyond half of its way is a button too: `ABS_HAT0Y-`,
`ABS_HAT0Y+`. Names and meanings: Documentation/input/gamepad.rst and event-codes.rst of the kernel.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import evdev
from evdev import ecodes

from twind.command_line.verb import UsageError
from twind.robot_client.jog_motion import HOLD

DEAD_ZONE = 0.1  # of the way of an axis, at least: worn sticks do not return to their middle
HALF = 0.5  # of it: there an axis is a button
TRIGGERS = ("ABS_Z", "ABS_RZ", "ABS_GAS", "ABS_BRAKE", "ABS_HAT1X", "ABS_HAT1Y", "ABS_HAT2X", "ABS_HAT2Y")
PREFIXES = ("BTN_SOUTH", "BTN_TRIGGER", "BTN_JOYSTICK")  # a device with one of these is a gamepad or joystick


@dataclass(frozen=True, slots=True)
class GamepadAxis:
    """Range of an axis, in its own units."""

    name: str
    rest: float
    half: float  # from the rest to the end
    dead: float  # share of `half` within which it rests

    def deflection(self, value: int) -> float:
        """Return how far the axis is deflected, -1 to 1; 0 at rest."""
        share = (value - self.rest) / self.half
        far = (abs(share) - self.dead) / (1.0 - self.dead)
        return 0.0 if far <= 0.0 else min(far, 1.0) * (1.0 if share > 0.0 else -1.0)


class GamepadInput:
    """One open device. Its dead-man button must be pressed anew after a pause of this process."""

    def __init__(self, device: Any) -> None:
        """`device`: an `evdev.InputDevice`. Raises UsageError: it has no axes or buttons."""
        self._device = device
        found = device.capabilities()
        self._buttons = {
            code: _name(ecodes.keys.get(code, f"KEY_{code}")) for code in found.get(ecodes.EV_KEY, ())
        }
        self._axes = {code: _axis(code, info) for code, info in found.get(ecodes.EV_ABS, ())}
        self._deflection = {
            axis.name: axis.deflection(device.absinfo(code).value) for code, axis in self._axes.items()
        }
        ends = [f"{axis.name}{sign}" for axis in self._axes.values() for sign in "-+"]
        self.controls = (*self._buttons.values(), *self._deflection, *ends)
        self.name = str(device.name)
        self.dead_man = ""
        self._down: set[str] = set()  # buttons and ends of axes
        self._free: set[str] = set()  # axes that were at rest since the dead-man button was pressed
        self._pressed: list[str] = []
        self._read_at: float | None = None

    # ------------------------------------------------------------------------------------- `TeleopInput`

    def take(self, now: float) -> None:
        """Read the events that have come. Raises EOFError."""
        if self._read_at is not None and now - self._read_at > HOLD:
            self._down.discard(self.dead_man)
        self._read_at = now
        try:
            while events := list(self._device.read()):
                for event in events:
                    self._event(event.type, event.code, event.value)
        except BlockingIOError:
            return
        except OSError as error:
            raise EOFError(f"{self.name}: {os.strerror(error.errno or 0)}") from None
        raise EOFError(f"{self.name}: unplugged")

    def held(self, now: float) -> Mapping[str, float]:
        """Return held buttons and deflected axes; nothing while the dead-man button is not held."""
        if self.dead_man not in self._down:
            return {}
        axes = {name: self._deflection[name] for name in self._free if self._deflection[name]}
        buttons = [name for name in self._down if name[:-1] in self._free or name in self._buttons.values()]
        return axes | {name: 1.0 for name in buttons if name != self.dead_man}

    def pressed(self) -> Sequence[str]:
        """Return buttons, and ends of axes, that were pressed since the last call."""
        pressed = self._pressed
        self._pressed = []
        return pressed

    def is_kept(self, control: str) -> bool:
        """Return True: a gamepad reports each release."""
        return True

    def close(self) -> None:
        """Close the device."""
        self._device.close()

    # -------------------------------------------------------------------------------------------- events

    def _event(self, kind: int, code: int, value: int) -> None:
        if kind == ecodes.EV_SYN and code == ecodes.SYN_DROPPED:  # a release may be among the lost events
            self._down.clear()
        elif kind == ecodes.EV_KEY and code in self._buttons and value != 2:
            self._switch(self._buttons[code], down=value == 1)
        elif kind == ecodes.EV_ABS and code in self._axes:
            name = self._axes[code].name
            self._deflection[name] = far = self._axes[code].deflection(value)
            self._switch(f"{name}-", down=far <= -HALF)
            self._switch(f"{name}+", down=far >= HALF)
            if not far:
                self._free.add(name)

    def _switch(self, name: str, *, down: bool) -> None:
        if down and name not in self._down:
            self._down.add(name)
            self._pressed.append(name)
            if name == self.dead_man:
                self._free = {axis for axis, far in self._deflection.items() if not far}
        elif not down:
            self._down.discard(name)


def open_gamepad(path: str) -> GamepadInput:
    """Open a gamepad; "": the first one. Raises UsageError."""
    try:
        paths = [path] if path else evdev.list_devices(writable=False)
        for each in paths:
            device = evdev.InputDevice(each)
            if path or _is_gamepad(device):
                return GamepadInput(device)
            device.close()
    except OSError as error:
        raise UsageError(
            f"{path or '/dev/input'}: {error.strerror or error}; is this user in the group input?"
        ) from None
    raise UsageError("no gamepad in /dev/input that this user may read: plug it in, or join the group input")


def _is_gamepad(device: Any) -> bool:
    keys = device.capabilities().get(ecodes.EV_KEY, ())
    return any(ecodes.ecodes[name] in keys for name in PREFIXES)


def _name(names: Any) -> str:
    """Return one name of a code: BTN_SOUTH rather than BTN_A or BTN_GAMEPAD."""
    if isinstance(names, str):
        return names
    usual = [each for each in names if each in ("BTN_SOUTH", "BTN_EAST", "BTN_NORTH", "BTN_WEST")]
    return str((usual or list(names))[0])


def _axis(code: int, info: Any) -> GamepadAxis:
    name = _name(ecodes.ABS.get(code, f"ABS_{code}"))
    low = float(info.min)
    high = float(info.max)
    rest = low if name in TRIGGERS else 0.5 * (low + high)
    half = max(high - rest, 1e-9)
    return GamepadAxis(name, rest, half, max(DEAD_ZONE, min(0.5, info.flat / half)))
