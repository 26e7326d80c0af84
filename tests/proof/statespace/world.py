"""The real loop with its real state machines, on modelled buses: one step is an event and a tick.

Stand-ins: buses, guard (its decision is an event here), twin, clocks of the hops, publisher and front. A tick
lasts a second, so that ways and time limits are few ticks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np

from tests.proof.statespace.bus_model import COUNT, BusModel, DeviceTruth, model_joints
from tests.proof.statespace.claims import Claims
from tests.support.gate_rig import limits
from twind import link
from twind.loop.ipc.front_link import ReceivedCommand
from twind.loop.procedures.procedure_runner import Priority
from twind.loop.procedures.torque_release import STOPS
from twind.loop.tick.control_loop import Loop
from twind.loop.tick.loop_parts import LoopParts
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.joint_state import JointState
from twind.robot.modes import Mode
from twind.safety.device_rules import DeviceRules
from twind.safety.gate_types import GateThresholds
from twind.safety.guard_types import GuardDecision, GuardThresholds, Reaction
from twind.safety.lease import Lease
from twind_drivers.clock import FakeClock

PERIOD = 1.0  # s
READ = 0.02  # s from the reading of a tick to the next one
BEGIN = 1e6  # s; a number from BEGIN / 2 on is a time
REST = np.array([0.0, 0.1, -0.1])
HOLDER = 1
OTHER = 2
STRANGER = 3  # never holds the lease
MOST = 60  # ticks in which every procedure has ended
WHY = Finding(ReasonCode.FOLLOW_ERR, 1, value=0.6, bound=0.5, message="ordered by the search")
FINE = GuardDecision()
DEVICES = DeviceRules(np.zeros(COUNT, np.bool_), free=False, bounds=GuardThresholds())


def nothing(*_args: Any, **_named: Any) -> Any:
    """Do nothing."""


class CommandQueue:
    """The front's end of the link: commands in, replies kept for one tick."""

    def __init__(self) -> None:
        self.lost = False
        self.no_front = ""
        self.dropped = 0
        self.queue: list[ReceivedCommand] = []
        self.replies: list[link.Reply] = []
        self.reset_ticket = -1
        self.obeyed: Callable[[], None] = nothing  # a reset was obeyed
        self.supervise_front = self.set_briefing = self.ask_reread = self.event = nothing
        self.state = self.flush = self.close = nothing

    def commands(self, now: float) -> list[ReceivedCommand]:
        """Everything that was sent since the last tick."""
        taken = self.queue
        self.queue = []
        return taken

    def reply(self, reply: link.Reply) -> None:
        """Keep a reply."""
        self.replies.append(reply)
        if reply.ticket == self.reset_ticket and reply.error is None:
            self.obeyed()

    def sequence(self) -> int:
        """Events are not counted."""
        return 1


class ModelWorld:
    """One history: `step` goes on with it. Raises `ClaimBroken`."""

    def __init__(self, support: str = "gantry") -> None:
        self.support = support
        self.clock = FakeClock(BEGIN)
        self.truth = DeviceTruth(REST)
        self._bounds = limits(COUNT, velocity=0.5, acceleration=0.5)
        self._ticket = 0
        self.birth()
        while str(self.loop.condition.state) != "connected":
            self.tick()

    def birth(self) -> None:
        """A daemon begins on these devices as they are."""
        self.hardware: Any = BusModel(self.clock, self.truth)
        self.decision = FINE
        self.front: Any = CommandQueue()
        self.lease = Lease()
        joints: Any = model_joints()
        file = SimpleNamespace(
            joints=[SimpleNamespace(type=SimpleNamespace(lost_turn_remedy=""))] * COUNT,
            support=self.support,
            fall=None,
        )
        binding = SimpleNamespace(
            joint_map=joints, limits=self._bounds, ratings=ActuatorRatings.unknown(COUNT), rest=REST
        )
        bound = SimpleNamespace(file=file, binding=binding, judge=lambda devices: Verdict())
        parts: Any = LoopParts(
            clock=self.clock,
            period=PERIOD,
            bound=bound,  # type: ignore[arg-type]
            hardware=self.hardware,
            twin=SimpleNamespace(  # type: ignore[arg-type]
                update=self._simulated, place=nothing, halt=nothing, resets=0, halted=False
            ),
            executor=TrajectoryExecutor(self._bounds, PERIOD),
            guard=SimpleNamespace(  # type: ignore[arg-type]
                judge=self._judge, bars=(), holding=lambda *args: (), contact=None, devices=DEVICES
            ),
            lease=self.lease,
            health=SimpleNamespace(  # type: ignore[arg-type]
                latency=lambda now: 0.0,
                latency_p95=lambda now: 0.0,
                hop=nothing,
                update=nothing,
                alerts=lambda: (),
            ),
            way=SimpleNamespace(  # type: ignore[arg-type]
                **dict.fromkeys(
                    ("forget", "silence", "end", "write", "look", "take", "judge", "accept"), nothing
                )
            ),
            thresholds=GateThresholds(),
            link=self.front,
            notifier=SimpleNamespace(extend=nothing, send=nothing),  # type: ignore[arg-type]
            realtime={},
            live_denied=None,
        )
        self.loop = Loop(parts, Mode.LIVE)
        self.loop.publisher = SimpleNamespace(publish=nothing)  # type: ignore[assignment]
        self.hardware.written = lambda: self.loop.robot.written
        self.claims = Claims(self)
        self.hardware.watch = self.claims.request
        self.hardware.on_loss = self.claims.lose
        self.front.obeyed = self.claims.reset

    def _simulated(self, measured: Any, goal: Any, now: float) -> JointState:
        still = np.zeros(COUNT)
        return JointState(now, REST, still, still, still, np.ones(COUNT, np.bool_))

    def _judge(self, facts: Any) -> GuardDecision:
        decision = self.decision
        self.decision = FINE
        if decision.latches:
            self.claims.stop()
        return decision

    # ------------------------------------------------------------------------- steps

    def send(self, kind: type[link.Command], client: int = HOLDER, **parameters: Any) -> int:
        """A call of a client; its ticket."""
        self._ticket += 1
        self.front.queue.append(
            ReceivedCommand(kind(ticket=self._ticket, client=client, uid=0, holder="model", **parameters))
        )
        return self._ticket

    def tick(self, *, fails: bool = False) -> None:
        """One period. With `fails` every request that waits fails at its end."""
        now = self.clock.now() + READ
        self.clock.sleep_until(now)
        self.front.replies.clear()
        self.loop.tick(now)
        self.clock.sleep_until(now + PERIOD - READ)
        self.loop.robot.measured = replace(self.loop.robot.measured, time=self.clock.now())
        if fails:
            self.hardware.fail()
        self.hardware.serve()
        self.claims.after_tick()

    def step(self, name: str) -> None:
        """One event and its tick."""
        STEPS[name](self)


def _tick(world: ModelWorld) -> None:
    world.tick()


def _fail(world: ModelWorld) -> None:
    world.tick(fails=True)


def _rest(world: ModelWorld) -> None:
    for _ in range(MOST):
        world.tick()
        if world.loop.procedures.rank is None or world.loop.condition.finished:
            return
    raise AssertionError(f"{world.loop.procedures.rank} did not end within {MOST} ticks")


def _arm(world: ModelWorld) -> None:
    world.send(link.AcquireLease)
    world.send(link.Arm)
    if world.loop.procedures.rank is None and world.lease.holder_client(world.clock.now()) in (0, HOLDER):
        world.claims.arm(leased=True)
    world.tick()


def _arm_unleased(world: ModelWorld) -> None:
    world.send(link.Arm, STRANGER)
    if world.loop.procedures.rank is None:
        world.claims.arm(leased=False)
    world.tick()


def _taken(world: ModelWorld) -> None:
    world.send(link.AcquireLease, OTHER, take=True)
    world.tick()


def _move(world: ModelWorld) -> None:
    world.send(link.AcquireLease)
    world.send(link.Setpoint, joints=[0], positions=[0.005])
    world.tick()


def _stop(level: str, *, fails: bool = False) -> Callable[[ModelWorld], None]:
    def run(world: ModelWorld) -> None:
        world.send(link.EStop, STRANGER, level=level)
        world.claims.stop(level)
        world.claims.release(STOPS[level])
        world.tick(fails=fails)

    return run


def _reset(world: ModelWorld) -> None:
    world.front.reset_ticket = world.send(link.Reset)
    world.tick()


def _guard(decision: GuardDecision) -> Callable[[ModelWorld], None]:
    def run(world: ModelWorld) -> None:
        world.decision = decision
        world.tick()

    return run


def _disarm(world: ModelWorld) -> None:
    world.send(link.Disarm)
    world.claims.release(Priority.DISARM)
    world.tick()


def _client_killed(world: ModelWorld) -> None:
    world.front.queue.append(ReceivedCommand(link.ConnectionClosed(client=HOLDER)))
    world.tick()


def _front_killed(world: ModelWorld) -> None:
    world.front.lost = True
    world.tick()


def _loop_killed(world: ModelWorld) -> None:
    world.truth.tripped |= world.truth.torque
    world.birth()
    world.tick()


def _terminated(world: ModelWorld) -> None:
    world.loop.condition.stop_wanted = True
    world.tick()


def _unplugged(number: int) -> Callable[[ModelWorld], None]:
    def run(world: ModelWorld) -> None:
        world.truth.plugged[number] = False
        world.tick()

    return run


def _plugged(world: ModelWorld) -> None:
    world.truth.plugged = [True, True]
    world.tick()


def _latching(reaction: Reaction) -> GuardDecision:
    return GuardDecision(reaction, (WHY,), latches=True, causes=(WHY,))


STEPS: Mapping[str, Callable[[ModelWorld], None]] = MappingProxyType(
    {
        "tick": _tick,
        "tick, requests fail": _fail,
        "until no procedure runs": _rest,
        "arm": _arm,
        "arm without the lease": _arm_unleased,
        "lease taken": _taken,
        "setpoint": _move,
        "e-stop settle": _stop("settle"),
        "e-stop cut": _stop("cut"),
        "e-stop cut, requests fail": _stop("cut", fails=True),
        "reset": _reset,
        "disarm": _disarm,
        "client killed": _client_killed,
        "front killed": _front_killed,
        "loop killed": _loop_killed,
        "SIGTERM": _terminated,
        "lower bus lost": _unplugged(0),
        "upper bus lost": _unplugged(1),
        "buses back": _plugged,
        "guard: hold": _guard(GuardDecision(Reaction.HOLD, (WHY,), causes=(WHY,))),
        "guard: settle": _guard(_latching(Reaction.SETTLE)),
        "guard: damp": _guard(_latching(Reaction.DAMP)),
        "guard: inhibit": _guard(_latching(Reaction.INHIBIT)),
    }
)

# The histories that are searched to their end.
CORE = (
    "tick",
    "arm",
    "e-stop settle",
    "e-stop cut",
    "e-stop cut, requests fail",
    "reset",
    "disarm",
    "lower bus lost",
    "buses back",
    "loop killed",
    "client killed",
    "front killed",
    "tick, requests fail",
    "SIGTERM",
)
