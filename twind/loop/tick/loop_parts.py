"""Parts of a loop; `assembly` makes them. Loop's process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from twind.loop.bus.bus_port import Enabler
from twind.loop.bus.hardware import Hardware
from twind.loop.ipc.front_link import ControlLink
from twind.loop.process.power_child import PowerChild
from twind.loop.process.realtime import Granted
from twind.loop.process.service_notify import Notifier
from twind.loop.tick.bound_robot import BoundRobot
from twind.motion.gravity_compensation import GravityCompensation
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.finding import Finding
from twind.safety.gate_types import GateThresholds
from twind.safety.guard import Guard
from twind.safety.lease import Lease
from twind.telemetry.command_latency import CommandLatencyTracer
from twind.telemetry.timing_monitor import TimingMonitor
from twind.twin.collision_lookahead import CollisionLookahead
from twind.twin.torque_observer import ExternalTorqueObserver
from twind.twin.twin import Twin
from twind_drivers.clock import Clock


@dataclass(frozen=True, slots=True)
class LoopParts:
    """Parts that a loop is put together from. They are the same for its whole life."""

    clock: Clock
    period: float  # s
    bound: BoundRobot  # joints, limits and ratings at the start; a reload replaces them in `ControlledRobot`
    hardware: Hardware
    twin: Twin
    executor: TrajectoryExecutor
    guard: Guard
    lease: Lease
    health: TimingMonitor
    way: CommandLatencyTracer
    thresholds: GateThresholds  # at the start
    link: ControlLink
    notifier: Notifier
    realtime: Mapping[str, Granted]
    live_denied: Finding | None  # reason why mode live is refused; None: it is allowed
    # how write halves are made for a robot that was changed
    rewire: Callable[[BoundRobot], Enabler] | None = None
    power: PowerChild | None = None  # None: the robot has neither supply relay nor stop button
    compensation: GravityCompensation | None = None  # None: goals have no offset against gravity
    observer: ExternalTorqueObserver | None = None  # of external torque; None: no identified model
    outlook: CollisionLookahead | None = None  # None: no two bodies of the model can collide
