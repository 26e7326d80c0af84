"""A whole daemon under a fake clock: the real loop, driver and virtual servos in one process, real bytes.

Only the front is missing: its end of the link is in the test's hands, over a real socket pair.
"""

import os
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from tests.support.can_loopback import CanLoopback
from tests.support.slot_poses import joint_angles
from twind import link, sealed_memfd
from twind.config.calibration_file import Calibration
from twind.config.counts import slot_angles, ticks_of
from twind.config.driver_family import family
from twind.config.port_names import Medium
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.flight import FlightRing
from twind.loop.bus.bus_opener import BusOpener
from twind.loop.bus.bus_tap import FlightRecorder
from twind.loop.ipc.front_link import FrontLink
from twind.loop.process.service_notify import Notifier
from twind.loop.tick import assembly
from twind.loop.tick.bound_robot import BoundRobot
from twind.robot.arrays import Floats
from twind.robot.finding import Finding
from twind.robot.modes import Mode
from twind.robot.trajectory import Trajectory
from twind.safety.gate import GateThresholds
from twind.twin.binding import bind
from twind.virtual.joint_actuators import fence
from twind.virtual.robot_ground_truth import RobotGroundTruth
from twind.virtual.virtual_robot_spec import VirtualRobotSpec, calibration, make_spec, sensor_of
from twind.virtual.virtual_twin import BusTiming, PhysicsRequest, VirtualBusRequest, twin_of
from twind_drivers.bus import BusReader, PortError
from twind_drivers.clock import FakeClock
from twind_drivers.virtual.serial_loopback import Loopback
from twind_drivers.virtual.servo_physics import FirstOrderPhysics

CLIENT = 7
MakeRig = Callable[..., Any]  # the fixture `make_rig`: arguments as for `Rig`


@cache
def known_robot(name: str) -> RobotFile:
    """A robot of the package, read once for all tests."""
    return load_robot(name)


@cache
def known_calibration(name: str) -> Calibration:
    """The calibration of a virtual robot without faults, made once for all tests."""
    return calibration(known_virtual_robot(name))


@cache
def known_virtual_robot(name: str) -> VirtualRobotSpec:
    """A virtual robot as described, made once for all tests."""
    return make_spec(known_robot(name))


@cache
def known_binding(name: str) -> BoundRobot:
    """A robot of the package with its calibration and model, bound once for all tests."""
    robot = known_robot(name)
    calibrated = known_calibration(name)
    return BoundRobot(robot, calibrated, bind(robot, calibrated))


class HandFront:
    """In place of the front's process: a socket pair whose outer end the test holds."""

    def __init__(self) -> None:
        self.socket, self.outer = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.setblocking(False)
        self.outer.setblocking(False)
        self.briefings: list[int] = []

    def alive(self, now: float) -> None: ...

    def set_briefing(self, briefing: int) -> None:
        """Kept for the next front."""
        self.briefings.append(briefing)

    def forget_briefings(self) -> None:
        """Close all but the newest, as the process of the front does."""
        for briefing in self.briefings[:-1]:
            os.close(briefing)
        del self.briefings[:-1]

    def overdue(self, now: float) -> bool:
        return False

    def reap(self) -> bool:
        return False

    def due(self, now: float) -> bool:
        return False

    def finish(self) -> None:
        self.end(0.0)

    def end(self, now: float) -> None:
        if self.socket is not None:
            self.socket.close()
            self.outer.close()
            for briefing in self.briefings:
                os.close(briefing)
            self.briefings.clear()
        self.socket = None


class Rig:
    """`ticks(n)` lets time pass; `send` is a client's call; `replies` what came back to a ticket."""

    def __init__(
        self,
        robot: str = "h24",
        mode: Mode = Mode.LIVE,
        *,
        start: Mapping[str, float] | None = None,
        muscles: type[FirstOrderPhysics] = FirstOrderPhysics,
        rate_hz: float | None = None,
        support: str | None = None,
        truth: RobotGroundTruth | None = None,
        calibrated: Calibration | None = None,
        ring: FlightRing | None = None,
        power: Any = None,
        live_denied: Finding | None = None,
    ) -> None:
        """`calibrated`: before now, and not as these servos would be. `ring`: where it is written down."""
        self._muscles = muscles
        self._live_denied = live_denied
        self.power = power  # stand-in for the process of supply relay and stop button
        self.clock = FakeClock(100.0)
        known = None if "/" in robot else known_robot(robot)
        self.robot = known or load_robot(robot)
        if rate_hz is not None:
            self.robot = replace(self.robot, rate_hz=rate_hz)
        if support is not None:
            self.robot = replace(self.robot, support=support)
        plain = truth is None and self.robot is known
        self.made = known_virtual_robot(robot) if plain else make_spec(self.robot, truth=truth)
        self._stops = truth is not None
        self.zeros = self.made.zeros
        start = start if start is not None else self.robot.poses["rest"]
        self.virtual = {bus.name: self._virtual(bus.name, start) for bus in self.robot.buses}
        if plain and self.robot is known and calibrated is None:  # `_virtual` may have changed the robot
            self.one = known_binding(robot)
        else:
            calibrated = calibrated or calibration(self.made)
            self.one = BoundRobot(self.robot, calibrated, bind(self.robot, calibrated))
        self.calibration = calibrated or known_calibration(robot)
        self.names = self.one.binding.joint_map.names
        buses = [bus.name for bus in self.one.binding.joint_map.buses]
        self.recorder = None if ring is None else FlightRecorder(ring, buses, self.clock)
        self.front = self.new_front()
        self.loop = self.born(mode)
        self.news: list[Any] = []
        self.last_ticket = 0
        self.next_tick = self.clock.now()

    def new_front(self) -> HandFront:
        """Stand-in for the process of the front."""
        return HandFront()

    def born(self, mode: Mode) -> Any:
        """A daemon that begins on these servos as they are."""
        recorded = self.recorder
        tapes = {} if recorded is None else dict(recorded.tapes)
        self.buses = BusOpener(self.robot, self.one.binding.joint_map, {}, self.robot.rate_hz, tapes)
        return assembly.build(
            self.one,
            mode=mode,
            rate_hz=self.robot.rate_hz,
            clock=self.clock,
            where={bus.name: f"virtual:{bus.name}" for bus in self.robot.buses},
            opener=self.open_port,
            enabler=self.buses.enable,
            link=FrontLink(self.front, *([] if recorded is None else [recorded.link])),  # type: ignore[arg-type]
            notifier=Notifier({}),
            thresholds=GateThresholds(),
            realtime={},
            rewire=self._rewire,
            tapes=tapes,
            power=self.power,
            live_denied=self._live_denied,
        )

    def _rewire(self, one: BoundRobot) -> Any:
        self.buses = replace(self.buses, robot=one.file, joints=one.binding.joint_map)
        return self.buses.enable

    def close(self) -> None:
        self.loop.close()

    # ------------------------------------------------------------------------- the virtual robot

    def _virtual(self, bus: str, start: Mapping[str, float]) -> Any:
        joints = self.made.joints(bus)
        pose = slot_angles(self.robot, {name: start.get(name, 0.0) for name in self.robot.names})
        ticks = [ticks_of(joint, self.zeros[joint.name], pose[joint.name]) for joint in joints]
        described = self.robot.bus(bus)
        twin = twin_of(family(described.kind))
        devices = self.made.devices[bus]
        hinges = [device.hinge for device in devices]
        now = self.clock.now()
        if family(described.kind).medium is Medium.CAN:
            moved = twin.physics(PhysicsRequest(None, (), ticks, hinges, now))
        else:
            moved = self._muscles(np.array(ticks, np.float64), now=now)
            if self._stops:  # a body of MuJoCo has its own
                fence(moved, hinges)
        sensor = sensor_of(self.robot, bus, None)
        return twin.bus(VirtualBusRequest(bus, devices, moved, BusTiming(), described.baud, now, sensor))

    def open_port(self, name: str) -> BusReader:
        if not self.virtual[name].is_plugged:
            raise PortError(f"virtual:{name}", "no such port")
        can = family(self.robot.bus(name).kind).medium is Medium.CAN
        return self.buses.reader(name, (CanLoopback if can else Loopback)(self.virtual[name], self.clock))

    # ------------------------------------------------------------------------- time and calls

    def ticks(self, count: int) -> None:
        """Let `count` ticks pass and collect the news."""
        for _ in range(count):
            self.next_tick = max(self.next_tick, self.clock.now())
            self.clock.sleep_until(self.next_tick)
            self.loop.run(until=self.clock.now() + 1e-9)
            self.next_tick += self.loop.robot.period
            self.collect_news()

    def seconds(self, seconds: float) -> None:
        """Let time pass."""
        self.ticks(round(seconds / self.loop.robot.period))

    def collect_news(self) -> None:
        while True:
            try:
                self.news.append(link.decode_news(self.front.outer.recv(link.DATAGRAM)))
            except (BlockingIOError, OSError):
                return

    def send(self, kind: type[link.Command], *, client: int = CLIENT, **parameters: Any) -> int:
        """A call of `client`; its ticket."""
        self.last_ticket += 1
        command = kind(ticket=self.last_ticket, client=client, uid=0, holder="test", **parameters)
        self.front.outer.send(link.encode(command))  # type: ignore[arg-type]
        return self.last_ticket

    def call(self, kind: type[link.Command], *, ticks: int = 300, **parameters: Any) -> link.Reply:
        """A call and its last reply, within `ticks`."""
        ticket = self.send(kind, **parameters)
        for _ in range(ticks):
            seen = len(self.news)
            self.ticks(1)
            for news in self.news[seen:]:  # all news of a long call, in each of its ticks, would be its cost
                if isinstance(news, link.Reply) and news.ticket == ticket and not news.continues:
                    return news
        raise AssertionError(f"{kind.__name__} was not answered within {ticks} ticks")

    def submit(self, path: Trajectory, *, client: int = CLIENT, **parameters: Any) -> int:
        """Submit a trajectory; its ticket."""
        self.last_ticket += 1
        parameters.setdefault("generation", self.loop.commands.reloads.generation)
        command = link.Submit(
            ticket=self.last_ticket,
            client=client,
            id=f"t{self.last_ticket}",
            points=len(path.time),
            commanded=np.flatnonzero(path.commanded).tolist(),
            velocity=path.velocity is not None,
            acceleration=path.acceleration is not None,
            **parameters,
        )
        fd = sealed_memfd.seal("path", link.pack_path(path))
        socket.send_fds(self.front.outer, [link.encode(command)], [fd])
        os.close(fd)
        return self.last_ticket

    def adopt(self, changes: Mapping[str, Any], *, announced: bool = True, **parameters: Any) -> link.Reply:
        """Changes of the front's, with the next briefing; what the loop answers."""
        if parameters.get("reread", True) and announced:
            self.front.outer.send(link.encode(link.ReloadStarted()))
        self.last_ticket += 1
        given = {"generation": self.loop.commands.reloads.generation + 1, "client": 0} | parameters
        command = link.ApplyChanges(ticket=self.last_ticket, changes=dict(changes), **given)
        fd = sealed_memfd.seal("briefing", b"for the next front")
        socket.send_fds(self.front.outer, [link.encode(command)], [fd])
        os.close(fd)
        self.ticks(2)
        return self.replies(self.last_ticket)[-1]

    def replies(self, ticket: int) -> list[link.Reply]:
        """Everything that answered a ticket so far."""
        return [news for news in self.news if isinstance(news, link.Reply) and news.ticket == ticket]

    def events(self, code: str | None = None) -> list[link.Event]:
        """Events so far."""
        found = [news for news in self.news if isinstance(news, link.Event)]
        return [event for event in found if code is None or event.code == code]

    # ------------------------------------------------------------------------- common ground

    def connect(self) -> None:
        """Until everybody is identified, and every slow register was read once."""
        for _ in range(200):
            self.ticks(1)
            if (
                self.loop.condition.state == "connected"
                and np.isfinite(self.loop.hardware.slow.health_time).all()
            ):
                return
        raise AssertionError(
            f"not connected: {self.loop.condition.state}, {[event.message for event in self.events()]}"
        )

    def arm(self) -> None:
        """Connected, leased, armed."""
        self.connect()
        self.call(link.AcquireLease)
        reply = self.call(link.Arm)
        assert reply.error is None, reply

    def lease(self) -> None:
        """Keep the lease."""
        assert self.call(link.AcquireLease).error is None

    def path(self, joint: str, position: Sequence[float], time: Sequence[float]) -> Trajectory:
        """Positions of one joint; the others keep what they do."""
        place = self.names.index(joint)
        rows = np.tile(self.loop.robot.measured.position, (len(time), 1))
        rows[:, place] = position
        commanded = np.zeros(len(self.names), np.bool_)
        commanded[place] = True
        return Trajectory(np.array(time, np.float64), rows, commanded)

    @property
    def truth(self) -> Floats:
        """True positions of the joints, rad (n,)."""
        self.advance_servos()
        pose = joint_angles(self.robot, {name: self._angle(name) for name in self.robot.names})
        return np.array([pose[name] for name in self.robot.names])

    def _angle(self, name: str) -> float:
        joint = next(joint for joint in self.made.wired.joints if joint.name == name)
        row = [other.name for other in self.robot.joints if other.bus == joint.bus].index(name)
        bus = self.virtual[joint.bus]
        ticks = (
            bus.truth(self.clock.now())[row]["position"]
            if family(bus.kind).medium is Medium.CAN
            else bus.servos.muscles.position[row]
        )
        return (ticks - self.zeros[name]) * joint.sign / joint.ratio * 2 * np.pi / joint.type.ticks_per_turn

    @property
    def counts(self) -> Floats:
        """True positions of the servos, ticks, bus after bus."""
        self.advance_servos()
        return np.concatenate([bus.servos.muscles.position.copy() for bus in self.virtual.values()])

    def advance_servos(self) -> None:
        """The servos' own time goes on without traffic too."""
        for bus in self.virtual.values():
            bus.advance(self.clock.now())

    def register(self, key: str) -> np.ndarray:
        """One register of all servos, bus after bus."""
        return np.concatenate([np.asarray(bus.servos[key]) for bus in self.virtual.values()])
