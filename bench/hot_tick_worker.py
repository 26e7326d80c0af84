"""`python bench/hot_tick_worker.py`: CPU time of a tick under the fake clock, for the tree in PYTHONPATH.

Runs as a file, because the tree may be an earlier commit without this module. One line of JSON for each line
of standard input: µs a tick, and µs of it that the virtual servos in this process take.
"""

import importlib
import json
import sys
import time
from collections.abc import Callable
from functools import wraps
from types import ModuleType
from typing import Any

SPAN = 10.0  # s of robot in one round, one trajectory
# Names of the same module in this tree and in earlier commits, newest first.
IN_PROCESS_DAEMON = ("bench.in_process_daemon", "bench.indoors")
VIRTUAL_HOUR = ("bench.virtual_hour", "bench.hour")
LOOPBACK = ("twind_drivers.virtual.serial_loopback", "twind_drivers.virtual.loopback")
SERVO_METHODS = ("receive", "take", "next_output_time")


def first_of(names: tuple[str, ...]) -> ModuleType:
    """The first module of `names` that exists. Raises ModuleNotFoundError."""
    for name in names[:-1]:
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name != name:
                raise
    return importlib.import_module(names[-1])


class ServoTime:
    """CPU time that the methods of the virtual buses take while it is switched on."""

    def __init__(self, buses: set[type]) -> None:
        self.used = 0.0
        self._plain = {
            (kind, name): getattr(kind, name)
            for kind in buses
            for name in SERVO_METHODS
            if hasattr(kind, name)
        }

    def __enter__(self) -> "ServoTime":
        for (kind, name), method in self._plain.items():
            setattr(kind, name, self._counted(method))
        return self

    def __exit__(self, *_: object) -> None:
        for (kind, name), method in self._plain.items():
            setattr(kind, name, method)

    def _counted(self, method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def counted(*arguments: Any) -> Any:
            before = time.thread_time()
            try:
                return method(*arguments)
            finally:
                self.used += time.thread_time() - before

        return counted


def recorded_buses(loopback: type) -> set[type]:
    """Classes of the virtual buses that a Loopback made from now on serves; filled as they are made."""
    kinds: set[type] = set()
    plain = loopback.__init__  # type: ignore[misc]

    @wraps(plain)
    def made(self: Any, bus: Any, *arguments: Any, **named: Any) -> None:
        kinds.add(type(bus))
        plain(self, bus, *arguments, **named)

    loopback.__init__ = made  # type: ignore[misc]
    return kinds


def main() -> int:
    """Serve until the end of standard input."""
    daemon = first_of(IN_PROCESS_DAEMON)
    hour = first_of(VIRTUAL_HOUR)
    harness = importlib.import_module("bench.harness")
    buses = recorded_buses(first_of(LOOPBACK).Loopback)
    hour.MOTION = SPAN  # type: ignore[attr-defined]
    round_of = getattr(hour, "moving_round", None) or hour._round
    with daemon.indoors(physics=False) as robot, harness.as_in_the_loop():
        moving = round_of(robot, SPAN)
        period = 1.0 / 100.0  # s, of `h24` in both trees
        ticks = hour.HOUR / period  # `moving` gives the CPU time of an hour
        with ServoTime(buses) as servos:
            moving()
        share = servos.used / (SPAN / period)
        print("ready", flush=True)
        for _ in sys.stdin:
            print(json.dumps({"tick": moving() / ticks * 1e6, "servos": share * 1e6}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
