"""Virtual RobStride motor with the vendor's private protocol: 29-bit ids, parameters, faults in the id.

Sources: RobStride SampleProgram, lerobot. Assumed: every frame to it feeds its timeout; a fault frame is sent
when a fault appears. 0x7028 as the index of the timeout is unverified. A parameter that it lacks is echoed
with an error mark in bits 16-23 of the id (lerobot #4070).
"""

import struct
from collections.abc import Mapping, Sequence
from math import inf, isfinite

from twind_drivers.ports.frame import EXTENDED, EXTENDED_MASK, REMOTE
from twind_drivers.virtual.can.bit_fields import fraction, pack, unpack
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.can_motors import CanMotors
from twind_drivers.virtual.can.node import COMMON, HEAT, LOW, VirtualCanNode
from twind_drivers.virtual.can.node_spec import NodeSpec

HOST = 0xFD
GET_ID = 0
MOTION = 1
FEEDBACK = 2
ENABLE = 3
STOP = 4
ZERO = 6
READ = 17
WRITE = 18
FAULTS = 21
REPORT = 24
KNOCK = bytes([1, 2, 3, 4, 5, 6])  # begins the payload of the rare orders
# bits 16 on of a feedback's id
UNDER_VOLTAGE = 1
DRIVER = 2
OVER_TEMPERATURE = 4
RUN_MODE = 0x7005
TORQUE_LIMIT = 0x700B
PLACE = 0x7019
CURRENT = 0x701A
SPEED = 0x701B
SUPPLY = 0x701C
TURNS = 0x701D
TIMEOUT = 0x7028
TICK = 50e-6  # s of the timeout
EVERY = 0.01  # s between two feedbacks of an active report (assumed)
# name -> index, format, value as delivered, may it be written?
PARAMETERS: Mapping[str, tuple[int, str, float, bool]] = {
    "run_mode": (RUN_MODE, "<B", 0, True),
    "iq_reference": (0x7006, "<f", 0.0, True),
    "velocity_reference": (0x700A, "<f", 0.0, True),
    "torque_limit": (TORQUE_LIMIT, "<f", 0.0, True),
    "current_kp": (0x7010, "<f", 0.17, True),
    "current_ki": (0x7011, "<f", 0.012, True),
    "current_filter": (0x7014, "<f", 0.1, True),
    "position_reference": (0x7016, "<f", 0.0, True),
    "speed_limit": (0x7017, "<f", 2.0, True),
    "current_limit": (0x7018, "<f", 23.0, True),
    "position": (PLACE, "<f", 0.0, False),
    "current": (CURRENT, "<f", 0.0, False),
    "velocity": (SPEED, "<f", 0.0, False),
    "bus_voltage": (SUPPLY, "<f", 0.0, False),
    "turns": (TURNS, "<h", 0, False),
    "acceleration": (0x7022, "<f", 20.0, True),
    "pp_speed": (0x7024, "<f", 10.0, True),
    "pp_acceleration": (0x7025, "<f", 10.0, True),
    "timeout": (TIMEOUT, "<I", 0, True),
}
FORMS = {index: (form, writable) for index, form, _, writable in PARAMETERS.values()}


class VirtualRobStride(VirtualCanNode):
    """Virtual RobStride motor. Disabled until it is enabled; it replies to the host of the latest request."""

    def __init__(self, spec: NodeSpec, row: int, motors: CanMotors, now: float) -> None:
        """Raises ValueError for a setting that is no parameter."""
        super().__init__(spec, row, motors, now)
        self._host = spec.feedback_id or HOST
        self.flash = {index: value for index, _, value, _ in PARAMETERS.values()}
        self.flash[TORQUE_LIMIT] = spec.torque
        for name, value in spec.settings.items():
            if name in COMMON:
                continue
            if name not in PARAMETERS:
                raise ValueError(f"node {spec.id}: no parameter {name!r}; there are {', '.join(PARAMETERS)}")
            self.flash[PARAMETERS[name][0]] = value
        self.parameters = dict(self.flash)
        self._report_at = inf
        self.boot(now)

    def start(self) -> None:
        """Parameters fall back to what was saved."""
        self.parameters = dict(self.flash)
        self._report_at = inf
        self._look()

    def accepts_id(self, key: int) -> bool:
        """29-bit ids that end in its own."""
        return key == self.id | EXTENDED

    def watchdog(self) -> int:
        """Parameter 7028, 50 us ticks."""
        return int(self.parameters[TIMEOUT])

    def encode_fault(self, what: str) -> int:
        """Fault bits; the six have none for too high a supply, so that of the driver."""
        return OVER_TEMPERATURE if what == HEAT else UNDER_VOLTAGE if what == LOW else DRIVER

    def inject_fault(self, bits: int) -> Sequence[CanMessage]:
        """Set bits of the feedback's id; a new one sends a frame of its own."""
        news = bits & ~self.fault
        super().inject_fault(bits)
        return [self._make_message(FAULTS, struct.pack("<II", self.fault, 0))] if news else ()

    def next_beat(self) -> float:
        """An active report."""
        return self._report_at

    def beat(self, now: float) -> Sequence[CanMessage]:
        """See `next_beat`."""
        self._report_at = now + EVERY
        return [self.feedback()]

    def handle_frame(self, message: CanMessage, now: float) -> Sequence[CanMessage]:
        """Execute all of the private protocol except set id, baud rate and protocol switch."""
        id, data = message
        if not id & EXTENDED or id & REMOTE or id & 0xFF != self.id:
            return ()
        kind = (id & EXTENDED_MASK) >> 24
        upper = id >> 8 & 0xFFFF
        if kind in (FEEDBACK, FAULTS) or len(data) != 8:
            return ()
        self.watch.heard_at = now
        if kind == MOTION:
            if self.parameters[RUN_MODE] == 0:
                self.shaft.follow(*self._motion(upper, data))
            return [self.feedback()]
        self._host = upper & 0xFF
        return self._order(kind, data, now)

    def feedback(self) -> CanMessage:
        """Mode and faults in the id; place, speed, torque, temperature."""
        place, speed, torque = self.shaft.read_state()
        values = [
            pack(value, span, 16) for value, span in zip((place, speed, torque), self.spans, strict=True)
        ]
        warm = min(max(round(self.celsius * 10.0), 0), 65535)
        mode = 2 if self.shaft.on else 0
        return self._make_message(FEEDBACK, struct.pack(">4H", *values, warm), self.fault & 0x3F | mode << 6)

    def _motion(self, torque: int, data: bytes) -> tuple[float, float, float, float, float]:
        place, speed, kp, kd = struct.unpack(">4H", data)
        spans = self.spans
        return (
            unpack(place, spans[0], 16),
            unpack(speed, spans[1], 16),
            fraction(kp, self.spec.gains()[0], 16),
            fraction(kd, self.spec.gains()[1], 16),
            unpack(torque, spans[2], 16),
        )

    def _order(self, kind: int, data: bytes, now: float) -> Sequence[CanMessage]:
        if kind == GET_ID:
            return [CanMessage(EXTENDED | self.id << 8 | 0xFE, self.spec.number.to_bytes(8, "little"))]
        if kind == READ:
            return [self._read(data)]
        if kind == ENABLE:
            self.enable()
        elif kind == STOP:
            self.shaft.disable()
            if data[0] == 1:
                self.clear()
        elif kind == ZERO and data[0] == 1:
            self.shaft.set_zero()
        elif kind == WRITE:
            self._write(int.from_bytes(data[:2], "little"), data[4:])
        elif kind == REPORT and data[:6] == KNOCK:
            self._report_at = now if data[6] else inf
            return ()
        elif kind == 22 and data == bytes(range(1, 9)):
            self.flash = dict(self.parameters)
        else:
            return ()
        return [self.feedback()]

    def _make_message(self, kind: int, data: bytes, marks: int = 0) -> CanMessage:
        return CanMessage(EXTENDED | kind << 24 | marks << 16 | self.id << 8 | self._host, data)

    def _read(self, data: bytes) -> CanMessage:
        index = int.from_bytes(data[:2], "little")
        if index not in FORMS:
            return self._make_message(READ, data[:2] + bytes(6), 1)
        place, speed, torque = self.shaft.read_state()
        now = {
            PLACE: place,
            SPEED: speed,
            CURRENT: torque,
            SUPPLY: self.volts,
            TURNS: round(place / 6.2831853),
        }
        value = now.get(index, self.parameters[index])
        form = FORMS[index][0]
        raw = struct.pack(form, value if form == "<f" else int(value))
        return self._make_message(READ, data[:2] + bytes(2) + raw.ljust(4, b"\0"))

    def _write(self, index: int, raw: bytes) -> None:
        form, writable = FORMS.get(index, ("<f", False))
        value = struct.unpack_from(form, raw)[0]
        if not writable or not isfinite(value) or (index == RUN_MODE and (self.shaft.on or value > 5)):
            return
        self.parameters[index] = value
        self._look()

    def _look(self) -> None:
        ticks = self.parameters[TIMEOUT]
        self.watch.timeout = ticks * TICK if ticks else inf
        most = min(max(self.parameters[TORQUE_LIMIT], 0.0), self.spec.torque)
        self.motors.limit(self.row, most)
