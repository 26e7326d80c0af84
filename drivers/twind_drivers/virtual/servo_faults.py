"""Faults of single servos and of their supply, by name."""

from twind_drivers.virtual.hinge import ShaftGrip
from twind_drivers.virtual.shaft_faults import ShaftFaults
from twind_drivers.virtual.shown_position_log import ShownPositionLog
from twind_drivers.virtual.virtual_servos import VirtualServos

NEVER = 1e18  # s: the end of a boot that waits for power


class ServoFaults(ShaftFaults):
    """Faults of servos; unless named otherwise they outlast `clear`, as a servo's state does."""

    def __init__(self, bus: str, servos: VirtualServos) -> None:
        super().__init__(
            f"bus {bus}: no servo",
            servos.registers.ids,
            ShaftGrip(servos.hinges, servos.power.turn, servos.power.encoder, servos.set_hand_position),
        )
        self._servos = servos

    def silence(self, id: int | None = None, on: bool = True, number: int | None = None) -> None:
        """Pull the connector of one servo or (None) of all: it receives and sends nothing, keeps its power.

        `number`: of several with that id, from 1. `clear` plugs all in. Raises KeyError.
        """
        self._servos.silenced[slice(None) if id is None else self.rows(id, number)] = on
        self._servos.invalidate_cache()

    def damage(self, id: int, bits: int) -> None:
        """Set hardware error bits (register 70): alert; shutdown by register 63.

        Raises KeyError, ValueError.
        """
        if not 0 < bits <= 63:
            raise ValueError(f"damage: bits {bits} are outside 1..63")
        for row in self.rows(id):
            self._servos.inject_error(row, bits)

    def brown_out(self, id: int) -> None:
        """Interrupt the supply of one servo for a moment: an unrequested reboot. Raises KeyError."""
        for row in self.rows(id):
            if self._servos.power.boots_at[row] != NEVER:  # what has no supply cannot lose it
                self._servos.reboot(row, self._servos.now)

    def power(self, on: bool) -> None:
        """Switch the bus supply. Off: no servo answers or holds. On: all boot, RAM and turns are lost."""
        for row in range(len(self._servos.tripped)):
            self._servos.reboot(row, self._servos.now if on else NEVER)

    def supply(self, volts: float) -> None:
        """Set the bus supply, V, sag by load excluded: too little, too much, or none. Raises ValueError."""
        self._servos.supply(volts)

    def sag(self, id: int, volts: float) -> None:
        """Lower the supply of one servo by so many V, as a thin cable or a bad connector does; 0 ends it.

        Raises KeyError, ValueError.
        """
        for row in self.rows(id):
            self._servos.protection.drop(row, volts)

    def heat(self, id: int, celsius: float) -> None:
        """Set the temperature of one servo and its surroundings from now on. Raises KeyError, ValueError."""
        for row in self.rows(id):
            self._servos.protection.heat(row, celsius)

    def spike(self, id: int, celsius: float, seconds: float) -> None:
        """Show this value in the temperature register for so long, whatever the servo's temperature.

        Raises KeyError, ValueError outside 0..255 °C and 0..10 s.
        """
        if not (0.0 <= celsius <= 255.0 and 0.0 <= seconds <= 10.0):
            raise ValueError(f"spike: {celsius} °C for {seconds} s are outside 0..255 °C and 0..10 s")
        for row in self.rows(id):
            self._servos.readings.spike(row, celsius, self._servos.now + seconds)

    def record(self, count: int) -> None:
        """Keep the last `count` refreshes of the present positions in `servos.history`; 0: none.

        No fault, but ordered like one. Raises ValueError outside 0..100,000.
        """
        self._servos.history = ShownPositionLog(len(self._servos.tripped), count) if count else None

    def clear(self) -> None:
        """Plug in every connector."""
        self._servos.silenced[:] = False
        self._servos.invalidate_cache()

    def _block(self, row: int, held: bool) -> None:
        self._servos.block(row, held)

    def _freeze(self, row: int, on: bool) -> None:
        self._servos.readings.freeze(row, on)

    def _set_base_pose(self, base: str) -> None:
        self._servos.muscles.set_base_pose(base)
