"""Faults on demand, by name: of replies, of the line, of servos, of the plug."""

from twind_drivers.virtual.faulty_byte_stream import FaultyByteStream
from twind_drivers.virtual.half_duplex_wire import HalfDuplexWire
from twind_drivers.virtual.serial_line_faults import SerialLineFaults
from twind_drivers.virtual.servo_faults import ServoFaults
from twind_drivers.virtual.virtual_sensor import VirtualSensor
from twind_drivers.virtual.virtual_servos import VirtualServos


class SerialBusFaults(SerialLineFaults, ServoFaults):
    """Faults of one bus. Each method is an order; `docs/virtual.md` lists them."""

    def __init__(
        self,
        bus: str,
        servos: VirtualServos,
        wire: HalfDuplexWire,
        stream: FaultyByteStream,
        sensor: VirtualSensor | None = None,
    ) -> None:
        self._sensor = sensor
        ServoFaults.__init__(self, bus, servos)
        SerialLineFaults.__init__(self, wire, stream)

    def silence(self, id: int | None = None, on: bool = True, number: int | None = None) -> None:
        """Pull the connector of one device or (None) of all: it receives and sends nothing, keeps its power.

        `number`: of several with that id, from 1. `clear` plugs all in. Raises KeyError.
        """
        if self._sensor is not None and id in (None, self._sensor.id):
            self._sensor.silenced = on
        if self._sensor is None or id != self._sensor.id:
            ServoFaults.silence(self, id, on, number)

    def power(self, on: bool) -> None:
        """The supply of the bus. Off: no servo replies or holds. On: all boot, RAM and turns are lost."""
        ServoFaults.power(self, on)
        if self._sensor is not None:
            self._sensor.silenced = not on

    def require(self, id: int) -> None:
        """Raise KeyError, listing the ids, if no device has this id."""
        if self._sensor is None or id != self._sensor.id:
            self.rows(id)

    def rows(self, id: int, number: int | None = None) -> list[int]:
        """Places of the servos with this id. Raises KeyError that names the ids there are."""
        return ServoFaults.rows(self, id, number)

    def clear(self) -> None:
        """Heal every fault of the line; hardware errors, lost turns, power and an unplugged port stay."""
        SerialLineFaults.clear(self)
        ServoFaults.clear(self)
        if self._sensor is not None:
            self._sensor.silenced = False
