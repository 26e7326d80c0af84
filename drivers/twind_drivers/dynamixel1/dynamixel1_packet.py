"""Instructions and error bits of Dynamixel Protocol 1.0. The framing is that of `checksum_packet`.

An error byte mixes the state of the servo with the result of the instruction. Data beside a state are valid;
a refused instruction is answered without data.
"""

from collections.abc import Mapping, Sequence

from twind_drivers.half_duplex.checksum_packet import BROADCAST, instruction

RESET = 0x06  # factory settings, id 1
BULK_READ = 0x92  # MX only; each servo waits for the status of the one before it

STATES: Mapping[int, str] = {0x01: "supply voltage", 0x04: "overheating", 0x20: "overload"}
SHUT_DOWN = 0x80  # ours, no bit of the protocol: the torque limit reads 0
ANGLE_LIMIT = 0x02
RANGE = 0x08
CHECKSUM = 0x10
INSTRUCTION = 0x40
RESULTS: Mapping[int, str] = {
    ANGLE_LIMIT: "goal outside its angle limits",
    RANGE: "value or address out of range",
    CHECKSUM: "checksum of the request",
    INSTRUCTION: "unknown instruction",
}
FAULT_BITS = sum(STATES)


def explain(error: int) -> str:
    """Return the meaning of an error byte, in words."""
    bits = {**STATES, **RESULTS, SHUT_DOWN: "shut down by an alarm (torque limit 34 is 0)"}
    return ", ".join(text for bit, text in bits.items() if error & bit) or "no error"


def bulk_read(ids: Sequence[int], address: int, size: int) -> bytes:
    """Build a read of the same block of several devices; each sends a status, in this order."""
    rows = b"".join(bytes((size, id, address)) for id in ids)
    return instruction(BROADCAST, BULK_READ, b"\0" + rows)
