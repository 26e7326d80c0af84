"""The messages between the loop and its front, and how they travel: msgpack datagrams on SOCK_SEQPACKET.

Outwards (loop → front): `Tick` every tick and `Overview` ten times a second (dropped and counted when the
pipe is full), `Reply` and `Event` (bounded queue, never dropped). Inwards: one `Command` a datagram; the
arrays of a trajectory travel as a sealed memfd beside it (SCM_RIGHTS), never through the pipe.

Joints are indices here; the front names them. Times are the loop's monotonic seconds.
"""

from collections.abc import Sequence
from math import nan
from typing import Any

import msgspec
import numpy as np

from twind.robot.arrays import Floats
from twind.robot.finding import Finding
from twind.robot.trajectory import Trajectory

DATAGRAM = 1 << 17  # bytes: largest datagram of the link


class Base(msgspec.Struct, frozen=True, kw_only=True, tag=True, tag_field="kind"):
    """What every message has: a `kind` that names its type."""


# ------------------------------------------------------------------------------------- front → loop


class Command(Base, frozen=True, kw_only=True, tag=True, tag_field="kind"):
    """A call of one client. Replies carry its ticket; the lease is bound to its connection."""

    ticket: int
    client: int  # number of the connection, > 0, never used again
    uid: int = -1
    holder: str = ""  # how the client is named to others: "uid 1000, pid 4711"


class SetMode(Command, frozen=True, kw_only=True):
    """Change where commands go. Reply: {mode}."""

    mode: str


class AcquireLease(Command, frozen=True, kw_only=True):
    """Take the lease; `take` wrests it from another (motion holds first). Reply: {lease}."""

    take: bool = False


class RenewLease(Command, frozen=True, kw_only=True):
    """Keep the lease. Reply: {lease}."""


class ReleaseLease(Command, frozen=True, kw_only=True):
    """Give the lease back. Reply: {}."""


class Arm(Command, frozen=True, kw_only=True):
    """Goal := present, read back, then torque. Reply when armed: {joints: [index]}."""

    joints: Sequence[int] | None = None
    edited: Sequence[str] = ()  # files of the robot that were written anew since they were read


class Disarm(Command, frozen=True, kw_only=True):
    """Settle, then torque off. Reply when done: {state}."""


class EStop(Command, frozen=True, kw_only=True):
    """Stop now. First reply when its first effect is confirmed on the bus: {state, torque_off, done}."""

    level: str = "settle"
    reason: str = ""
    more: bool = False


class Reset(Command, frozen=True, kw_only=True):
    """Acknowledge latched faults. Reply: {state}."""

    codes: Sequence[str] | None = None


class Calibrate(Command, frozen=True, kw_only=True):
    """Begin or end `calibrating`. Needs the lease, and ends with it. Reply: {state}."""

    on: bool


class Submit(Command, frozen=True, kw_only=True):
    """A trajectory; its arrays in the memfd beside this datagram (`pack_path`).

    `check_only`: reply {verdict}, nothing moves. Else with `more`: {phase, progress, verdict?, findings?}
    from `accepted` to one of succeeded, cancelled, replaced, aborted; without: one reply at `accepted`.
    """

    id: str
    points: int
    commanded: Sequence[int]
    velocity: bool = False
    acceleration: bool = False
    start_in: float = 0.0
    goal_time: float | None = None
    tolerances: Sequence[tuple[int, float | None, float | None]] = ()  # (joint, path, goal), rad
    policy: str = "reject"
    append_stop: bool = False
    check_only: bool = False
    more: bool = False
    front_checked: float = 0.0  # s, when the state was true that the front judged its share from
    generation: int = 0  # of the limits that the front judged by
    refused: Sequence[Finding] = ()  # what the front found: clearance, torque, balance (S23–S26)
    warned: Sequence[Finding] = ()


class Cancel(Command, frozen=True, kw_only=True):
    """Decelerate and hold. Needs no lease. Reply: {state}."""


class Setpoint(Command, frozen=True, kw_only=True):
    """One streamed goal. Reply: {sequence, changes}."""

    joints: Sequence[int]
    positions: Sequence[float]
    velocities: Sequence[float] | None = None
    valid_for: float = 0.1
    allow_clamp: bool = False


class ReadRegister(Command, frozen=True, kw_only=True):
    """One register of one device. Reply: {register}."""

    bus: str
    id: int
    name: str


class WriteRegister(Command, frozen=True, kw_only=True):
    """Write and read back; only while disarmed, EEPROM only while calibrating. Reply: {register}."""

    bus: str
    id: int
    name: str
    value: int


class Reboot(Command, frozen=True, kw_only=True):
    """Restart one device; only while disarmed. Reply: {state, restored, differing}: RAM settings in words."""

    bus: str
    id: int


class Scan(Command, frozen=True, kw_only=True):
    """Ping every id of a bus. One reply (continues) per device found: {bus, id, model, ...}."""

    bus: str | None = None


class FindStop(Command, frozen=True, kw_only=True):
    """Drive one joint against its stop, so many times; only while calibrating, in live.

    Replies with `more`: {phase, progress}; the last one of all: {ticks} found, or {findings} failed, besides.
    """

    joint: int
    side: str  # lower or upper
    current_share: float | None = None  # of its current limit
    speed: float | None = None  # rad/s
    times: int | None = None
    more: bool = False


class Adopt(Command, frozen=True, kw_only=True):
    """Changes that both sides make at one moment (`config/hot.py`); the next front's briefing in the memfd.

    Reply: {applied: [key], needs_restart: [key]}.
    """

    generation: int  # of that briefing: one more than the one in force
    changes: dict[str, Any]
    needs_restart: Sequence[str] = ()
    reread: bool = True  # by files read again; False: by a client's word


class Rereading(Base, frozen=True, kw_only=True):
    """The front begins to read the files again."""


class RereadFailed(Base, frozen=True, kw_only=True):
    """What was wrong with the files; nothing changes."""

    message: str


class Gone(Base, frozen=True, kw_only=True):
    """A connection closed: its lease lapses, its unanswered tickets are void."""

    client: int


class Heartbeat(Base, frozen=True, kw_only=True):
    """The front lives; at least twice a second."""


Inward = (
    SetMode
    | AcquireLease
    | RenewLease
    | ReleaseLease
    | Arm
    | Disarm
    | EStop
    | Reset
    | Calibrate
    | FindStop
    | Submit
    | Cancel
    | Setpoint
    | ReadRegister
    | WriteRegister
    | Reboot
    | Scan
    | Adopt
    | Rereading
    | RereadFailed
    | Gone
    | Heartbeat
)

# ------------------------------------------------------------------------------------- loop → front


class Tick(Base, frozen=True, kw_only=True):
    """The state after one tick. Arrays are little-endian float64 bytes of n joints; NaN = unknown."""

    time: float
    sequence: int  # tick number
    mode: str
    state: str
    motion: str
    armed: bool
    inherited: bool
    position: bytes  # measured (in sim: simulated), rad
    velocity: bytes  # rad/s
    effort: bytes  # N·m
    age: bytes  # s, inf never heard
    heard: bytes  # n bytes, 0 or 1
    goal: bytes  # rad, NaN: none
    simulated: bytes  # rad
    read: float  # s, when the last byte of the reading arrived that `raw` is of
    raw: bytes  # int64 of n actuators: counts as they were on the wire; meaningless while raw_age is inf
    raw_effort: bytes  # as it was on the wire, NaN: not told
    raw_age: bytes  # s before `read`, inf never
    dropped: int = 0  # ticks and overviews lost before this one because the pipe was full
    skew: float = nan  # s between the first and the last bus that had answered; NaN: fewer than two did


class BusInfo(msgspec.Struct, frozen=True):
    """One bus, as `Bus` of the interface."""

    name: str
    port: str
    connected: bool
    latency_ms: float | None
    latency_p99_ms: float | None
    utilisation: float
    exchanges: int
    errors: int
    warning: str | None = None  # what is wrong with the port though it works, and the remedy


class LoopInfo(msgspec.Struct, frozen=True):
    """The loop's own figures, as `Loop` of the interface."""

    rate_hz: float
    ticks: int
    missed: int
    on_time: float
    late_p50_us: float | None
    late_p99_us: float | None
    late_max_us: float | None
    realtime: dict[str, str]


class LatencyInfo(msgspec.Struct, frozen=True):
    """One hop, as `Latency` of the interface. Window of 100; p50 and p99 of the run."""

    hop: str
    now_ms: float | None
    mean_ms: float | None
    std_ms: float | None
    min_ms: float | None
    max_ms: float | None
    p50_ms: float | None
    p99_ms: float | None
    violations: int


class LeaseInfo(msgspec.Struct, frozen=True):
    """Who may command, as `LeaseInfo` of the interface."""

    holder: str
    uid: int
    expires_in: float


class Overview(Base, frozen=True, kw_only=True):
    """What changes slowly; ten times a second and whenever mode, state or faults change."""

    time: float
    latency_ms: float | None
    latency_avg_ms: float | None
    latency_max_ms: float | None
    violations: int
    hw_connected: bool
    sim_connected: bool
    lease: LeaseInfo | None
    lease_client: int  # 0: nobody
    skew_ms: float | None = None  # between the first and the last bus that had answered
    skew_max_ms: float | None = None  # of the run
    faults: Sequence[Finding]
    buses: Sequence[BusInfo]
    loop: LoopInfo
    latencies: Sequence[LatencyInfo]
    temperature: bytes  # °C, float64 of n joints
    voltage: bytes  # V
    torque: bytes  # int8 of n joints: 1 on, 0 off, -1 unknown
    fault_bits: bytes  # int16 of n joints: hardware error, bit 8 alert; -1 unknown
    verified: bytes = b""  # bool of n joints: as calibrated, its turn known; empty: no robot is looked at


class Reply(Base, frozen=True, kw_only=True):
    """An answer to a ticket. `error` is the interface's error name without its prefix."""

    ticket: int
    parameters: dict[str, Any] = {}
    continues: bool = False
    error: str | None = None


class Event(Base, frozen=True, kw_only=True):
    """Something happened that a person may want to know. Also the loop's only way to a log."""

    time: float
    sequence: int
    level: str  # debug, info, warning, error
    code: str
    message: str
    findings: Sequence[Finding] = ()


class Moment(Base, frozen=True, kw_only=True):
    """A verdict was given: topic `verdicts`."""

    time: float
    sequence: int
    id: str
    verdict: dict[str, Any]


class Reread(Base, frozen=True, kw_only=True):
    """The loop was told to have the files read again (SIGHUP)."""


Outward = Tick | Overview | Reply | Event | Moment | Reread


# ------------------------------------------------------------------------------------- how they travel

_encoder = msgspec.msgpack.Encoder()
_inward = msgspec.msgpack.Decoder(Inward)
_outward = msgspec.msgpack.Decoder(Outward)


def encode(message: Inward | Outward) -> bytes:
    """One datagram."""
    return _encoder.encode(message)


def decode_command(data: bytes) -> Inward:
    """A datagram from the front. Raises msgspec.DecodeError."""
    command: Inward = _inward.decode(data)
    return command


def decode_news(data: bytes) -> Outward:
    """A datagram from the loop. Raises msgspec.DecodeError."""
    news: Outward = _outward.decode(data)
    return news


def pack_path(path: Trajectory) -> bytes:
    """time (k,), position (k, n), velocity, acceleration where given: float64, one after the other."""
    parts = [path.time, path.position, path.velocity, path.acceleration]
    return b"".join(np.ascontiguousarray(part, np.float64).tobytes() for part in parts if part is not None)


def unpack_path(data: bytes, submit: Submit, count: int) -> Trajectory:
    """The trajectory of `submit` for `count` joints. Raises ValueError when the two do not fit exactly."""
    k, joints = submit.points, list(submit.commanded)
    if submit.acceleration and not submit.velocity:
        raise ValueError("accelerations need velocities")
    if not all(0 <= joint < count for joint in joints):
        raise ValueError(f"joints {joints}: this robot has 0..{count - 1}")
    blocks = 1 + int(submit.velocity) + int(submit.acceleration)
    numbers: Floats = np.frombuffer(data, np.float64)
    if k < 1 or numbers.size != k * (1 + blocks * count):
        raise ValueError(f"trajectory of {k} points x {count} joints: got {numbers.size} numbers")
    columns = [block.reshape(k, count) for block in np.split(numbers[k:], blocks)]
    commanded = np.zeros(count, np.bool_)
    commanded[joints] = True
    return Trajectory(numbers[:k], columns[0], commanded, *columns[1:])
