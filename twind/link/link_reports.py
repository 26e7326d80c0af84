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
    age: bytes  # s, inf: never read
    heard: bytes  # n bytes, 0 or 1
    goal: bytes  # rad, NaN: none
    simulated: bytes  # rad
    # N·m from outside, its standard deviation, CONTACT (0 or 1): 3 n float64; empty: no estimate
    external: bytes = b""
    read: float  # s, when the last byte of the reading for `raw` arrived
    raw: bytes  # int64 of n actuators: counts as on the wire; meaningless while raw_age is inf
    raw_effort: bytes  # as on the wire, NaN: not reported
    raw_age: bytes  # s before `read`, inf never
    dropped: int = 0  # ticks and overviews lost before this one because the pipe was full
    skew: float = nan  # s between the replies of the first and the last bus; NaN: fewer than two
    imu: bytes = b""  # gyro rad/s, acceleration m/s², quaternion w x y z: 10 float64; empty: no reading
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
    warning: str | None = None  # problem of a port that works, and the remedy
    late_reply_ms: float | None = None  # delay of replies that come too late to be read; None: none do


class Bucket(msgspec.Struct, frozen=True):
    """One bucket of a histogram, as `Bucket` of the interface.

    It counts values above the bucket before, at most `upper_ms`.
    """

    upper_ms: float | None  # None: no bound
    count: int


class LoopInfo(msgspec.Struct, frozen=True):
    """Timing figures of the loop, as `Loop` of the interface."""

    rate_hz: float
    ticks: int
    missed: int
    on_time: float
    late_p50_us: float | None
    late_p99_us: float | None
    late_max_us: float | None
    realtime: dict[str, str]  # what the system granted, text for people
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
    lease_client: int  # 0: no client
    skew_ms: float | None = None  # between the replies of the first and the last bus
    skew_max_ms: float | None = None  # of the run
    faults: Sequence[Finding]
    latched: Sequence[str] = ()  # codes of `faults` that only Reset clears
    buses: Sequence[BusInfo]
    loop: LoopInfo
    latencies: Sequence[LatencyInfo]
    temperature: bytes  # °C, float64 of n joints
    voltage: bytes  # V
    torque: bytes  # int8 of n joints: 1 on, 0 off, -1 unknown
    torque_on: bool | None = None  # at some joint; False: read off at every joint; None: not known
    fault_bits: bytes  # int16 of n joints: hardware error, bit 8 alert; -1 unknown
    supply_relay: str | None = None  # open, closed, tripped, failed, unknown; None: there is none
    stop_button: str | None = None  # released, pressed, unplugged, unknown; None: there is none
    fall: str | None = None  # upright, falling, fallen, unknown; None: falls are not detected
    verified: bytes = b""  # bool of n joints: as calibrated, its turn known; empty: no robot is read


class Reply(LinkMessage, frozen=True, kw_only=True):
    """Reply to a ticket. `error` is the interface's error name without its prefix."""

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
    holder: str = ""  # the client of an annotation; "": no annotation
    id: str = ""  # of the trajectory that ended or was refused; "": of none, or of streamed setpoints
    phase: str = ""  # of code MOTION: succeeded, cancelled, replaced, aborted
    before: str = ""  # of a change of state, whose code is the new state: the state before
    cause: str = ""  # of a change of state: its cause, as `safety.state_machine.RobotEvent` names it
    stop: str = ""  # the stop that is demanded: hold, settle, damp, cut, inhibit; "": none


class VerdictReport(LinkMessage, frozen=True, kw_only=True, tag="Moment"):
    """Report of a verdict: topic `verdicts`. Without refusals it is followed: topic `trajectories`."""

    time: float
    sequence: int
    id: str
    verdict: dict[str, Any]
    lead: float = 0.0  # s by which it begins later, on the way to a first point at t = 0


class ReloadWanted(LinkMessage, frozen=True, kw_only=True, tag="Reread"):
    """Request of the loop that the front reads the files again (SIGHUP)."""


Outward = Tick | Overview | Reply | Event | VerdictReport | ReloadWanted
