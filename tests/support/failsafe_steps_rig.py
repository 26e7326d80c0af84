"""A fail-safe on scripted buses: `ProcedureRig` with what it judges, and devices that obey torque off."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.support.procedure_rig import ProcedureRig
from twind.loop.bus.bus_port import PortState
from twind.loop.procedures.failsafe import LONGEST, FailsafeRun
from twind.robot.finding import Finding

ALL = (1, 1, 1)


class FailsafeRig(ProcedureRig):
    """A robot with torque found on: two legs and a hand, on two buses. Devices obey torque off."""

    def __init__(self, support: str = "gantry", torque: Sequence[int] = ALL) -> None:
        super().__init__(support=support)
        self.found(torque)
        self.refusals: list[Finding] = []
        self.judged: list[Any] = []
        legs: Any = SimpleNamespace(leg=np.array([True, True, False]))
        self.robot.description = replace(self.robot.description, ratings=legs)
        bound: Any = self.robot.bound
        bound.judge = self._judge
        for port, ids in zip(self.hardware.ports, ((1, 2), (7,)), strict=True):
            port.link = PortState.CONNECTED
            port.devices = [SimpleNamespace(id=id) for id in ids]
        self.verified.mismatches = ()
        self.verified.found = []
        self.verified.doubts = lambda: self.verified.found
        self.identity: Any = SimpleNamespace(verified=self.verified, missing={})
        self.obeys = np.ones(3, np.bool_)
        notifier: Any = SimpleNamespace(extend=self.extended.append)
        self.safe = FailsafeRun(self, self.identity, self.release, notifier)

    def _judge(self, devices: Any) -> Any:
        self.judged.append(devices)
        return SimpleNamespace(refusals=tuple(self.refusals))

    def tick(self) -> None:
        before = len(self.hardware.log)
        super().tick()
        if "torque False" in self.hardware.log[before:]:
            self.hardware.slow.torque[self.obeys & self.hardware.open] = 0

    def age(self, *ages: float) -> None:
        """The last replies of the joints were so long ago, s."""
        self.read(age=np.array(ages))

    def finish(self, most: float = 2 * LONGEST) -> float:
        """Run the fail-safe to its end; s that took."""
        begun = self.clock.now()
        self.safe.begin()
        while not self.condition.finished:
            assert self.clock.now() - begun < most, self.hardware.log
            self.tick()
        return self.clock.now() - begun

    def unplug(self, bus: int = 1) -> None:
        """A bus is closed: nothing is known of its devices."""
        port = self.hardware.ports[bus]
        port.link = PortState.CLOSED
        port.reader = None
        port.devices = []
        self.hardware.connected = False
        self.hardware.away = np.array([bus == 0, bus == 0, bus == 1])
        self.hardware.slow.torque[self.hardware.away] = -1
