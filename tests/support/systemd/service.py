"""A unit of twind on the machine of the tests, a robot for it to drive, and how to ask both."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from tests.support.processes import Virtual
from tests.support.systemd.boot import FAVOURED
from tests.support.systemd.installed import REPOSITORY
from tests.support.systemd.machine import Machine, stop
from twind.client import Client, ClientError

START = 20.0  # s that a busy machine may take to start a daemon
DYNAMIC_USER = 61184  # the first user id that systemd gives to a service with DynamicUser=
Json = dict[str, Any]


def unprivileged_user(pid: int) -> int:
    """User id of a process that has no capability, gains no privilege and runs under a seccomp filter."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    status = dict(line.split(":\t", 1) for line in lines)
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")
    assert {int(status[key], 16) for key in ("CapEff", "CapPrm", "CapBnd", "CapAmb")} == {0}
    return int(status["Uid"].split()[1])


class Unit:
    """A unit, as systemd knows it."""

    def __init__(self, machine: Machine, unit: str) -> None:
        self.machine = machine
        self.unit = unit
        self._since = time.time()  # of this machine's clock, which is the journal's

    def start(self) -> Self:
        """Wait until systemd says that it is started. Raises Failed. Earlier starts do not count."""
        self.reset()
        self._since = time.time()
        self.machine.run("systemctl", "start", self.unit, seconds=START)
        return self

    def stop(self) -> None:
        """Wait until it is stopped."""
        self.machine.run("systemctl", "stop", self.unit, seconds=60.0)

    def reset(self) -> None:
        """Neither failed nor started lately."""
        self.machine.try_run("systemctl", "reset-failed", self.unit)

    def show(self, name: str) -> str:
        """A property, as systemd has it."""
        return self.machine.run("systemctl", "show", "-P", name, self.unit).strip()

    def until(self, seconds: float = START, **wanted: str) -> None:
        """Wait until these properties are so."""

        def so() -> bool:
            return all(self.show(name) == value for name, value in wanted.items())

        self.machine.until(so, seconds, f"{self.unit}: {wanted}")

    def signal(self, number: signal.Signals) -> None:
        """To the main process, as systemd knows it."""
        self.machine.run("systemctl", "kill", "-s", number.name, "--kill-whom=main", self.unit)

    def pids(self) -> dict[int, str]:
        """Its processes as this machine numbers them, with their command lines."""
        found = {}
        for pid in self.machine.pids(self.show("ControlGroup")):
            with suppress(OSError):
                found[pid] = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
        return found

    def main(self) -> int:
        """The main process, as this machine numbers it."""
        inside = self.show("MainPID")
        for pid in self.pids():
            if _inner(pid) == inside:
                return pid
        raise AssertionError(f"{self.unit} has no main process\n{self.machine.diagnostics()}")

    def within(self, *command: str) -> str:
        """Output of a command that runs under the unit's device rules and in its view of the machine."""
        cgroup = self.machine.cgroup(self.show("ControlGroup"))
        enter = f'echo $$ > {cgroup}/cgroup.procs; exec nsenter -t {self.main()} -m -r -w setpriv "$@"'
        # Users are those of the machine: their numbers are looked up inside.
        numbers = [self.machine.run("id", flag, "twind").strip() for flag in ("-u", "-g")]
        who = ["--reuid", numbers[0], "--regid", numbers[1], "--clear-groups"]
        done = subprocess.run(
            ["sh", "-c", enter, "sh", *who, *command], capture_output=True, text=True, timeout=10
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def journal(self, *options: str) -> list[Json]:
        """Messages about it, from itself and from systemd, oldest first. Since `start`, or since this object
        was made: others used the unit before."""
        since = f"--since=@{self._since:.6f}"
        text = self.machine.run("journalctl", "--no-pager", "-o", "json", since, "-u", self.unit, *options)
        return [json.loads(line) for line in text.splitlines()]

    def says(self, seconds: float, text: str, of: Callable[[Json], bool]) -> Json:
        """Wait for a line of its journal; that line."""
        return self.machine.until(lambda: next(filter(of, self.journal()), None), seconds, text)


class Service(Unit):
    """`twind.service` and its like, with the folder of its sockets."""

    def __init__(self, machine: Machine, unit: str = "twind.service", sockets: str = "/run/twind") -> None:
        super().__init__(machine, unit)
        self.sockets = sockets

    def front(self) -> int | None:
        """The front, as this machine numbers it; None while there is none."""
        return next((pid for pid, command in self.pids().items() if "twind.front" in command), None)

    def environment(self) -> list[str]:
        """Variables of the main process, NAME=VALUE."""
        return Path(f"/proc/{self.main()}/environ").read_bytes().decode().split("\0")

    def client(self, name: str = "control") -> Client:
        """A connection to one of its sockets, as root."""
        return Client(str(self.machine.inside(self.sockets)), name=name)

    def status(self) -> Json:
        """Asked anew. Raises ClientError."""
        with self.client() as client:
            status: Json = client.call("GetStatus")["status"]
            return status

    def reach(self, seconds: float = START, **wanted: Any) -> Json:
        """Wait until its status shows what is wanted."""

        def look() -> Json | None:
            with suppress(ClientError):
                status = self.status()
                if all(status[key] == value for key, value in wanted.items()):
                    return status
            return None

        return self.machine.until(look, seconds, f"{self.unit}: {wanted}")


class Robot(Virtual):
    """A virtual robot inside. Its ports are pseudo-terminals, root:dialout 0660 as udev makes adapters,
    behind links that stay: /run/robots/NAME/ports/BUS."""

    def __init__(self, machine: Machine, name: str, robot: str = "h24", *options: str) -> None:
        self.machine = machine
        self.name = name
        self.robot = robot
        self.place = f"/run/robots/{name}"
        self.folder = machine.inside(self.place)
        self.folder.mkdir(parents=True)
        self.calibration = self.folder / "calibration.yaml"
        command = [
            "twind-virtual",
            "--robot",
            robot,
            "--link",
            f"{self.place}/ports",
            "--muscles",
            "first-order",
        ]
        command += ["--calibration", f"{self.place}/calibration.yaml", "--faults", f"{self.place}/faults"]
        self.process = machine.popen("nice", "-n", str(FAVOURED), *command, *options)
        self.ports = {}
        assert self.process.stdout is not None
        while (line := self.process.stdout.readline().decode().split()) != ["ready"]:
            assert line, "twind-virtual did not start"
            self.ports[line[1]] = line[2]
        self.calibration.chmod(0o644)  # written by root, read by user twind

    def close(self) -> None:
        stop(self.process)

    def torque(self) -> set[bool]:
        """Torque of all servos: on, off, or some of each."""
        return {bool(servo["torque"]) for servo in self.servos()}

    def places(self) -> list[float]:
        """Positions of its servos, ticks."""
        return [servo["position"] for servo in self.servos()]

    def arrived(self) -> bool:
        """Every servo stands where it was sent."""
        return all(abs(servo["position"] - servo["goal"]) < 1.0 for servo in self.servos())

    def settings(self, **more: Any) -> Json:
        """Settings of a daemon that may drive it."""
        ports = {bus: f"{self.place}/ports/{bus}" for bus in self.ports}
        named = {"robot": self.robot, "calibration": f"{self.place}/calibration.yaml", "ports": ports}
        return {"mode": "live", **named, **more}


def settings(machine: Machine, name: str, content: Json | str) -> Path:
    """Write /etc/twind/NAME.yaml: the file, seen from here. (JSON is YAML.)"""
    path = machine.inside(f"/etc/twind/{name}.yaml")
    path.parent.mkdir(exist_ok=True)
    new = path.with_suffix(".new")
    new.write_text(content if isinstance(content, str) else json.dumps(content))
    os.replace(new, path)
    return path


def drop_in(machine: Machine, unit: str, example: str) -> None:
    """Put one of the repository's examples into that unit's folder."""
    path = machine.inside(f"/etc/systemd/system/{unit}.d/{example}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text((REPOSITORY / "systemd/examples" / example).read_text())
    machine.run("systemctl", "daemon-reload")


def _inner(pid: int) -> str:
    """Its number inside."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("NSpid:"):
            return line.split()[-1]
    return ""
