"""Search for servos with the framing `FF FF`, which Feetech and Dynamixel 1.0 share. Pure.

Their packets are equal and their registers are not. Only the place of the id tells the families apart: it is
register 5 of a Feetech and register 3 of a Dynamixel, each in the block of `IDENTITY`.
"""

from collections.abc import Callable, Mapping

from twind_drivers.half_duplex import checksum_packet as packet
from twind_drivers.half_duplex.checksum_reply import ChecksumReply
from twind_drivers.servo_tools.scan_protocol import ScanProtocol, ServoIdentity

IDENTITY = (0, 6)  # address and size: firmware and model of either family, and its id
FEETECH_ID = 5
DYNAMIXEL_ID = 3
LAST_END = 1  # largest value of register 2 of a Feetech: byte order
LONGEST_DELAY = 508e-6  # s: 254 x 2 us
REMEDIES = {
    "supply voltage": "compare the supply with the voltage limits of the servo",
    "encoder": "if it comes back after power-off, exchange the servo",
}
HOT = "let it cool, find the load, remove the obstacle"


def id_register(id: int, block: bytes) -> int | None:
    """Return the register that holds the id of a servo with an unknown model; None: none does."""
    places = [place for place in (DYNAMIXEL_ID, FEETECH_ID) if block[place] == id]
    return places[-1 if block[2] <= LAST_END else 0] if places else None


def checksum_protocol(
    kind: str,
    bauds: tuple[int, ...],
    identify: Callable[[int, bytes], ServoIdentity | None],
    *,
    pings: bool,
    fault_bits: int,
    explain: Callable[[int], str],
) -> ScanProtocol:
    """Return the search of a family. `pings`: its servos answer pings; else their identity is read.

    A read is no risk to a servo of the other family.
    """

    def ping(id: int) -> bytes:
        return packet.instruction(id, packet.PING) if pings else packet.read(id, *IDENTITY)

    return ScanProtocol(
        kind=kind,
        bauds=bauds,
        last_id=packet.LAST_ID,
        overhead=packet.OVERHEAD,
        delay=LONGEST_DELAY,
        find_packets=packet.find_packets,
        ping=ping,
        ping_size=0 if pings else IDENTITY[1],
        read=packet.read,
        write=packet.write,
        slot=0.0,
        line_probe=packet.read(packet.BROADCAST, *IDENTITY),
        identity=IDENTITY if pings else (0, 0),
        identify=identify,
        fault_bits=fault_bits,
        explain=explain,
    )


def reply_of(id: int, size: int, request: bytes) -> ChecksumReply:
    """Return the reply to a request."""
    return ChecksumReply((id,), size, (request,))


def errors_of(faults: Mapping[int, str]) -> dict[int, tuple[str, str]]:
    """Return name and remedy by bit; `faults`: names by mask."""
    return {mask.bit_length() - 1: (name, REMEDIES.get(name, HOT)) for mask, name in faults.items()}
