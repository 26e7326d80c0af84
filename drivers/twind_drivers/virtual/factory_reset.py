"""Instructions that reset a servo: factory reset, clear, control table backup.

Each answers an error number and acts on one servo; `servos.changed` must follow. Source: e-manual "Protocol
2.0", sections of those names. Cases on no page are decided here: a wrong or missing parameter is a range or
length error and does nothing, a restore without a backup fails.
"""

from twind_drivers.dynamixel.packet import BROADCAST, Packet, StatusErrorCode
from twind_drivers.virtual.virtual_servos import VirtualServos

RESET_ALL = 0xFF
KEEP_ID = 0x01
KEEP_ID_AND_BAUD = 0x02
STORE = 0x01
RESTORE = 0x02
TURNS = bytes((0x01, 0x44, 0x58, 0x4C, 0x22))  # clear: the count of turns, with its fixed tail
BACKUP_TAIL = bytes((0x43, 0x54, 0x52, 0x4C))


def factory_reset(servos: VirtualServos, row: int, packet: Packet, now: float) -> StatusErrorCode:
    """Defaults in EEPROM and RAM, by a reboot. To all at once "reset all" does nothing from firmware 42."""
    if not packet.params:
        return StatusErrorCode.DATA_LENGTH
    option = packet.params[0]
    memory = servos.memory
    old = servos.memory.raw[row].copy()
    if option not in (RESET_ALL, KEEP_ID, KEEP_ID_AND_BAUD):
        return StatusErrorCode.DATA_RANGE
    if packet.id == BROADCAST and option == RESET_ALL and _supports(servos, row, "clear_from"):
        return (
            StatusErrorCode.RESULT_FAIL
        )  # of MX(2.0) and X, with the firmware that also brought the clear instruction
    keep = ["model_number", "model_information", "firmware_version"]
    keep += [] if option == RESET_ALL else ["id"] if option == KEEP_ID else ["id", "baud_rate"]
    settings = memory.fresh(row)
    for field in (memory.tables[row][key] for key in keep):
        settings[field.address : field.end] = old[field.address : field.end]
    servos.power.down(row, now, settings=settings)
    return StatusErrorCode.NONE


def clear(servos: VirtualServos, row: int, packet: Packet, now: float) -> StatusErrorCode:
    """The position falls back to one turn; the goal register keeps its number. Refused while moving."""
    if not _supports(servos, row, "clear_from"):
        return StatusErrorCode.INSTRUCTION
    if len(packet.params) < len(TURNS):
        return StatusErrorCode.DATA_LENGTH
    if packet.params != TURNS:
        return StatusErrorCode.DATA_RANGE
    servos.settle(now)
    if servos.memory.value(row, servos.memory.tables[row]["moving"]):
        return StatusErrorCode.RESULT_FAIL
    servos.power.collapse(row)
    return StatusErrorCode.NONE


def backup(servos: VirtualServos, row: int, packet: Packet, now: float) -> StatusErrorCode:
    """Store the table, or restore its EEPROM and reboot (RAM settings: see startup configuration, bit 1)."""
    if not _supports(servos, row, "backup_from"):
        return StatusErrorCode.INSTRUCTION
    if len(packet.params) < 1 + len(BACKUP_TAIL):
        return StatusErrorCode.DATA_LENGTH
    if packet.params[0] not in (STORE, RESTORE) or packet.params[1:] != BACKUP_TAIL:
        return StatusErrorCode.DATA_RANGE
    if servos["torque_enable"][row]:
        return StatusErrorCode.RESULT_FAIL
    if packet.params[0] == STORE:
        servos.power.back_up(row)
        return StatusErrorCode.NONE
    kept = servos.power.backup(row)
    if kept is None:
        return StatusErrorCode.RESULT_FAIL
    servos.power.down(row, now, settings=kept)
    return StatusErrorCode.NONE


def _supports(servos: VirtualServos, row: int, what: str) -> bool:
    """Return True if its firmware supports this. `what`: a `..._from` of the model's facts."""
    first: int | None = getattr(servos.memory.tables[row].facts, what)
    return first is not None and servos.memory.firmwares[row] >= first
