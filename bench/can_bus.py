"""`can.cycle_cpu_24`: one control cycle of 24 MIT actuators, by our bus and by hand over python-can.

A cycle sends every actuator a command (position, stiffness, damping) and takes its feedback into floats. The
actuators are `bench.can_responder`, processes of their own; CPU is of this process alone.
"""

import struct
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial

import can
import numpy as np
from can.interfaces.slcan import slcanBus

from bench.can import COUNT, PATIENCE, RATE, FrameExchange, average
from bench.can_responder import OFFSET
from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    interleaved,
    medians,
    responder_port,
    spread,
)
from twind_drivers.can.actuator import CanActuatorIdentity
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_units import COUNT as RADIAN
from twind_drivers.can.can_units import EFFORT
from twind_drivers.can.can_writer import CanWriter
from twind_drivers.clock import MonotonicClock
from twind_drivers.ports.can_ports import open_channel

MODEL = "DM4340"
# what its fields span
POSITION = 12.5
VELOCITY = 8.0
TORQUE = 28.0
KP = 50.0
KD = 1.0
TURN = 8192  # counts, half a turn


class CanDriverCycle:
    """Our reader and writer as the loop uses them, on `buses` ports with as many actuators each."""

    def __init__(self, paths: list[str]) -> None:
        self._clock = MonotonicClock()
        each = COUNT // len(paths)
        self._readers = []
        self._writers = []
        for place, path in enumerate(paths):
            ids = range(1 + place * each, 1 + (place + 1) * each)
            actuators = [
                CanActuatorIdentity(id, id + OFFSET, MODEL, POSITION, VELOCITY, TORQUE) for id in ids
            ]
            channel = open_channel(f"can:slcan:{path}", RATE)
            reader = CanReader(f"bus{place}", channel, actuators, bitrate=RATE, slack=PATIENCE)
            wide = np.full(each, TURN)
            gains = np.ones(each)
            writer = CanWriter(reader, lower=-wide, upper=wide, kp=KP * gains, kd=KD * gains)
            self._readers.append(reader)
            self._writers.append(writer)
        self._goals = np.zeros(each, np.int64)
        self._waits = [reader.transport for reader in self._readers]

    def __call__(self, i: int) -> int:
        """One cycle; how many actuators were heard."""
        goals = self._goals + (i & 63)
        for reader, writer in zip(self._readers, self._writers, strict=True):
            writer.goals(goals)
            reader.request(self._clock.now())
        deadline = max(reader.deadline for reader in self._readers)
        open_ = list(self._readers)
        while open_:
            self._clock.wait(self._waits, deadline)
            now = self._clock.now()
            open_ = [reader for reader in open_ if not reader.feed(now) and now < reader.deadline]
        heard = 0
        for reader in self._readers:
            sample = reader.finish(self._clock.now())
            self.position = sample.position * RADIAN
            self.velocity = sample.velocity * RADIAN
            self.effort = sample.effort * EFFORT
            heard += int(np.count_nonzero(sample.heard))
        return heard

    def close(self) -> None:
        for reader in self._readers:
            reader.channel.close()


class ManualPythonCanCycle:
    """python-can as one writes a loop with it: a message an actuator, packed and unpacked one by one."""

    def __init__(self, paths: list[str]) -> None:
        self._buses = [slcanBus(path, bitrate=RATE, sleep_after_open=0.0) for path in paths]
        self._each = COUNT // len(paths)
        self.values = np.zeros((COUNT, 3))

    def __call__(self, i: int) -> int:
        """One cycle; how many actuators were heard."""
        goal = (i & 63) * RADIAN
        for place, bus in enumerate(self._buses):
            for id in range(1 + place * self._each, 1 + (place + 1) * self._each):
                data = packed(goal, 0.0, KP, KD, 0.0)
                bus.send(can.Message(arbitration_id=id, data=data, is_extended_id=False))
        heard = 0
        for bus in self._buses:
            for _ in range(self._each):
                message = bus.recv(timeout=PATIENCE)
                if message is None:
                    return heard
                self.values[message.arbitration_id - OFFSET - 1] = unpacked(message.data)
                heard += 1
        return heard

    def close(self) -> None:
        for bus in self._buses:
            bus.shutdown()


def packed(position: float, velocity: float, kp: float, kd: float, torque: float) -> bytes:
    """A MIT command."""
    p = int((position + POSITION) * 65535 / (2 * POSITION))
    v = int((velocity + VELOCITY) * 4095 / (2 * VELOCITY))
    k = int(kp * 4095 / 500)
    d = int(kd * 4095 / 5)
    t = int((torque + TORQUE) * 4095 / (2 * TORQUE))
    return struct.pack(">Q", p << 48 | v << 36 | k << 24 | d << 12 | t)


def unpacked(data: bytearray) -> tuple[float, float, float]:
    """Position, velocity, torque of a feedback."""
    p = data[1] << 8 | data[2]
    v = data[3] << 4 | data[4] >> 4
    t = (data[4] & 15) << 8 | data[5]
    return (
        p * 2 * POSITION / 65535 - POSITION,
        v * 2 * VELOCITY / 4095 - VELOCITY,
        t * 2 * TORQUE / 4095 - TORQUE,
    )


def take_cycle() -> Mapping[str, MeasuredFigure]:
    """CPU of a cycle of 24 actuators on one bus, and on two."""
    figures = {}
    for count, key in ((1, "can.cycle_cpu_24"), (2, "can.cycle_cpu_24_split")):
        with ExitStack() as stack:
            paths = [stack.enter_context(responder_port("bench.can_responder")) for _ in range(count)]
            makers: dict[str, Callable[[], FrameExchange]] = {
                "twind": partial(CanDriverCycle, paths),
                "python-can": partial(ManualPythonCanCycle, paths),
            }
            takes = {who: partial(average, make, time.process_time) for who, make in makers.items()}
            rounds = interleaved(ROUNDS, takes)
        cost = {who: value * 1e6 for who, value in medians(rounds).items()}
        note = f"command and feedback of 24 Damiao actuators over slcan, {count} bus{'es' * (count > 1)}"
        note += f", system calls included; {spread([value * 1e6 for value in rounds['twind']], 'µs')}"
        figures[key] = MeasuredFigure(cost.pop("twind"), note, cost)
    return figures


MEASUREMENTS = (
    Measurement(
        {"can.cycle_cpu_24": FigureSpec("µs", "≤ 1/3"), "can.cycle_cpu_24_split": FigureSpec("µs", "≤ 1/3")},
        take_cycle,
    ),
)
