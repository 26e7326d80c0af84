"""Facts of Protocol 1.0 for scan, adoption and doctor."""

from collections.abc import Mapping, Sequence
from functools import partial

from twind.config.robot_spec import BusSpec, JointSpec
from twind.config.unwatched_type import MICROSECONDS
from twind_drivers.dynamixel1.dynamixel1_budget import Dynamixel1Cycle
from twind_drivers.dynamixel1.dynamixel1_identification import LAST, SLAVE, UNLOADING, derived
from twind_drivers.dynamixel1.dynamixel1_models import TWO, model, model_of
from twind_drivers.dynamixel1.dynamixel1_packet import CHECKSUM, FAULT_BITS, RESULTS, STATES, explain
from twind_drivers.dynamixel1.dynamixel1_registers import baud_of, table_of
from twind_drivers.dynamixel1.dynamixel1_type import FULL, KIND, Dynamixel1Type
from twind_drivers.servo_tools.checksum_scan import (
    DYNAMIXEL_ID,
    checksum_protocol,
    errors_of,
    id_register,
    reply_of,
)
from twind_drivers.servo_tools.family_tools import FamilyTools, ServoLocation
from twind_drivers.servo_tools.port_scan import scan_port
from twind_drivers.servo_tools.scan_protocol import ServoIdentity, ServoTable

# Rates of register 4, the most usual first.
BAUDS = (
    *(1_000_000, 57_600, 115_200, 500_000, 250_000, 200_000, 400_000, 2_250_000, 2_500_000, 3_000_000),
    *(19_200, 9_600),
)

FACTORY = (ServoLocation(1, 1_000_000), ServoLocation(1, 57_600))  # AX and MX-12W; the others
ANSWERS_ALL = 2  # status return level


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


def _demanded(joint: JointSpec, known: ServoTable, values: Mapping[str, int]) -> dict[str, int]:
    """Return what arming needs. Limits: only where they choose another mode."""
    assert isinstance(joint.type, Dynamixel1Type)
    delay = joint.type.return_delay_us // MICROSECONDS
    wanted = {"status_return_level": ANSWERS_ALL, "resolution_divider": 1, "lock": 0}
    wanted["return_delay_time"] = min(delay, values.get("return_delay_time", delay))
    wanted["shutdown"] = values.get("shutdown", UNLOADING) | UNLOADING
    wanted["drive_mode"] = values.get("drive_mode", 0) & ~SLAVE
    wanted["max_torque"] = values.get("max_torque") or FULL
    ends = (values.get("min_position_limit"), values.get("max_position_limit"))
    if ends in ((0, 0), (LAST, LAST)):
        wanted |= _limits(joint)
    return {name: value for name, value in (wanted | dict(joint.registers)).items() if name in known}


def _limits(joint: JointSpec) -> dict[str, int]:
    return {"min_position_limit": 0, "max_position_limit": model(joint.type.device).counts - 1}


def _required(joint: JointSpec, known: ServoTable, values: Mapping[str, int]) -> dict[str, int]:
    """Return what a new servo must hold: limits as from the factory, too."""
    return _limits(joint) | _demanded(joint, known, values)


def _refusal(error: int) -> str:
    refused = error & sum(RESULTS) & ~CHECKSUM
    return explain(refused) if refused else ""


def _objection(values: Mapping[str, int]) -> str:
    return (
        "its settings are locked (lock, 47): take its power away and give it back" if values["lock"] else ""
    )


def _reading_time(bus: BusSpec, joints: Sequence[JointSpec]) -> float:
    kinds = [joint.type for joint in joints if isinstance(joint.type, Dynamixel1Type)]
    alone = sum(not kind.model.bulk_read for kind in kinds)
    delay = max(kind.return_delay_us for kind in kinds) * 1e-6
    return Dynamixel1Cycle(len(kinds), alone, bus.baud, delay).seconds


TOOLS = FamilyTools(
    protocol=PROTOCOL,
    reply=reply_of,
    settings=list,
    errors=errors_of(STATES),
    reboots=False,
    number_of=lambda device: model(device).number,
    table_of=lambda device: table_of(model(device)),
    derive=lambda values, error: {**values, **derived(values, error)},
    delivered=lambda device: FACTORY,
    baud_code=lambda baud: next((code for code in range(255) if baud_of(code) == baud), None),
    required=_required,
    demanded=_demanded,
    refusal=_refusal,
    objection=_objection,
    reading_time=_reading_time,
)
