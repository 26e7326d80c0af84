"""`bus.*`: one control cycle of a bus, by our driver and by the two others that do the same.

A cycle reads current, velocity and position of N servos into numpy floats and writes N goals. The servos are
`bench.responder`, a process of its own; CPU is of this process alone.
"""

import time
from collections.abc import Callable, Mapping
from functools import partial
from math import inf
from typing import Any

import numpy as np

from bench import peers
from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    as_in_the_loop,
    interleaved,
    medians,
    responder_port,
    spread,
)
from bench.peers import ControlCycle
from twind_drivers.clock import MonotonicClock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.serial_cycle_budget import budget
from twind_drivers.ports.serial_port import SerialTransport

COUNT = 24
MODEL = 1020
# cycles of one round; before it, uncounted
CYCLES = 1500
WARM = 50
PACED_SPAN = 3.0  # s of a round
PACED_ROUNDS = 5
USB_TICK = 0.00025  # s
PATIENCE = 0.05  # s: the servos are a process on a shared machine; what is measured here is not their delay
SILENT_CYCLES = 20  # that a peer has to become fresh again
TURN = 2.0 * np.pi / 4096.0
WAYS = {"fast": True, "plain": False}


class DynamixelDriverCycle:
    """Control cycle by the twind driver, used on one port as the control loop uses it."""

    def __init__(self, path: str, count: int, *, fast: bool, baud: int = 4_000_000) -> None:
        ids = tuple(range(1, count + 1))
        self.clock = MonotonicClock()
        self.transport = SerialTransport(path, baud)
        self.reader = DynamixelReader(
            "bench",
            self.transport,
            ids,
            [MODEL] * count,
            baud=baud,
            return_delay_us=0.0,
            fast=fast,
            slack=PATIENCE,
        )
        wide = np.full(count, 4095)
        self.writer = DynamixelWriter(self.reader, lower=wide * 0, upper=wide, gains=[(800, 0, 0)] * count)
        self._goals = np.full(count, 2048)

    def __call__(self, i: int) -> int:
        """Run one cycle; return the number of servos that answered."""
        self.writer.goals(self._goals + (i & 63))
        self.reader.request(self.clock.now())
        self.clock.wait([self.transport], self.reader.deadline)
        while not self.reader.feed(now := self.clock.now()) and now < self.reader.deadline:
            self.clock.wait([self.transport], self.reader.deadline)
        sample = self.reader.finish(self.clock.now())
        self.position = (sample.position - 2048) * TURN
        self.velocity = sample.velocity * 0.02398
        self.effort = sample.effort * 0.00269
        return int(np.count_nonzero(sample.heard))

    def close(self) -> None:
        """Close the port."""
        self.transport.close()


def cycles(
    path: str, count: int, *, fast: bool, baud: int = 4_000_000
) -> dict[str, Callable[[], ControlCycle]]:
    """Return the implementations of a control cycle on this port, by name.

    A library that is not installed is left out.
    """
    found: dict[str, Callable[[], ControlCycle]] = {
        "twind": lambda: DynamixelDriverCycle(path, count, fast=fast, baud=baud),
        "dynamixel_sdk": lambda: peers.DynamixelSdkCycle(path, count, fast=fast, baud=baud),
        "bare syscalls": lambda: peers.SyscallCycle(path, count, fast=fast),
    }
    if peers.rustypot is not None:
        found["rustypot"] = lambda: peers.RustypotCycle(path, count, fast=fast, baud=baud)
    return found


# ------------------------------------------------------------------------------------------ CPU


def _cpu(make: Callable[[], ControlCycle], count: int) -> float:
    """Measure the CPU time (µs) of one cycle, averaged over a round.

    Raises MeasurementUnavailable when a cycle is incomplete.
    """
    cycle = make()
    try:
        for i in range(WARM):
            if cycle(i) != count:
                raise MeasurementUnavailable(
                    f"{type(cycle).__name__}: a cycle of {count} servos was not whole"
                )
        with as_in_the_loop():
            before = time.process_time()
            for i in range(CYCLES):
                cycle(i)
            return (time.process_time() - before) / CYCLES * 1e6
    finally:
        cycle.close()


def _cpu_rounds(counts: tuple[int, ...], *, fast: bool) -> dict[str, list[float]]:
    """Measure the CPU time (µs) per cycle, keyed by "name count"; the implementations are interleaved."""
    with responder_port("bench.responder") as path:
        takes = {
            f"{name} {count}": partial(_cpu, make, count)
            for count in counts
            for name, make in cycles(path, count, fast=fast).items()
        }
        return interleaved(ROUNDS, takes)


def take_cpu() -> Mapping[str, MeasuredFigure]:
    """Measure the CPU time of a cycle of 24 servos, fast and plain, and its growth from 6 to 48 servos."""
    fast = _cpu_rounds((6, COUNT, 48), fast=True)
    plain = _cpu_rounds((COUNT,), fast=False)
    figures = {}
    for way, rounds in (("fast", fast), ("plain", plain)):
        middle = medians(rounds)
        beside = {n.removesuffix(f" {COUNT}"): v for n, v in middle.items() if n.endswith(f" {COUNT}")}
        own = beside.pop("twind")
        how = f"read 10 B of {COUNT}, write {COUNT} goals, {way} sync read, answers at once"
        note = f"{how}; {spread(rounds[f'twind {COUNT}'], 'µs')}{peers.missing()}"
        figures[f"bus.cycle_cpu_{way}_24"] = MeasuredFigure(own, note, beside)
    middle = medians(fast)
    names = sorted({name.rpartition(" ")[0] for name in middle} - {"bare syscalls"})
    growth = {name: middle[f"{name} 48"] / middle[f"{name} 6"] for name in names}
    own = growth.pop("twind")
    ends = f"{middle['twind 6']:.1f} and {middle['twind 48']:.1f} µs"
    figures["bus.cycle_cpu_48_over_6"] = MeasuredFigure(
        own, f"fast sync read, {ends}; medians of {ROUNDS}", growth
    )
    return figures


# ------------------------------------------------------------------------------------------ the wire


def _rate(make: Callable[[], ControlCycle], count: int, ideal: float) -> float:
    """Measure the complete cycles per second, as a share of `ideal`."""
    cycle = make()
    try:
        for i in range(WARM):
            cycle(i)
        with as_in_the_loop():
            since = time.perf_counter()
            until = since + PACED_SPAN
            whole = 0
            i = 0
            while time.perf_counter() < until:
                whole += cycle(i) == count
                i += 1
            return whole / (time.perf_counter() - since) / ideal
    finally:
        cycle.close()


def take_wire() -> Mapping[str, MeasuredFigure]:
    """Measure cycles per second against the wire-time formula, at 1 and at 3 Mbaud."""
    figures = {}
    for name, baud in (("1m", 1_000_000), ("3m", 3_000_000)):
        ideal = budget(COUNT, baud, fast=True, return_delay_us=0.0).reachable_hz
        with responder_port("bench.responder", "--baud", str(baud), "--tick", str(USB_TICK)) as path:
            makers = cycles(path, COUNT, fast=True, baud=baud)
            makers.pop("bare syscalls")
            takes = {who: partial(_rate, make, COUNT, ideal) for who, make in makers.items()}
            rounds = interleaved(PACED_ROUNDS, takes)
        middle = medians(rounds)
        own = middle.pop("twind")
        note = f"{own * ideal:.0f} of {ideal:.0f} cycles/s, fast sync read, adapter hands over every 0.25 ms"
        note += f"; {spread(rounds['twind'], '')}{peers.missing()}"
        figures[f"bus.wire_efficiency_{name}"] = MeasuredFigure(own, note, middle)
    return figures


# ------------------------------------------------------------------------------------------ a dead servo


def _fresh_after(make: Callable[[], ControlCycle]) -> float:
    """Count the cycles until all other servos answer in one cycle; inf: never within `SILENT_CYCLES`."""
    cycle = make()
    try:
        for i in range(SILENT_CYCLES):
            if cycle(i) >= COUNT - 1:
                return i + 1.0
        return inf
    finally:
        cycle.close()


def take_dead() -> Mapping[str, MeasuredFigure]:
    """Measure fast sync read while one servo in the middle is silent from the first cycle on."""
    with responder_port("bench.responder", "--silent", str(COUNT // 2)) as path:
        makers = cycles(path, COUNT, fast=True)
        makers.pop("bare syscalls")
        took: dict[str, Any] = {who: _fresh_after(make) for who, make in makers.items()}
    never = [who for who, after in took.items() if after == inf]
    beside = {who: None if after == inf else after for who, after in took.items() if who != "twind"}
    own = None if took["twind"] == inf else took["twind"]
    note = f"id {COUNT // 2} of {COUNT} silent from the first cycle on, fast sync read at first"
    if never:
        note += f"; never within {SILENT_CYCLES} cycles: {', '.join(never)}"
    return {"bus.dead_servo_fresh_cycles": MeasuredFigure(own, note + peers.missing(), beside)}


MEASUREMENTS = (
    Measurement(
        {
            "bus.cycle_cpu_fast_24": FigureSpec("µs", "≤ 1/8 SDK, ≤ 1/2 rustypot, ≤ 3 × bare"),
            "bus.cycle_cpu_plain_24": FigureSpec("µs", "≤ 1/12 SDK, ≤ 1/2 rustypot"),
            "bus.cycle_cpu_48_over_6": FigureSpec("ratio", "≤ 1.3"),
        },
        take_cpu,
    ),
    Measurement(
        {
            "bus.wire_efficiency_1m": FigureSpec("ratio", "≥ 0.94"),
            "bus.wire_efficiency_3m": FigureSpec("ratio", "≥ 0.90"),
        },
        take_wire,
    ),
    Measurement({"bus.dead_servo_fresh_cycles": FigureSpec("cycles", "≤ 2")}, take_dead),
)
