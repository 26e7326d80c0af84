"""Real processes for the tests: `twind-virtual` on ptys, `twind` on its port, a client on its socket.

Everything started here is ended here, by its own id.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from twind.client import Client, ClientError, Refused
from twind.config.driver_family import family
from twind.config.port_names import virtual_port
from twind.config.robot_file import load_robot

T = TypeVar("T")
# What a machine with too little time for daemon and virtual servos makes of a bus (docs/safety.md): nobody
# arms or moves while it is so, and a second after. Whoever uses the robot then asks again; so do the tests.
# A servo that is silent for 0.1 s, or hears nothing for so long, trips its watchdog or the driver's.
BUSY = frozenset({"BUS_ERRORS", "LOOP_LATE", "STATE_STALE", "LATENCY_BLOCK", "TIME_GAP", "WATCHDOG_TRIPPED"})
LATCHED = frozenset({"FAULT_LATCHED", "NOT_ARMED"})  # what such a thing leaves behind where it was bad enough
PATIENCE = 30.0  # s that a machine may be too busy


def until(what: Callable[[], T | None], seconds: float, message: str | Callable[[], str]) -> T:
    """Wait until `what` returns a true value, at most `seconds`, and return it; else fail with `message`."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        found = what()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError(f"not within {seconds} s: {message if isinstance(message, str) else message()}")


def favour(process: "subprocess.Popen[bytes] | subprocess.Popen[str]") -> None:
    """Before the other programs of this machine, where that is allowed: as the daemon's unit has it.

    Who starts later in that process inherits it.
    """
    with suppress(PermissionError, ProcessLookupError):
        os.setpriority(os.PRIO_PROCESS, process.pid, -10)


def patiently(call: Callable[[], T], seconds: float = PATIENCE) -> T:
    """Result of the call, which is repeated as long as a busy machine causes the refusal."""
    deadline = time.monotonic() + seconds
    while True:
        try:
            return call()
        except Refused as refusal:
            if not _busy(refusal.findings) or time.monotonic() > deadline:
                raise
            print(f"asked again: {refusal}")
        time.sleep(0.1)


def _busy(findings: Any) -> bool:
    """A busy machine is among the reasons. So it is where a question to a servo was lost at arming, and where
    a joint was heard, or its temperature and supply read, a moment too long ago."""
    return any(
        each["code"] in BUSY
        or (each["code"] == "ARM_FAILED" and "no reply" in each["message"])
        or any(each["message"].count(said) for said in ("not read lately", "not read yet"))
        or (each["code"] == "HW_DISCONNECTED" and "no fresh reading" in each["message"])
        for each in findings
    )


def arm(client: Client, *, take: bool = False) -> None:
    """The lease, then torque."""

    def both() -> None:
        client.call("AcquireLease", take=take)
        client.call("Arm")

    patiently(both)


def go(client: Client, trajectory: dict[str, Any], seconds: float = PATIENCE) -> dict[str, Any]:
    """The last answer to a motion that succeeded; asked for again where the machine was too busy for it."""
    deadline = time.monotonic() + seconds
    while True:
        last: dict[str, Any] = {}
        client.call("AcquireLease")  # arming may have taken longer than it lasts
        try:
            *_, last = client.stream("SubmitTrajectory", trajectory=trajectory)
            if last["phase"] == "succeeded":
                return last
            found = last["findings"]
        except Refused as refusal:
            found = refusal.findings
        status = client.call("GetStatus")["status"]
        latched = {each["code"] for each in status["faults"]}
        told = {each["code"] for each in found}
        assert _busy(found) or (told <= LATCHED and latched and latched <= BUSY), (last, found, latched)
        assert time.monotonic() < deadline, (last, found, latched)
        print(f"moved again: {told}, {latched}")
        time.sleep(0.3)
        if latched:
            rearm(client)


def rearm(client: Client) -> None:
    """Torque again, after a latched fault. Servos that a busy machine silenced are identified anew first."""
    client.call("Disarm")
    client.call("Reset")
    until(
        lambda: client.call("GetStatus")["status"]["state"] != "identifying",
        PATIENCE,
        "the robot is not identified again",
    )
    arm(client)


class Virtual:
    """A `twind-virtual` with its calibration, its links to the ports and its order socket."""

    def __init__(self, folder: Path, robot: str = "h24", *options: str) -> None:
        self.folder = folder
        self.robot = robot
        self.calibration = folder / "calibration.yaml"
        command = [sys.executable, "-m", "twind.virtual", "--robot", robot, "--link", str(folder / "ports")]
        command += ["--calibration", str(self.calibration), "--faults", str(folder / "faults"), *options]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        favour(self.process)
        assert self.process.stdout is not None
        self.ports = {}
        while (line := self.process.stdout.readline().decode().split()) != ["ready"]:
            assert line, "twind-virtual did not start"
            if line[0] == "bus":
                self.ports[line[1]] = line[2]

    def order(self, **order: Any) -> dict[str, Any]:
        """A fault or a query, and its answer."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
            client.settimeout(5.0)
            client.connect(str(self.folder / "faults"))
            client.sendall(json.dumps(order).encode() + b"\n")
            data = b""
            while not data.endswith(b"\n"):
                data += client.recv(1 << 20)
        answer: dict[str, Any] = json.loads(data)
        assert answer.get("ok", True), answer
        return answer

    def servos(self) -> list[dict[str, Any]]:
        """State of every servo."""
        return [servo for bus in self.order(query="state")["buses"].values() for servo in bus["servos"]]

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait(10)
        self.process.stdout.close()


class Daemon:
    """A `twind` in a folder of its own."""

    def __init__(
        self,
        folder: Path,
        *options: str,
        environment: dict[str, str] | None = None,
        stderr: int | None = None,
        enter: Sequence[str] = (),
    ) -> None:
        """Start it. `stderr` None: the file `log`; else the descriptor, and `log` stays empty.

        `enter`: a command that becomes the daemon, as `nsenter`.
        """
        folder.mkdir(exist_ok=True)
        self.sockets = folder
        self.log = folder / "log"
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [*enter, sys.executable, "-m", "twind.cli", "--socket", str(folder), *options],
                stderr=log if stderr is None else stderr,
                stdin=subprocess.DEVNULL,
                env={**os.environ, **(environment or {})},
            )
        favour(self.process)

    def client(self) -> Client:
        """A connection."""
        return Client(str(self.sockets))

    def status(self) -> dict[str, Any]:
        """Asked anew."""
        with self.client() as client:
            status: dict[str, Any] = client.call("GetStatus")["status"]
            return status

    def reach(self, seconds: float = 30.0, **wanted: Any) -> dict[str, Any]:
        """Wait until the status shows what is wanted."""

        def look() -> dict[str, Any] | None:
            assert self.process.poll() is None, self.log.read_text()
            with suppress(ClientError):
                status = self.status()
                if all(status[key] == value for key, value in wanted.items()):
                    return status
            return None

        return until(look, seconds, f"{wanted}: {self.log.read_text()}")

    def front(self) -> int:
        """Process id of the front: the child that runs it."""
        for child in self._children():
            if b"twind.front" in Path(f"/proc/{child}/cmdline").read_bytes():
                return child
        raise AssertionError("no front")

    def end(self, number: int = signal.SIGTERM, seconds: float = 20.0) -> int:
        """Signal it and wait for its end; its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.kill()
            raise

    def kill(self) -> None:
        """End it and its front at once, one that was stopped by a test too; nothing where it has ended."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGSTOP)  # it starts no other front, and no pid is used again
            for child in self._children():
                os.kill(child, signal.SIGKILL)
            self.process.kill()
        self.process.wait(10)

    def _children(self) -> list[int]:
        pid = self.process.pid
        return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


class Moving(threading.Thread):
    """A client that plays a motion; `last` is what it heard of it last, in the end how it ended."""

    def __init__(self, running: Daemon, trajectory: dict[str, Any]) -> None:
        super().__init__(daemon=True)
        self._running = running
        self._trajectory = trajectory
        self.last = ""
        self.start()

    def run(self) -> None:
        with self._running.client() as client:
            client.call("AcquireLease")
            try:
                for report in client.stream("SubmitTrajectory", trajectory=self._trajectory):
                    self.last = report["phase"]
            except Refused as refusal:  # a busy machine
                self.last = str(refusal)


@contextmanager
def unread_pipe() -> Iterator[int]:
    """Writing end of a full pipe that is never read."""
    reader, writer = os.pipe()
    try:
        os.set_blocking(writer, False)
        for size in (4096, 1):
            with suppress(BlockingIOError):
                while True:
                    os.write(writer, b"x" * size)
        os.set_blocking(writer, True)
        yield writer
    finally:
        os.close(reader)
        os.close(writer)


@contextmanager
def simulated(folder: Path, robot: str = "h24") -> Iterator[Daemon]:
    """A daemon in mode sim; killed at the end if the test did not end it."""
    running = Daemon(folder, "--mode", "sim", "--robot", robot)
    try:
        running.reach(mode="sim")
        yield running
    finally:
        running.kill()


@contextmanager
def twindctl(*words: str, **environment: str) -> Iterator["subprocess.Popen[str]"]:
    """A verb that goes on until it is told to end; killed at the end if nobody told it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "twind.ctl.ctl_main", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | environment,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait(10)
        assert process.stdout is not None
        process.stdout.close()


@contextmanager
def robot(name: str = "h24", *options: str) -> Iterator[tuple[Virtual, Path]]:
    """A virtual robot and a folder that goes with it."""
    with tempfile.TemporaryDirectory(prefix="twind-test-") as folder:
        virtual = Virtual(Path(folder), name, *options)
        try:
            yield virtual, Path(folder)
        finally:
            virtual.close()


@contextmanager
def daemon(
    virtual: Virtual,
    folder: Path,
    *,
    mode: str = "live",
    more: Sequence[str] = (),
    stderr: int | None = None,
) -> Iterator[Daemon]:
    """A daemon on that robot, with `more` options and that standard error (`Daemon`).

    Killed at the end if the test did not end it.
    """
    options = ["--mode", mode, "--robot", virtual.robot, "--calibration", str(virtual.calibration)]
    kinds = {bus.name: bus.kind for bus in load_robot(virtual.robot).buses}
    for bus in virtual.ports:
        port = virtual_port(family(kinds[bus]).medium, str(virtual.folder / "ports" / bus))
        options += ["--port", f"{bus}={port}"]
    running = Daemon(folder / "run", *options, *more, stderr=stderr)
    try:
        yield running
    finally:
        running.kill()
