"""Registers of a device by name: one with its value, the result of a restart, and a name that is unknown."""

from collections.abc import Sequence
from dataclasses import dataclass

from twind.exceptions import InvalidInput


@dataclass(frozen=True, slots=True)
class RegisterAddress:
    """Register of a device with its value. `name`: the spelling of the vendor's control table."""

    name: str
    address: int
    size: int  # bytes
    value: int  # signed where the register is
    eeprom: bool = False  # survives power-off: one of those that identification may have read


@dataclass(frozen=True, slots=True)
class RestartResult:
    """Result of a restart for the settings of a device."""

    restored: tuple[RegisterAddress, ...] = ()  # the restart had changed them; they read back as before it
    differing: tuple[tuple[RegisterAddress, int], ...] = ()  # registers that differ, with their value before


def unknown_register(device: str, name: str, near: Sequence[str] = ()) -> InvalidInput:
    """Build the error for a register that `device` lacks. `near`: the nearest names that it has."""
    nearest = f"; near: {', '.join(near)}" if near else ""
    return InvalidInput(f"{device} has no register {name!r}{nearest}", near=near)
