"""A random life of one robot under the fake clock: motions, streams, stops, faults, and back again.

Every second: nothing against the rules of the bus, a state that makes sense, torque as it is said to be. A
flight recorder is attached. Buses of a family without a monitor are judged by the rest.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.proof.faults.tap import Tap
from tests.proof.soak.growth import Growth
from tests.proof.soak.life_faults import Device, drawn, known, supply
from tests.proof.soak.living import ends_of, robot_file, robot_of
from tests.support.daemon_rig import Rig
from tests.support.fault_cases import Order
from twind import link
from twind.config.robot_spec import JointSpec
from twind.flight import FlightRing
from twind.loop.procedures.torque_readback import torque_inherited
from twind.robot.modes import Motion, RobotState
from twind.robot.trajectory import Trajectory
from twind.safety.state_machine import LATCHED
from twind.virtual.fault_commands import arguments

RING = 8 << 20  # bytes of the flight recorder
LOOK = 20.0  # s between two samples of memory
BACK = 40.0  # s within which commands must bring it back from anything


class Life:
    """`seed` decides everything, also the robot where none is given. `wrong`: what must not be, and when."""

    def __init__(self, seed: int, robot: str | None = None) -> None:
        self.random = np.random.default_rng([seed, 4])
        self.robot = robot or robot_of(seed)
        self.folder = tempfile.TemporaryDirectory(prefix="twind-soak-")
        file = robot_file(self.robot, Path(self.folder.name))
        self.rig = Rig(file, ring=FlightRing.create(RING))
        self.tap = Tap(self.rig)
        self.growth = Growth("loop")
        self.wrong = list[str]()
        self.acts: dict[str, int] = {}
        self.faults: dict[str, int] = {}
        self._looked = self._second = self.rig.clock.now()
        self.volts = {name: supply(bus) for name, bus in self.rig.virtual.items()}
        self.base, self.far = ends_of(self.rig)
        limits = self.rig.one.binding.limits
        self.devices: dict[str, list[Device]] = {name: [] for name in self.rig.virtual}
        for joint in self.rig.robot.joints:
            place = self.rig.names.index(joint.name)
            device = Device(joint.id, float(limits.lower[place]), float(limits.upper[place]))
            self.devices[joint.bus].append(device)
        self._hand = False  # one has moved a joint since the robot was armed last
        self.moved = 0  # motions that were accepted

    def close(self) -> None:
        """Ends the daemon."""
        self.rig.close()
        self.folder.cleanup()

    # ------------------------------------------------------------------------------------ time

    def ticks(self, count: int) -> None:
        """Let ticks pass; each second is judged, each minute weighed."""
        rig = self.rig
        for _ in range(count):
            rig.ticks(1)
            now = rig.clock.now()
            self.tap.listen(now)  # a port that is gone for a moment carries no bytes that would make it look
            if now - self._second >= 1.0:
                self._second = now
                self._judge(now)
        if len(rig.news) > 3000:
            del rig.news[:-300]

    def seconds(self, seconds: float) -> None:
        self.ticks(round(seconds * 100.0))

    def until(self, what: Callable[[], bool], seconds: float) -> bool:
        for _ in range(round(seconds * 20.0)):
            if what():
                return True
            self.ticks(5)
        return what()

    def _judge(self, now: float) -> None:
        loop = self.rig.loop
        self.tap.look()
        self.wrong += [f"{now:.2f} bus: {each}" for each in self.tap.wrong[:3]]
        for monitor in self.tap.monitors.values():
            monitor.violations.clear()
        if loop.condition.latches and loop.condition.state not in (
            *LATCHED,
            RobotState.INHIBITED,
            RobotState.DISCONNECTED,
            RobotState.IDENTIFYING,
        ):
            self.wrong.append(
                f"{now:.2f} latched {sorted(loop.condition.latches)} in state {loop.condition.state.value}"
            )
        if loop.torque.armed and loop.condition.state in (
            RobotState.CONNECTED,
            RobotState.IDENTIFYING,
            RobotState.DISCONNECTED,
        ):
            self.wrong.append(f"{now:.2f} armed in state {loop.condition.state.value}")
        reference = loop.executor.reference
        if reference is not None and not np.isfinite(reference.position).all():
            self.wrong.append(f"{now:.2f} a reference that is no number")
        if loop.condition.finished:
            self.wrong.append(f"{now:.2f} the daemon ended")
        if now - self._looked >= LOOK:
            self._looked = now
            self.growth.look(now)

    # ------------------------------------------------------------------------------------ acts

    def call(self, kind: type[link.Command], seconds: float = 15.0, **given: Any) -> link.Reply | None:
        """A call; None: it was not answered in time, which is wrong."""
        ticket = self.rig.send(kind, **given)
        found: list[link.Reply] = []

        def answered() -> bool:
            found[:] = [reply for reply in self.rig.replies(ticket) if not reply.continues]
            return bool(found)

        for _ in range(round(seconds * 100.0)):
            self.ticks(1)
            if answered():
                return found[-1]
        self.wrong.append(f"{self.rig.clock.now():.2f} {kind.__name__} was not answered")
        return None

    def motion(self) -> None:
        """A trajectory of some joints, followed for a while or to its end."""
        rig = self.rig
        random = self.random
        self.call(link.AcquireLease)
        here = rig.loop.executor.reference
        if here is None:
            return
        knots = int(random.integers(1, 8))
        share = random.random((knots, len(self.far)))
        share[-1] *= random.random() < 0.5
        way = self.base + share * (self.far - self.base)
        commanded = random.random(len(self.far)) < random.uniform(0.1, 1.0)
        commanded[int(random.integers(len(self.far)))] = True
        times = np.cumsum(random.uniform(0.6, 2.0, knots))
        way = np.where(commanded, way, here.position)
        ticket = rig.submit(Trajectory(times, way, commanded, np.zeros_like(way)), more=True, policy="retime")
        self.seconds(float(random.choice([random.uniform(0.1, times[-1]), times[-1] + 1.0])))
        self.moved += any(reply.error is None for reply in rig.replies(ticket))

    def stream(self) -> None:
        """Setpoints of one joint for a while; then it falls silent, or is cancelled."""
        rig = self.rig
        random = self.random
        self.call(link.AcquireLease)
        if rig.loop.executor.reference is None:
            return
        joint = int(random.integers(len(self.far)))
        here = float(rig.loop.executor.reference.position[joint])
        there = float(self.base[joint] + random.random() * (self.far - self.base)[joint])
        steps = max(20, round(abs(there - here) / 0.004))
        for number in range(steps):
            share = 0.5 - 0.5 * np.cos(np.pi * (number + 1) / steps)
            rig.send(link.Setpoint, joints=[joint], positions=[float(here + share * (there - here))])
            self.ticks(1)
        if random.random() < 0.3:
            self.call(link.Cancel)
        self.seconds(0.5)

    def cancel(self) -> None:
        self.call(link.Cancel)
        self.seconds(0.3)

    def leave(self) -> None:
        """The client goes."""
        self.rig.front.outer.send(link.encode(link.ConnectionClosed(client=7)))
        self.seconds(0.6)

    def idle(self) -> None:
        self.seconds(float(self.random.uniform(0.1, 15.0)))

    def lie_down(self) -> None:
        self.call(link.Disarm)
        self.seconds(float(self.random.uniform(0.1, 5.0)))

    def stop(self) -> None:
        """An e-stop in whatever goes on."""
        self.call(link.EStop, level="cut" if self.random.random() < 0.4 else "settle")
        self.seconds(float(self.random.uniform(0.0, 6.0)))

    def fault(self) -> None:
        """One fault of the table, of one bus, healed after a while."""
        name = str(self.random.choice(sorted(self.rig.virtual)))
        fault = drawn(self.random, self.rig.virtual[name], self.volts[name], self.devices[name])
        self.faults[fault.name] = self.faults.get(fault.name, 0) + 1
        if self.random.random() < 0.7:
            self.motion_begins()
        self.ticks(int(self.random.integers(0, 60)))
        self.obey(fault.given)
        self.seconds(fault.lasts)
        for each in fault.heal:
            self.obey(each)
        self.seconds(float(self.random.uniform(0.0, 1.5)))

    def part(self) -> None:
        """Torque for some joints alone, and off again."""
        self.call(link.Disarm)
        self.call(link.AcquireLease)
        count = len(self.far)
        some = sorted(self.random.choice(count, size=int(self.random.integers(1, count + 1)), replace=False))
        self.call(link.Arm, joints=[int(each) for each in some])
        self.seconds(float(self.random.uniform(0.1, 3.0)))
        self.call(link.Disarm)

    def other_mode(self) -> None:
        """The bus read only, or closed, and live again; motions go to the simulation meanwhile."""
        self.call(link.Disarm)
        self.until(lambda: self.rig.loop.procedures.rank is None, 15.0)
        self.call(link.SetMode, mode=str(self.random.choice(["mirror", "sim"])))
        for _ in range(int(self.random.integers(0, 3))):
            self.motion()
        self.call(link.Cancel)
        self.until(lambda: self.rig.loop.executor.motion in (Motion.IDLE, Motion.HOLDING), 3.0)
        self.call(link.SetMode, mode="live")
        self.seconds(float(self.random.uniform(0.1, 2.0)))

    def reload(self) -> None:
        """Settings are read again while whatever goes on."""
        self.rig.adopt({"thresholds.latency_warn_ms": float(self.random.uniform(15.0, 40.0))}, reread=False)
        self.rig.front.forget_briefings()

    def motion_begins(self) -> None:
        """Everybody on the way, and left so."""
        rig = self.rig
        if rig.loop.executor.reference is None or rig.loop.executor.motion is Motion.IDLE:
            return
        self.call(link.AcquireLease)
        way = np.array([self.base + self.random.random() * (self.far - self.base), self.base])
        everybody = np.ones(len(self.far), np.bool_)
        rig.submit(
            Trajectory(np.array([2.0, 4.0]), way, everybody, np.zeros_like(way)), more=True, policy="retime"
        )

    def obey(self, given: Order) -> None:
        """An order to its bus, or to each."""
        self._hand |= given["fault"] == "hand"
        for name, bus in self.rig.virtual.items():
            if given.get("bus", name) == name:
                fault, parameters = arguments(given, known(bus))
                bus.advance(self.rig.clock.now())
                getattr(bus.faults, fault)(**parameters)

    # ------------------------------------------------------------------------------------ back

    def ready(self) -> None:
        """Armed, by commands, from whatever there is, within `BACK`. What cannot be is wrong."""
        loop = self.rig.loop
        begun = self.rig.clock.now()
        said = ""
        while loop.condition.state is not RobotState.ARMED or loop.condition.latches:
            if self.rig.clock.now() - begun > BACK:
                latched = sorted(loop.condition.latches)
                self.wrong.append(
                    f"{self.rig.clock.now():.2f} no way back: {loop.condition.state.value} {latched} {said}"
                )
                return
            if loop.condition.latches or torque_inherited(loop) or loop.procedures.rank is not None:
                self.call(link.Disarm if self.random.random() < 0.7 else link.EStop)
                self.until(lambda: loop.procedures.rank is None, 15.0)
                self.call(link.Reset)
            self.until(lambda: loop.condition.state is RobotState.CONNECTED, 3.0)
            self.seconds(1.1)
            self.call(link.AcquireLease)
            reply = self.call(link.Arm)
            said = str(reply)[:300] if reply is not None else ""
            if reply is not None:
                self._remedy(reply)
        self._hand = False

    def _remedy(self, refused: link.Reply) -> None:
        """Do what a refusal to arm asks: restart servos, turn a joint back that a hand turned too far."""
        for finding in refused.parameters.get("findings") or ():
            if finding["joint"] is None:
                continue
            if finding["code"] == "SERVO_ALERT" or "restart it" in finding["message"]:
                self._restart(self.rig.robot.joints[finding["joint"]])
            elif "by hand" in finding["message"]:
                if not self._hand:
                    self.wrong.append(f"{self.rig.clock.now():.2f} no hand moved it: {finding}")
                joint = self.rig.robot.joints[finding["joint"]]
                hand: Order = {"fault": "hand", "bus": joint.bus, "id": joint.id}
                rad = float(self.base[finding["joint"]])
                self.obey(hand | {"rad": rad, "speed": 3.0})
                self.seconds(1.5)
                self.obey(hand | {"off": True})
                self.acts["by hand"] = self.acts.get("by hand", 0) + 1

    def _restart(self, joint: JointSpec) -> None:
        """Restart a device that shut down; of one without a restart the supply is switched."""
        reply = self.call(link.Reboot, bus=joint.bus, id=joint.id)
        if self.rig.virtual[joint.bus].kind == "can" and (reply is None or reply.error is not None):
            power: Order = {"fault": "power", "bus": joint.bus, "id": joint.id}
            self.obey(power | {"on": False})
            self.seconds(0.3)
            self.obey(power | {"on": True})
        self.seconds(0.3)

    def live(self, hours: float) -> dict[str, Any]:
        """So long, or until ten things were wrong."""
        begun = self.rig.clock.now()
        cpu = time.process_time()
        acts = (
            self.motion,
            self.stream,
            self.cancel,
            self.leave,
            self.idle,
            self.lie_down,
            self.stop,
            self.fault,
            self.part,
            self.other_mode,
            self.reload,
        )
        weights = np.array([8.0, 4.0, 1.0, 1.0, 3.0, 0.6, 0.6, 1.5, 0.3, 0.3, 0.5])
        self.reload()  # from now on a briefing is kept
        while self.rig.clock.now() - begun < 3600.0 * hours and len(self.wrong) < 10:
            if self.rig.loop.condition.state is not RobotState.ARMED or self.rig.loop.condition.latches:
                self.ready()
            act = acts[int(self.random.choice(len(acts), p=weights / weights.sum()))]
            act()
            self.acts[act.__name__] = self.acts.get(act.__name__, 0) + 1
        lived = (self.rig.clock.now() - begun) / 3600.0
        cpu = time.process_time() - cpu
        packets = sum(monitor.sent_packets for monitor in self.tap.monitors.values())
        figures: dict[str, Any] = {"robot": self.robot, "hours": round(lived, 3), "cpu_s": round(cpu, 1)}
        figures |= {"packets": packets, "moved": self.moved, "unmonitored": self.tap.unmonitored}
        figures["hours_per_s"] = round(lived / cpu, 5)
        if 2 * self.moved < self.acts.get("motion", 0):
            self.wrong.append(f"{self.moved} of {self.acts['motion']} motions were accepted: a life at rest")
        self.wrong += self.growth.wrong()
        self.close()
        return (
            figures | {"acts": self.acts, "faults": self.faults, "wrong": self.wrong} | self.growth_figures()
        )

    def growth_figures(self) -> dict[str, Any]:
        return self.growth.figures() if len(self.growth.time) > 3 else {}
