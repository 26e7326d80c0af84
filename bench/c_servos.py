"""A daemon on servos in C: a process of `bench/native/servos.c` for each bus, with the timing of a wire.

The servos share no code with `twind`. Of the daemon only files and command lines are used,
so that every commit with the same formats can be measured.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from bench.base_commit import SourceTree
from bench.compiled import compiled
from bench.daemon import BenchDaemon, await_state, twind
from bench.harness import MeasurementUnavailable

BAUD_REGISTER = {57_600: 1, 115_200: 2, 1_000_000: 3, 2_000_000: 4, 3_000_000: 5, 4_000_000: 6}
USB_TICK = 250  # µs between two hand-overs of the adapter
PRIORITY = 60  # SCHED_FIFO of the servos, above the loop's: real ones do not wait for a processor
VIRTUAL_START = 60.0  # s


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """Wire and adapter of the servos, and the core they run on."""

    usb_tick_us: int = USB_TICK
    return_delay_us: int = 0  # 0: register 9 of the answering servo
    core: int | None = None


@contextmanager
def on_c_servos(
    tree: SourceTree,
    folder: Path,
    robot: Path,
    *arguments: str,
    servos: ServoSettings = ServoSettings(),
) -> Iterator[BenchDaemon]:
    """Yield a connected, disarmed daemon of `tree` in mode live. Raises MeasurementUnavailable."""
    program = compiled("servos", folder)
    place = folder / tree.name.replace(" ", "-")
    place.mkdir(exist_ok=True)
    measured = place / f"{robot.stem}-calibration.yaml"
    if not measured.exists():
        _write_calibration(tree, robot, measured)
    rows = servo_files(robot, measured, place)
    with ExitStack() as stack:
        ports = [
            f"--port={bus}={stack.enter_context(serving(program, path, baud, servos))}"
            for bus, (path, baud) in rows.items()
        ]
        files = ("--mode", "live", "--robot", str(robot), "--calibration", str(measured))
        environment = tree.environment()
        daemon = stack.enter_context(twind(place, *files, *ports, *arguments, environment=environment))
        await_state(daemon, "connected")
        yield daemon


def servo_files(robot: Path, measured: Path, folder: Path) -> dict[str, tuple[Path, int]]:
    """File and baud rate for the servos of each bus, with the EEPROM that the calibration expects."""
    described: dict[str, Any] = yaml.safe_load(robot.read_text())
    joints = yaml.safe_load(measured.read_text())["joints"]
    lines: dict[str, list[str]] = {bus: [] for bus in described["buses"]}
    for name, joint in described["joints"].items():
        bus = joint.get("bus", described["defaults"].get("bus"))
        kind = described["types"][joint.get("type", described["defaults"].get("type"))]
        limits = joints[name]["device"]["eeprom"]
        registers = (
            f"8:1={BAUD_REGISTER[described['buses'][bus]['baud']]}",
            f"9:1={kind['return_delay_us'] // 2}",
            f"48:4={limits['max_ticks']}",
            f"52:4={limits['min_ticks']}",
            f"84:2={kind['gains']['p']}",
        )
        lines[bus].append(f"{joint['id']} {joints[name]['zero_ticks']} {name} {' '.join(registers)}\n")
    files = {}
    for bus, rows in lines.items():
        path = folder / f"{robot.stem}-{bus}.servos"
        path.write_text("".join(rows))
        files[bus] = (path, int(described["buses"][bus]["baud"]))
    return files


@contextmanager
def serving(program: Path, file: Path, baud: int, settings: ServoSettings) -> Iterator[str]:
    """Yield the port of a running servo process. It ends with its standard input."""
    command = [str(program), str(file), "--baud", str(baud), "--usb-tick-us", str(settings.usb_tick_us)]
    command += ["--return-delay-us", str(settings.return_delay_us)]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        port = process.stdout.readline().strip()
        if not port:
            raise MeasurementUnavailable("the servos in C did not start")
        with suppress(PermissionError):
            os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(PRIORITY))
        if settings.core is not None:
            os.sched_setaffinity(process.pid, {settings.core})
        yield port
    finally:
        process.stdin.close()
        process.terminate()
        process.wait(10.0)
        process.stdout.close()


def _write_calibration(tree: SourceTree, robot: Path, path: Path) -> None:
    """Calibration of `robot` as the virtual robot of `tree` writes it. Raises MeasurementUnavailable."""
    command = [sys.executable, "-m", "twind.virtual", "--robot", str(robot), "--calibration", str(path)]
    process = subprocess.Popen(
        [*command, "--muscles", "first-order"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        env=tree.environment(),
        cwd=tree.folder,
    )
    assert process.stdin is not None
    until = time.monotonic() + VIRTUAL_START
    while not path.exists() and process.poll() is None and time.monotonic() < until:
        time.sleep(0.05)
    process.stdin.close()
    process.wait(VIRTUAL_START)
    if not path.exists():
        raise MeasurementUnavailable(f"{tree.name}: its virtual robot wrote no calibration")
