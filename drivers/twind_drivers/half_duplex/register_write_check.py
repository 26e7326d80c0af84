"""Last check of a command's bytes (WIRE_CLAMP): known ids, writable addresses, goals in range. Pure."""

from collections.abc import Collection, Mapping

from twind_drivers.bus import WireRangeError
from twind_drivers.half_duplex import checksum_packet as packet
from twind_drivers.half_duplex.checksum_packet import ChecksumPacket
from twind_drivers.half_duplex.register_table import MappedRegister, RegisterTable

LAST_ADDRESS = 0xFF


class RegisterWriteCheck:
    """Permitted writes of one bus.

    `goals`: range by id. `off`: packet that switches torque off on all. `bare`: instructions without
    data. `volatile`: addresses of kept registers whose write changes the RAM copy alone. `unlocked`: id whose
    kept registers may be written.
    """

    def __init__(
        self,
        name: str,
        tables: Mapping[int, RegisterTable],
        goals: Mapping[int, tuple[int, int]],
        off: bytes,
        *,
        volatile: Collection[int] = (),
        bare: Collection[int] = (),
    ) -> None:
        self._name = name
        self._tables = tables
        self._off = off
        self._volatile = frozenset(volatile)
        self._bare = frozenset(bare)
        self.goals = goals
        self.unlocked: int | None = None

    def judge(self, data: bytes) -> None:
        """Raise WireRangeError for anything but whole packets with permitted writes."""
        found = packet.find_packets(data)
        if not found or sum(each.octets for each in found) != len(data):
            raise WireRangeError(self._name, packet.BROADCAST, len(data), 0, 0, "stray bytes in a packet")
        for each in found:
            if packet.instruction(each.id, each.code, each.data) == self._off:
                continue
            for id, address, raw in self._rows(each):
                self._row(id, address, raw)

    def _row(self, id: int, address: int, raw: bytes) -> None:
        if id not in self.goals:
            raise WireRangeError(self._name, id, id, min(self.goals), max(self.goals), "address to id")
        end = address + len(raw)
        own = self._tables[id].registers
        place = address
        while place < end:
            field = next((each for each in own.values() if each.address == place), None)
            if field is None or not field.writable or place + field.size > end:
                raise WireRangeError(self._name, id, place, 0, LAST_ADDRESS, "read-only address")
            self._value(id, field, field.decode(raw[place - address :]))
            place += field.size

    def _value(self, id: int, field: MappedRegister, value: int) -> None:
        least, most = field.least, field.most
        if field.name == "goal_position":
            least, most = self.goals[id]
        elif field.name == "torque_enable":
            least, most = 0, 1
        if field.kept and field.address not in self._volatile and self.unlocked != id:
            raise WireRangeError(self._name, id, field.address, 0, LAST_ADDRESS, "EEPROM address")
        if not least <= value <= most:
            raise WireRangeError(self._name, id, value, least, most, field.name.replace("_", " "))

    def _rows(self, found: ChecksumPacket) -> list[tuple[int, int, bytes]]:
        """Return (id, address, data) of each write; what is no permitted form of one counts as one to all."""
        data = found.data
        if found.code in self._bare and not data:
            return [(found.id, 0, b"")]
        if found.code == packet.WRITE and data:
            return [(found.id, data[0], data[1:])]
        if found.code != packet.SYNC_WRITE or len(data) < 2 or (len(data) - 2) % (data[1] + 1):
            return [(packet.BROADCAST, 0, data)]
        size = data[1] + 1
        return [(data[at], data[0], data[at + 1 : at + size]) for at in range(2, len(data), size)]
