"""`ros.dds_*`: what 24 joints in a ROS graph over DDS cost, beside the typed writer of cyclonedds."""

import shutil
import struct
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bench.daemon import scratch
from bench.harness import (
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    interleaved,
    medians,
    quantile,
    spread,
)
from bench.ros_zenoh import RosZenohProcess
from tests.support.dds_domain import free_domain
from twind.ros import JOINT_STATE, dds_type

# s of each window
ROUNDS = 5
SPAN = 4.0
RATES = {"ours": (100.0, 500.0), "idl": (500.0,)}
# s until the reader is there; s for the last messages
START = 10.0
ARRIVE = 0.5
SOURCE = Path(__file__).parents[1] / "tests" / "dds" / "fast_dds.cpp"
_RECORD = struct.Struct("<QII")
_STAMP = struct.Struct("<iI")


def built(folder: Path) -> Path:
    """The reader: Fast DDS in C++, what most ROS nodes have. Raises CannotTake."""
    if shutil.which("g++") is None or not Path("/usr/include/fastdds").is_dir():
        raise MeasurementUnavailable("no g++ or no libfastrtps-dev: the reader is Fast DDS in C++")
    program = folder / "fast_dds"
    command = ["g++", "-std=c++17", "-O2", "-w", "-o", str(program), str(SOURCE), "-lfastrtps", "-lfastcdr"]
    subprocess.run(command, check=True)
    return program


@contextmanager
def reader(program: Path, folder: Path, domain: int) -> Iterator[Path]:
    """The reader of joint states; the file of what it heard."""
    words = (str(domain), "listen", str(folder), "rt/hw/joint_states", dds_type(JOINT_STATE))
    found = folder / "found"  # a file: what it finds of others is more than a pipe holds
    with found.open("wb") as output:
        process = subprocess.Popen([str(program), *words], stdin=subprocess.PIPE, stdout=output)
    try:
        deadline = time.monotonic() + START
        while b"ready" not in found.read_bytes():
            if process.poll() is not None or time.monotonic() > deadline:
                raise MeasurementUnavailable(f"the reader did not start in domain {domain}")
            time.sleep(0.01)
        yield folder / "samples"
    finally:
        process.kill()
        process.communicate()


def ways(data: bytes) -> list[float]:
    """s from stamp to arrival of each message in the reader's file."""
    found = []
    at = 0
    while at + _RECORD.size < len(data):
        came, _, length = _RECORD.unpack_from(data, at)
        sec, nanosec = _STAMP.unpack_from(data, at + _RECORD.size + 4)
        found.append((came - sec * 10**9 - nanosec) / 1e9)
        at += _RECORD.size + length
    return found


def take() -> Mapping[str, MeasuredFigure]:
    """Every publisher at its rates, one after the other, the same reader for all."""
    if find_spec("cyclonedds") is None:
        raise MeasurementUnavailable("cyclonedds is not installed")
    windows: dict[str, list[dict[str, Any]]] = {}
    with scratch() as folder, free_domain() as domain, reader(built(folder), folder, domain) as samples:

        def window(who: str, rate: float) -> float:
            part = RosZenohProcess(who, str(domain), str(rate), module="bench.ros_parts")
            try:
                part.ask("1")  # warm: both know each other, the caches are filled
                time.sleep(ARRIVE)
                before = samples.stat().st_size
                told = part.ask(str(SPAN))
                time.sleep(ARRIVE)
                with samples.open("rb") as file:
                    file.seek(before)
                    came = ways(file.read())
            finally:
                part.close()
            windows.setdefault(f"{who} {rate:g}", []).append(told | {"ways": came})
            return float(told["cpu"])

        takes = {
            f"{who} {rate:g}": partial(window, who, rate) for who, rates in RATES.items() for rate in rates
        }
        interleaved(ROUNDS, takes)
    return _figures(windows)


def _figures(windows: Mapping[str, Sequence[dict[str, Any]]]) -> dict[str, MeasuredFigure]:
    def row(of: str, scale: float) -> dict[str, list[float]]:
        return {who: [each[of] * scale for each in rows] for who, rows in windows.items()}

    def way(rank: float) -> dict[str, list[float]]:
        return {who: [quantile(each["ways"], rank) * 1e3 for each in rows] for who, rows in windows.items()}

    cpu = row("cpu", 1e2)
    late = way(0.99)
    share, call, p99, half, most = map(medians, (cpu, row("call", 1e6), late, way(0.5), way(1.0)))
    lost = {who: sum(each["sent"] - len(each["ways"]) for each in rows) for who, rows in windows.items()}
    sent = {who: sum(each["sent"] for each in rows) for who, rows in windows.items()}
    gone = ", ".join(f"{lost[who]} of {sent[who]} ({who} Hz)" for who in windows)
    how = "JointState, 24 joints, three columns; publisher and reader (Fast DDS, C++) on loopback"
    return {
        "ros.dds_cpu_500hz": MeasuredFigure(
            share["ours 500"],
            f"{how}; % of a core, all threads of the publisher; a message made and sent in "
            f"{call['ours 500']:.0f} µs, theirs {call['idl 500']:.0f} µs; at 100 Hz "
            f"{share['ours 100']:.2g} %; {spread(cpu['ours 500'], '%')}",
            {"cyclonedds, IDL classes": share["idl 500"]},
        ),
        "ros.dds_latency_p99": MeasuredFigure(
            p99["ours 500"],
            f"{how}; 500 Hz, stamp to bytes in C++; p50 {half['ours 500'] * 1e3:.0f} µs, max "
            f"{most['ours 500']:.2g} ms; at 100 Hz p99 {p99['ours 100']:.2g} ms; "
            f"{spread(late['ours 500'], 'ms')}; lost {gone}",
            {"cyclonedds, IDL classes": p99["idl 500"]},
        ),
    }


MEASUREMENTS = (
    Measurement(
        {"ros.dds_cpu_500hz": FigureSpec("%", "≤ 4"), "ros.dds_latency_p99": FigureSpec("ms", "≤ 1")}, take
    ),
)
