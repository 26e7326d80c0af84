"""Key of a state: equal keys mean that the loop goes on alike. Times count from now, so that states recur."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import GeneratorType
from typing import TYPE_CHECKING, Any

import numpy as np

from tests.proof.statespace.world import BEGIN
from tests.support.procedure_rig import BusTask
from twind.loop.ipc.call_outcome import CallFailure
from twind.loop.procedures.procedure_runner import Priority, RunningProcedure
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.finding import Finding
from twind.robot.trajectory import Reference
from twind.safety.lease import Lease
from twind.safety.state_machine import StateLatch

if TYPE_CHECKING:
    from tests.proof.statespace.world import ModelWorld

LONG = 6.0  # s: older times are alike: no procedure waits longer
PLAIN = (str, bytes, bool, int, type(None), Enum)
DIGITS = 2  # of an angle in rad: the least that a procedure tells apart is 0.02


def state_key(world: ModelWorld) -> tuple[Any, ...]:
    """Return the key of the present state. Left out: texts of findings, and counters of reports."""
    loop = world.loop
    hardware = world.hardware
    key = Key(world.clock.now(), vars(loop.executor)["_tick"])
    return (
        key.of(vars(loop.condition)["_latch"]),
        tuple(sorted(loop.condition.latches)),
        loop.condition.stop_wanted,
        loop.condition.finished,
        tuple((name, key.of(value)) for name, value in vars(loop.torque).items()),
        key.procedure(vars(loop.procedures)["_torque"]),
        tuple(key.procedure(other) for other in vars(loop.procedures)["_others"]),
        tuple(
            (port.link, port.prepared, port.holding, port.writer is None, port.identification is None)
            for port in hardware.ports
        ),
        key.of(hardware.left_out),
        key.of(hardware.slow.torque),
        key.of(hardware.slow.watchdog),
        key.of(max(hardware.quiet_until, BEGIN)),
        key.of(vars(world.truth)),
        tuple(lost.bus for lost in hardware.lost),
        key.executor(loop.executor),
        key.of(loop.robot.written),
        key.of(loop.robot.measured.age),
        key.lease(world.lease),
        vars(loop.commands)["_arming_client"] if loop.procedures.rank is Priority.ARM else 0,
        bool(vars(loop.commands.stops)["_waiting"]),
        key.of(loop.identity.verified.turn_known),
        world.claims.memory,
    )


class Key:
    """Values as hashable ones; `now`: s, `tick`: the executor's."""

    def __init__(self, now: float, tick: int) -> None:
        self._now = now
        self._tick = tick

    def of(self, value: Any) -> Any:
        """Return a value by what it holds, to some depth; what is no data by its type."""
        if isinstance(value, float):
            return self._number(value)
        if isinstance(value, PLAIN):
            return value
        if isinstance(value, np.ndarray):
            rounded = np.round(value, DIGITS) + 0.0 if value.dtype.kind == "f" else value
            return rounded.tobytes()
        if isinstance(value, tuple | list):
            return tuple(self.of(each) for each in value)
        if isinstance(value, Mapping):
            return tuple((name, self.of(each)) for name, each in value.items())
        if isinstance(value, StateLatch):
            return value
        if isinstance(value, Reference):
            return self.of((value.position, value.velocity))
        if isinstance(value, Finding):
            return value.code
        if isinstance(value, BusTask):
            return value.done, value.error is None
        if isinstance(value, CallFailure):
            return value.error
        if isinstance(value, GeneratorType):
            return self._generator(value)
        return type(value).__name__

    def _number(self, value: float) -> float:
        if BEGIN / 2 <= value < 2 * BEGIN:
            return round(max(value - self._now, -LONG), 3)
        return round(value, 6)

    def procedure(self, running: RunningProcedure | None) -> Any:
        """Return where a procedure is, and its values."""
        if running is None:
            return None
        return getattr(running, "rank", None), self.of(running.body), running.broken

    def _generator(self, body: GeneratorType[Any, Any, Any]) -> Any:
        frame = body.gi_frame
        if frame is None:
            return None
        names = {name: self.of(value) for name, value in frame.f_locals.items() if name != "here"}
        inner = None if body.gi_yieldfrom is None else self.of(body.gi_yieldfrom)
        return body.__qualname__, frame.f_lasti, tuple(sorted(names.items(), key=lambda each: each[0])), inner

    def lease(self, lease: Lease) -> Any:
        """Return the holder and the time left."""
        held = vars(lease)
        if not held["_client"]:
            return None
        return held["_client"], self.of(held["_renewed"]), held["_term"], len(held["_pins"])

    def executor(self, executor: TrajectoryExecutor) -> Any:
        """Return the motion, and how far it is."""
        floor = vars(executor)["_floor"]
        return (
            executor.motion,
            self.of(executor.reference),
            tuple((layer.goal.id, self.of(layer.fraction(self._tick))) for layer in executor.layers),
            self.of({} if floor is None else _values(floor)),
            executor.stream is None,
            vars(executor)["_yielding"] is None,
            executor.waiting,
        )


def _values(each: Any) -> Mapping[str, Any]:
    found = vars(each)
    return {name: value for name, value in found.items() if name != "_steps"} | {"": type(each).__name__}
