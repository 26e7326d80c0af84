"""RobStride actuators by the vendor's own protocol of 29-bit ids. Pure.

Id = type << 24 | data16 << 8 | target. Source: the vendor's sample program (July 2025) and lerobot. The
communication timeout, 7028 (50 us ticks, 0 off), is in public drivers alone (takarakasai/robstride-driver,
`param.rs`): **unverified on hardware**. Position and velocity are read as parameters, which are answered
whether torque is on or not; those replies carry no effort. A write is acknowledged by feedback alone:
read back. An index that the firmware does not have is answered with an error flag (bits 16 to 23 of the id)
and a value of zero (lerobot, measured there): such an answer is dropped.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from twind_drivers.bus import Bools, Floats, Ints
from twind_drivers.can.actuator_family import (
    ELECTRICAL,
    ENCODER,
    HEAT,
    OVERLOAD,
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
from twind_drivers.can.id_lookup import NONE, by_name, checked_ids, four, to_one, untold
from twind_drivers.can.mit_frame import WIDE, FieldScale
from twind_drivers.ports.frame import BYTES, EXTENDED, EXTENDED_MASK, NOTHING, Frames, Octets, frames

GET_ID = 0x00
MOTION = 0x01
TOLD = 0x02
ENABLE = 0x03
STOP = 0x04
ZERO = 0x06
GET = 0x11
SET = 0x12
FAULTS = 0x15
HARMLESS = (GET_ID, GET)  # of what a host may send: neither moves nor changes anything
BROADCAST = 0xFE  # target of the answer to GET_ID
ORDERS = {  # type and D0
    ValuelessCommand.ENABLE: (ENABLE, 0),
    ValuelessCommand.DISABLE: (STOP, 0),
    ValuelessCommand.CLEAR: (STOP, 1),
    ValuelessCommand.ZERO: (ZERO, 1),
}
FARTHEST = 1e6  # rad, rad/s: a float beyond it is no reading
ELSEWISE = 100  # operating modes other than motion control begin here: this and run_mode

POSITION = FamilyRegister("mechanical_position", 0x7019, RegisterType.F32)
VELOCITY = FamilyRegister("mechanical_velocity", 0x701B, RegisterType.F32)
TIMEOUT = FamilyRegister("timeout", 0x7028, RegisterType.U32, writable=True, kept=True, unit=50e-6)
PARAMETERS = by_name(
    # From the reply to GET_ID: the 64-bit number of its processor, the only unique value of an individual.
    FamilyRegister("mcu_low", 0, RegisterType.U32, kept=True),
    FamilyRegister("mcu_high", 4, RegisterType.U32, kept=True),
    FamilyRegister("run_mode", 0x7005, RegisterType.U8, writable=True),
    FamilyRegister("iq_reference", 0x7006, RegisterType.F32),
    FamilyRegister("velocity_reference", 0x700A, RegisterType.F32),
    FamilyRegister("torque_limit", 0x700B, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("current_kp", 0x7010, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("current_ki", 0x7011, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("current_filter", 0x7014, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("position_reference", 0x7016, RegisterType.F32),
    FamilyRegister("speed_limit", 0x7017, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("current_limit", 0x7018, RegisterType.F32, writable=True, kept=True),
    POSITION,
    FamilyRegister("filtered_iq", 0x701A, RegisterType.F32),
    VELOCITY,
    FamilyRegister("bus_voltage", 0x701C, RegisterType.F32),
    FamilyRegister("turn_count", 0x701D, RegisterType.I16),
    FamilyRegister("velocity_acceleration", 0x7022, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("profile_speed", 0x7024, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("profile_acceleration", 0x7025, RegisterType.F32, writable=True, kept=True),
    TIMEOUT,
)
IDENTITY = ("run_mode", "timeout", "torque_limit", "bus_voltage", "mcu_low", "mcu_high")

_FLAG = 0xFF << 16  # of an answer to a read: not zero, and it is none
_FLAGS_AND_TARGET = 0xFFFF_FFFF & ~EXTENDED_MASK | 0xFF
_HARMLESS = np.isin(np.arange(32), HARMLESS)
# Bits 16 to 23 of the id of feedback: six faults, and the mode, whose fourth value has no name.
_BITS = (VOLTAGE, ELECTRICAL, HEAT, ENCODER, OVERLOAD, UNCALIBRATED)
_MODES = ((0, 0), (1, 0), (1, 0), (-1, UNKNOWN))  # reset, calibration, run: torque, fault
_ENABLED = np.array([_MODES[state >> 6][0] for state in range(256)], np.int64)
_FAULT = np.array(
    [
        sum(fault for bit, fault in enumerate(_BITS) if state >> bit & 1) | _MODES[state >> 6][1]
        for state in range(256)
    ],
    np.int64,
)
# Bits of a fault frame (type 21), D0 to D3: those that the sample program names.
_REPORTED = {0: HEAT, 1: ELECTRICAL, 2: VOLTAGE, 3: ENCODER, 7: UNCALIBRATED, 14: OVERLOAD}


class RobStrideCodec(ActuatorFamily):
    """Codec of k RobStride actuators of one bus (`ActuatorFamily`)."""

    name = "robstride"
    parameters: Mapping[str, FamilyRegister] = PARAMETERS
    identity: Sequence[str] = IDENTITY
    watchdog: FamilyRegister | None = TIMEOUT
    answers = 2

    def __init__(self, port: str, ids: Sequence[int], ranges: FieldRanges, host: int = 0xFD) -> None:
        """Make the codec; `host`: the host id in frames.

        Raises ValueError for ids outside 1..FD, twice, or the host's.
        """
        self.port = port
        self.host = host
        self.ids = checked_ids(port, self.name, ids, 1, 0xFD)
        if host in self.ids or not 0 <= host <= 0xFF or host == BROADCAST:
            raise ValueError(
                f"{port}: host id {host:#x} is a motor's, {BROADCAST:#x} or no byte: give another"
            )
        self.replies: Bools = np.ones(len(self.ids), np.bool_)
        self.claims: frozenset[int] = frozenset()  # its ids have 29 bits
        self.ranges = ranges
        self._rows = np.full(256, NONE, np.int64)
        self._rows[list(self.ids)] = range(len(self.ids))
        self._scale = FieldScale(port, self.ids, ranges, WIDE, WIDE[:3])
        self._motion = np.array([EXTENDED | MOTION << 24 | id for id in self.ids], np.uint32)
        self._blank = frames(self._motion)
        self._blank["size"] = BYTES
        requests = [self.read(row, what) for what in (POSITION, VELOCITY) for row in range(len(self.ids))]
        self._question = np.concatenate(requests) if requests else NOTHING

    def _to(self, row: int, kind: int, data: bytes) -> Frames:
        return to_one(EXTENDED | kind << 24 | self.host << 8 | self.ids[row], data)

    def make_position_request(self) -> Frames:
        """Reads the position of each, then the velocity of each."""
        return self._question

    def command(self, position: Floats, velocity: Floats, kp: Floats, kd: Floats, torque: Floats) -> Frames:
        """One motion frame each, torque in the id. Raises WireRangeError with id, field, value, range."""
        fields = self._scale.fields(position, velocity, kp, kd, torque)
        made = self._blank.copy()
        made["id"] = self._motion | fields[4].astype(np.uint32) << np.uint32(8)
        made["data"] = np.ascontiguousarray(fields[:4].T).astype(">u2").view(np.uint8)
        return made

    def encode_valueless_command(self, row: int, what: ValuelessCommand) -> Frames:
        """Enable (3), stop (4; D0 = 1 clears faults) or zero (6). Raises ValueError for REBOOT."""
        if what not in ORDERS:
            raise ValueError(f"{self.port}: id {self.ids[row]}: a RobStride has no {what.name.lower()}")
        kind, first = ORDERS[what]
        return self._to(row, kind, bytes([first, 0, 0, 0, 0, 0, 0, 0]))

    def read(self, row: int, parameter: FamilyRegister) -> Frames:
        """Encode the read of one parameter (17); for the number of its processor by type 0."""
        if parameter.address < 0x100:
            return self._to(row, GET_ID, bytes(8))
        return self._to(row, GET, parameter.address.to_bytes(2, "little") + bytes(6))

    def write(self, row: int, parameter: FamilyRegister, data: bytes) -> Frames:
        """Writes one parameter in RAM (18). Raises ValueError for one that is only read."""
        value = four(self.port, parameter, data)
        return self._to(row, SET, parameter.address.to_bytes(2, "little") + bytes(2) + value)

    def _match_rows(self, received: Frames) -> tuple[Ints, Ints, Ints, Octets]:
        """Return row, id, type and payload (j, 8) of each frame; the row of other senders is -1."""
        came = received["id"].astype(np.int64)
        rows = self._rows.take(came >> 8 & 0xFF)
        own = (came & _FLAGS_AND_TARGET == EXTENDED | self.host) & (received["size"] == BYTES)
        return np.where(own, rows, NONE), came, came >> 24 & 0x1F, received["data"]

    def feedback(self, frames: Frames) -> tuple[ActuatorFeedback, Bools]:
        """Decode feedback (2), fault frames (21) and answers to reads of position and velocity (17)."""
        rows, came, kind, data = self._match_rows(frames)
        whole = (rows >= 0) & (kind == TOLD)
        if whole.all():
            return self._decode_feedback(rows, came, data), whole
        index = data[:, 0] + data[:, 1].astype(np.int64) * 256
        sound = (rows >= 0) & (kind == GET) & (came & _FLAG == 0)
        place = sound & (index == POSITION.address)
        speed = sound & (index == VELOCITY.address)
        faults = (rows >= 0) & (kind == FAULTS)
        reported = whole | place | speed | faults
        found = untold(rows[reported])
        found.position[place[reported]] = _readings(data[place])
        found.velocity[speed[reported]] = _readings(data[speed])
        if whole.any():
            into = whole[reported]
            at = self._decode_feedback(rows[whole], came[whole], data[whole])
            for name in ("position", "velocity", "effort", "enabled", "fault", "temperature"):
                getattr(found, name)[into] = getattr(at, name)
        if faults.any():
            reports = [int.from_bytes(one[:4].tobytes(), "little") for one in data[faults]]
            found.fault[faults[reported]] = [_reported(report) for report in reports]
        return found, reported

    def _decode_feedback(self, rows: Ints, came: Ints, data: Octets) -> ActuatorFeedback:
        """Decode feedback frames (2)."""
        fields = np.ascontiguousarray(data).view(">u2").T.astype(np.float64)
        position, velocity, effort = self._scale.values(fields[:3], rows)
        heat = np.where(fields[3] < 32768.0, fields[3], fields[3] - 65536.0) / 10.0
        state = came >> 16 & 0xFF
        unknown = np.full(len(rows), np.nan)
        enabled = _ENABLED.take(state)
        fault = _FAULT.take(state)
        return ActuatorFeedback(rows, position, velocity, effort, enabled, fault, heat, unknown)

    def decode_register_replies(self, frames: Frames) -> tuple[list[RegisterReply], Bools]:
        """Decode values read (17), and processors' numbers (0). Never a write.

        An error flag is the reply for a parameter that this firmware lacks: without a value, and no stranger.
        """
        rows, came, kind, data = self._match_rows(frames)
        told = (rows >= 0) & (kind == GET)
        found = told & (came & _FLAG == 0)
        born = kind == GET_ID
        if born.any():
            born &= (came & (_FLAGS_AND_TARGET | _FLAG) == EXTENDED | BROADCAST) & (frames["size"] == BYTES)
            born &= self._rows.take(came >> 8 & 0xFF) >= 0
        answers = []
        for at in np.flatnonzero(found | born):
            content = data[at].tobytes()
            if born[at]:
                row = int(self._rows[came[at] >> 8 & 0xFF])
                answers += [RegisterReply(row, 0, content[:4]), RegisterReply(row, 4, content[4:])]
            else:
                index = int.from_bytes(content[:2], "little")
                answers.append(RegisterReply(int(rows[at]), index, content[4:]))
        return answers, told | born

    def operating_mode(self, values: Mapping[str, float]) -> int:
        """1 motion control (run_mode 0); else 100 + run_mode; 0: it was not read."""
        if "run_mode" not in values:
            return 0
        mode = int(values["run_mode"])
        return 1 if mode == 0 else ELSEWISE + mode

    def commanded_rows(self, frames: Frames) -> Ints:
        """Return the row of each 29-bit frame to an id of this bus, except requests of ids and parameters."""
        came = frames["id"].astype(np.int64)
        rows = self._rows.take(came & 0xFF)
        idle = _HARMLESS.take(came >> 24 & 0x1F)  # a frame with an id of 11 bits has type 0
        return np.where(idle, NONE, rows)

    def decode_commanded_position(self, frames: Frames) -> Floats:
        """Return the position of each motion frame (1) to an id of this bus, rad. NaN: another frame."""
        rows = self.commanded_rows(frames)
        motion = (rows >= 0) & (frames["id"] >> 24 & 0x1F == MOTION) & (frames["size"] == BYTES)
        position = np.full(len(frames), np.nan)
        position[motion] = self._scale.position(frames["data"][motion], rows[motion])
        return position


def _readings(data: Octets) -> Floats:
    """Floats (j,) in D4 to D7, little-endian. NaN for what is no reading."""
    with np.errstate(invalid="ignore"):  # a signalling NaN may come over the wire
        value = np.ascontiguousarray(data[:, 4:]).view("<f4")[:, 0].astype(np.float64)
    return np.where(np.abs(value) <= FARTHEST, value, np.nan)


def _reported(bits: int) -> int:
    """Fault bits of a fault frame; what the sample program does not name counts as unknown."""
    known = sum(1 << bit for bit in _REPORTED)
    fault = UNKNOWN if bits & ~known else 0
    for bit, meaning in _REPORTED.items():
        fault |= meaning if bits >> bit & 1 else 0
    return fault
