"""Real processes for the figures: the daemon, its virtual robot, a client that counts bytes, `cyclictest`."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from bench.harness import MeasurementUnavailable
from twind.client import Client
from twind.config.driver_family import family
from twind.config.port_names import Medium
from twind.config.robot_file import load_robot
from twind.loop.process.virtual_robot_process import VirtualRobotProcess
from twind_drivers.ports.can_ports import is_can

# s that they may take
READY = 30.0
CONNECTED = 15.0
CYCLICTEST = "cyclictest"  # of the Debian package rt-tests


@dataclass(frozen=True, slots=True)
class BenchDaemon:
    """A running `twind` process that the benchmark started."""

    pid: int
    sockets: Path
    started: float  # s from exec to READY=1

    def client(self) -> Client:
        """A new connection to the control socket."""
        return Client(self.sockets)

    @property
    def front(self) -> int:
        """Process of the front, which is the only child of the daemon. Raises MeasurementUnavailable."""
        children = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()
        if len(children) != 1:
            raise MeasurementUnavailable(f"the daemon has {len(children)} children, expected its front")
        return int(children[0])


@contextmanager
def scratch() -> Iterator[Path]:
    """Yield a temporary folder that is deleted at the end."""
    with tempfile.TemporaryDirectory(prefix="twind-bench-") as folder:
        yield Path(folder)


@contextmanager
def twind(
    folder: Path,
    *arguments: str,
    command: Sequence[str] = ("-m", "twind.cli"),
    environment: Mapping[str, str] = os.environ,
) -> Iterator[BenchDaemon]:
    """Yield a daemon that has sent READY=1; SIGTERM ends it. Raises MeasurementUnavailable."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(folder / "notify"))
    listener.settimeout(READY)
    line = [sys.executable, *command, "--socket", str(folder), *arguments]
    variables = {**environment, "NOTIFY_SOCKET": str(folder / "notify")}
    log = folder / "twind.log"
    with listener, log.open("wb") as output:
        since = time.monotonic()
        process = subprocess.Popen(line, env=variables, stdin=subprocess.DEVNULL, stderr=output)
        try:
            _await_ready(listener, process)
            yield BenchDaemon(process.pid, folder, time.monotonic() - since)
        except MeasurementUnavailable as reason:
            last = log.read_text(errors="replace").strip().splitlines()[-1:]
            raise MeasurementUnavailable(f"{reason} {' '.join(last)}".strip()) from None
        finally:
            _end(process)
            (folder / "notify").unlink()


def _await_ready(listener: socket.socket, process: subprocess.Popen[bytes]) -> None:
    until = time.monotonic() + READY
    listener.settimeout(0.1)
    while time.monotonic() < until:
        try:
            if b"READY=1" in listener.recv(4096).splitlines():
                return
        except TimeoutError:
            if process.poll() is not None:
                raise MeasurementUnavailable(
                    f"the daemon ended with {process.returncode} before READY=1"
                ) from None
    raise MeasurementUnavailable(f"no READY=1 within {READY:g} s")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(20.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def live(
    folder: Path,
    *arguments: str,
    robot: str = "h24",
    command: Sequence[str] = ("-m", "twind.cli"),
    apart: bool = False,
) -> Iterator[BenchDaemon]:
    """Yield a connected, disarmed daemon in mode live on the virtual servos of a separate process.

    `apart`: one process per bus; the joints of each bus then move independently of the other buses.
    """
    buses = load_robot(robot).buses
    adapters = {bus.name for bus in buses if family(bus.kind).medium is Medium.CAN}
    with ExitStack() as stack:
        if apart:
            alone = [("--muscles", "first-order", "--bus", bus.name) for bus in buses]
            children = [stack.enter_context(VirtualRobotProcess(robot, *options)) for options in alone]
        else:
            children = [stack.enter_context(VirtualRobotProcess(robot))]
        ports = [
            f"--port={name}={'can:slcan:' if name in adapters and not is_can(path) else ''}{path}"
            for child in children
            for name, path in child.ports.items()
        ]
        files = ("--robot", robot, "--calibration", str(children[0].calibration))
        with twind(folder, "--mode", "live", *ports, *files, *arguments, command=command) as daemon:
            await_state(daemon, "connected")
            yield daemon


def await_state(daemon: BenchDaemon, wanted: str) -> None:
    """Return when the state of the robot is `wanted`. Raises MeasurementUnavailable."""
    until = time.monotonic() + CONNECTED
    state = ""
    with daemon.client() as client:
        while time.monotonic() < until:
            state = client.call("GetStatus")["status"]["state"]
            if state == wanted:
                return
            time.sleep(0.05)
    raise MeasurementUnavailable(f"the robot is {state} after {CONNECTED:g} s, expected {wanted}")


def require_armed(daemon: BenchDaemon) -> None:
    """Raises MeasurementUnavailable where the robot is armed no longer: an idle one costs less."""
    with daemon.client() as client:
        status = client.call("GetStatus")["status"]
    if status["state"] != "armed":
        raise MeasurementUnavailable(f"the robot was {status['state']} at the end, expected armed")


class StatusPoller:
    """Client that calls `GetStatus` with all joints over a bare socket and does not parse the answers."""

    CALL = b'{"method":"io.twind.Control.GetStatus","parameters":{"joints":true}}\0'

    def __init__(self, daemon: BenchDaemon) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(5.0)
        self._socket.connect(str(daemon.sockets / "control.sock"))

    def ask(self) -> int:
        """Send one call and read its whole answer; return the bytes of the answer."""
        self._socket.sendall(self.CALL)
        size = 0
        data = b"?"
        while data and data[-1]:
            data = self._socket.recv(1 << 16)
            size += len(data)
        return size

    def flat_out(self, seconds: float) -> int:
        """Send calls without pause; return the number of answered calls."""
        until = time.monotonic() + seconds
        count = 0
        while time.monotonic() < until:
            self.ask()
            count += 1
        return count

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class Cyclictest:
    """`cyclictest` run in parallel at 100 Hz, with the policy of `twind`; p99 from its histogram."""

    LONGEST = 20_000  # µs of the histogram

    def __init__(self, policy: str) -> None:
        """`policy`: scheduling policy as `GetStatus` reports it: `fifo 40`, or why it is not set."""
        self.path = shutil.which(CYCLICTEST)
        wanted = re.fullmatch(r"fifo (\d+)", policy)
        self._policy = ["--policy=fifo", f"--priority={wanted[1]}"] if wanted else ["--policy=other"]
        self._process: subprocess.Popen[str] | None = None

    def start(self, seconds: float) -> None:
        """Start a run; does nothing where `cyclictest` is not installed."""
        if self.path is None:
            return
        # --default-system: it must not tune the machine for itself, and so for us.
        command = [self.path, "--default-system", "--quiet", "--mlockall", "--interval=10000", *self._policy]
        command += [f"--loops={round(seconds * 100)}", f"--histogram={self.LONGEST}"]
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

    def p99(self) -> float | None:
        """Return the 99th percentile latency of the last run, µs; None without a run. Waits for its end."""
        if self._process is None:
            return None
        output, _ = self._process.communicate(timeout=60.0)
        self._process = None
        rows = re.findall(r"^(\d{6}) (\d+)$", output, re.MULTILINE)
        above = re.search(r"Histogram Overflows: (\d+)", output)
        total = sum(int(count) for _, count in rows) + int(above[1] if above else 0)
        seen = 0
        for late, count in rows:
            seen += int(count)
            if seen >= 0.99 * total:
                return float(late)
        return float(self.LONGEST) if total else None
