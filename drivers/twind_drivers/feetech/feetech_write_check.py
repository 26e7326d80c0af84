"""Last check of a command's bytes (WIRE_CLAMP): known ids, writable addresses, goals in range. Pure."""

from collections.abc import Mapping

from twind_drivers.bus import WireRangeError
from twind_drivers.feetech.feetech_packet import FeetechInstruction
from twind_drivers.feetech.feetech_registers import EPROM_END, FeetechRegister, RegisterMap
from twind_drivers.half_duplex import checksum_packet as packet
from twind_drivers.half_duplex.checksum_packet import ChecksumPacket

TORQUE = 40
OFF = packet.write(packet.BROADCAST, TORQUE, b"\0")
SHADOWED = (21, 22, 23)  # gains: while the lock is on, a write changes the RAM copy alone


class FeetechWriteCheck:
    """Permitted writes of one bus. `goals`: range by id; `unlocked`: id whose EPROM is open."""

    def __init__(
        self, name: str, maps: Mapping[int, RegisterMap], goals: Mapping[int, tuple[int, int]]
    ) -> None:
        self._name = name
        self._maps = maps
        self.goals = goals
        self.unlocked: int | None = None

    def judge(self, data: bytes) -> None:
        """Raise WireRangeError for anything but whole packets with permitted writes."""
        found = packet.find_packets(data)
        if not found or sum(each.octets for each in found) != len(data):
            raise WireRangeError(self._name, packet.BROADCAST, len(data), 0, 0, "stray bytes in a packet")
        for each in found:
            if packet.instruction(each.id, each.code, each.data) == OFF:
                continue
            for id, address, raw in _rows(each):
                self._row(id, address, raw)

    def _row(self, id: int, address: int, raw: bytes) -> None:
        if id not in self.goals:
            raise WireRangeError(self._name, id, id, min(self.goals), max(self.goals), "address to id")
        end = address + len(raw)
        own = self._maps[id]
        place = address
        while place < end:
            field = next((each for each in own.registers.values() if each.address == place), None)
            if field is None or not field.writable or place + field.size > end:
                raise WireRangeError(self._name, id, place, EPROM_END, 0xFF, "read-only address")
            self._value(id, field, field.decode(raw[place - address :]))
            place += field.size

    def _value(self, id: int, field: FeetechRegister, value: int) -> None:
        least, most = field.least, field.most
        if field.name == "goal_position":
            least, most = self.goals[id]
        elif field.name == "torque_enable":
            least, most = 0, 1
        if field.eprom and field.address not in SHADOWED and self.unlocked != id:
            raise WireRangeError(self._name, id, field.address, EPROM_END, 0xFF, "EPROM address")
        if not least <= value <= most:
            raise WireRangeError(self._name, id, value, least, most, field.name.replace("_", " "))


def _rows(found: ChecksumPacket) -> list[tuple[int, int, bytes]]:
    """Return (id, address, data) of each write; an unknown instruction counts as one to all ids."""
    data = found.data
    if found.code == FeetechInstruction.REBOOT:
        return [(found.id, 0, b"")]
    if found.code == FeetechInstruction.WRITE:
        return [(found.id, data[0], data[1:])]
    if found.code != FeetechInstruction.SYNC_WRITE:
        return [(packet.BROADCAST, 0, data)]
    size = data[1] + 1
    return [(data[at], data[0], data[at + 1 : at + size]) for at in range(2, len(data), size)]
