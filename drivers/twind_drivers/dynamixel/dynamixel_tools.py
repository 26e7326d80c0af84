"""Facts of protocol 2.0 for scan, adoption and doctor."""

from collections.abc import Mapping, Sequence
from functools import partial

from twind.config.driver_family import FamilyPart
from twind.config.robot_spec import BusSpec, JointSpec
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.dynamixel_identification import SETTINGS, find_table
from twind_drivers.dynamixel.packet import StatusErrorCode
from twind_drivers.dynamixel.replies import StatusReply
from twind_drivers.dynamixel.servo_check import SECONDARY
from twind_drivers.dynamixel.servo_limits import usual_supply
from twind_drivers.dynamixel.servo_type import KIND, ServoType
from twind_drivers.half_duplex.pending_reply import wire
from twind_drivers.servo_tools.family_tools import FamilyTools, ServoLocation
from twind_drivers.servo_tools.port_scan import scan_port
from twind_drivers.servo_tools.scan_protocol import OLD_PING, ScanProtocol, ServoIdentity, ServoTable

# Register 70, bit by bit (e-manual, "Hardware Error Status"), and what precedes a reboot.
ERRORS = {
    0: ("input voltage", "correct the supply"),
    2: ("overheating", "let it cool, find the load"),
    3: ("encoder", "if it comes back after a reboot, exchange the servo"),
    4: ("electrical shock", "check supply current and connectors"),
    5: ("overload", "remove the obstacle or load"),
}
# Value of register 8 -> bit/s (e-manual, "Baud Rate"; the last two: P series).
RATES = (
    *(9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000),
    *(4_000_000, 4_500_000, 6_000_000, 10_500_000),
)
REPORTS = ("torque_enable", "hardware_error_status")  # never written by adoption
ANSWERS_ALL = 2  # status return level (68): pings, reads and writes are answered
SECOND_OFF = 255  # second id (12): none
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
    return ", ".join(text for bit, (text, _) in ERRORS.items() if bits >> bit & 1) or f"{bits:#04x}"


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


def _settings(known: ServoTable) -> Sequence[str]:
    return [key for key in SETTINGS if key in known]


def _delivered(device: str) -> Sequence[ServoLocation]:
    """Return the factory id and baud rate of a model (`register_rules`)."""
    known = table(number_of(device))
    id, rate = (known[key].rule.default for key in ("id", "baud_rate"))
    return () if id is None or rate is None else (ServoLocation(id, RATES[rate]),)


def _required(joint: JointSpec, _: ServoTable, __: Mapping[str, int]) -> dict[str, int]:
    """Return the required values by register; without a requirement the factory default.

    A register without a documented default and without a required value is left out.
    """
    kind = joint.type
    assert isinstance(kind, ServoType)
    known = table(number_of(kind.device))
    own = {
        "status_return_level": ANSWERS_ALL,
        "operating_mode": joint.operating_mode,
        "drive_mode": 0,  # sign and offset live in the daemon's files, not in the servo
        "homing_offset": 0,
        "startup_configuration": 0,
        "return_delay_time": kind.return_delay_us // 2,
        **dict.fromkeys(SECONDARY, SECOND_OFF),
        **joint.registers,
    }
    found = {key: own.get(key, known[key].rule.default) for key in _settings(known) if key not in REPORTS}
    return {key: value for key, value in found.items() if value is not None}


def _refusal(error: int) -> str:
    """Return why a write was refused; a packet that broke on its way is no refusal."""
    known = error & 0x7F in (StatusErrorCode.NONE, StatusErrorCode.CRC)
    return "" if known else packet.explain(error)


def _reading_time(bus: BusSpec, joints: Sequence[JointSpec]) -> float:
    count = len(joints)
    data = (14 + 5 * count) + (14 + count) + count * (11 + 10)
    delays = [joint.type.return_delay_us for joint in joints if isinstance(joint.type, ServoType)]
    return wire(data, bus.baud) + sum(delays) * 1e-6


TOOLS = FamilyTools(
    protocol=PROTOCOL,
    number_of=number_of,
    name_of=lambda device: table(number_of(device)).model,
    table_of=lambda device: table(number_of(device)),
    reply=lambda id, size, request: StatusReply((id,), size),
    settings=_settings,
    derive=lambda values, error: dict(values),
    delivered=_delivered,
    baud_code=lambda baud: RATES.index(baud) if baud in RATES else None,
    required=_required,
    refusal=_refusal,
    errors=ERRORS,
    reboots=True,
    judges=FamilyPart("twind_drivers.dynamixel.doctor.dynamixel_judges:JUDGES"),
    supply=usual_supply,
    reading_time=_reading_time,
)
