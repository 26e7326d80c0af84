"""Access of the doctor to this machine: /proc, /sys, /dev, programs, systemd. Reads only.

The kernel's folders are arguments, so that a test can replace them.
"""

import os
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from twind.exceptions import OperationFailed
from twind.protocol.socket_paths import SYSTEM
from twind_drivers.ports.can_interface_lock import owners
from twind_drivers.ports.port_holder import command

PATIENCE = 5.0  # s for a program
BOOTED = Path("/run/systemd/system")  # sd_booted(3): exists only where systemd is the init system
LAST_LINES = 8  # systemd itself writes up to five after the last line of a service that failed
RUNNING = ("active", "activating", "reloading")


class PortHolder(NamedTuple):
    """Process that has a port open or locked."""

    pid: int
    command: str  # its command line, 80 characters at most


@dataclass(frozen=True)
class HostInspector:
    """Machine as one user sees it."""

    proc: Path = Path("/proc")
    sys: Path = Path("/sys")
    dev: Path = Path("/dev")
    etc: Path = Path("/etc")
    environ: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    uid: int = field(default_factory=os.geteuid)

    def holders(self, path: str) -> list[PortHolder]:
        """List the other processes that have the device open or locked, as far as this user may see them.

        A child that has what its parent has is left out: it inherited it.
        """
        real = os.path.realpath(path)
        found = set(self._lockers(path))
        for entry in self.proc.iterdir():
            if entry.name.isdigit():
                try:
                    held = [fd for fd in (entry / "fd").iterdir() if os.readlink(fd) == real]
                except OSError:  # gone, or another user's
                    continue
                if any(_is_same_node(fd, path) for fd in held):
                    found.add(int(entry.name))
        return self._others(found)

    def owners(self, interface: str) -> list[PortHolder]:
        """List the other processes that own a CAN interface as twind does, if visible to this user."""
        return self._others(set(owners(interface, self.proc)))

    def daemons(self) -> list[PortHolder]:
        """List the daemons of every user; fewer where /proc hides them (proc(5), hidepid)."""
        lines = {pid: " ".join(self.command_line(pid)) for pid in self.processes() if pid != os.getpid()}
        return [PortHolder(pid, line) for pid, line in lines.items() if is_daemon(line)]

    def command_line(self, pid: int) -> list[str]:
        """Return the command line of a process; empty where it is hidden or gone."""
        return (self.text(self.proc / str(pid) / "cmdline") or "").rstrip("\0").split("\0")

    def unit(self, pid: int) -> str:
        """Return the service of a process, by its control group (cgroups(7)): `0::/system.slice/UNIT`."""
        groups = (self.text(self.proc / str(pid) / "cgroup") or "").splitlines()
        names = (os.path.basename(line.rpartition(":")[2]) for line in groups)
        return next((name for name in names if name.endswith(".service")), "")

    def hears(self, interface: str) -> bool:
        """Return whether a program of this network namespace receives frames of a CAN interface.

        Lines of /proc/net/can/rcvlist_*: device, id, mask, two pointers, matches, owner (net/can/proc.c).
        """
        for file in sorted((self.proc / "net/can").glob("rcvlist_*")):
            for line in (self.text(file) or "").splitlines():
                words = line.split()
                if len(words) == 7 and words[0] in (interface, "any"):
                    return True
        return False

    def has_listener(self, path: str) -> bool | None:
        """Return whether a process listens on a Unix socket, also in a hidden folder; None: unknown.

        Lines of /proc/net/unix: number, references, protocol, flags, type, state, inode, path; flag 0x10000
        is __SO_ACCEPTCON, a listener (proc(5)). Of this network namespace alone.
        """
        table = self.text(self.proc / "net/unix")
        if table is None:
            return None
        lines = [line.split(maxsplit=7) for line in table.splitlines()[1:]]
        heard = {words[7] for words in lines if len(words) == 8 and int(words[3], 16) & 0x10000}
        return not heard.isdisjoint((path, os.path.realpath(path)))

    def _others(self, found: set[int]) -> list[PortHolder]:
        found.discard(os.getpid())
        return [PortHolder(pid, command(pid)) for pid in sorted(found) if self._parent(pid) not in found]

    def _lockers(self, path: str) -> Iterator[int]:
        """Yield the pids of every user that locked the node.

        Lines of /proc/locks: `1: FLOCK ADVISORY WRITE PID MAJOR:MINOR:INODE 0 EOF` (proc(5)).
        """
        try:
            node = os.stat(path)
        except OSError:
            return
        wanted = f"{os.major(node.st_dev):02x}:{os.minor(node.st_dev):02x}:{node.st_ino}"
        for line in (self.text(self.proc / "locks") or "").splitlines():
            words = line.split()
            if len(words) >= 6 and words[1] == "FLOCK" and words[5] == wanted and int(words[4]) > 0:
                yield int(words[4])

    def _parent(self, pid: int) -> int:
        words = self.stat(pid)
        return 0 if words is None else int(words[1])

    def age(self, pid: int) -> float | None:
        """Return the age (s) of a process; None where it is hidden or gone."""
        words = self.stat(pid)
        up = self.text(self.proc / "uptime")
        if words is None or up is None:
            return None
        return float(up.split()[0]) - int(words[19]) / os.sysconf("SC_CLK_TCK")  # field 22 (proc(5))

    def children(self, pid: int, word: str) -> list[tuple[int, float]]:
        """List pid and age (s) of the children of a process with `word` in their command line."""
        found = []
        for other in self.processes():
            words = self.stat(other)
            age = self.age(other)
            if words is not None and age is not None and int(words[1]) == pid and word in command(other):
                found.append((other, age))
        return found

    def processes(self) -> list[int]:
        """List the pids that this user may see."""
        return sorted(int(entry.name) for entry in self.proc.iterdir() if entry.name.isdigit())

    def stat(self, pid: int) -> list[str] | None:
        """Return the fields of /proc/PID/stat from the third on: the second may hold spaces and brackets."""
        text = self.text(self.proc / str(pid) / "stat")
        return None if text is None or ")" not in text else text.rpartition(")")[2].split()

    def text(self, path: Path) -> str | None:
        """Return the stripped text of a small file; None: it is missing or unreadable."""
        try:
            return path.read_text(errors="replace").strip()
        except OSError:
            return None

    def number(self, path: Path) -> int | None:
        """Return the whole number in a file; None: there is none."""
        text = self.text(path)
        try:
            return None if text is None else int(text)
        except ValueError:
            return None

    def program(self, *words: str) -> str:
        """Return the standard output of a program.

        Raises OperationFailed: it is not installed, failed, or took too long.
        """
        try:
            done = subprocess.run(
                words, capture_output=True, text=True, timeout=PATIENCE, check=False, stdin=subprocess.DEVNULL
            )
        except FileNotFoundError:
            raise OperationFailed(f"{words[0]} is not installed") from None
        except (OSError, subprocess.TimeoutExpired) as error:
            raise OperationFailed(f"`{' '.join(words[:3])}`: {error}") from error
        if done.returncode:
            output = done.stderr.strip() or done.stdout.strip() or f"exit code {done.returncode}"
            raise OperationFailed(f"`{' '.join(words[:3])}`: {output.splitlines()[0]}")
        return done.stdout


def is_daemon(command: str) -> bool:
    """Return whether a command line is a daemon's: `…/bin/twind`, also after `python`, or `-m twind.cli`."""
    return any(os.path.basename(word) in ("twind", "twind.cli") for word in command.split()[:3])


def _is_same_node(one: Path, other: str) -> bool:
    """Return whether both are one node: a container has a /dev/pts/0 of its own. Unknown: True."""
    try:
        return os.path.samestat(one.stat(), os.stat(other))
    except OSError:
        return True


def properties(host: HostInspector, unit: str, *names: str) -> dict[str, str]:
    """Return properties of a unit by `systemctl show`. Raises OperationFailed."""
    return parse_properties(host.program("systemctl", "show", unit, "-p", ",".join(names)))


def parse_properties(text: str) -> dict[str, str]:
    """Parse the `Key=value` lines of `systemctl show`."""
    return dict(line.split("=", 1) for line in text.splitlines() if "=" in line)


def asleep(host: HostInspector, path: str) -> str:
    """Return the service that a connection to this socket would start; "": none.

    A diagnosis starts no daemon, which would take the ports (systemd.socket(5)).
    """
    folder, file = os.path.split(os.path.abspath(path))
    above, instance = os.path.split(folder)
    if not BOOTED.is_dir() or SYSTEM not in (folder, above):
        return ""
    at = "" if folder == SYSTEM else f"@{instance}"
    service = f"twind{at}.service"
    listener = f"twind-{file.removesuffix('.sock')}{at}.socket"
    try:
        states = host.program("systemctl", "show", "-P", "ActiveState", service, listener).split()
    except OperationFailed:
        return ""
    return service if len(states) == 2 and states[0] not in RUNNING and states[1] == "active" else ""


def would_start(service: str) -> str:
    """Describe the stopped `service` that a socket starts."""
    return f"{service} is stopped, and a connection would start it"


def last_lines(host: HostInspector, unit: str) -> str:
    """Return the last lines of a service's journal, or the reason why they are unavailable."""
    try:
        lines = host.program("journalctl", "-u", unit, "-n", str(LAST_LINES), "-o", "cat", "--no-pager", "-q")
    except OperationFailed as error:
        return f"(its journal cannot be read: {error})"
    return lines.strip() or f"(no line of it may be read: `sudo journalctl -u {unit}`)"
