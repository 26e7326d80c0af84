"""Virtual ODrive axis on CANSimple: it reports periodically, and its watchdog is off as delivered.

Sources: ODrive docs/can-protocol.rst, csv and firmware f9b5419c (3.x). `do_command` feeds the watchdog for
any frame addressed to the axis, remote requests included. Not simulated: calibrations, trajectories and
filters (an input is followed at once), the velocity integrator, node ids of 24 bits, setting the node id.
"""

import math
import struct
from collections.abc import Sequence
from math import inf
from typing import NamedTuple

from twind_drivers.ports.frame import EXTENDED, REMOTE
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.can_motors import CanMotors
from twind_drivers.virtual.can.node import COMMON, HEAT, LOW, VirtualCanNode
from twind_drivers.virtual.can.node_shaft import TURN
from twind_drivers.virtual.can.node_spec import NodeSpec

# fmt: off
HEARTBEAT = 0x01
ESTOP = 0x02
MOTOR_ERROR = 0x03
ENCODER_ERROR = 0x04
SENSORLESS_ERROR = 0x05
STATE = 0x07
ESTIMATES = 0x09
ENCODER_COUNT = 0x0A
MODES = 0x0B
POSITION = 0x0C
VELOCITY = 0x0D
TORQUE = 0x0E
LIMITS = 0x0F
IQ = 0x14
REBOOT = 0x16
BUS = 0x17
CLEAR = 0x18
SET_COUNT = 0x19
POSITION_GAIN = 0x1A
VELOCITY_GAINS = 0x1B
CONTROLLER_ERROR = 0x1D
# fmt: on
# axis states
IDLE = 1
CLOSED_LOOP = 8
# control modes
BY_TORQUE = 1
BY_POSITION = 3
MOTOR_FAILED = 0x40  # axis error of a 3.x


class ODriveErrorCodes(NamedTuple):
    """Axis errors: low supply, high supply, heat, watchdog, emergency stop, a state that it cannot take."""

    low: int
    high: int
    heat: int
    watchdog: int
    stop: int
    state: int


OLD = ODriveErrorCodes(0x2, 0x4, 0x40000, 0x800, 0x4000, 0x1)  # 3.x
LATER = ODriveErrorCodes(0x200, 0x100, 0x2000, 1 << 24, 1 << 25, 0)  # S1, Pro (recalled, unverified)
CPR = 8192
LIMITED = 0.002  # s between two checks of an axis whose speed is limited
FACTORY = {
    "watchdog_timeout": 0.0,
    "heartbeat": 0.1,
    "estimates": 0.01,
    "velocity_limit": 2.0,
    "current_limit": 10.0,
    "torque_constant": 0.04,
    "position_gain": 20.0,
    "velocity_gain": 0.16,
}


class VirtualODrive(VirtualCanNode):
    """One axis; `settings` are its configuration, which only USB can write, but for limits and gains."""

    def __init__(self, spec: NodeSpec, row: int, motors: CanMotors, now: float) -> None:
        """Raises ValueError for a setting that it has not."""
        super().__init__(spec, row, motors, now)
        strange = sorted(set(spec.settings) - set(FACTORY) - set(COMMON))
        if strange:
            raise ValueError(f"node {spec.id}: no setting {strange[0]!r}; there are {', '.join(FACTORY)}")
        self.later = spec.model.startswith("ODrive-")  # S1, Pro: another heartbeat, other errors
        self.codes = LATER if self.later else OLD
        self.configured = FACTORY | dict(spec.settings)
        self.boot(now)
        phase = self.id * 0.61803399 % 1.0  # no two axes start at the same moment
        self._heart_at = now + phase * self.configured["heartbeat"]
        self._tell_at = now + phase * self.configured["estimates"] if self.configured["estimates"] else inf

    def start(self) -> None:
        """The configuration counts again; idle."""
        self.held = dict(self.configured)
        self.mode = BY_POSITION
        self.input = (0.0, 0.0, 0.0)
        self.watch.timeout = self.held["watchdog_timeout"] or inf
        self._limit()
        self._heart_at = self.watch.heard_at + 0.01
        self._tell_at = self.watch.heard_at + 0.01
        self._look_at = inf

    def accepts_id(self, key: int) -> bool:
        """Node id in the upper six bits."""
        return not key & EXTENDED and key >> 5 == self.id

    def encode_fault(self, what: str) -> int:
        """Axis error."""
        codes = self.codes
        return codes.heat if what == HEAT else codes.low if what == LOW else codes.high

    def watchdog(self) -> int:
        """Timeout of the watchdog, ms; this bus cannot read it."""
        return round(self.held["watchdog_timeout"] * 1e3)

    def on_watchdog_timeout(self, now: float) -> Sequence[CanMessage]:
        """An axis error, and idle."""
        super().on_watchdog_timeout(now)
        return self.inject_fault(self.codes.watchdog)

    def next_beat(self) -> float:
        """Time of the next heartbeat, estimate, or check of the speed limit, s."""
        return min(self._heart_at, self._tell_at, self._look_at)

    def beat(self, now: float) -> Sequence[CanMessage]:
        """See `next_beat`."""
        said: list[CanMessage | None] = []
        if self._look_at <= now:
            self._pull(now)
        if self._heart_at <= now:
            self._heart_at += self.held["heartbeat"] or inf
            said.append(self._heartbeat())
        if self._tell_at <= now:
            self._tell_at += self.held["estimates"] or inf
            said.append(self._answer(ESTIMATES))
        return [each for each in said if each is not None]

    def handle_frame(self, message: CanMessage, now: float) -> Sequence[CanMessage]:
        """Execute orders with data; a remote frame or an empty one is a request."""
        id, data = message
        if id & EXTENDED or (id & 0x7FF) >> 5 != self.id:
            return ()
        self.watch.heard_at = now
        command = id & 0x1F
        if id & REMOTE or not data:
            answer = self._answer(command)
            if answer is not None:
                return [answer]
        self._order(command, data, now)
        return ()

    # ------------------------------------------------------------------------------------- reports

    def _make_message(self, command: int, data: bytes) -> CanMessage:
        return CanMessage(self.id << 5 | command, data)

    def _heartbeat(self) -> CanMessage:
        state = CLOSED_LOOP if self.shaft.on else IDLE
        if self.later:  # byte 5: result of the last procedure, 6: is the trajectory done
            return self._make_message(HEARTBEAT, struct.pack("<IBBBB", self.fault, state, 0, 1, 0))
        failed = 1 if self.fault & MOTOR_FAILED else 0
        return self._make_message(HEARTBEAT, struct.pack("<IBBBB", self.fault, state, failed, 0, 0x80))

    def _answer(self, command: int) -> CanMessage | None:
        place, speed, torque = self.shaft.read_state()
        amps = torque / self.held["torque_constant"]
        turns = place / TURN
        if command == HEARTBEAT:
            return self._heartbeat()
        answers = {
            ESTIMATES: struct.pack("<ff", turns, speed / TURN),
            ENCODER_COUNT: struct.pack("<ii", math.floor(turns * CPR), math.floor(turns % 1.0 * CPR)),
            IQ: struct.pack("<ff", amps, amps),
            BUS: struct.pack("<ff", self.volts, amps * torque / self.volts if self.volts else 0.0),
        }
        own = {
            MOTOR_ERROR: struct.pack("<Q", 1 if self.fault & MOTOR_FAILED else 0),
            ENCODER_ERROR: bytes(4),
            SENSORLESS_ERROR: bytes(4),
            CONTROLLER_ERROR: bytes(4),
        }
        if self.later:  # active errors, and why it was disarmed; endpoints instead of the other errors
            own = {MOTOR_ERROR: struct.pack("<II", self.fault, self.fault)}
        answers |= own
        return self._make_message(command, answers[command]) if command in answers else None

    # ------------------------------------------------------------------------------------- what it does

    def _order(self, command: int, data: bytes, now: float) -> None:
        numbers = data.ljust(8, b"\0")
        if command == ESTOP:
            self.inject_fault(self.codes.stop)
        elif command == STATE:
            self._state(int.from_bytes(numbers[:4], "little"), now)
        elif command == MODES:
            self.mode = struct.unpack("<i", numbers[:4])[0]
            self._pull(now)
        elif command == REBOOT:
            self.down(now + self.spec.settings.get("boot", 0.3))
        elif command == CLEAR:
            self.clear()
        elif command == SET_COUNT:
            place = struct.unpack("<i", numbers[:4])[0] / CPR * TURN
            self.shaft.set_zero()
            self.shaft.zero = self.shaft.kept_zero = self.shaft.zero - place
        else:
            self._numbers(command, numbers, now)

    def _state(self, state: int, now: float) -> None:
        if state == CLOSED_LOOP and self.fault:
            self.fault |= self.codes.state
        elif state == CLOSED_LOOP:
            self.enable()
            if self.mode == BY_POSITION:  # 3.x: the input is set to where it is
                self.input = (self.shaft.read_state()[0] / TURN, 0.0, 0.0)
            self._pull(now)
        elif state == IDLE:
            self.shaft.disable()

    def _numbers(self, command: int, data: bytes, now: float) -> None:
        first, second = struct.unpack("<ff", data)
        if command == POSITION:
            ahead, torque = struct.unpack("<hh", data[4:])
            self._aim(first, ahead * 1e-3, torque * 1e-3, now)
        elif command == VELOCITY:
            self._aim(self.input[0], first, second, now)
        elif command == TORQUE:
            self._aim(self.input[0], self.input[1], first, now)
        elif command == LIMITS and first > 0.0 and second > 0.0:
            self.held |= {"velocity_limit": first, "current_limit": second}
            self._limit()
        elif command == POSITION_GAIN:
            self.held["position_gain"] = first
        elif command == VELOCITY_GAINS:
            self.held["velocity_gain"] = first

    def _limit(self) -> None:
        most = self.held["current_limit"] * self.held["torque_constant"]
        self.motors.limit(self.row, min(most, self.spec.torque))

    def _aim(self, turns: float, speed: float, torque: float, now: float) -> None:
        if not all(map(math.isfinite, (turns, speed, torque))):
            return
        self.input = (turns, speed, torque)
        self._pull(now)

    def _pull(self, now: float) -> None:
        """Drive the cascade as an impedance: position gain times velocity gain is a stiffness.

        While the position loop requests more than the speed limit, the axis is a damper around that speed,
        checked again soon.
        """
        place, speed, torque = self.input
        outer = self.held["position_gain"]
        inner = self.held["velocity_gain"] / TURN
        self._look_at = inf
        if self.mode == BY_TORQUE:
            self.shaft.follow(0.0, 0.0, 0.0, 0.0, torque)
            return
        most = self.held["velocity_limit"]
        wish = speed
        if self.mode == BY_POSITION:
            wish += outer * (place - self.shaft.read_state()[0] / TURN)
        if self.mode == BY_POSITION and abs(wish) <= most:
            self.shaft.follow(place * TURN, speed * TURN, outer * inner, inner, torque)
            return
        self.shaft.follow(0.0, min(max(wish, -most), most) * TURN, 0.0, inner, torque)
        self.shaft.goal = place * TURN
        if self.mode == BY_POSITION and self.shaft.on:
            self._look_at = now + LIMITED
