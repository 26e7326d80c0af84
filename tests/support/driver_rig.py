"""A driver of any kind on virtual devices, in process under a fake clock: driven as by the loop.

What a new driver gives to pass `driver_contract`: a reader, a writer, its clock, its faults, and what its
devices really do.
"""

from collections.abc import Generator
from typing import Any

import numpy as np

from twind_drivers.bus import (
    BusReader,
    BusSample,
    PingRequest,
    PortError,
    PortErrorCause,
    ReadRequest,
    Request,
    Script,
)
from twind_drivers.bus_writer import BusWriter
from twind_drivers.clock import FakeClock
from twind_drivers.run_script import perform

RATE = 100.0  # Hz


def is_output_full(error: BaseException) -> bool:
    """True for the error of a port whose output was dropped."""
    return isinstance(error, PortError) and error.kind is PortErrorCause.OUTPUT_FULL


class DriverRig:
    """One bus of m devices at `start`, limp. `told` and what is commanded are in raw counts."""

    name: str
    clock: FakeClock
    reader: BusReader
    writer: BusWriter
    faults: Any  # by name, the same in every virtual bus
    lower: np.ndarray  # (m,) goals that may be sent
    upper: np.ndarray
    rate_hz: float = RATE
    stroke = 200.0  # counts: amplitude that these devices follow in an oscillation of 1 s
    first = 0.0  # s after the first cycle in which nobody need be heard yet

    # ------------------------------------------------------------------ what a driver's own rig answers

    def places(self) -> np.ndarray:
        """True positions (m,) of the devices, counts."""
        raise NotImplementedError

    def energised(self) -> np.ndarray:
        """True torque states (m,)."""
        raise NotImplementedError

    def sent(self) -> int:
        """Bytes or frames that were sent since the start."""
        raise NotImplementedError

    # ------------------------------------------------------------------ the same for all

    @property
    def m(self) -> int:
        return len(self.reader.ids)

    @property
    def registers(self) -> Any:
        return self.reader.registers

    def perform(self, script: Script[Any]) -> Any:
        return perform(self.reader, script, self.clock, self.writer)

    def read(self, goal: np.ndarray | None = None) -> BusSample:
        """The cyclic reading alone."""
        if goal is not None:
            self.writer.goals(goal)
        try:
            self.reader.request(self.clock.now())
        except PortError as error:  # the loop misses the reading
            if not is_output_full(error):
                raise
            return self.missed()
        self.wait()
        return self.reader.finish(self.clock.now())

    def missed(self) -> BusSample:
        """A reading that was not asked for."""
        now = self.clock.now()
        nothing = np.zeros(self.m, np.int64)
        nobody = np.zeros(self.m, np.bool_)
        error = np.zeros(self.m, np.uint8)
        return BusSample(now, now, nothing, nothing, nothing, error, nobody, ~nobody, 0, 0)

    def tick(self, goal: np.ndarray | None = None) -> BusSample:
        """One cycle of the loop: the reading, then a turn of upkeep."""
        begin = self.clock.now()
        sample = self.read(goal)
        query = self.reader.upkeep(self.clock.now())
        try:
            if query is not None:
                self.transact(query)
        except PortError as error:
            if not is_output_full(error):
                raise
        self.clock.sleep_until(begin + 1.0 / self.rate_hz)
        return sample

    def ticks(self, count: int, goal: np.ndarray | None = None) -> list[BusSample]:
        return [self.tick(goal) for _ in range(count)]

    def transact(self, request: Request) -> Any:
        half: Any = self.reader if isinstance(request, PingRequest | ReadRequest) else self.writer
        half.begin(request, self.clock.now())
        self.wait()
        return self.reader.answer(self.clock.now())

    def beside(self, script: Script[Any], limit: int = 300) -> Any:
        """A script as the loop runs it: one transaction a tick, the reading before it."""
        stepped = self.stepped(script)
        for _ in range(limit):
            try:
                next(stepped)
            except StopIteration as stop:
                return stop.value
        raise AssertionError(f"no end after {limit} ticks")

    def stepped(self, script: Script[Any]) -> Generator[None, None, Any]:
        """The same, a tick at a time."""
        try:
            request = next(script)
            while True:
                begin = self.clock.now()
                self.read()
                try:
                    reply = self.transact(request)
                except PortError as error:  # requested again in the next tick
                    if not is_output_full(error):
                        raise
                    self.clock.sleep_until(begin + 1.0 / self.rate_hz)
                    yield
                    continue
                self.clock.sleep_until(begin + 1.0 / self.rate_hz)
                request = script.send(reply)
                yield
        except StopIteration as stop:
            return stop.value

    def positions(self) -> np.ndarray:
        """Reported positions (m,), once all devices replied."""
        if self.first and not self.tick().heard.all():
            self.clock.sleep_until(self.clock.now() + self.first)
        sample = self.ticks(5)[-1]
        assert sample.heard.all(), sample
        return sample.position

    def arm(self) -> np.ndarray:
        """Everybody holds where he is; the goal (m,)."""
        here = self.positions()
        self.beside(self.writer.prepare(here))
        self.beside(self.writer.write_goals(here))
        self.beside(self.writer.torque(True))
        return here

    def wait(self) -> None:
        while not self.reader.feed(self.clock.now()) and self.clock.now() < self.reader.deadline:
            self.clock.wait([self.reader.transport], self.reader.deadline)


def both(rig: DriverRig, here: np.ndarray) -> Script[None]:
    """All that comes before torque."""
    yield from rig.writer.prepare(here)
    yield from rig.writer.write_goals(here)
