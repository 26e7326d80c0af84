"""One robot under the fake clock for one injection: the whole daemon, real bytes, a watch on the bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from tests.proof.faults.fault import Fault, Outcome
from tests.proof.faults.tap import Tap
from tests.proof.faults.trace import Trace
from tests.support.daemon_rig import Rig
from tests.support.fault_cases import Order
from tests.support.fault_rig import Judge
from twind import link
from twind.config.driver_family import family
from twind.robot.modes import Motion, RobotState
from twind.robot.trajectory import Trajectory
from twind.virtual.fault_commands import arguments
from twind.virtual.virtual_twin import twin_of

TICK = 0.01  # s
BRAKE = 0.4  # s: from 4 rad/s with 20 rad/s², and the shaft behind it
LONGEST = 4.0 + 5.0 + 1.0  # s: a way down that comes to no end, damping, and its reading back
STILL = 3.0  # ticks that a shaft may still creep
REST = 0.05  # rad from the rest pose, and it is there
QUIET = {"debug", "info"}
FREE = {1, 2, 10, 11, 13, 14, 17, 18}  # rows of which every third robot stands by itself
LEGS = ("hip", "knee", "ankle")
AFTER = {"MOTION", "LATENCY_WARN", "LATENCY_CALM"}  # told of whatever stops a motion or delays a reading
AWAY = (
    "PORT_UNAVAILABLE",
    "HW_DISCONNECTED",
    "STATE_STALE",
    "BUS_ERRORS",
    "RX_SHAPE",
)  # of a bus that is gone
AWAY += ("WATCHDOG_TRIPPED", "TORQUE_INHERITED", "TORQUE_MISMATCH", "VOLTAGE", "MIRROR_DRIFT")
# A pose for each joint that is clear of body and floor, whatever the others do between it and rest, rad.
CLEAR = {
    **{"head_yaw": 0.8, "head_pitch": -0.5, "waist_yaw": 0.25, "waist_pitch": 0.25},
    **{"l_shoulder_pitch": -0.8, "l_shoulder_roll": 1.0, "l_shoulder_yaw": 0.5, "l_elbow": -0.8},
    **{"r_shoulder_pitch": -0.8, "r_shoulder_roll": -1.0, "r_shoulder_yaw": -0.5, "r_elbow": -0.8},
    **{"l_hip_yaw": 0.1, "l_hip_roll": 0.4, "l_hip_pitch": -0.5, "l_knee": 0.6},
    **{"l_ankle_pitch": -0.4, "l_ankle_roll": 0.25},
    **{"r_hip_yaw": -0.1, "r_hip_roll": -0.4, "r_hip_pitch": -0.5, "r_knee": 0.6},
    **{"r_ankle_pitch": -0.4, "r_ankle_roll": -0.25},
}


class Robot:
    """`random` decides joint, motion, phase and strength; the same seed is the same run."""

    clear: Mapping[str, float] = CLEAR
    around: Mapping[str, float] = MappingProxyType(
        {}
    )  # rad, the pose between which and `clear` joints move; else 0

    def __init__(self, fault: Fault, seed: int) -> None:
        self.fault = fault
        self.outcome = Outcome(fault.number, seed)
        self.random = np.random.default_rng([fault.number, seed])
        self.wrong = self.outcome.wrong
        self.free = fault.number in FREE and seed % 3 == 2  # nothing carries it but its legs
        self.also = AFTER | set(fault.codes) | set(fault.also)
        self.rig: Rig = None  # type: ignore[assignment]
        self.begun = 0.0

    def close(self) -> None:
        if self.rig is not None:
            self.rig.close()

    # ------------------------------------------------------------------------------------ making

    def take(self, rig: Rig, *, judge: bool = False) -> Rig:
        """This rig from now on, watched."""
        self.rig = rig
        self.trace = Trace(rig)
        self.tap = Tap(rig)
        self.judge = Judge(rig) if judge else None
        self._seen = 0
        self.events: list[link.Event] = []
        for number, bus in enumerate(rig.virtual.values()):
            bus.faults.seed(int(self.random.integers(1 << 30)) + number)
        return rig

    def live(self, robot: str = "h24", *, judge: bool = False, **how: Any) -> Rig:
        """A daemon in live mode, everybody identified."""
        if self.free:
            how.setdefault("support", "free")
            self.also |= {"DAMP", "FOLLOW_ERR", "SETTLE"}  # ways down with a joint that does not follow
            self.also.add("MIRROR_DRIFT")  # the simulated robot stands by itself, too, and its joints give
        rig = self.take(Rig(robot, **how), judge=judge)
        for _ in range(200):
            self.ticks(1)
            if rig.loop.condition.state is RobotState.CONNECTED:
                return rig
        raise AssertionError("never connected")

    def armed(self, robot: str = "h24", *, judge: bool = False, **how: Any) -> Rig:
        """The same, armed."""
        rig = self.live(robot, judge=judge, **how)
        self.arm()
        return rig

    def moving(self, robot: str = "h24", *, far: float = 0.0, **how: Any) -> Rig:
        """The same, on its way, at a random moment; `joint` is one that goes at least so far (rad)."""
        rig = self.armed(robot, **how)
        joints = [
            joint
            for joint, name in enumerate(rig.names)
            if self._stroke(name) > 0.0 and self._stroke(name) >= far
        ]
        self.joint = int(self.random.choice(joints))
        self.id = self.id_of(self.joint)
        self.move()
        self.ticks(int(self.random.integers(20, 120)))
        return rig

    def _stroke(self, name: str) -> float:
        """Distance of the two poses of a joint, rad."""
        around = self.around.get(name, 0.0)
        return abs(self.clear.get(name, around) - around)

    @property
    def leg(self) -> bool:
        """Does `joint` carry the robot?"""
        return any(part in self.rig.names[self.joint] for part in LEGS)

    def id_of(self, joint: int) -> int:
        """The id of a joint, unique on its bus."""
        return int(self.rig.robot.joints[joint].id)

    # ------------------------------------------------------------------------------------ time

    def ticks(self, count: int) -> None:
        """Let ticks pass, and look at the servos after each."""
        for _ in range(count):
            self.rig.ticks(1)
            self.note()

    def note(self) -> None:
        """Record the present: servos and reports."""
        self.trace.look()
        self.tap.look()
        for news in self.rig.news[self._seen :]:
            if isinstance(news, link.Event):
                self.events.append(news)
        self._seen = len(self.rig.news)

    def seconds(self, seconds: float) -> None:
        self.ticks(round(seconds / self.rig.loop.robot.period))

    @property
    def now(self) -> float:
        return self.rig.clock.now()

    def until(self, what: Callable[[], bool], seconds: float) -> bool:
        """Ticks until it is so; False: not within that time."""
        for _ in range(round(seconds / self.rig.loop.robot.period)):
            if what():
                return True
            self.ticks(1)
        return what()

    # ------------------------------------------------------------------------------------ calls

    def call(self, kind: type[link.Command], seconds: float = 12.0, **parameters: Any) -> link.Reply:
        """A call and its last answer."""
        ticket = self.rig.send(kind, **parameters)
        found: list[link.Reply] = []

        def answered() -> bool:
            found[:] = [reply for reply in self.rig.replies(ticket) if not reply.continues]
            return bool(found)

        assert self.until(answered, seconds), f"{kind.__name__} was never answered"
        return found[-1]

    def arm(self) -> None:
        """Leased and armed, once heat and supply of all have been read. Raises AssertionError."""
        slow = self.rig.loop.hardware.slow
        self.until(lambda: bool(np.isfinite(slow.temperature).all()), 1.5)
        self.ticks(2)
        self.call(link.AcquireLease)
        reply = self.call(link.Arm)
        assert reply.error is None, reply

    def arm_again(self) -> None:
        """Let go by command, and armed and moving again."""
        self.call(link.Disarm, seconds=14.0)
        self.arm()
        self.move()
        self.begun = self.now

    def stream(self, seconds: float = 0.5) -> None:
        """The client sends setpoints for so long, and then nothing: the injection is its last one."""
        rig = self.rig
        self.call(link.Cancel)
        self.until(lambda: rig.loop.executor.motion is Motion.HOLDING, 1.0)
        self.seconds(0.3)
        self.call(link.AcquireLease)
        here = float(rig.loop.executor.reference.position[0])  # type: ignore[union-attr]
        for number in range(round(seconds / rig.loop.robot.period)):
            rig.send(link.Setpoint, joints=[0], positions=[here + 0.005 * number * 0.5])
            self.begun = self.now
            self.ticks(1)

    def move(self, pace: float = 0.6, *, more: bool = True) -> int:
        """Random joints, `joint` among them, to and fro for a minute; the ticket."""
        rig = self.rig
        assert self.call(link.AcquireLease).error is None
        reference = rig.loop.executor.reference
        here = reference.position if reference is not None else rig.loop.robot.measured.position
        far = np.array([self.clear.get(name, self.around.get(name, 0.0)) for name in rig.names])
        commanded = self.random.random(len(far)) < 0.7
        commanded[self.joint] = True
        share = self.random.uniform(0.5, 1.0, len(far))
        share[self.joint] = 1.0
        step = float(self.random.uniform(0.9, 1.2)) * pace / 0.6
        knots = int(50.0 / step)
        base = np.array([self.around.get(name, 0.0) for name in rig.names])
        way = base + (np.arange(knots)[:, None] + 1) % 2 * share * (far - base)
        way = np.where(commanded, way, here)
        time = step * (1.0 + np.arange(knots))
        path = Trajectory(time, way, commanded, np.zeros_like(way))
        ticket = rig.submit(path, more=more, policy="retime")
        running = self.until(lambda: rig.loop.executor.motion is Motion.ACTIVE, 0.5)
        assert running, rig.replies(ticket)
        return ticket

    # ------------------------------------------------------------------------------------ injecting

    def inject(self, *orders: Order, inside: bool | None = None) -> None:
        """Carry out orders now, between two ticks or (by chance) in the middle of the next exchange."""
        inside = bool(self.random.random() < 0.5) if inside is None else inside
        if inside:
            self.within(lambda: self.obey(*orders))
        else:
            self.obey(*orders)
            self.begun = self.now

    def within(self, act: Callable[[], None]) -> None:
        """Do it when the loop next waits for answers, and let that tick end."""
        wait = self.rig.clock.wait
        clock = self.rig.clock

        def once(*given: Any) -> Any:
            del clock.wait  # type: ignore[attr-defined]
            self.begun = self.now
            act()
            return wait(*given)

        clock.wait = once  # type: ignore[method-assign]
        self.ticks(1)
        if "wait" in vars(clock):
            del clock.wait  # type: ignore[attr-defined]
            self.begun = self.now
            act()

    def obey(self, *orders: Order) -> None:
        """Orders of the socket, on every bus that has the id."""
        for each in orders:
            for bus in self.rig.virtual.values():
                if "bus" in each and each["bus"] != bus.name:
                    continue
                name, given = arguments(each, twin_of(family(bus.kind)).faults)
                if "id" in given and given["id"] not in bus.ids():
                    continue
                bus.advance(self.now)
                getattr(bus.faults, name)(**given)
