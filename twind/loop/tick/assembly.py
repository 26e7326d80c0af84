"""Assembly of a loop from robot, calibration, ports and sockets, and the briefing for its front."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np

from twind.briefing import Briefing, JointInfo
from twind.config.driver_family import family
from twind.config.file_changes import texts
from twind.config.port_names import Medium
from twind.config.robot_file import RobotFile
from twind.listening_sockets import Listener
from twind.loop.bus.bus_port import BusPort, Enabler, Opener
from twind.loop.bus.bus_tap import BusTap, FlightRecorder
from twind.loop.bus.hardware import Hardware
from twind.loop.bus.imu_poller import ImuPoller
from twind.loop.ipc.former_flight_recorder import FormerFlightRecorder
from twind.loop.ipc.front_link import ControlLink, FrontLink
from twind.loop.ipc.front_process import FrontProcess
from twind.loop.process.power_child import PowerChild
from twind.loop.process.realtime import Granted
from twind.loop.process.service_notify import Notifier
from twind.loop.tick.bound_robot import BoundRobot
from twind.loop.tick.control_loop import Loop
from twind.loop.tick.loop_parts import LoopParts
from twind.motion.gravity_compensation import GravityCompensation
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.fall_settings import FallSettings
from twind.robot.finding import Finding
from twind.robot.modes import Mode
from twind.safety.capture_point import CapturePoint
from twind.safety.contact_rules import ContactRules
from twind.safety.fall_rules import FallRules
from twind.safety.gate import GateThresholds
from twind.safety.guard import Guard
from twind.safety.guard import GuardThresholds as Bounds
from twind.safety.lead_rules import TorqueAtRest
from twind.safety.lease import Lease
from twind.sealed_memfd import seal
from twind.telemetry.command_latency import CommandLatencyTracer
from twind.telemetry.timing_monitor import TimingMonitor
from twind.twin.binding import Binding
from twind.twin.binding_transfer import packed
from twind.twin.collision_lookahead import CollisionLookahead
from twind.twin.dynamics import Dynamics
from twind.twin.load_survey import worst_load
from twind.twin.standing_feet import inside
from twind.twin.support_geometry import SupportGeometry
from twind.twin.torque_observer import has_observer, limbs, observer_of
from twind.twin.twin import Twin
from twind.version import __version__
from twind_drivers.clock import Clock

NO_TAPES: Mapping[str, BusTap] = MappingProxyType({})


def build(
    robot: BoundRobot,
    *,
    mode: Mode,
    rate_hz: float,
    clock: Clock,
    where: Mapping[str, str | None],
    opener: Opener,
    enabler: Enabler,
    link: ControlLink,
    notifier: Notifier,
    thresholds: GateThresholds,
    realtime: Mapping[str, Granted],
    live_denied: Finding | None = None,
    rewire: Callable[[BoundRobot], Enabler] | None = None,
    tapes: Mapping[str, BusTap] = NO_TAPES,
    power: PowerChild | None = None,
) -> Loop:
    """Return a loop ready to run.

    `rewire` makes the `enabler` for the same robot with other limits or gains. `tapes` are the recorders of
    the buses that the flight recorder covers. `power`: process of supply relay and stop button.
    """
    binding = robot.binding
    period = 1.0 / rate_hz
    ports = [
        BusPort(
            bus.name,
            where.get(bus.name),
            opener,
            enabler,
            tapes.get(bus.name, BusTap()),
            alert_register=family(robot.file.bus(bus.name).kind).alert_register,
        )
        for bus in binding.joint_map.buses
    ]
    health = TimingMonitor(len(ports), thresholds.latency_warn)
    guard = _guard(robot, period)
    parts = LoopParts(
        clock=clock,
        period=period,
        bound=robot,
        hardware=Hardware(binding.joint_map, ports, clock, period, _inertial(robot.file, binding)),
        twin=Twin(binding, period),
        executor=TrajectoryExecutor(binding.limits, period),
        guard=guard,
        lease=Lease(),
        health=health,
        way=CommandLatencyTracer(health),
        thresholds=thresholds,
        link=link,
        notifier=notifier,
        realtime=realtime,
        live_denied=live_denied,
        rewire=rewire,
        power=power,
        outlook=CollisionLookahead.of(binding, period),
        compensation=gravity_compensation(robot.file, binding, guard),
        observer=observer_of(binding, period),
    )
    return Loop(parts, mode)


def _guard(robot: BoundRobot, period: float) -> Guard:
    """Return the rules that judge each tick."""
    binding = robot.binding
    return Guard(
        binding.limits,
        _bounds(robot.file, period),
        buses=[bus.name for bus in binding.joint_map.buses],
        can=_can(robot.file, binding),
        support=robot.file.support,
        ratings=binding.ratings,
        linked=binding.joint_map.linked,
        at_rest=_torque_at_rest(binding),
        load=worst_load(binding),
        falls=_falls(robot.file.fall, binding),
        contact=_contact(binding),
    )


def _falls(settings: FallSettings | None, binding: Binding) -> FallRules | None:
    """Return the rule of falls; None: the robot file does not ask for it. Raises InvalidInput: no feet."""
    if settings is None:
        return None
    return FallRules(settings, CapturePoint(SupportGeometry(binding).place, inside))


def _contact(binding: Binding) -> ContactRules | None:
    """Return the rules on torque from outside; None: the robot has no observer."""
    if not has_observer(binding):
        return None
    hold = binding.robot.gate.contact_hold_nm
    bound = np.array([hold.get(name, np.inf) for name in binding.robot.names])
    return ContactRules(bound, limbs(binding))


def power(robot: RobotFile, rate_hz: float, virtual: Mapping[str, str]) -> PowerChild | None:
    """Return the process of supply relay and stop button, not started; None: the robot has neither.

    `virtual`: ports of a virtual robot, which replace those of the file. Raises InvalidInput.
    """
    relay = robot.relay
    button = robot.stop_button
    if relay is not None and virtual:
        relay = replace(relay, kind="lcus1", port=virtual["relay"])
    if button is not None and virtual:
        button = replace(button, kind="serial", port=virtual["stop_button"])
    return None if relay is None and button is None else PowerChild(relay, button, rate_hz)


def _inertial(robot: RobotFile, binding: Binding) -> ImuPoller | None:
    """Return the poller of the IMU; None: the robot has none."""
    if robot.imu is None or binding.mount is None:
        return None
    names = [bus.name for bus in binding.joint_map.buses]
    return ImuPoller(robot.imu, binding.mount, names.index(robot.imu.bus))


def _can(robot: RobotFile, binding: Binding) -> dict[str, list[int]]:
    """Return the joint indices of each CAN bus, by bus name."""
    maps = binding.joint_map.buses
    return {
        bus.name: bus.joints.tolist() for bus in maps if family(robot.bus(bus.name).kind).medium is Medium.CAN
    }


def _torque_at_rest(binding: Binding) -> TorqueAtRest | None:
    """Return the torque that holds a pose, as the model gives it; None: every device has a watchdog."""
    return Dynamics(binding).at_rest if np.isfinite(binding.ratings.lead).any() else None


def gravity_compensation(robot: RobotFile, binding: Binding, guard: Guard) -> GravityCompensation | None:
    """Return the offset of goals against gravity; None: the robot file does not ask for it."""
    if not robot.compensate_gravity:
        return None
    return GravityCompensation(Dynamics(binding).at_rest, binding.ratings, guard.follow)


def _bounds(robot: RobotFile, period: float) -> Bounds:
    """Return the bounds of the guard for a tick of `period` s.

    At a low rate every reading is older than the usual 30 ms; the bound grows, as this is no fault.
    """
    usual = Bounds(setpoint_age=robot.command_timeout_ms / 1e3)
    return replace(usual, stale_warn=max(usual.stale_warn, min(1.5 * period, usual.stale_hold)))


def make_briefing(
    robot: BoundRobot,
    rate_hz: float,
    parameters: dict[str, Any],
    log_level: str,
    files: Mapping[str, str] | None = None,
    described: bytes = b"",
) -> int:
    """Return a sealed memfd with the briefing for the front, so that both processes judge the same robot.

    `files`: sha256 by path, of the files as they were read. `described`: the content of these files.
    """
    made = briefing(robot, rate_hz, parameters, log_level, files, described)
    return seal("twind-briefing", msgspec.msgpack.encode(made))


def briefing(
    robot: BoundRobot,
    rate_hz: float,
    parameters: dict[str, Any],
    log_level: str = "info",
    files: Mapping[str, str] | None = None,
    described: bytes = b"",
) -> Briefing:
    """Return the briefing, not packed; arguments as for `make_briefing`."""
    binding = robot.binding
    limits = binding.limits
    joint_map = binding.joint_map
    at = {int(place): (bus, i) for bus in joint_map.buses for i, place in enumerate(bus.joints)}
    joints = [
        JointInfo(
            name=name,
            bus=at[place][0].name,
            id=at[place][0].ids[at[place][1]],
            actuator=robot.file.joints[place].actuator,
            calibrated=joint_map.calibrated[place],
            lower=float(limits.lower[place]),
            upper=float(limits.upper[place]),
            watchdog=not np.isfinite(binding.ratings.lead[place]),
        )
        for place, name in enumerate(joint_map.names)
    ]
    return Briefing(
        version=__version__,
        robot=robot.file.name,
        joints=joints,
        description=msgspec.to_builtins(robot.file, enc_hook=str),
        calibration=None
        if robot.calibration is None
        else msgspec.to_builtins(robot.calibration, enc_hook=str),
        mjcf=binding.mjcf,
        binding=packed(binding),
        bodiless=robot.file.gate.collision.bodiless,
        rate_hz=rate_hz,
        parameters=parameters,
        log_level=log_level,
        files=dict(files or {}),
        texts=texts(files or {}),
        described=described,
    )


def front(
    briefing: int,
    listeners: Mapping[str, Listener],
    recorder: FlightRecorder | None,
    folder: Path,
    crash_recording: FormerFlightRecorder | None = None,
) -> FrontLink:
    """Return the link to a front that starts with the first tick.

    `folder`: where the recordings of `recorder` and of a former daemon, `crash_recording`, are written.
    """
    flight = None if recorder is None else recorder.fd
    process = FrontProcess(briefing, listeners, flight, folder, crash_recording)
    return FrontLink(process) if recorder is None else FrontLink(process, recorder.link)
