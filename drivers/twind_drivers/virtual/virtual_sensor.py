"""Virtual inertial sensor on a servo bus, which only reports.

It answers ping and read, refuses every write, and ignores group instructions.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twind_drivers.bus import Floats
from twind_drivers.dynamixel.packet import BROADCAST, Instruction, Packet, StatusErrorCode, status
from twind_drivers.register_sensor import SensorField

# a model number that no servo has
MODEL = 65000
FIRMWARE = 1
HEAD = 8  # bytes: model number at 0, firmware at 6, id at 7, as servos have them


@dataclass(frozen=True, slots=True)
class SensorRegisters:
    """Numbers in registers: raw = value / lsb + zero."""

    field: SensorField
    lsb: float
    zero: float = 0.0


class VirtualSensor:
    """Virtual sensor. `tell`: source of the true values of its fields, SI, in their order."""

    def __init__(
        self,
        id: int,
        cells: Sequence[SensorRegisters],
        tell: Callable[[], Sequence[Floats]],
        *,
        return_delay: float = 0.0,
    ) -> None:
        """`return_delay` in s."""
        self.id = id
        self.return_delay = return_delay
        self.silenced = False
        self.cells = tuple(cells)
        self.measure = tell
        self._random = np.random.default_rng(0)
        # of the first two fields: gyro, acceleration
        self._noise = np.zeros(2)
        self._bias = np.zeros(2)
        self._size = max(HEAD, *(each.field.end for each in cells))

    def err(self, gyro_noise: float = 0.0, acceleration_noise: float = 0.0, gyro_bias: float = 0.0) -> None:
        """Set noise (standard deviation, rad/s, m/s²) and bias (rad/s) of each axis; 0: none.

        Raises ValueError for a noise below 0, and beyond 10 rad/s and 100 m/s².
        """
        noise = (gyro_noise, acceleration_noise)
        most = (10.0, 100.0)
        fit = all(0.0 <= each <= end for each, end in zip(noise, most, strict=True))
        if not (fit and abs(gyro_bias) <= most[0]):
            raise ValueError("imu: noise is 0..10 rad/s and 0..100 m/s², a bias within 10 rad/s")
        self._noise = np.array(noise)
        self._bias = np.array([gyro_bias, 0.0])

    def answer(self, packet: Packet) -> bytes:
        """Return its status to a sound packet; empty for a packet to another device."""
        ping = packet.instruction == Instruction.PING
        if self.silenced or not (packet.id == self.id or (packet.id == BROADCAST and ping)):
            return b""
        if ping:
            return status(self.id, 0, MODEL.to_bytes(2, "little") + bytes((FIRMWARE,)))
        if packet.instruction == Instruction.READ and len(packet.params) == 4:
            address, size = (int.from_bytes(packet.params[at : at + 2], "little") for at in (0, 2))
            data = self.registers()[address : address + size]
            return (
                status(self.id, 0, data) if len(data) == size else status(self.id, StatusErrorCode.DATA_RANGE)
            )
        known = packet.instruction in (Instruction.READ, Instruction.WRITE, Instruction.REG_WRITE)
        return status(self.id, StatusErrorCode.ACCESS if known else StatusErrorCode.INSTRUCTION)

    def registers(self) -> bytes:
        """All registers as bytes, with the present measurement."""
        memory = bytearray(self._size)
        memory[:HEAD] = MODEL.to_bytes(2, "little") + bytes((0, 0, 0, 0, FIRMWARE, self.id))
        for place, (cells, told) in enumerate(zip(self.cells, self.measure(), strict=True)):
            if place < len(self._noise):
                told = told + self._bias[place] + self._random.normal(0.0, self._noise[place], len(told))
            memory[cells.field.address : cells.field.end] = _raw(cells, told)
        return bytes(memory)


def _raw(cells: SensorRegisters, values: Floats) -> bytes:
    """Return the register values: rounded, and at the end of the range for a value beyond."""
    kind = np.dtype(cells.field.kind)
    raw = values / cells.lsb + cells.zero
    if kind.kind == "f":
        return raw.astype(kind).tobytes()
    ends = np.iinfo(kind)
    return np.clip(np.rint(raw), ends.min, ends.max).astype(kind).tobytes()
