"""Facts of Feetech servos for scan, adoption and doctor."""

from collections.abc import Mapping, Sequence
from functools import partial

from twind.config.robot_spec import BusSpec, JointSpec
from twind_drivers.feetech.feetech_budget import WHOLE, cycle_seconds
from twind_drivers.feetech.feetech_identification import MULTI_TURN, UNLOADING, complete
from twind_drivers.feetech.feetech_models import model, name_of
from twind_drivers.feetech.feetech_packet import FAULT_BITS, FAULTS, explain
from twind_drivers.feetech.feetech_registers import BAUDS, map_of_firmware, register_map
from twind_drivers.feetech.feetech_type import KIND, MANY, FeetechType
from twind_drivers.servo_tools.checksum_scan import (
    FEETECH_ID,
    checksum_protocol,
    errors_of,
    id_register,
    reply_of,
)
from twind_drivers.servo_tools.family_tools import FamilyTools, ServoLocation
from twind_drivers.servo_tools.port_scan import scan_port
from twind_drivers.servo_tools.scan_protocol import ServoIdentity, ServoTable

CERTAIN = 5  # codes of register 6 below it mean the same rate in all sources
# Rates as delivered: the second of SMS; SCS: the first or the last, by source.
FACTORY = tuple(ServoLocation(1, baud) for baud in (1_000_000, 115_200, 500_000))


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


def _demanded(joint: JointSpec, known: ServoTable, values: Mapping[str, int]) -> dict[str, int]:
    """Return what arming needs. Limits: only where they choose another mode."""
    many = joint.mode == MANY
    wanted = {"status_return_level": 1, "operating_mode": 0, "return_delay_time": 0}
    wanted["shutdown"] = values.get("shutdown", UNLOADING) | UNLOADING
    turns = values.get("phase", 0) & ~MULTI_TURN
    wanted["phase"] = turns | MULTI_TURN if many else turns
    ends = (values.get("min_position_limit"), values.get("max_position_limit"))
    if many or ends == (0, 0):
        wanted |= _limits(joint)
    return {name: value for name, value in (wanted | dict(joint.registers)).items() if name in known}


def _limits(joint: JointSpec) -> dict[str, int]:
    assert isinstance(joint.type, FeetechType)
    last = 0 if joint.mode == MANY else 2 * joint.type.centre - 1
    return {"min_position_limit": 0, "max_position_limit": last}


def _required(joint: JointSpec, known: ServoTable, values: Mapping[str, int]) -> dict[str, int]:
    """Return what a new servo must hold: limits and offset as from the factory, too."""
    own = {"homing_offset": 0, "lock": 1} | _limits(joint)
    return {name: value for name, value in own.items() if name in known} | _demanded(joint, known, values)


def _reading_time(bus: BusSpec, joints: Sequence[JointSpec]) -> float:
    maps = [joint.type.map for joint in joints if isinstance(joint.type, FeetechType)]
    return cycle_seconds(len(maps), sum(not each.sync_read for each in maps), WHOLE, baud=bus.baud)


TOOLS = FamilyTools(
    protocol=PROTOCOL,
    reply=reply_of,
    settings=list,
    errors=errors_of(FAULTS),
    reboots=False,
    number_of=lambda device: model(device).number,
    table_of=lambda device: register_map(model(device).map),
    derive=lambda values, error: complete(values),
    delivered=lambda device: FACTORY,
    baud_code=lambda baud: BAUDS.index(baud) if baud in BAUDS[:CERTAIN] else None,
    required=_required,
    demanded=_demanded,
    refusal=lambda error: "",
    locks=True,
    reading_time=_reading_time,
)
