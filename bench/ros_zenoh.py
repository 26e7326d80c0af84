"""`ros.zenoh_*`: what 24 joints in a ROS graph over Zenoh cost, beside the publisher of zenoh-ros2-sdk."""

import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.util import find_spec
from typing import Any

from bench.harness import (
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    interleaved,
    medians,
    spread,
)

# s of each window
ROUNDS = 5
SPAN = 4.0
RATES = {"ours": (100.0, 500.0), "sdk": (500.0,)}
ARRIVE = 1.0  # s for the last messages


class RosZenohProcess:
    """One process of `module`, which says `up` and then answers lines."""

    def __init__(self, *words: str, module: str = "bench.ros_zenoh_parts") -> None:
        command = [sys.executable, "-m", module, *words]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        if self._line() != "up\n":
            raise MeasurementUnavailable(f"{words[0]} did not start")

    def ask(self, text: str = "") -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(text + "\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._line())
        return answer

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextmanager
def router() -> Iterator[str]:
    """A router of this machine; where it is."""
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{sock.getsockname()[1]}"
    command = [sys.executable, "-m", "bench.fleet_parts", "router", endpoint]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        process.stdout.readline()
        yield endpoint
    finally:
        process.kill()
        process.communicate()


def take() -> Mapping[str, MeasuredFigure]:
    """Every publisher at its rates, one after the other, the same reader for all."""
    if find_spec("zenoh_ros2_sdk") is None:
        raise MeasurementUnavailable("zenoh-ros2-sdk is not installed")
    windows: dict[str, list[dict[str, Any]]] = {}
    with ExitStack() as ends, router() as endpoint:
        reader = RosZenohProcess("hears", endpoint)
        ends.callback(reader.close)

        def window(who: str, rate: float) -> float:
            part = RosZenohProcess(who, endpoint, str(rate))
            try:
                reader.ask()
                told = part.ask(str(SPAN))
                time.sleep(ARRIVE)
                windows.setdefault(f"{who} {rate:g}", []).append(told | reader.ask())
            finally:
                part.close()
            return float(told["cpu"])

        takes = {
            f"{who} {rate:g}": partial(window, who, rate) for who, rates in RATES.items() for rate in rates
        }
        interleaved(ROUNDS, takes)
    return _figures(windows)


def _figures(windows: Mapping[str, list[dict[str, Any]]]) -> dict[str, MeasuredFigure]:
    cpu = {who: [each["cpu"] * 1e2 for each in rows] for who, rows in windows.items()}
    late = {who: [each["way"]["0.99"] * 1e3 for each in rows] for who, rows in windows.items()}
    share = medians(cpu)
    p99 = medians(late)
    half = medians({who: [each["way"]["0.5"] * 1e6 for each in rows] for who, rows in windows.items()})
    call = medians({who: [each["call"] * 1e6 for each in rows] for who, rows in windows.items()})
    lost = {who: sum(each["sent"] - each["count"] for each in rows) for who, rows in windows.items()}
    sent = {who: sum(each["sent"] for each in rows) for who, rows in windows.items()}
    gone = ", ".join(f"{lost[who]} of {sent[who]} ({who} Hz)" for who in windows)
    how = "JointState, 24 joints, three columns; a process of each, router and reader on loopback"
    return {
        "ros.zenoh_cpu_500hz": MeasuredFigure(
            share["ours 500"],
            f"{how}; % of a core, all threads of the publisher; a message made and sent in "
            f"{call['ours 500']:.0f} µs; at 100 Hz {share['ours 100']:.2g} %; {spread(cpu['ours 500'], '%')}",
            {"zenoh-ros2-sdk": share["sdk 500"]},
        ),
        "ros.zenoh_latency_p99": MeasuredFigure(
            p99["ours 500"],
            f"{how}; 500 Hz, stamp to decoded by zenoh-ros2-sdk (Python); p50 {half['ours 500']:.0f} µs; at "
            f"100 Hz p99 {p99['ours 100']:.2g} ms; {spread(late['ours 500'], 'ms')}; lost {gone}",
            {"zenoh-ros2-sdk": p99["sdk 500"]},
        ),
    }


MEASUREMENTS = (
    Measurement(
        {"ros.zenoh_cpu_500hz": FigureSpec("%", "≤ 1 ×"), "ros.zenoh_latency_p99": FigureSpec("ms", "≤ 1 ×")},
        take,
    ),
)
