"""This machine, really looked at: /proc, /sys, /dev, users and groups, programs. Nothing is changed here.

Where the kernel's folders stand is an argument, so that a test can plant what this machine has not.
"""

import os
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from twind.doctor.check import CheckUnavailable
from twind_drivers.can.can_interface_lock import owners
from twind_drivers.dynamixel.port_holder import command

PATIENCE = 5.0  # s for a program


class PortHolder(NamedTuple):
    """A process that has a port."""

    pid: int
    command: str  # its command line, 80 characters at most


@dataclass(frozen=True)
class HostInspector:
    """One machine as one user sees it."""

    proc: Path = Path("/proc")
    sys: Path = Path("/sys")
    dev: Path = Path("/dev")
    etc: Path = Path("/etc")
    environ: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    uid: int = field(default_factory=os.geteuid)

    def holders(self, path: str) -> list[PortHolder]:
        """Other processes that have the device open or locked, as far as this user may see them.

        A child that holds what its parent holds is left out: it has it by inheritance.
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
        """Other processes that own a CAN interface as twind does, as far as this user may see them."""
        return self._others(set(owners(interface, self.proc)))

    def daemons(self) -> list[PortHolder]:
        """Processes that are a twind, of any user; fewer where /proc hides them (proc(5), hidepid)."""
        lines = {pid: " ".join(self.command_line(pid)) for pid in self.processes() if pid != os.getpid()}
        return [PortHolder(pid, line) for pid, line in lines.items() if is_daemon(line)]

    def command_line(self, pid: int) -> list[str]:
        """The whole command line of a process; nothing where it is hidden or gone."""
        return (self.text(self.proc / str(pid) / "cmdline") or "").rstrip("\0").split("\0")

    def unit(self, pid: int) -> str:
        """The service of a process, by its control group (cgroups(7)): `0::/system.slice/UNIT`."""
        groups = (self.text(self.proc / str(pid) / "cgroup") or "").splitlines()
        names = (os.path.basename(line.rpartition(":")[2]) for line in groups)
        return next((name for name in names if name.endswith(".service")), "")

    def hears(self, interface: str) -> bool:
        """Has any program of this network namespace asked the kernel for frames of a CAN interface?

        Lines of /proc/net/can/rcvlist_*: device, id, mask, two pointers, matches, who (net/can/proc.c).
        """
        for file in sorted((self.proc / "net/can").glob("rcvlist_*")):
            for line in (self.text(file) or "").splitlines():
                words = line.split()
                if len(words) == 7 and words[0] in (interface, "any"):
                    return True
        return False

    def has_listener(self, path: str) -> bool | None:
        """Does anybody listen on a Unix socket, also where this user may not look? None: nobody can say.

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
        """Pids that flocked the node, anybody's: `1: FLOCK ADVISORY WRITE PID MAJOR:MINOR:INODE 0 EOF`."""
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
        """Seconds since a process began; None where it is hidden or gone."""
        words = self.stat(pid)
        up = self.text(self.proc / "uptime")
        if words is None or up is None:
            return None
        return float(up.split()[0]) - int(words[19]) / os.sysconf("SC_CLK_TCK")  # field 22 (proc(5))

    def children(self, pid: int, word: str) -> list[tuple[int, float]]:
        """Pid and age (s) of the children of a process with `word` in their command line."""
        found = []
        for other in self.processes():
            words = self.stat(other)
            age = self.age(other)
            if words is not None and age is not None and int(words[1]) == pid and word in command(other):
                found.append((other, age))
        return found

    def processes(self) -> list[int]:
        """Every pid that may be seen."""
        return sorted(int(entry.name) for entry in self.proc.iterdir() if entry.name.isdigit())

    def stat(self, pid: int) -> list[str] | None:
        """/proc/PID/stat from its third field on; the second may hold spaces and brackets."""
        text = self.text(self.proc / str(pid) / "stat")
        return None if text is None or ")" not in text else text.rpartition(")")[2].split()

    def text(self, path: Path) -> str | None:
        """A small file's text, stripped; None where there is none, or it may not be read."""
        try:
            return path.read_text(errors="replace").strip()
        except OSError:
            return None

    def number(self, path: Path) -> int | None:
        """A file that holds one whole number; None where it does not."""
        text = self.text(path)
        try:
            return None if text is None else int(text)
        except ValueError:
            return None

    def program(self, *words: str) -> str:
        """Standard output of a program. Raises CannotLook: it is not installed, failed, or took too long."""
        return self.program_or_status(words)[0]

    def program_or_status(self, words: Sequence[str], fine: Sequence[int] = (0,)) -> tuple[str, int]:
        """Standard output and exit code, one of `fine`. Raises CannotLook otherwise."""
        try:
            done = subprocess.run(
                words, capture_output=True, text=True, timeout=PATIENCE, check=False, stdin=subprocess.DEVNULL
            )
        except FileNotFoundError:
            raise CheckUnavailable(f"{words[0]} is not installed") from None
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CheckUnavailable(f"`{' '.join(words[:3])}`: {error}") from error
        if done.returncode not in fine:
            said = (
                done.stderr.strip() or done.stdout.strip() or f"exit code {done.returncode}"
            ).splitlines()[0]
            raise CheckUnavailable(f"`{' '.join(words[:3])}`: {said}")
        return done.stdout, done.returncode


def is_daemon(command: str) -> bool:
    """Is this a twind's command line? `…/python …/bin/twind`, `…/bin/twind`, `python -m twind.cli`."""
    return any(os.path.basename(word) in ("twind", "twind.cli") for word in command.split()[:3])


def _is_same_node(one: Path, other: str) -> bool:
    """The same node, not only the same name: a container has a /dev/pts/0 of its own. Unknown: the same."""
    try:
        return os.path.samestat(one.stat(), os.stat(other))
    except OSError:
        return True
