"""ODrive's CANSimple: a node and a command in 11 bits; floats in turns."""

import struct

from tests.proof.busmon.can.acts import Act, MotorReply, forbidden, sized
from tests.proof.busmon.can.motors import TURN, Motor
from tests.proof.busmon.can.text import Frame, Malformed

HEARTBEAT = 0x01
ESTOP = 0x02
SET_NODE = 0x06
STATE = 0x07
ESTIMATES = 0x09
MODES = 0x0B
GOAL = 0x0C
LIMITS = 0x0F
REBOOT = 0x16
CLEAR = 0x18
PLACE = 0x19
GAIN = 0x1A
GAINS = 0x1B
IDLE = 1
CLOSED_LOOP = 8
POSITION_CONTROL = (3, 1)  # control mode, input mode: straight
READS = frozenset((0x03, 0x04, 0x05, 0x09, 0x0A, 0x14, 0x17, 0x1D))
THOUSANDTH = 1e-3
TAU = 6.283185307179586


class ODrive:
    """Its nodes on one bus."""

    def __init__(self, motors: list[Motor]) -> None:
        self._by_id = {motor.id: motor for motor in motors}

    def command(self, frame: Frame) -> Act | None:
        """None: not to one of these. Raises Malformed."""
        motor = None if frame.extended else self._by_id.get(frame.id >> 5)
        if motor is None:
            return None
        node = motor.id
        what = frame.id & 31
        data = frame.data
        if what in READS and not data:
            return Act("read", node)
        if frame.remote:
            raise Malformed(f"a remote frame for {what:02x} to node {node}")
        if what == SET_NODE:
            raise forbidden("another id", node)
        if what == PLACE:
            raise forbidden("a new place", node)
        if what == GOAL:
            return self._goal(motor, sized(data, 8, f"a goal to node {node}"))
        if what == STATE:
            state = int.from_bytes(sized(data, 4 if len(data) == 4 else 8, "a state")[:4], "little")
            kind = {IDLE: "off", CLOSED_LOOP: "on"}.get(state)
            return Act(kind, node) if kind else Act("wrong", node, why=f"axis state {state}")
        if what == MODES:
            modes = struct.unpack("<ii", sized(data, 8, "controller modes"))
            fine = modes == POSITION_CONTROL
            return Act("stiffen", node) if fine else Act("wrong", node, why=f"controller modes {modes}")
        simple = {ESTOP: "off", CLEAR: "clear", REBOOT: "clear", LIMITS: "set"}
        simple |= {GAIN: "stiffen", GAINS: "stiffen"}  # also under torque: commands carry no stiffness
        return Act(simple[what], node) if what in simple else Act("wrong", node, why=f"command {what:02x}")

    def _goal(self, motor: Motor, data: bytes) -> Act:
        turns, rate, push = struct.unpack("<fhh", data)
        if not abs(turns) < 1e4:
            raise Malformed(f"a goal of {turns} turns to node {motor.id}")
        return Act("goal", motor.id, round(turns * TURN), rate * THOUSANDTH * TAU, push * THOUSANDTH)

    def reply(self, frame: Frame) -> MotorReply | None:
        """None: nothing that is known."""
        motor = None if frame.extended or frame.remote else self._by_id.get(frame.id >> 5)
        if motor is None or len(frame.data) != 8:
            return None
        if frame.id & 31 == ESTIMATES:
            turns, _ = struct.unpack("<ff", frame.data)
            return MotorReply(motor.id, round(turns * TURN)) if abs(turns) < 1e4 else None
        if frame.id & 31 == HEARTBEAT:
            error = int.from_bytes(frame.data[:4], "little")
            state = frame.data[4]
            return MotorReply(motor.id, None, state == CLOSED_LOOP, error != 0)
        return None
