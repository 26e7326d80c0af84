"""Facts of protocol 2.0 for scan, adoption and doctor."""

from functools import partial

from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.dynamixel_identification import find_table
from twind_drivers.dynamixel.servo_type import KIND
from twind_drivers.servo_tools.port_scan import scan_port
from twind_drivers.servo_tools.scan_protocol import OLD_PING, ScanProtocol, ServoIdentity

# Bits of register 70 (e-manual, "Hardware Error Status").
ERRORS = {0: "input voltage", 2: "overheating", 3: "encoder", 4: "electrical shock", 5: "overload"}
LONGEST_DELAY = 508e-6  # s: the largest return delay (register 9: 254 x 2 us)
PING_DATA = 3  # bytes of a reply to a ping: model number 2, firmware 1
# s per id of a broadcast ping, beside its wire time. Devices reply in the order of their ids. Id 5 alone did
# not reply within 10 ms at 2 Mbaud, but within 50 ms (Dynamixel2Arduino #106). Less than 3 ms misses high ids
# (DynamixelSDK, `broadcastPing`).
SLOT = 0.003


def identify(id: int, data: bytes) -> ServoIdentity:
    """Return the identity in the reply to a ping."""
    number = int.from_bytes(data[:2], "little")
    firmware = data[2]
    known = find_table(number, firmware)
    return ServoIdentity(number, None if known is None else known.model, firmware, known)


def explain(bits: int) -> str:
    """Return the meaning of a hardware error, in words."""
    return ", ".join(text for bit, text in ERRORS.items() if bits >> bit & 1) or f"{bits:#04x}"


PROTOCOL = ScanProtocol(
    kind=KIND,
    bauds=(57_600, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 115_200, 4_500_000, 9_600),  # register 8
    last_id=packet.LAST_ID,
    overhead=packet.STATUS_OVERHEAD,
    delay=LONGEST_DELAY,
    find_packets=packet.find_packets,
    ping=packet.ping,
    ping_size=PING_DATA,
    read=packet.read,
    write=packet.write,
    slot=SLOT,
    line_probe=OLD_PING,
    identity=(0, 0),
    identify=identify,
    fault_bits=0,
    explain=explain,
)
scan = partial(scan_port, PROTOCOL)
