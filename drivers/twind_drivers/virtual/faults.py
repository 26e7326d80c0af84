"""Faults on demand, by name: of the line, of one servo, of the plug."""

from collections.abc import Sequence

from twind_drivers.dynamixel.packet import LAST_ID, status
from twind_drivers.virtual.servos import Servos
from twind_drivers.virtual.wire import Wire


class Faults:
    """What goes wrong on one bus. An answer is what one device sends; counts are of answers to come."""

    def __init__(self, bus: str, servos: Servos, wire: Wire) -> None:
        self._bus, self._servos, self._wire = bus, servos, wire
        self._drop = self._corrupt = self._foreign = 0
        self.plugged = True
        self.active = False  # is any answer still to be struck?

    def silence(self, id: int, on: bool = True) -> None:
        """Pull the connector of one servo: it hears and says nothing, keeps its power. Raises KeyError."""
        self._servos.silenced[self.rows(id)] = on
        self._servos.changed()

    def drop(self, count: int) -> None:
        """The next `count` answers get lost. Raises ValueError below 0."""
        self._drop = _counted(count)
        self.active = True

    def corrupt(self, count: int) -> None:
        """The next `count` answers arrive with a flipped bit. Raises ValueError below 0."""
        self._corrupt = _counted(count)
        self.active = True

    def foreign(self, count: int) -> None:
        """Before each of the next `count` answers comes a sound one of a device that nobody asked."""
        self._foreign = _counted(count)
        self.active = True

    def delay(self, seconds: float) -> None:
        """Every answer comes that much later, until set to 0. Raises ValueError outside 0..10 s."""
        if not 0.0 <= seconds <= 10.0:
            raise ValueError(f"delay: {seconds} s is outside 0..10 s")
        self._wire.lag = seconds

    def damage(self, id: int, bits: int) -> None:
        """Hardware error bits (register 70): alert, shutdown by register 63. Raises KeyError, ValueError."""
        if not 0 < bits <= 63:
            raise ValueError(f"damage: bits {bits} are outside 1..63")
        for row in self.rows(id):
            self._servos.damage(row, bits)

    def brown_out(self, id: int) -> None:
        """One servo loses its supply for a moment: a reboot that nobody asked for. Raises KeyError."""
        for row in self.rows(id):
            self._servos.reboot(row, self._servos.now)

    def unplug(self) -> None:
        """The adapter is pulled out: what is under way is lost; the servos keep power and time."""
        self.plugged = False
        self._wire.clear()

    def replug(self) -> None:
        """The adapter is back."""
        self.plugged = True

    def clear(self) -> None:
        """Heal every fault of the line; hardware errors, lost turns and an unplugged port stay."""
        self._drop = self._corrupt = self._foreign = 0
        self.active = False
        self._wire.lag = 0.0
        self._servos.silenced[:] = False
        self._servos.changed()

    def rows(self, id: int) -> list[int]:
        """Places of the servos with this id. Raises KeyError that names the ids there are."""
        ids = self._servos.registers.ids()
        found = [row for row, each in enumerate(ids) if each == id]
        if not found:
            raise KeyError(f"bus {self._bus}: no servo with id {id}; ids are {sorted(ids)}")
        return found

    def strike(self, pieces: Sequence[bytes]) -> list[bytes]:
        """The answers as they arrive; a lost one is empty."""
        struck = [self._one(piece) for piece in pieces]
        self.active = self._drop > 0 or self._corrupt > 0 or self._foreign > 0
        return struck

    def _one(self, piece: bytes) -> bytes:
        if self._drop > 0:
            self._drop -= 1
            return b""
        if self._corrupt > 0:
            self._corrupt -= 1
            place = len(piece) // 2
            piece = piece[:place] + bytes((piece[place] ^ 0x10,)) + piece[place + 1 :]
        if self._foreign > 0:
            self._foreign -= 1
            piece = status(LAST_ID, 0, bytes(4)) + piece
        return piece


def _counted(count: int) -> int:
    if count < 0:
        raise ValueError(f"{count} answers: a count is 0 or more")
    return count
