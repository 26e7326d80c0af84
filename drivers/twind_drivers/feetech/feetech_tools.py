"""Facts of Feetech servos for scan, adoption and doctor."""

from functools import partial

from twind_drivers.feetech.feetech_models import name_of
from twind_drivers.feetech.feetech_packet import FAULT_BITS, explain
from twind_drivers.feetech.feetech_registers import BAUDS, map_of_firmware
from twind_drivers.feetech.feetech_type import KIND
from twind_drivers.servo_tools.checksum_scan import FEETECH_ID, checksum_protocol, id_register
from twind_drivers.servo_tools.port_scan import scan_port
from twind_drivers.servo_tools.scan_protocol import ServoIdentity


def identify(id: int, block: bytes) -> ServoIdentity | None:
    """Return the identity in registers 0 to 5; None: a Dynamixel of Protocol 1.0."""
    own = map_of_firmware(*block[:3])
    if own.name == "unknown" and id_register(id, block) != FEETECH_ID:
        return None
    number = int.from_bytes(block[3:5], "big" if own.big_endian else "little")
    return ServoIdentity(number, name_of(number, own.name), block[0] * 100 + block[1], own)


PROTOCOL = checksum_protocol(
    KIND, (*BAUDS, 19_200), identify, pings=False, fault_bits=FAULT_BITS, explain=explain
)
scan = partial(scan_port, PROTOCOL)
