"""Messages of the control interface, as their JSON decodes. Standard library only, Python 3.10.

The IDL has units and meaning of the fields. None: unknown or absent.
"""

from __future__ import annotations

from typing import TypedDict


class FindingMessage(TypedDict):
    """`Finding` of the interface."""

    code: str
    joint: str | None
    point: int | None
    time: float | None
    value: float | None
    bound: float | None
    message: str


class JointMessage(TypedDict):
    """`Joint` of the interface."""

    name: str
    bus: str
    id: int
    position: float | None
    velocity: float | None
    effort: float | None
    goal: float | None
    simulated: float | None
    temperature: float | None
    voltage: float | None
    age_ms: float | None
    heard: bool
    torque: bool | None
    calibrated: bool
    verified: bool | None
    faults: list[str]
    external_nm: float | None  # an older daemon sends none of these three
    external_sd_nm: float | None
    contact: bool | None


class BusMessage(TypedDict):
    """`Bus` of the interface."""

    name: str
    port: str
    connected: bool
    latency_ms: float | None
    latency_p99_ms: float | None
    utilisation: float
    exchanges: int
    errors: int
    warning: str | None
    late_reply_ms: float | None


class BucketMessage(TypedDict):
    """`Bucket` of the interface."""

    upper_ms: float | None
    count: int


class LoopMessage(TypedDict):
    """`Loop` of the interface."""

    rate_hz: float
    ticks: int
    missed: int
    on_time: float
    late_p50_us: float | None
    late_p99_us: float | None
    late_max_us: float | None
    realtime: dict[str, str]
    lateness: list[BucketMessage] | None
    lateness_sum_ms: float | None
    realtime_denied: list[str] | None


class LeaseInfoMessage(TypedDict):
    """`LeaseInfo` of the interface."""

    holder: str
    uid: int
    expires_in: float


class StreamingMessage(TypedDict):
    """`Streaming` of the interface."""

    name: str
    endpoint: str
    rate_hz: float
    sent: int
    waiting: int
    dropped: int
    dead: int
    failures: int
    error: str | None


class FlightMessage(TypedDict):
    """`Flight` of the interface."""

    span_s: float
    bytes: int
    last: str | None


class GapFigureMessage(TypedDict):
    """`GapFigure` of the interface."""

    rms: float
    nrmse_spread: float | None
    unexplained: float | None


class JointGapMessage(TypedDict):
    """`JointGap` of the interface."""

    joint: str
    samples: int
    moved: float
    delay: float
    position: GapFigureMessage | None
    velocity: GapFigureMessage | None
    effort: GapFigureMessage | None


class GapMessage(TypedDict):
    """`Gap` of the interface."""

    joints: list[JointGapMessage]
    total: dict[str, GapFigureMessage | None]


class StatusMessage(TypedDict):
    """`Status` of the interface."""

    version: str
    robot: str
    mode: str
    state: str
    motion: str
    armed: bool
    inherited: bool
    hw_connected: bool
    sim_connected: bool
    latency_ms: float | None
    latency_avg_ms: float | None
    latency_max_ms: float | None
    violations: int
    lease: LeaseInfoMessage | None
    faults: list[FindingMessage]
    buses: list[BusMessage]
    loop: LoopMessage
    skew_ms: float | None
    skew_max_ms: float | None
    flight: FlightMessage | None
    streams: list[StreamingMessage] | None
    latched: list[str] | None
    unwatched: list[str] | None
    bodiless: bool | None
    supply_relay: str | None
    stop_button: str | None
    fall: str | None
    gap: GapMessage | None
    torque_on: bool | None
