"""Last check of a command's bytes (WIRE_CLAMP): known ids, writable addresses, goals in range. Pure."""

from collections.abc import Mapping

from twind_drivers.bus import WireRangeError
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.control_tables import ControlTable
from twind_drivers.dynamixel.device_layout import RegisterBlock

Fences = Mapping[RegisterBlock, tuple[int, int]]  # goal register -> smallest and largest word, inclusive


class CommandPacketCheck:
    """Permitted writes of one bus."""

    def __init__(self, name: str, tables: Mapping[int, ControlTable], fences: Mapping[int, Fences]) -> None:
        """Make the check; `tables`: by id, may change later. `fences`: all goal registers of each id."""
        self._name = name
        self._tables = tables
        self._fences = fences

    def judge(self, data: bytes) -> None:
        """Raise WireRangeError for anything but whole packets with permitted writes."""
        framer = packet.Framer(status=False)
        found = framer.feed(data)
        if framer.discarded or len(framer) or not found:
            raise WireRangeError(self._name, packet.BROADCAST, len(data), 0, 0, "stray bytes in a packet")
        for each in found:
            for id, address, raw in written_rows(each):
                self._row(id, address, raw)

    def _row(self, id: int, address: int, raw: bytes) -> None:
        if id not in self._fences:
            raise WireRangeError(self._name, id, id, min(self._fences), max(self._fences), "address to id")
        for goal, (lower, upper) in self._fences[id].items():
            if address < goal.address + goal.size and goal.address < address + len(raw):
                word = int.from_bytes(raw, "little", signed=True)
                if (address, len(raw)) != (goal.address, goal.size) or not lower <= word <= upper:
                    what = "goal" if upper >= lower else f"register {goal.address}, no goal of this mode:"
                    raise WireRangeError(self._name, id, word, lower, upper, what)
        writable = self._tables[id].writable
        if not writable.issuperset(range(address, address + len(raw))):
            raise WireRangeError(self._name, id, address, min(writable), max(writable), "read-only address")


def written_rows(found: packet.Packet) -> list[tuple[int, int, bytes]]:
    """Return (id, address, data) of each write in a packet; a restart has an id and no data.

    An instruction that no order makes, or a row cut short, counts as a write to all ids, which is refused.
    """
    params = found.params
    code = found.instruction
    if code == packet.Instruction.REBOOT:
        return [(found.id, 0, b"")]
    address = int.from_bytes(params[:2], "little")
    if code == packet.Instruction.WRITE:
        return [(found.id, address, params[2:])]
    size = int.from_bytes(params[2:4], "little") + 1
    if code != packet.Instruction.SYNC_WRITE or len(params) < 4 or (len(params) - 4) % size:
        return [(packet.BROADCAST, address, params[2:])]
    rows = [params[at : at + size] for at in range(4, len(params), size)]
    return [(row[0], address, row[1:]) for row in rows]
