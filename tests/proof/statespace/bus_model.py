"""Buses whose devices obey as is worst: torque is on once it is ordered, and off once that is confirmed.

Two buses of three joints. A request is done at the end of its tick; one that is failed may have been obeyed.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.support.procedure_rig import NAMES, BusTask, JointNames, ScriptedHardware
from twind.loop.bus.bus_port import PortLost, PortState
from twind.robot.arrays import Bools, Floats
from twind.robot.joint_state import JointState
from twind_drivers.bus import TRIPPED, BusError, PortError
from twind_drivers.clock import FakeClock

COUNT = len(NAMES)


class DeviceTruth:
    """The devices, which outlive the daemon: torque, watchdog, position, and which buses are plugged in."""

    def __init__(self, position: Floats) -> None:
        """`position` (n,): rad, where the robot begins, without torque."""
        self.torque: Bools = np.zeros(COUNT, np.bool_)
        self.tripped: Bools = np.zeros(COUNT, np.bool_)
        self.position: Floats = position.copy()
        self.plugged = [True, True]

    def energise(self, joints: Bools) -> None:
        """Torque comes on in these joints (n,)."""
        self.torque |= joints

    def release(self, joints: Bools) -> None:
        """Torque goes off in these joints (n,)."""
        self.torque &= ~joints


def model_joints() -> JointNames:
    """The joints of the rig, on buses as the identification reads them."""
    return JointNames(
        (
            SimpleNamespace(name="lower", ids=(1, 2), joints=np.array([0, 1]), linked=()),
            SimpleNamespace(name="upper", ids=(7,), joints=np.array([2]), linked=()),
        )
    )


class ModelPort:
    """One port as the identification sees it: identified in the tick after it was opened."""

    def __init__(self, name: str, ids: tuple[int, ...]) -> None:
        self.name = name
        self.ids = ids
        self.link = PortState.CLOSED
        self.reader: Any = None
        self.writer: Any = None
        self.prepared = self.holding = False
        self.devices: Any = ()
        self.identification: Any = None
        self.readings = 9
        self.trouble = self.warning = ""
        self.patient = self.busy = self.strays = False
        self.late_reply = None
        self.tape = SimpleNamespace(identified=lambda *, whole: None)

    def identify(self, *, patient: bool = False) -> None:
        """Begin an identification, which finds every device."""
        self.link = PortState.IDENTIFYING
        found = tuple(SimpleNamespace(id=id, settings=True) for id in self.ids)
        self.identification = SimpleNamespace(done=True, result=found)
        self.patient = patient


class BusModel(ScriptedHardware):
    """The loop's hardware. `watch` sees each request and goal as it leaves."""

    def __init__(self, clock: FakeClock, truth: DeviceTruth) -> None:
        self.truth = truth
        self.watch: Callable[[str, Bools], None] = lambda name, joints: None
        self.on_loss: Callable[[], None] = lambda: None
        self._sent: list[tuple[str, Bools, BusTask]] = []
        super().__init__(clock)
        self._open = (False, False)
        self.map = model_joints()
        self.ports: Any = [ModelPort(bus.name, bus.ids) for bus in self.map.buses]
        self.lost: list[PortLost] = []
        self.clamped = None
        self.left = False
        self.sent = 0.0
        self.last_exchange = SimpleNamespace(discarded=0, traffic=())
        never = np.full(COUNT, np.nan)
        self.slow.torque[:] = -1
        vars(self.slow).update(temperature=never, voltage=never, health_time=np.zeros(COUNT))
        vars(self.slow).update(fault=np.zeros(COUNT, np.int16), tick=np.full(COUNT, -1, np.int32))
        none = np.zeros(COUNT, np.int64)
        vars(self.readings).update(jumps=none, leaps=np.zeros(COUNT), alerts=np.zeros(COUNT, np.uint8))
        vars(self.readings).update(silence=lambda bus, now: 0.0, loads=lambda now: None)
        vars(self.readings).update(placed=np.ones(COUNT, np.bool_), where=lambda: self.truth.position.copy())

    # ------------------------------------------------------------------------- ports

    # The rig has lists of its own for these; here they follow from the ports.
    @property
    def writers(self) -> Any:
        return [port.writer for port in self.ports if port.writer is not None]

    @writers.setter
    def writers(self, _given: Any) -> None: ...

    @property
    def connected(self) -> bool:
        return all(port.link is PortState.CONNECTED for port in self.ports)

    @connected.setter
    def connected(self, _given: bool) -> None: ...

    @property
    def pairs(self) -> Any:
        return tuple(zip(self.ports, self.map.buses, strict=True))

    @property
    def open(self) -> Bools:
        return self._where(lambda port: port.reader is not None)

    @property
    def energised_joints(self) -> Bools:
        return self._where(lambda port: port.holding) & ~self.left_out

    @property
    def is_whole(self) -> bool:
        return bool(self.energised_joints.all())

    def _where(self, chosen: Callable[[Any], bool]) -> Bools:
        found = np.zeros(COUNT, np.bool_)
        for port, bus in self.pairs:
            found[bus.joints] = chosen(port)
        return found

    def access(self, *, read: bool, write: bool) -> None:
        """As the mode allows."""
        self._open = (read, write)
        for number in range(2):
            if read:
                self._enable(number)

    def _enable(self, number: int) -> None:
        port = self.ports[number]
        if port.reader is None and self.truth.plugged[number]:
            port.reader = SimpleNamespace(lags=False)
            port.writer = SimpleNamespace(cut=lambda: None) if self._open[1] else None
            port.identify()

    def lose(self, number: int) -> None:
        """Lose a bus: every pending request fails, and watchdogs trip."""
        port = self.ports[number]
        if port.reader is None:
            return
        self.on_loss()
        port.link = PortState.CLOSED
        port.reader = port.writer = port.identification = None
        port.prepared = port.holding = False
        joints = self.map.buses[number].joints
        self.slow.torque[joints] = -1
        self.truth.tripped[joints] |= self.truth.torque[joints]
        self.lost.append(PortLost(port.name, PortError(port.name, "unplugged")))
        self.fail()

    def give_up(self, bus: int, why: str) -> None:
        self.lose(bus)

    # ------------------------------------------------------------------------- requests

    def _task(self, name: str) -> list[Any]:
        joints = self.open if name == "torque False" else self.open & ~self.left_out
        self.watch(name, joints)
        if name == "torque True":
            self.truth.energise(joints)
        for port in self.ports:
            back = port.link is PortState.CONNECTED and not port.holding
            if port.writer is not None and (name == "prepare" or (name == "prepare back" and back)):
                port.prepared = True
        tasks = super()._task(name) if self.writers else []
        self._sent += [(name, joints, task) for task in tasks]
        return tasks

    def serve(self) -> None:
        """Every request that waits is done."""
        for name, joints, task in self._sent:
            if not task.done and task.error is None:
                if name == "torque False":
                    self.truth.release(joints & self.open)
                elif name.startswith("prepare"):
                    self.truth.tripped &= ~joints
        super().serve()
        self._sent.clear()

    def fail(self) -> None:
        """Every request that waits fails."""
        for _, _, task in self._sent:
            task.error = BusError("no confirmation")
            task.done = True
        self._sent.clear()

    def clear(self) -> None:
        self.fail()

    def hold(self, on: bool) -> None:
        self.left_out = self.left_out & on
        for port in self.ports:
            port.holding = port.prepared = on and port.writer is not None and port.prepared

    @property
    def waiting(self) -> tuple[tuple[str, tuple[bool, ...]], ...]:
        """Requests that are not done, with their joints."""
        return tuple((name, tuple(joints.tolist())) for name, joints, _ in self._sent)

    @property
    def back(self) -> Bools:
        """Joints on a bus that is identified and gets no goals."""
        return self._where(lambda port: port.link is PortState.CONNECTED and not port.holding)

    @back.setter
    def back(self, _given: Bools) -> None: ...

    # ------------------------------------------------------------------------- the exchange

    def exchange(self, goal: Floats | None, now: float) -> JointState:
        """Goals to the buses that hold; a reading of all that are open, at the end of the tick."""
        if self._open[0]:
            for number in range(2):
                self._enable(number)
                if not self.truth.plugged[number]:
                    self.lose(number)
        held = self.energised_joints
        self.left = goal is not None and bool(held.any())
        if goal is not None and held.any():
            self.watch("goal", held)
            self.truth.position = np.where(held & self.truth.torque, goal, self.truth.position)
        self.sent = now
        quiet = now < self.quiet_until
        heard = self.open & (not quiet)
        self.slow.torque[heard] = self.truth.torque[heard]
        self.slow.watchdog[heard] = np.where(self.truth.tripped[heard], TRIPPED, 5)
        self.slow.status_time[heard] = now
        still = np.zeros(COUNT)
        age = np.where(heard, 0.0, np.inf)
        return JointState(self.clock.now(), self.truth.position.copy(), still, still, age, heard)
