"""Virtual Damiao motor: MIT frames, registers on 7FF, replies on its master id.

Sources: public drivers (axol, lerobot `motors/damiao`). What they leave open is marked "assumed" here: a
refused register write is answered with the value held, every frame to it feeds its watchdog, and lost
communication drops torque.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from math import inf

from twind_drivers.virtual.can.bit_fields import mit_command, mit_state
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.can_motors import CanMotors
from twind_drivers.virtual.can.node import COMMON, HEAT, LOW, VirtualCanNode
from twind_drivers.virtual.can.node_spec import NodeSpec

REGISTERS_ID = 0x7FF
READ = 0x33
WRITE = 0x55
STORE = 0xAA
REFRESH = 0xCC
ENABLE, DISABLE, ZERO, CLEAR = (bytes([255] * 7 + [last]) for last in (0xFC, 0xFD, 0xFE, 0xFB))
OVER_VOLTAGE = 0x8
UNDER_VOLTAGE = 0x9
ROTOR_HOT = 0xC
LOST = 0xD
TICK = 50e-6  # s of register 9
MASTER = 7
ESC = 8
TIMEOUT = 9
MODE = 10
PMAX = 21
VMAX = 22
TMAX = 23
TOO_HIGH = 29
WHOLE = frozenset((7, 8, 9, 10, 13, 14, 15, 16, 35, 36))  # u32; the rest is float32
FIXED = frozenset((13, 14, 15, 16))  # read only (assumed for 16)
FACTORY: Mapping[str, tuple[int, float]] = {
    "under_voltage": (0, 15.0),
    "torque_constant": (1, 1.0),
    "over_temperature": (2, 100.0),
    "over_current": (3, 0.98),
    "acceleration": (4, 10.0),
    "deceleration": (5, -10.0),
    "max_speed": (6, 100.0),
    "master_id": (MASTER, 0),
    "esc_id": (ESC, 0),
    "timeout": (TIMEOUT, 0),
    "mode": (MODE, 1),
    "hardware_version": (13, 0x3130),
    "software_version": (14, 0),
    "serial_number": (15, 0),
    "position_max": (PMAX, 12.5),
    "velocity_max": (VMAX, 30.0),
    "torque_max": (TMAX, 10.0),
    "current_bandwidth": (24, 1000.0),
    "speed_kp": (25, 0.004),
    "speed_ki": (26, 0.002),
    "position_kp": (27, 50.0),
    "position_ki": (28, 0.0),
    "over_voltage": (TOO_HIGH, 60.0),
    "can_rate": (35, 4),
}


class VirtualDamiao(VirtualCanNode):
    """Disabled until it is enabled; answers every frame to it."""

    def __init__(self, spec: NodeSpec, row: int, motors: CanMotors, now: float) -> None:
        """Raises ValueError for a setting that is no register."""
        super().__init__(spec, row, motors, now)
        self.flash: dict[int, float] = dict(FACTORY.values())
        self.flash |= {PMAX: spec.position, VMAX: spec.velocity, TMAX: spec.torque, ESC: spec.id}
        self.flash |= {MASTER: spec.feedback_id, 14: spec.firmware, 15: 10_000 + spec.id}
        for name, value in spec.settings.items():
            if name in COMMON:
                continue
            if name not in FACTORY:
                raise ValueError(f"node {spec.id}: no register {name!r}; there are {', '.join(FACTORY)}")
            self.flash[FACTORY[name][0]] = value
        self.registers = dict(self.flash)
        self.boot(now)

    def start(self) -> None:
        """Registers fall back to what was stored."""
        self.registers = dict(self.flash)
        self.id = int(self.registers[ESC])  # one that was written counts from now on (assumed)
        self._look()

    def accepts_id(self, key: int) -> bool:
        """Return True for its own id, and that of all registers."""
        return key in (self.id, REGISTERS_ID)

    def bounds(self) -> tuple[float, float, float]:
        """Registers 2, 0 and 29."""
        return self.registers[2], self.registers[0], self.registers[TOO_HIGH]

    def watchdog(self) -> int:
        """Register 9, 50 us ticks."""
        return int(self.registers[TIMEOUT])

    def encode_fault(self, what: str) -> int:
        """Status nibble."""
        return ROTOR_HOT if what == HEAT else UNDER_VOLTAGE if what == LOW else OVER_VOLTAGE

    def inject_fault(self, bits: int) -> Sequence[CanMessage]:
        """One status nibble, 8 to F: the first fault stays until it is cleared."""
        return super().inject_fault(0 if self.fault else bits)

    def on_watchdog_timeout(self, now: float) -> Sequence[CanMessage]:
        """Communication lost: torque off (assumed), until the fault is cleared."""
        super().on_watchdog_timeout(now)
        return self.inject_fault(LOST)

    def rescale(self, position: float, velocity: float, torque: float) -> None:
        """Registers 21 to 23 from now on, and over a power cut."""
        for register, value in ((PMAX, position), (VMAX, velocity), (TMAX, torque)):
            self.flash[register] = self.registers[register] = value
        self._look()

    def handle_frame(self, message: CanMessage, now: float) -> Sequence[CanMessage]:
        """MIT frames, special frames, registers."""
        id, data = message
        if id == REGISTERS_ID:
            mine = len(data) >= 4 and data[0] | data[1] << 8 == self.id
            if mine:
                self.watch.heard_at = now
            return self._register(data) if mine else ()
        if id != self.id or len(data) != 8:
            return ()
        self.watch.heard_at = now
        if data[:7] == ENABLE[:7] and data[7] >= CLEAR[7]:
            self._special(data)
        elif self.registers[MODE] == 1:
            self.shaft.follow(*mit_command(data, self.spans))
        return [self.feedback()]

    def feedback(self) -> CanMessage:
        """Status and id in the first byte, place, speed, torque, two temperatures."""
        status = self.fault or int(self.shaft.on)
        place, speed, torque = self.shaft.read_state()
        warm = min(max(round(self.celsius), 0), 255)
        head = (self.id & 0xF) | status << 4
        return self._make_feedback(
            bytes([head]) + mit_state(place, speed, torque, self.spans) + bytes([warm, warm])
        )

    def _special(self, data: bytes) -> None:
        if data == ENABLE:
            self.enable()
        elif data == DISABLE:
            self.shaft.disable()
        elif data == ZERO:
            self.shaft.set_zero()
        else:
            self.clear()

    def _make_feedback(self, data: bytes) -> CanMessage:
        return CanMessage(int(self.registers[MASTER]), data)

    def _register(self, data: bytes) -> Sequence[CanMessage]:
        order = data[2]
        register = data[3]
        if order == REFRESH:
            return [self.feedback()]
        if order == STORE and not self.shaft.on:
            self.flash = dict(self.registers)
            return [self._make_feedback(data[:2] + bytes([STORE, 1]) + bytes(4))]
        if order not in (READ, WRITE) or register not in self.registers or len(data) != 8:
            return ()
        if order == WRITE and register not in FIXED:
            self._write(register, data[4:8])
        return [self._make_feedback(data[:2] + bytes([order, register]) + self._bytes(register))]

    def _bytes(self, register: int) -> bytes:
        value = self.registers[register]
        return struct.pack("<I", int(value)) if register in WHOLE else struct.pack("<f", value)

    def _write(self, register: int, raw: bytes) -> None:
        value = struct.unpack("<I" if register in WHOLE else "<f", raw)[0]
        if not math.isfinite(value) or (register in (PMAX, VMAX, TMAX) and value <= 0.0):
            return
        if register == MODE and not 1 <= value <= 4:
            return
        if register == MODE and value != self.registers[MODE]:
            self.shaft.wrap()  # a switch may restart it
        self.registers[register] = value
        self._look()

    def _look(self) -> None:
        self.spans = tuple(self.registers[each] for each in (PMAX, VMAX, TMAX))  # type: ignore[assignment]
        ticks = self.registers[TIMEOUT]
        self.watch.timeout = ticks * TICK if ticks else inf
