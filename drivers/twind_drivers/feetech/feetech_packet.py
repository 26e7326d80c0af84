"""Feetech instructions, error bits, sign and magnitude. The framing is that of `checksum_packet`."""

from collections.abc import Mapping, Sequence
from enum import IntEnum

from twind_drivers.half_duplex.checksum_packet import BROADCAST, instruction


class FeetechInstruction(IntEnum):
    """Instruction codes. `REBOOT` enters the boot loader for 0.8 s and has no reply."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    RECOVERY = 0x06
    REBOOT = 0x08
    CLEAR_TURNS = 0x0A
    CALIBRATE = 0x0B
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


# Bits of the error byte: the state of the servo now, not the result of an instruction.
FAULTS: Mapping[int, str] = {
    0x01: "supply voltage",
    0x02: "encoder",
    0x04: "temperature",
    0x08: "current",
    0x20: "overload",
}
FAULT_BITS = sum(FAULTS)


def explain(error: int) -> str:
    """Return the meaning of an error byte, in words."""
    return ", ".join(text for bit, text in FAULTS.items() if error & bit) or "no error"


def sync_read(ids: Sequence[int], address: int, size: int) -> bytes:
    """Build a read of the same block of several devices; each sends a status, in this order."""
    return instruction(BROADCAST, FeetechInstruction.SYNC_READ, bytes((address, size, *ids)))
