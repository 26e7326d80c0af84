"""RobStride's own protocol: the type of a frame stands in its 29-bit id."""

import struct

from tests.proof.busmon.can.acts import Act, MotorReply, field, forbidden, sized
from tests.proof.busmon.can.motors import Motor, word
from tests.proof.busmon.can.text import Frame, Malformed

GET_ID = 0
COMMAND = 1
FEEDBACK = 2
ON = 3
OFF = 4
ZERO = 6
SET_ID = 7
READ = 0x11
WRITE = 0x12
KEEPING = {0x16: "an order to store", 0x17: "another bit rate", 0x19: "another protocol"}
RUN_MODE = 0x7005
PUSH_LIMIT = 0x700B
CURRENT_LIMIT = 0x7018
PLACE = 0x7019
WATCHDOG = 0x7028
TICK = 50e-6  # s
RUNNING = 2


class RobStride:
    """Its motors on one bus."""

    def __init__(self, motors: list[Motor]) -> None:
        self._by_id = {motor.id: motor for motor in motors}

    def command(self, frame: Frame) -> Act | None:
        """None: not to one of these. Raises Malformed."""
        if not frame.extended or not self._by_id:
            return None
        kind = frame.id >> 24
        extra = frame.id >> 8 & 0xFFFF
        target = frame.id & 0xFF
        motor = self._by_id.get(target)
        if motor is None:
            return None
        if frame.remote:
            raise Malformed(f"a remote frame to {target}")
        data = sized(frame.data, 8, f"a frame of type {kind} to {target}")
        if kind in KEEPING:
            raise forbidden(KEEPING[kind], target)
        if kind == ZERO:
            raise forbidden("a new zero", target)
        if kind == SET_ID:
            raise forbidden("another id", target)
        if kind == COMMAND:
            return self._command(motor, extra, data)
        if kind == WRITE:
            return self._write(motor, data)
        simple = {GET_ID: "ask", ON: "on", OFF: "clear" if data[0] == 1 else "off", READ: "read"}
        if kind in simple:
            return Act(simple[kind], target)
        return Act("wrong", target, why=f"a frame of type {kind}")

    def _command(self, motor: Motor, extra: int, data: bytes) -> Act:
        place, rate, kp, kd = (data[at] << 8 | data[at + 1] for at in (0, 2, 4, 6))
        push = field(extra, 16, motor.torque)
        if not kp and not kd and abs(push) <= motor.torque / 32000.0:
            return Act("limp", motor.id)
        return Act("goal" if kp else "soft", motor.id, place, field(rate, 16, motor.velocity), push)

    def _write(self, motor: Motor, data: bytes) -> Act:
        index = data[0] | data[1] << 8
        value = int.from_bytes(data[4:], "little")
        if index == WATCHDOG:
            return Act("write", motor.id, seconds=value * TICK)
        if index in (PUSH_LIMIT, CURRENT_LIMIT) or (index == RUN_MODE and value & 0xFF == 0):
            return Act("set", motor.id)
        return Act("wrong", motor.id, why=f"parameter {index:04x} := {data[4:].hex(' ')}")

    def reply(self, frame: Frame) -> MotorReply | None:
        """None: nothing that is known."""
        if not frame.extended or frame.remote or len(frame.data) != 8:
            return None
        kind = frame.id >> 24 & 0x1F
        data = frame.data
        motor = self._by_id.get(frame.id >> 8 & 0xFF)
        if motor is None:
            return None
        if kind == FEEDBACK:
            state = frame.id >> 22 & 3
            faults = frame.id >> 16 & 63
            return MotorReply(motor.id, data[0] << 8 | data[1], state == RUNNING, faults != 0)
        if kind == READ and not frame.id >> 16 & 0xFF:  # else: it has no such parameter
            return self._answer(motor, data)
        return None

    def _answer(self, motor: Motor, data: bytes) -> MotorReply | None:
        index = data[0] | data[1] << 8
        if index == WATCHDOG:
            return MotorReply(motor.id, seconds=int.from_bytes(data[4:], "little") * TICK)
        angle = struct.unpack("<f", data[4:])[0]
        if index == PLACE and abs(angle) <= motor.position:
            return MotorReply(motor.id, round(word("robstride", motor.position, angle)))
        return None
