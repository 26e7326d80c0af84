"""`can.*`: frames over a serial adapter, by our channel and by python-can.

Who is measured sends a command to each of 24 actuators and takes their answers into arrays. The actuators are
`bench.can_responder`, a process of its own; CPU is of this process alone.
"""

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Protocol

import can
import numpy as np
from can.interfaces.slcan import slcanBus

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
from twind_drivers.clock import MonotonicClock
from twind_drivers.ports.can_ports import open_channel
from twind_drivers.ports.frame import frames

COUNT = 24
# of one round; before it, uncounted
CYCLES = 300
WARM = 20
PATIENCE = 1.0  # s for the answers of a cycle: the adapter is a process on a shared machine
IDS = np.arange(1, COUNT + 1)
RATE = 1_000_000  # bit/s


class FrameExchange(Protocol):
    """Commands out, answers in, again and again."""

    def __call__(self, i: int) -> int:
        """One cycle; how many answers came."""

    def close(self) -> None:
        """Let go of the port."""


class SlcanChannelExchange:
    """Our channel, as the bus uses it."""

    def __init__(self, path: str) -> None:
        self._clock = MonotonicClock()
        self._channel = open_channel(f"can:slcan:{path}", RATE)
        self._data = np.zeros((COUNT, 8), np.uint8)

    def __call__(self, i: int) -> int:
        self._data[:, 0] = i & 255
        now = self._clock.now()
        self._channel.send(frames(IDS, self._data), now)
        heard = 0
        deadline = now + PATIENCE
        while heard < COUNT and now < deadline:
            self._clock.wait([self._channel], deadline)
            now = self._clock.now()
            found = self._channel.receive(now)
            self.ids = found["id"]
            self.data = found["data"]
            heard += len(found)
        return heard

    def close(self) -> None:
        self._channel.close()


class PythonCanExchange:
    """python-can's slcan, as its documentation uses it: a message a frame."""

    def __init__(self, path: str) -> None:
        self._bus = slcanBus(path, bitrate=RATE, sleep_after_open=0.0)

    def __call__(self, i: int) -> int:
        data = bytes([i & 255, 0, 0, 0, 0, 0, 0, 0])
        for id in range(1, COUNT + 1):
            self._bus.send(can.Message(arbitration_id=id, data=data, is_extended_id=False))
        found = [self._bus.recv(timeout=PATIENCE) for _ in range(COUNT)]
        whole = [each for each in found if each is not None]
        self.ids = np.array([each.arbitration_id for each in whole])
        self.data = np.array([list(each.data) for each in whole], np.uint8)
        return len(whole)

    def close(self) -> None:
        self._bus.shutdown()


def average(make: Callable[[], FrameExchange], clock: Callable[[], float]) -> float:
    """Time (s, by `clock`) of a cycle, averaged over a round. Raises CannotTake when one is not whole."""
    exchange = make()
    try:
        for i in range(WARM):
            if exchange(i) != COUNT:
                raise MeasurementUnavailable(
                    f"{type(exchange).__name__}: a cycle of {COUNT} actuators was not whole"
                )
        with as_in_the_loop():
            before = clock()
            for i in range(CYCLES):
                exchange(i)
            return (clock() - before) / CYCLES
    finally:
        exchange.close()


def take_slcan() -> Mapping[str, MeasuredFigure]:
    """CPU of a frame out and its answer in, and frames a second, both ways counted."""
    with responder_port("bench.can_responder") as path:
        makers: dict[str, Callable[[], FrameExchange]] = {
            "twind": partial(SlcanChannelExchange, path),
            "python-can": partial(PythonCanExchange, path),
        }
        takes = {who: partial(average, make, time.process_time) for who, make in makers.items()}
        cpu = interleaved(ROUNDS, takes)
        takes = {who: partial(average, make, time.perf_counter) for who, make in makers.items()}
        wall = interleaved(ROUNDS, takes)
    cost = {who: value / COUNT * 1e6 for who, value in medians(cpu).items()}
    rate = {who: 2 * COUNT / value for who, value in medians(wall).items()}
    own = spread([value / COUNT * 1e6 for value in cpu["twind"]], "µs")
    note = f"a command out and its answer in, {COUNT} a cycle, on a pty, system calls included; {own}"
    rates = "frames out and in, as fast as the adapter's process answers: the host waits for it in both"
    return {
        "can.slcan_frame_cpu": MeasuredFigure(cost.pop("twind"), note, cost),
        "can.slcan_frames": MeasuredFigure(rate.pop("twind"), rates, rate),
    }


MEASUREMENTS = (
    Measurement(
        {
            "can.slcan_frame_cpu": FigureSpec("µs", "≤ 1/20"),
            "can.slcan_frames": FigureSpec("1/s"),
        },
        take_slcan,
    ),
)
