"""A robot with legs on CAN under the fake clock: the same world, whose actuators are of two kinds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.proof.faults.fault import Fault
from tests.proof.faults.robot import TICK
from tests.proof.faults.world import World
from tests.support.daemon_rig import Rig
from tests.support.fault_cases import Order
from twind.robot.modes import RobotState

ROBOT = "h24-mixed"
LEGS = ("l_leg", "r_leg")
TRIP = 0.12  # s after the last frame, that an actuator's own watchdog has let go
COUNTS = 3.0  # of 16384 a turn: 1.2 mrad
TRUE = {"goal_position": "goal", "torque_enable": "torque"}


class MixedRig(Rig):
    """Registers and shafts of actuators of both kinds, bus after bus: a CAN node's are what is true of it."""

    def nodes(self, bus: Any) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = bus.truth(self.clock.now())
        return found

    @property
    def counts(self) -> NDArray[np.float64]:
        """(m,) shafts, each in its own counts."""
        self.advance_servos()
        rows = [
            bus.servos.muscles.position.copy()
            if bus.kind != "can"
            else np.array([node["position"] for node in self.nodes(bus)])
            for bus in self.virtual.values()
        ]
        return np.concatenate(rows)

    def register(self, key: str) -> np.ndarray:
        """(m,) a goal, a torque; of a watchdog 255 where it has tripped."""
        rows = []
        for bus in self.virtual.values():
            if bus.kind != "can":
                rows.append(np.asarray(bus.servos[key]))
            elif key in TRUE:
                rows.append(np.array([round(float(node[TRUE[key]])) for node in self.nodes(bus)]))
            else:
                rows.append(np.array([255 if node["tripped"] else 5 for node in self.nodes(bus)]))
        return np.concatenate(rows)


class CanWorld(World):
    """`leg` is the CAN bus that it happens on, `id` one of its nodes and `joint` its joint."""

    def __init__(self, fault: Fault, seed: int) -> None:
        super().__init__(fault, seed)
        self.bus = str(self.random.choice(LEGS))

    # ------------------------------------------------------------------------------------ making

    def live(self, robot: str = ROBOT, *, judge: bool = False, **how: Any) -> Rig:
        """A daemon in live mode, everybody identified."""
        if self.free:
            how.setdefault("support", "free")
            self.also |= {"DAMP", "FOLLOW_ERR", "SETTLE", "MIRROR_DRIFT"}
        rig = self.take(MixedRig(ROBOT, **how))
        for _ in range(300):
            self.ticks(1)
            if rig.loop.condition.state is RobotState.CONNECTED:
                return rig
        raise AssertionError("never connected")

    def moving(self, robot: str = ROBOT, *, far: float = 0.0, **how: Any) -> Rig:
        """The same, armed and on its way; `joint` is one of `bus`."""
        rig = self.armed(robot, **how)
        mine = [at for at, joint in enumerate(rig.robot.joints) if joint.bus == self.bus]
        self.joint = int(self.random.choice([at for at in mine if abs(self.clear[rig.names[at]]) >= far]))
        self.id = self.id_of(self.joint)
        self.move()
        self.ticks(int(self.random.integers(20, 120)))
        return rig

    # ------------------------------------------------------------------------------------ injecting

    def on_bus(self, fault: str, **given: Any) -> Order:
        """An order to the bus that it happens on."""
        return {"fault": fault, "bus": self.bus, **given}

    # ------------------------------------------------------------------------------------ what must be seen

    def left(self, bound: float, codes: tuple[str, ...] = ("CAN_BUS_STATE",)) -> list[int]:
        """The bus is given up in time: its actuators let go by themselves, the others hold or are lowered."""
        rig = self.rig
        mine = self.of_bus(self.bus)
        self.latches(bound, codes)
        self.claim(
            rig.loop.condition.state is RobotState.FAULT, f"state {rig.loop.condition.state.value}, not fault"
        )
        self.seconds(max(0.0, self.begun + 0.3 - self.now))
        (port,) = [port for port in rig.loop.hardware.ports if port.name == self.bus]
        self.claim(not port.holding, "goals still go to the bus that nobody hears us on")
        off = rig.register("torque_enable")[mine]
        self.claim(not off.any(), "an actuator that hears nothing keeps its torque past its watchdog")
        delays = [node["trip_delay"] for node in rig.virtual[self.bus].truth(self.now) if node["tripped"]]
        self.claim(all(delay <= TRIP for delay in delays), f"a watchdog was late: {delays}")
        self.limp(mine)
        if self.free:
            self.settles(11.0, but=mine)
            self.sinks(but=mine)
        else:
            self.holds(self.now, 1.0, but=mine)
        return mine

    def limp(self, mine: list[int]) -> None:
        """A leg without torque does not follow when the rest is lowered: soon it is too far off, and what
        comes down with it is damped (FOLLOW_ERR). Nobody else may end so."""
        if not self.rig.register("torque_enable")[mine].any():
            self.also.add("DAMP")

    def latches(self, bound: float, codes: tuple[str, ...]) -> None:
        """Like `detected`, but that it is a fault by then; that many errors are told before is no matter."""
        self.until(
            lambda: bool(set(codes) & set(self.rig.loop.condition.latches)),
            self.begun + bound + 0.3 - self.now,
        )
        self.latched(*codes)
        delay = self.now - self.begun
        self.outcome.delay = delay
        self.outcome.bound = bound
        late = f"latched after {delay:.3f} s, bound {bound:.3f} s and the tick in which it is looked at"
        self.claim(delay <= bound + TICK + 1e-6, late)

    def back(self, mine: list[int], *heal: Order) -> None:
        """Healed: everybody is identified, nothing of before moves anybody, nobody is armed."""
        rig = self.rig
        self.seconds(float(self.random.uniform(0.05, 1.0)))
        since = self.now
        places = rig.counts[mine]
        self.obey(*heal)
        self.seconds(0.5)
        found = self.until(lambda: rig.loop.hardware.connected, 3.0)
        self.claim(found, "not identified within 3 s")
        self.stays_so()
        moved = np.abs(self.trace.place(since)[:, mine] - places).max()
        self.claim(moved <= COUNTS, f"an actuator moved {moved:.1f} counts when its bus came back")
        self.claim(not self.trace.torque(since)[:, mine].any(), "torque came on when the bus came back")
        self.claim(
            rig.loop.condition.state is RobotState.FAULT, f"state {rig.loop.condition.state.value}, not fault"
        )
        self.recover()

    def recover(self) -> None:
        """Torque off, acknowledged, who shut down restarted, armed, moving: by commands alone."""
        rig = self.rig
        try:
            self._down()
            for bus in rig.virtual.values():
                for node in bus.truth(self.now) if bus.kind == "can" else ():
                    if node["fault"]:  # a Damiao has no restart: its power is switched
                        self.obey({"fault": "power", "bus": bus.name, "on": False, "id": node["id"]})
                        self.seconds(0.3)
                        self.obey({"fault": "power", "bus": bus.name, "on": True, "id": node["id"]})
            self.seconds(1.1)
            connected = self.until(lambda: rig.loop.condition.state is RobotState.CONNECTED, 5.0)
            assert connected, f"state {rig.loop.condition.state.value} after a reset"
            self.arm()
            self.joint = int(self.random.integers(len(rig.names)))
            self.move()
            since = self.now
            self.seconds(1.5)
            moved = np.ptp(self.trace.place(since)[:, self.row(self.joint)])
            assert moved > 20, f"armed again, and {rig.names[self.joint]} moves {moved:.0f} counts"
        except AssertionError as error:
            self.blame(f"no way back: {error}")
