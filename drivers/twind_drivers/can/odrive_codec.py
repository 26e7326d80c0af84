"""ODrive axes over CANSimple. Pure.

Id = node << 5 | command. Source: ODrive's can-protocol page, its csv and firmware f9b5419c (3.x); error
numbers and the heartbeat of the later boards (S1, Pro) from public drivers that name ODrive's own reference.
The frames do not show which of the two an axis uses: its model in the robot file determines it.

A command is a position with velocity and torque beside it; **stiffness and damping are not on the wire**:
`gains` sets them before torque; kp and kd of `command` are checked, and not sent. The current that an
axis reports is no torque, so effort stays NaN. Its watchdog is off as delivered, can be neither set nor read
over CANSimple, and every frame to the axis feeds it, reads included: a reader keeps a dead writer's axis
alive.
"""

import struct
from collections.abc import Mapping, Sequence
from math import pi

import numpy as np

from twind_drivers.bus import Bools, Floats, Ints
from twind_drivers.can.actuator_family import (
    ELECTRICAL,
    ENCODER,
    HEAT,
    OVERLOAD,
    SILENCE,
    UNCALIBRATED,
    UNKNOWN,
    VOLTAGE,
    ActuatorFamily,
    ActuatorFeedback,
    FamilyRegister,
    FieldRanges,
    RegisterReply,
    RegisterType,
    ValuelessCommand,
)
from twind_drivers.can.id_lookup import NONE, by_name, checked_ids, row_of, to_one, untold
from twind_drivers.can.mit_frame import bounds, checked
from twind_drivers.ports.frame import BYTES, REMOTE, STANDARD_MASK, Frames, Octets, frames

TURN = 2.0 * pi
NODES = 0x3F
HEARTBEAT = 0x01
STATE = 0x07
ESTIMATES = 0x09
MODES = 0x0B
INPUT = 0x0C
REBOOT = 0x16
SUPPLY = 0x17
CLEAR = 0x18
COUNT = 0x19
POSITION_GAIN = 0x1A
VELOCITY_GAINS = 0x1B
IDLE = 1
CLOSED_LOOP = 8
POSITION_CONTROL = 3
DIRECT = 1
FED = 1e-3  # rev/s and N·m of one count of a feed-forward
MOST_FED = 32767 * FED
FARTHEST = 1e6  # rev, rev/s, V: a float beyond it is no reading
SECOND = 0x100  # in an address: the second four bytes of that command's answer
# Reports and their requests: all other commands move or change an axis.
TELLING = (HEARTBEAT, 0x03, 0x05, ESTIMATES, 0x0A, 0x14, 0x15, SUPPLY, 0x1C, 0x1D)
ENCODER_ERROR = 0x04  # 3.x; on later boards that command writes endpoints

ORDERS = {
    ValuelessCommand.ENABLE: (STATE, CLOSED_LOOP.to_bytes(4, "little")),
    ValuelessCommand.DISABLE: (STATE, IDLE.to_bytes(4, "little")),
    ValuelessCommand.CLEAR: (CLEAR, bytes(BYTES)),
    ValuelessCommand.ZERO: (COUNT, bytes(4)),
    ValuelessCommand.REBOOT: (REBOOT, bytes(BYTES)),
}
PARAMETERS = by_name(
    FamilyRegister("motor_error", 0x03, RegisterType.U32),
    FamilyRegister("encoder_error", ENCODER_ERROR, RegisterType.U32),
    FamilyRegister("controller_error", 0x1D, RegisterType.U32),
    FamilyRegister("iq_setpoint", 0x14, RegisterType.F32),
    FamilyRegister("iq_measured", 0x14 + SECOND, RegisterType.F32),
    FamilyRegister("bus_voltage", SUPPLY, RegisterType.F32),
    FamilyRegister("bus_current", SUPPLY + SECOND, RegisterType.F32),
)

# Bits of the first word of a heartbeat. What is not named here counts as unknown.
_AXIS = {  # 3.x
    1: VOLTAGE,  # under
    2: VOLTAGE,  # over
    3: ELECTRICAL,  # no current reading
    4: ELECTRICAL,  # brake resistor disarmed
    5: ELECTRICAL,  # motor disarmed
    6: ELECTRICAL,  # motor failed
    8: ENCODER,
    11: SILENCE,  # its watchdog
    18: HEAT,
    19: UNCALIBRATED,  # unknown position
}
_ACTIVE = {  # later boards
    3: ENCODER,  # no estimate
    5: ELECTRICAL,  # gate driver
    8: VOLTAGE,  # over
    9: VOLTAGE,  # under
    10: ELECTRICAL,  # supply current
    11: ELECTRICAL,  # fed back
    12: OVERLOAD,  # current limit
    13: HEAT,  # motor
    14: HEAT,  # inverter
    24: SILENCE,  # its watchdog
    26: ENCODER,  # spin-out
    27: ELECTRICAL,  # brake resistor disarmed
    28: HEAT,  # no thermistor
    30: UNCALIBRATED,
}


_TELLING = np.isin(np.arange(32), TELLING)
_ANSWERS = np.isin(np.arange(32), (0x03, ENCODER_ERROR, 0x14, SUPPLY, 0x1D))
_REPORTS = _ANSWERS | (_TELLING & ~np.isin(np.arange(32), (HEARTBEAT, ESTIMATES)))  # no feedback


class ODriveCodec(ActuatorFamily):
    """Codec of k ODrive axes of one bus (`ActuatorFamily`)."""

    name = "odrive"
    parameters: Mapping[str, FamilyRegister] = PARAMETERS
    identity: Sequence[str] = ("bus_voltage",)
    watchdog: FamilyRegister | None = None
    answers = 1

    def __init__(self, port: str, ids: Sequence[int], ranges: FieldRanges, later: Sequence[bool]) -> None:
        """Make the codec; `later` (k,): a board after 3.x.

        Raises ValueError for ids outside 0..3F or twice the same.
        """
        self.port = port
        self.ids = checked_ids(port, self.name, ids, 0, NODES)
        self.replies: Bools = np.zeros(len(self.ids), np.bool_)
        self.claims = frozenset(node << 5 | command for node in self.ids for command in range(32))
        self.ranges = ranges
        self._later = np.array(later, np.bool_)
        self._lower, self._upper = bounds(ranges)
        self._lower[1] = np.maximum(self._lower[1], -MOST_FED * TURN)  # what a feed-forward holds
        self._upper[1] = np.minimum(self._upper[1], MOST_FED * TURN)
        self._lower[4] = np.maximum(self._lower[4], -MOST_FED)
        self._upper[4] = np.minimum(self._upper[4], MOST_FED)
        self._rows = np.full((STANDARD_MASK >> 5) + 2, NONE, np.int64)
        self._rows[list(self.ids)] = range(len(self.ids))
        self._nodes = np.array(self.ids, np.uint32) << np.uint32(5)
        self._question = frames(self._nodes | np.uint32(ESTIMATES | REMOTE))

    def make_position_request(self) -> Frames:
        """Return frames that request the encoder estimates of each (09), by a remote frame."""
        return self._question

    def command(self, position: Floats, velocity: Floats, kp: Floats, kd: Floats, torque: Floats) -> Frames:
        """One position each (0C), velocity and torque beside it to the nearest thousandth of rev/s and N·m.

        `kp` and `kd` are not sent. Raises WireRangeError naming id, field, value and range.
        """
        values = np.array((position, velocity, kp, kd, torque), np.float64)
        if values.shape != self._lower.shape:
            raise ValueError(f"{self.port}: {values.shape} values for {self._lower.shape} fields")
        checked(self.port, self.ids, values, self._lower, self._upper)
        made = self._blank(INPUT)
        made["data"][:, :4] = (values[0] / TURN).astype("<f4").view(np.uint8).reshape(-1, 4)
        fed = np.rint(np.stack((values[1] / TURN, values[4]), axis=1) / FED)
        made["data"][:, 4:] = fed.astype("<i2").view(np.uint8).reshape(-1, 4)
        return made

    def _blank(self, command: int, size: int = BYTES) -> Frames:
        made = frames(self._nodes | np.uint32(command))
        made["size"] = size
        return made

    def gains(self, kp: Floats, kd: Floats) -> Frames:
        """Position control by direct input (0B) and gains (1A, 1B): a spring of `kp` N·m/rad, damped by `kd`
        N·m·s/rad (k,), without integrator.

        The position gain works through the velocity gain, so kd must be above 0 (else WireRangeError).
        """
        values = np.zeros(self._lower.shape)
        values[2] = kp
        values[3] = kd
        lower = self._lower.copy()
        lower[3] = np.finfo(np.float32).tiny
        checked(self.port, self.ids, values, lower, self._upper)
        modes = self._blank(MODES)
        outer = self._blank(POSITION_GAIN, 4)
        inner = self._blank(VELOCITY_GAINS)
        modes["data"] = np.frombuffer(struct.pack("<ii", POSITION_CONTROL, DIRECT), np.uint8)
        outer["data"][:, :4] = (values[2] / values[3]).astype("<f4").view(np.uint8).reshape(-1, 4)
        inner["data"][:, :4] = (values[3] * TURN).astype("<f4").view(np.uint8).reshape(-1, 4)
        return np.concatenate((modes, outer, inner))

    def encode_valueless_command(self, row: int, what: ValuelessCommand) -> Frames:
        """Closed loop or idle (07), clear errors (18), encoder count 0 (19), reboot (16)."""
        command, data = ORDERS[what]
        return to_one(self.ids[row] << 5 | command, data)

    def read(self, row: int, parameter: FamilyRegister) -> Frames:
        """Encode the read of a parameter by a remote frame. Raises ValueError on boards that lack it."""
        if self._later[row] and parameter.address in (0x03, ENCODER_ERROR, 0x1D):
            raise ValueError(f"{self.port}: node {self.ids[row]}: only ODrive 3.x reports {parameter.name}")
        return frames([self.ids[row] << 5 | parameter.address & 0x1F | REMOTE])

    def write(self, row: int, parameter: FamilyRegister, data: bytes) -> Frames:
        """Raise ValueError: no value that CANSimple reads can be written."""
        raise ValueError(
            f"{self.port}: node {self.ids[row]}: {parameter.name} cannot be written over CANSimple"
        )

    def _match_rows(self, received: Frames) -> tuple[Ints, Ints, Octets]:
        """Row of each data frame of 8 bytes, else -1; commands; payloads (j, 8)."""
        came = received["id"]
        rows = row_of(self._rows, came >> np.uint32(5))
        rows[received["size"] != BYTES] = NONE
        return rows, (came & np.uint32(0x1F)).astype(np.int64), received["data"]

    def feedback(self, frames: Frames) -> tuple[ActuatorFeedback, Bools]:
        """Decode estimates (09: position), heartbeats (01: torque and faults) and supply (17: voltage)."""
        rows, command, data = self._match_rows(frames)
        reported = (rows >= 0) & ((command == ESTIMATES) | (command == HEARTBEAT) | (command == SUPPLY))
        if not reported.all():
            rows = rows[reported]
            command = command[reported]
            data = data[reported]
        found = untold(rows)
        place, beat, supply = (command == which for which in (ESTIMATES, HEARTBEAT, SUPPLY))
        if place.any():
            turns = _readings(data[place])
            found.position[place] = turns[:, 0] * TURN
            found.velocity[place] = turns[:, 1] * TURN
        if supply.any():
            found.voltage[supply] = _readings(data[supply])[:, 0]
        for at in np.flatnonzero(beat):
            found.enabled[at], found.fault[at] = _beat(data[at].tobytes(), bool(self._later[rows[at]]))
        return found, reported

    def decode_register_replies(self, frames: Frames) -> tuple[list[RegisterReply], Bools]:
        """Decode frames with errors, currents and supply; both halves of those with two values.

        An axis sends these and other reports by itself, where it is set to: none of them is a stranger.
        """
        rows, command, data = self._match_rows(frames)
        found = (rows >= 0) & _ANSWERS.take(command)
        answers = []
        for at in np.flatnonzero(found):
            content = data[at].tobytes()
            row = int(rows[at])
            address = int(command[at])
            answers.append(RegisterReply(row, address, content[:4]))
            if address in (0x14, SUPPLY):
                answers.append(RegisterReply(row, address + SECOND, content[4:]))
        return answers, (rows >= 0) & _REPORTS.take(command)

    def operating_mode(self, values: Mapping[str, float]) -> int:
        """Return 1: the mode is unreadable, and `gains` sets it."""
        return 1

    def commanded_rows(self, frames: Frames) -> Ints:
        """Return the row of each frame on a node of this bus, remote ones too, except reports and requests.

        Command 04 counts only with data and on later boards, where it writes.
        """
        bare = frames["id"] & np.uint32(~REMOTE & 0xFFFF_FFFF)
        rows = row_of(self._rows, bare >> np.uint32(5))
        command = bare & np.uint32(0x1F)
        writes = (frames["size"] > 0) & (self._later.take(rows, mode="clip") if len(self.ids) else False)
        idle = _TELLING.take(command) | ((command == ENCODER_ERROR) & ~writes)
        return np.where(idle, NONE, rows)

    def decode_commanded_position(self, frames: Frames) -> Floats:
        """Return the position of each 0C to a node of this bus, rad. NaN: another frame."""
        rows, command, data = self._match_rows(frames)
        motion = (rows >= 0) & (command == INPUT)
        position = np.full(len(frames), np.nan)
        position[motion] = _readings(data[motion])[:, 0] * TURN
        return position


def _readings(data: Octets) -> Floats:
    """Two floats each (j, 2), little-endian. NaN for what is no reading."""
    with np.errstate(invalid="ignore"):  # a signalling NaN may come over the wire
        values = np.ascontiguousarray(data).view("<f4").astype(np.float64)
    return np.where(np.abs(values) <= FARTHEST, values, np.nan)


def _beat(data: bytes, later: bool) -> tuple[int, int]:
    """Return torque (1 on, 0 off, -1 unknown) and fault bits of a heartbeat.

    Homing and calibration move the axis: torque is on in every named state but idle. 3.x reports motor,
    encoder and controller errors in the lowest bits of D5 to D7; later boards use these bits differently.
    """
    errors, state = struct.unpack_from("<IB", data)
    named = _ACTIVE if later else _AXIS
    fault = 0
    for bit in range(32):
        if errors >> bit & 1:
            fault |= named.get(bit, UNKNOWN)
    if not later:
        for place, meaning in ((5, ELECTRICAL), (6, ENCODER), (7, UNKNOWN)):
            fault |= meaning if data[place] & 1 else 0
    if state == 0:
        return -1, fault
    return int(state != IDLE), fault
