"""Facts of Protocol 1.0 for scan, adoption and doctor."""

from functools import partial

from twind_drivers.dynamixel1.dynamixel1_models import TWO, model_of
from twind_drivers.dynamixel1.dynamixel1_packet import FAULT_BITS, explain
from twind_drivers.dynamixel1.dynamixel1_registers import table_of
from twind_drivers.dynamixel1.dynamixel1_type import KIND
from twind_drivers.servo_tools.checksum_scan import DYNAMIXEL_ID, checksum_protocol, id_register
from twind_drivers.servo_tools.port_scan import scan_port
from twind_drivers.servo_tools.scan_protocol import ServoIdentity

# Rates of register 4, the most usual first.
BAUDS = (
    *(1_000_000, 57_600, 115_200, 500_000, 250_000, 200_000, 400_000, 2_250_000, 2_500_000, 3_000_000),
    *(19_200, 9_600),
)


def identify(id: int, block: bytes) -> ServoIdentity | None:
    """Return the identity in registers 0 to 5; None: a Feetech servo."""
    number = int.from_bytes(block[:2], "little")
    known = model_of(number)
    name = TWO.get(number) if known is None else known.name
    if name is None and id_register(id, block) != DYNAMIXEL_ID:
        return None
    return ServoIdentity(number, name, block[2], table_of(known))


PROTOCOL = checksum_protocol(KIND, BAUDS, identify, pings=True, fault_bits=FAULT_BITS, explain=explain)
scan = partial(scan_port, PROTOCOL)
