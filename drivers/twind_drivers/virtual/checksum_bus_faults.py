"""Faults of a virtual bus with the framing `FF FF`, by name: of replies, line, servos and their supply."""

from twind_drivers.half_duplex.checksum_packet import instruction
from twind_drivers.virtual.faulty_byte_stream import FaultyByteStream
from twind_drivers.virtual.half_duplex_wire import HalfDuplexWire
from twind_drivers.virtual.hinge import ShaftGrip
from twind_drivers.virtual.serial_line_faults import SerialLineFaults
from twind_drivers.virtual.shaft_faults import ShaftFaults
from twind_drivers.virtual.shown_position_log import ShownPositionLog
from twind_drivers.virtual.virtual_table_servos import VirtualTableServos

NEVER = 1e18  # s: the end of a boot that waits for power


class ChecksumBusFaults(SerialLineFaults, ShaftFaults):
    """Faults of one bus. Each method is an order; the state of a servo outlasts `clear`."""

    def __init__(
        self, bus: str, servos: VirtualTableServos, wire: HalfDuplexWire, stream: FaultyByteStream
    ) -> None:
        self._servos = servos
        hands = ShaftGrip(servos.hinges, servos.turn, servos.encoder, servos.set_hand_position)
        ShaftFaults.__init__(self, f"bus {bus}: no servo", servos.ids, hands)
        SerialLineFaults.__init__(self, wire, stream)

    def require(self, id: int) -> None:
        """Raise KeyError, listing the ids, if no device has this id."""
        self.rows(id)

    def silence(self, id: int | None = None, on: bool = True, number: int | None = None) -> None:
        """Pull the connector of one servo or (None) of all: it receives and sends nothing, keeps its power.

        `number`: of several with that id, from 1. `clear` plugs all in. Raises KeyError.
        """
        for row in range(len(self._servos.silenced)) if id is None else self.rows(id, number):
            self._servos.silenced[row] = on

    def damage(self, id: int, bits: int) -> None:
        """Set these error bits until the next order; 0: none. They are a state, nothing latches.

        Raises KeyError, ValueError.
        """
        if not 0 <= bits <= 63:
            raise ValueError(f"damage: bits {bits} are outside 0..63")
        for row in self.rows(id):
            self._servos.injected[row] = bits

    def brown_out(self, id: int) -> None:
        """Interrupt the supply of one servo for a moment. Raises KeyError."""
        for row in self.rows(id):
            if self._servos.boots_at[row] != NEVER:
                self._servos.reset(row, self._servos.now + self._servos.BOOT)

    def power(self, on: bool) -> None:
        """Switch the bus supply. Off: no servo answers or holds. On: all boot, RAM and turns are lost."""
        for row in range(len(self._servos.silenced)):
            self._servos.reset(row, self._servos.now + self._servos.BOOT if on else NEVER)

    def supply(self, volts: float) -> None:
        """Set the bus supply, V. Raises ValueError outside 0..25 V."""
        if not 0.0 <= volts <= 25.0:
            raise ValueError(f"supply: {volts} V is outside 0..25 V")
        self._servos.volts[:] = [volts] * len(self._servos.volts)
        self._servos.drive()

    def heat(self, id: int, celsius: float) -> None:
        """Set the temperature of one servo. Raises KeyError, ValueError outside 0..255 °C."""
        if not 0.0 <= celsius <= 255.0:
            raise ValueError(f"heat: {celsius} °C is outside 0..255 °C")
        for row in self.rows(id):
            self._servos.celsius[row] = celsius

    def record(self, count: int) -> None:
        """Keep the last `count` refreshes of the positions in `servos.history`; 0: none."""
        self._servos.history = ShownPositionLog(len(self._servos.silenced), count) if count else None

    def clear(self) -> None:
        """Heal every fault of the line and plug in every connector; the state of servos and plug stays."""
        SerialLineFaults.clear(self)
        self._servos.silenced[:] = [False] * len(self._servos.silenced)

    def _status(self, id: int, data: bytes) -> bytes:
        return instruction(id, 0, data)

    def _payload(self, piece: bytes) -> bytes:
        return piece[5:-1]

    def _block(self, row: int, held: bool) -> None:
        self._servos.block(row, held)

    def _freeze(self, row: int, on: bool) -> None:
        self._servos.frozen[row] = self._servos.shown(row) if on else None

    def _set_base_pose(self, base: str) -> None:
        self._servos.muscles.set_base_pose(base)
