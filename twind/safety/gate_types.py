"""Inputs and results of the gate."""

from dataclasses import dataclass

from twind.robot.arrays import Bools, Floats
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.splines import Spline
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.headroom import JointCondition


@dataclass(frozen=True, slots=True)
class GateThresholds:
    """Thresholds of the gate that do not depend on the joint. Settings may only tighten them."""

    latency_warn: float = 0.05  # s
    latency_block: float = 0.1  # s
    stale: float = 0.1  # s
    health: float = 1.0  # s, oldest reading of temperature and supply that counts (THERMAL_HEADROOM)
    start_jump: float = 0.05  # rad, at t = 0
    jerk_warn: float = 5000.0  # rad/s³
    max_points: int = 2000
    max_duration: float = 60.0  # s
    min_dt: float = 0.001  # s
    brake_floor: float = 0.05  # rad/s, always allowed towards the limit
    brake_margin: float = 0.2  # rad/s, kept back from the fastest speed that can still stop
    end_velocity: float = 0.05  # rad/s, still counts as rest


@dataclass(frozen=True, slots=True)
class GateSnapshot:
    """State of robot and daemon for the gate, at one instant. Arrays are (n,), in joint order."""

    now: float  # s
    mode: Mode
    state: RobotState
    motion: Motion
    latched: tuple[ReasonCode, ...]  # codes that latched a fault or an e-stop
    lease_held: bool  # by the connection of the request
    mismatches: tuple[Finding, ...]  # calibration against read-back (CALIB_MISMATCH)
    calibrated: Bools
    age: Floats  # s since the last reading of each joint of the target, inf never
    latency: float  # s, state age + bus round trip, now; NaN unknown
    latency_p95: float  # s, of the last 0.5 s; NaN unknown
    reference: Reference  # last commanded while holding or moving, measured otherwise
    period: float  # s, of a tick: how long the way to a first point at 0 s lasts
    torque_on: bool | None = None  # of a stopped robot: on; read off at every joint; None: not known
    limp: Bools | None = None  # joints that stay without torque by request; None: none
    busy: bool = False  # one trajectory runs and one waits
    bars: tuple[Finding, ...] = ()  # findings of servos and buses that prevent arming now
    holding: tuple[Finding, ...] = ()  # findings for which the guard would hold a motion at once
    unreachable: Finding | None = None  # reason why no new client can connect; None: clients can
    condition: JointCondition | None = None  # temperature and supply; None: unknown, which refuses


@dataclass(frozen=True, slots=True)
class TrajectoryRequest:
    """Options of a submitted trajectory."""

    policy: str = "reject"  # or "retime": one uniform stretch in time, reported
    append_stop: bool = False
    start_in: float = 0.0  # s from now


@dataclass(frozen=True, slots=True)
class GateResult:
    """The verdict, and the path that would run: as requested, or as the verdict's changes say.

    Where the path's form allows no curve, `spline` stays at the reference.
    """

    verdict: Verdict
    path: Trajectory
    spline: Spline
