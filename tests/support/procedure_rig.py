"""Procedures without a daemon: real executor, states, torque and runner, on buses that the test scripts.

Three joints on two buses. Each request to the devices is written down by name and done a tick later; a test
orders which one fails. Joints follow their goals while they are held.
"""

from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.support.gate_rig import limits, ratings
from twind import link
from twind.loop.bus.bus_wait import all_of
from twind.loop.ipc.call_outcome import CallOutcome
from twind.loop.ipc.responder import Responder
from twind.loop.procedures.controlled_robot import ControlledRobot, RobotInForce
from twind.loop.procedures.procedure_runner import Priority, Procedure, ProcedureRunner
from twind.loop.procedures.robot_condition import RobotCondition
from twind.loop.procedures.torque_release import TorqueRelease
from twind.loop.procedures.torque_state import TorqueState
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.arrays import Bools, Floats
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.joint_state import JointState
from twind.robot.modes import Mode
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import BusError, NoReply
from twind_drivers.clock import FakeClock

PERIOD = 0.01
NAMES = ("hip", "knee", "toe")
REST = np.array([0.0, 0.1, -0.1])
PLACE = np.array([0.4, 0.5, -0.5])  # where the robot begins
RESOLUTION = 0.001  # rad per tick
SILENT = NoReply("upper", (7,), 0.1)
BROKEN = BusError("the bus is broken")
WHY = Finding(ReasonCode.FOLLOW_ERR, 1, value=0.6, bound=0.5, message="rad: ordered by the test")


@dataclass(eq=False)
class BusTask:
    """One request: done at the end of the tick, with the error that was ordered."""

    error: BusError | None = None
    result: Any = None
    done: bool = False


class ScriptedHardware:
    """Buses of three joints: `log` lists what was asked of them, `failing` what goes wrong there, by name."""

    def __init__(self, clock: FakeClock) -> None:
        count = len(NAMES)
        self.clock = clock
        self.log: list[str] = []
        self.failing: dict[str, BusError | Sequence[BusError | None]] = {}
        self.results: dict[str, Any] = {}
        self.slow = SimpleNamespace(
            torque=np.zeros(count, np.int8), watchdog=np.full(count, 5, np.int16), status_time=np.zeros(count)
        )
        self.ports = [
            SimpleNamespace(name=name, reader=object(), trouble="", writer=object(), holding=False)
            for name in ("lower", "upper")
        ]
        self.writers = [
            SimpleNamespace(cut=lambda bus=bus: self.log.append(f"cut {bus}")) for bus in range(2)
        ]
        self.left_out: Bools = np.zeros(count, np.bool_)
        self.back: Bools = np.zeros(count, np.bool_)  # joints on a bus that is back, and gets no goals yet
        self.away: Bools = np.zeros(count, np.bool_)  # joints on a bus that is closed
        self.resolution = np.full(count, RESOLUTION)
        self.quiet_until = 0.0
        self.connected = True
        self.readings = SimpleNamespace(
            raw=SimpleNamespace(ticks=np.zeros(count, np.int64)), shift=np.zeros(count, np.int64)
        )
        self.holding = False
        self.goals: list[Floats] = []  # positions with each request that has some
        self.among: Bools | None = None
        self.obeyed = True  # the registers hold the goals that were written
        self.written: Callable[[], Floats | None] = lambda: None
        self.given_up: list[int] = []
        self.tasks: list[BusTask] = []
        self._counts: Counter[str] = Counter()

    @property
    def energised_joints(self) -> Bools:
        return np.full(len(NAMES), self.holding) & ~self.left_out & ~self.back & ~self.away

    @property
    def open(self) -> Bools:
        return ~self.away

    def _task(self, name: str) -> list[Any]:
        self.log.append(name)
        ordered = self.failing.get(name)
        if isinstance(ordered, list | tuple):
            place = self._counts[name]
            ordered = ordered[place] if place < len(ordered) else None
        self._counts[name] += 1
        task = BusTask(ordered, self.results.get(name))  # type: ignore[arg-type]
        self.tasks.append(task)
        return [task]

    def serve(self) -> None:
        """Every request is done."""
        for task in self.tasks:
            task.done = True
        self.tasks.clear()

    def access(self, *, read: bool, write: bool) -> None:
        self.log.append(f"access read {read} write {write}")

    def clear(self) -> None:
        self.log.append("clear")

    def hold(self, on: bool) -> None:
        self.log.append(f"hold {on}")
        self.holding = on
        self.left_out = self.left_out & on
        if on:
            self.back = np.zeros_like(self.back)

    def prepare(self, position: Floats, among: Bools | None = None) -> list[Any]:
        self.goals.append(position.copy())
        self.among = among
        self.left_out = np.zeros(len(NAMES), np.bool_) if among is None else ~among
        return self._task("prepare")

    def prepare_back(self, position: Floats, among: Bools | None = None) -> list[Any]:
        self.goals.append(position.copy())
        self.among = among
        return self._task("prepare back") if self.back.any() else []

    def write_goals(self, position: Floats) -> list[Any]:
        self.goals.append(position.copy())
        return self._task("write goals")

    def torque(self, on: bool) -> list[Any]:
        return self._task(f"torque {on}")

    def damp(self) -> list[Any]:
        return self._task("damp")

    def read_goals(self) -> Generator[None, float, Floats]:
        yield from all_of(self._task("read goals"))
        last = self.written()
        return np.full(len(NAMES), np.nan) if last is None or not self.obeyed else last

    def reachable(self, position: Floats) -> Floats:
        return np.clip(position, -2.0, 2.0)

    def quantised(self, position: Floats) -> Floats:
        return np.round(position / RESOLUTION) * RESOLUTION

    def give_up(self, bus: int, why: str) -> None:
        self.given_up.append(bus)


class ReportBook:
    """End of the link: keeps replies and events."""

    def __init__(self) -> None:
        self.replies: list[link.Reply] = []
        self.events: list[link.Event] = []

    def reply(self, reply: link.Reply) -> None:
        self.replies.append(reply)

    def event(self, event: Any) -> None:
        self.events.append(event)

    def sequence(self) -> int:
        return len(self.events) + 1


def _described(count: int) -> Any:
    """Robot file with as many joints, whose types know a remedy for a lost turn."""
    joint = SimpleNamespace(type=SimpleNamespace(lost_turn_remedy="set its offset to 0"))
    return SimpleNamespace(file=SimpleNamespace(joints=[joint] * count))


class ProcedureRig:
    """A `ProcedureContext` whose robot does what the test says. Live and connected."""

    def __init__(self, *, support: str = "gantry", period: float = PERIOD) -> None:
        self.clock = FakeClock(100.0)
        self.book = ReportBook()
        self.reports: Any = Responder(self.book, self.clock)  # type: ignore[arg-type]
        self.condition = RobotCondition(Mode.LIVE, self.reports)
        self.procedures = ProcedureRunner(lambda: self.condition.cause)
        self.torque = TorqueState(len(NAMES))
        bounds = limits(3, velocity=2.0, acceleration=10.0)
        buses = (
            SimpleNamespace(name="lower", ids=(1, 2), joints=np.array([0, 1])),
            SimpleNamespace(name="upper", ids=(7,), joints=np.array([2])),
        )
        joints: Any = JointNames(buses)
        described = RobotInForce(_described(3), joints, bounds, ratings(3), REST, support, period)
        self.robot = ControlledRobot(described, None, self.state(PLACE))
        self.robot.measured = self.state(PLACE)
        self.hardware: Any = ScriptedHardware(self.clock)
        self.hardware.written = lambda: self.robot.written
        self.executor: Any = TrajectoryExecutor(bounds, period)
        self.follows = True  # joints follow their goals
        self.outcomes: list[CallOutcome | None] = []
        self.verified: Any = SimpleNamespace(unjudged=np.zeros(3, np.bool_))
        self.extended: list[float] = []
        self.halted = 0
        notifier: Any = SimpleNamespace(extend=self.extended.append)
        twin: Any = SimpleNamespace(halt=self._halt)
        self.release = TorqueRelease(self, self.verified, notifier, twin)
        self.condition.change(RobotEvent.PORT_OPENED)
        self.condition.change(RobotEvent.IDENTIFIED)
        self.book.events.clear()
        self.watched: Callable[[], None] = lambda: None  # called once a tick

    def _halt(self) -> None:
        self.halted += 1

    def state(self, position: Floats, velocity: float = 0.0, age: float = 0.0) -> JointState:
        """A reading of all joints, taken now."""
        count = len(position)
        return JointState(
            self.clock.now(),
            np.array(position, np.float64),
            np.full(count, velocity),
            np.zeros(count),
            np.full(count, age),
            np.ones(count, np.bool_),
        )

    def read(self, **values: Any) -> None:
        """The next readings have these values, and joints follow no goal any more."""
        self.follows = False
        self.robot.measured = replace(self.robot.measured, **values)

    def hold(self, place: Floats = PLACE) -> None:
        """The robot is armed and holds."""
        self.hardware.holding = True
        self.torque.take_hold(np.ones(len(NAMES), np.bool_))
        self.executor.begin(place)
        self.robot.written = place
        self.robot.measured = self.state(place)
        self.hardware.slow.torque[:] = 1
        self.condition.change(RobotEvent.ARM)
        self.condition.change(RobotEvent.ARMED)
        self.book.events.clear()

    def found(self, torque: Sequence[int] = (1, 1, 1)) -> None:
        """Torque was on when the daemon began."""
        self.hardware.slow.torque[:] = torque

    def own(self, rank: Priority, start: Callable[[], Procedure]) -> bool:
        """Begin a procedure; its outcome is kept."""
        return self.procedures.own(rank, start, self.outcomes.append)

    def tick(self) -> None:
        """One period: procedures, goal, reading, and every request done."""
        self.clock.sleep_until(self.clock.now() + self.robot.period)
        now = self.clock.now()
        self.watched()
        self.procedures.step(now)
        goal = self.executor.goal(now)
        if goal is not None and self.torque.armed:
            self.robot.written = goal.position
        if self.follows and self.robot.written is not None and self.torque.armed:
            self.robot.measured = self.state(self.robot.written)
        else:
            self.robot.measured = replace(self.robot.measured, time=now)
        self.hardware.serve()

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.tick()

    def until_done(self, most: int = 2000) -> float:
        """Until no procedure owns the torque; s that took."""
        begun = self.clock.now()
        for _ in range(most):
            if self.procedures.rank is None:
                return self.clock.now() - begun
            self.tick()
        raise AssertionError(f"{self.procedures.rank} did not end: {self.hardware.log}")

    def run(self, body: Generator[None, float, Any], rank: Priority = Priority.FAULT) -> Any:
        """Run one part of a procedure to its end; return what it returns, or raise what it raises."""
        result: list[Any] = []

        def procedure() -> Procedure:
            try:
                result.append((yield from body))
            except BusError as error:
                result.append(error)
            return None

        assert self.own(rank, procedure)
        self.until_done()
        if isinstance(result[0], BusError):
            raise result[0]
        return result[0]

    def codes(self) -> list[str]:
        """Codes of all events."""
        return [event.code for event in self.book.events]

    def requests(self) -> list[str]:
        """Requests to the devices, without the clearing of the queue."""
        return [name for name in self.hardware.log if name not in ("clear",)]


class JointNames:
    """Joints of the rig in place of a `JointMap`."""

    def __init__(self, buses: Sequence[Any]) -> None:
        self.names = NAMES
        self.buses = buses
        self.turns: Any = None
        self.unwatched: tuple[int, ...] = ()
        self.transmission_groups: tuple[Any, ...] = ()
        self.calibrated = (True,) * len(NAMES)

    def __len__(self) -> int:
        return len(self.names)

    def on_bus(self, name: str) -> Bools:
        return np.array(
            [any(place in bus.joints for bus in self.buses if bus.name == name) for place in range(3)]
        )


def granted(now: float) -> Verdict:
    """The gate's verdict on an Arm that it allows."""
    return Verdict()
