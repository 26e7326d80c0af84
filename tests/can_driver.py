"""Our CAN driver on virtual nodes, in process under a fake clock: both sides speak real frames."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from twind_drivers.bus import Device, Sample, Script, perform
from twind_drivers.can.bus import Actuator, CanReader, CanWriter
from twind_drivers.can.models import model
from twind_drivers.can.units import TURN
from twind_drivers.clock import FakeClock
from twind_drivers.virtual.can.bus import VirtualCanBus
from twind_drivers.virtual.can.controller import CanAdapter
from twind_drivers.virtual.can.loopback import CanLoopback
from twind_drivers.virtual.can.muscles import FirstOrderCan
from twind_drivers.virtual.can.spec import NodeSpec

BITRATE = 1_000_000
EDGE = TURN // 2 - 200  # counts: goals that may be sent, either way
RANGES = {"ODrive": (12.5, 30.0, 10.0)}  # of models that no source gives ranges of


def actuators(models: Sequence[str], first: int = 1) -> list[Actuator]:
    made = []
    for place, name in enumerate(models):
        known = model(name)
        position, velocity, torque = RANGES.get(name, (known.position, known.velocity, known.torque))
        id = first + place
        made.append(
            Actuator(id, id + 0x10 if known.family == "damiao" else id, name, position, velocity, torque)
        )
    return made


class CanRig:
    """Actuators at 0.25 rad, limp. `tick` is one cycle of the loop: reading, then one rare transaction."""

    def __init__(
        self,
        models: Sequence[str] = ("DM4310",) * 4,
        *,
        adapter: CanAdapter | None = None,
        watchdog: bool = True,
        settings: dict[str, float] | None = None,
        rate_hz: float = 100.0,
    ) -> None:
        self.actuators = actuators(models)
        nodes = [
            NodeSpec(
                each.id,
                each.model,
                feedback_id=each.feedback_id,
                position=each.position,
                velocity=each.velocity,
                torque=each.torque,
                settings=settings or {},
            )
            for each in self.actuators
        ]
        self.m, self.rate_hz = len(nodes), rate_hz
        self.clock = FakeClock()
        self.muscles = FirstOrderCan(np.full(self.m, 0.25))
        self.bus = VirtualCanBus("arm", nodes, self.muscles, bitrate=BITRATE, adapter=adapter)
        self.faults = self.bus.faults
        self.watchdog = watchdog
        self.open()

    def open(self) -> None:
        self.channel = CanLoopback(self.bus, self.clock)
        self.reader = CanReader("arm", self.channel, self.actuators, bitrate=BITRATE, rate_hz=self.rate_hz)
        self.writer = CanWriter(
            self.reader,
            lower=np.full(self.m, -EDGE),
            upper=np.full(self.m, EDGE),
            kp=np.full(self.m, 40.0),
            kd=np.full(self.m, 1.0),
            watchdog=[self.watchdog] * self.m,
        )

    @property
    def registers(self) -> Any:
        return self.reader.registers

    def perform(self, script: Script[Any]) -> Any:
        return perform(self.reader, script, self.clock, self.writer)

    def identify(self) -> tuple[Device, ...]:
        found: tuple[Device, ...] = self.perform(self.reader.identify())
        return found

    def tick(self, goal: np.ndarray | None = None, *, rare: bool = True) -> Sample:
        begin = self.clock.now()
        if goal is not None:
            self.writer.goals(goal)
        self.reader.request(begin)
        self._wait()
        sample = self.reader.finish(self.clock.now())
        if rare:
            self.reader.begin(self.reader.upkeep(self.clock.now()), self.clock.now())
            self._wait()
            self.reader.answer(self.clock.now())
        self.clock.sleep_until(begin + 1.0 / self.rate_hz)
        return sample

    def ticks(self, count: int, goal: np.ndarray | None = None) -> list[Sample]:
        return [self.tick(goal) for _ in range(count)]

    def beside(self, script: Script[Any], limit: int = 200) -> Any:
        """A script as the loop runs it: one transaction a tick, the reading before it."""
        try:
            request = next(script)
            for _ in range(limit):
                begin = self.clock.now()
                self.reader.request(begin)
                self._wait()
                self.reader.finish(self.clock.now())
                half = self.reader if type(request).__name__ in ("Ping", "Read") else self.writer
                half.begin(request, self.clock.now())
                self._wait()
                reply = self.reader.answer(self.clock.now())
                self.clock.sleep_until(begin + 1.0 / self.rate_hz)
                request = script.send(reply)
        except StopIteration as stop:
            return stop.value
        raise AssertionError(f"no end after {limit} ticks")

    def arm(self) -> np.ndarray:
        self.ticks(5 if all("AK" not in each.model for each in self.actuators) else 120)
        here = self.tick().position
        self.beside(self.writer.prepare(here))
        self.beside(self.writer.aim(here))
        self.beside(self.writer.torque(True))
        return here

    def place(self) -> np.ndarray:
        return np.asarray(self.muscles.position)

    def _wait(self) -> None:
        while not self.reader.feed(self.clock.now()) and self.clock.now() < self.reader.deadline:
            self.clock.wait([self.reader.transport], self.reader.deadline)
