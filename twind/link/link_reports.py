"""Messages of the loop to its front. Joints are indices, times the loop's monotonic seconds."""

from collections.abc import Sequence
from math import nan
from typing import Any

import msgspec

from twind.link.link_commands import Annotation, LinkMessage
from twind.robot.finding import Finding


class Tick(LinkMessage, frozen=True, kw_only=True):
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
    imu: bytes = b""  # gyro rad/s, acceleration m/s², quaternion w x y z: 10 float64; empty: not heard
    imu_age: float = nan  # s


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


class Bucket(msgspec.Struct, frozen=True):
    """One of a histogram, as `Bucket` of the interface: values above the one before, at most `upper_ms`."""

    upper_ms: float | None  # None: no bound
    count: int


class LoopInfo(msgspec.Struct, frozen=True):
    """The loop's own figures, as `Loop` of the interface."""

    rate_hz: float
    ticks: int
    missed: int
    on_time: float
    late_p50_us: float | None
    late_p99_us: float | None
    late_max_us: float | None
    realtime: dict[str, str]  # what was got, for people
    lateness: Sequence[Bucket] | None = None  # of the run, and its sum: once a second
    lateness_sum_ms: float | None = None
    realtime_denied: Sequence[str] | None = None  # keys of `realtime`; None: an older daemon


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
    histogram: Sequence[Bucket] | None = None  # of the run, and its sum: once a second
    histogram_sum_ms: float | None = None


class LeaseInfo(msgspec.Struct, frozen=True):
    """Holder of the lease, the client that may command, as `LeaseInfo` of the interface."""

    holder: str
    uid: int
    expires_in: float


class Overview(LinkMessage, frozen=True, kw_only=True):
    """State that changes slowly; sent ten times a second and whenever mode, state or faults change."""

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


class Reply(LinkMessage, frozen=True, kw_only=True):
    """An answer to a ticket. `error` is the interface's error name without its prefix."""

    ticket: int
    parameters: dict[str, Any] = msgspec.field(default_factory=dict)
    continues: bool = False
    error: str | None = None


class Event(LinkMessage, frozen=True, kw_only=True):
    """An event for people. It is also the loop's only way to a log."""

    time: float
    sequence: int
    level: str  # debug, info, warning, error
    code: str
    message: str
    findings: Sequence[Finding] = ()
    annotation: Annotation | None = None
    holder: str = ""  # the client that caused it by asking for nothing else; "": the robot did
    id: str = ""  # of the trajectory that ended or was refused; "": of none, or of streamed setpoints
    phase: str = ""  # of code MOTION: succeeded, cancelled, replaced, aborted
    before: str = ""  # of a change of state, whose code is the new state: the state before
    cause: str = ""  # of a change of state: what changed it, as `safety.states.Event` names it
    stop: str = ""  # the stop that is demanded: hold, settle, damp, cut, inhibit; "": none


class VerdictReport(LinkMessage, frozen=True, kw_only=True, tag="Moment"):
    """A verdict was given: topic `verdicts`. Without refusals it is followed: topic `trajectories`."""

    time: float
    sequence: int
    id: str
    verdict: dict[str, Any]
    lead: float = 0.0  # s by which it begins later, on the way to a first point at t = 0


class ReloadWanted(LinkMessage, frozen=True, kw_only=True, tag="Reread"):
    """The loop was told to have the files read again (SIGHUP)."""


Outward = Tick | Overview | Reply | Event | VerdictReport | ReloadWanted
