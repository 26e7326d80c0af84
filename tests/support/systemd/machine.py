"""A machine for the tests: a real systemd as PID 1 of private namespaces, on a throw-away layer over `/`.

    machine = Machine(tree, binds); machine.boot(); machine.run("systemctl", "status"); machine.down()

About 0.3 s to boot. Nothing of it is left when it is down, nor when the tests are killed: its init dies with
the process that made it, its mounts with its last process. Needs root, overlayfs, util-linux and a cgroup2
mount anywhere; `why_not` says what is missing.
"""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
PATH = {"PATH": "/opt/twind/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LANG": "C.UTF-8", "HOME": "/root"}
TOOLS = ("unshare", "nsenter", "setpriv", "systemctl", "pivot_root", "mount")
UNSHARE = ["--pid", "--fork", "--kill-child=SIGKILL", "--mount", "--propagation", "private"]
UNSHARE += ["--cgroup", "--uts", "--ipc", "--net"]
BOOT = 20.0  # s that a busy machine may take
COMMAND = 20.0  # s for one command inside
PREFIX = "twind-tests-"
# <linux/capability.h>
NET_ADMIN = 12
SYS_NICE = 23
SYS_RESOURCE = 24


class Failed(AssertionError):
    """A command inside ended with another code than 0."""


def cgroup2() -> Path | None:
    """Mount point of the unified hierarchy; it needs no controllers."""
    for line in Path("/proc/mounts").read_text().splitlines():
        _, place, kind, *_ = line.split()
        if kind == "cgroup2":
            return Path(place)
    return None


def why_not() -> str | None:
    """Why no machine can be booted here; None: it can. Tries what the kernel allows, and leaves nothing."""
    if sys.platform != "linux" or os.geteuid() != 0:
        return "a private systemd needs root"
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing or not Path("/lib/systemd/systemd").exists():
        return f"a private systemd needs {', '.join(missing) or '/lib/systemd/systemd'}"
    if (unified := cgroup2()) is None or not os.access(unified, os.W_OK):
        return "a private systemd needs a cgroup2 mount that can be written"
    overlay = "mount -n -t tmpfs t /tmp && mkdir /tmp/u /tmp/w /tmp/r && "
    overlay += "mount -n -t overlay -o lowerdir=/,upperdir=/tmp/u,workdir=/tmp/w o /tmp/r"
    tried = subprocess.run(
        ["unshare", *UNSHARE, "sh", "-c", overlay], capture_output=True, text=True, timeout=20
    )
    return None if tried.returncode == 0 else f"namespaces are not allowed here: {tried.stderr.strip()}"


class Machine:
    """One boot. `tree` is laid over `/`; `binds` shows folders of this machine elsewhere, read only."""

    def __init__(self, tree: Callable[[Path], None], binds: Mapping[str, str]) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix=f"{PREFIX}{os.getpid()}-"))
        self.binds = dict(binds)
        self.init = 0  # its process id, as we see it
        self.booted = 0.0  # s that it took
        self._cgroup: Path | None = None
        self._unshare: subprocess.Popen[bytes] | None = None
        tree(self.folder / "tree")

    def boot(self) -> None:
        """Until it is up. Raises AssertionError with its console."""
        begun = time.monotonic()
        unified = cgroup2()
        assert unified is not None
        sweep(unified)
        self._cgroup = unified / self.folder.name
        self._cgroup.mkdir()
        plan = self.folder / "plan"
        plan.write_text(json.dumps({"bind": self.binds}))
        # Into its cgroup before the cgroup namespace is made: so that is the root for PID 1. It dies with us.
        enter = f'echo $$ > {self._cgroup}/cgroup.procs; exec setpriv --pdeathsig KILL unshare "$@"'
        boot = [sys.executable, "-I", str(Path(__file__).with_name("boot.py")), str(self.folder), str(plan)]
        with (self.folder / "console").open("wb") as console:
            self._unshare = subprocess.Popen(
                ["sh", "-c", enter, "sh", *UNSHARE, *boot],
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=console,
                start_new_session=True,  # Ctrl-C is for the tests
            )
        self.init = self.until(self._find_init, BOOT, "no init")
        self.until(self._up, BOOT, "not up")
        self.booted = time.monotonic() - begun

    def _find_init(self) -> int | None:
        assert self._unshare is not None
        assert self._unshare.poll() is None, (self.folder / "console").read_text()
        pid = self._unshare.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        for child in map(int, children):
            with contextlib.suppress(OSError):
                if Path(f"/proc/{child}/comm").read_text() == "systemd\n":
                    return child
        return None

    def _up(self) -> bool:
        state = self.try_run("systemctl", "is-system-running").stdout.strip()
        return state in ("running", "degraded")

    def down(self) -> None:
        """At once: every process of it is killed, its cgroups are removed. May be called again."""
        if self._unshare is not None:
            self._unshare.kill()  # --kill-child: its init goes with it, and so does the whole pid namespace
            self._unshare.wait(10)
            self._unshare = None
        if self._cgroup is not None:
            deadline = time.monotonic() + 5.0
            while not _remove(self._cgroup) and time.monotonic() < deadline:
                time.sleep(0.02)
            self._cgroup = None
        shutil.rmtree(self.folder, ignore_errors=True)

    def inside(self, path: str) -> Path:
        """The same file, seen from here. Sockets too: a connection through it reaches who listens inside."""
        return Path(f"/proc/{self.init}/root", path.lstrip("/"))

    def cgroup(self, path: str) -> Path:
        """A cgroup of it, as we see it."""
        assert self._cgroup is not None
        return self._cgroup / path.lstrip("/")

    def pids(self, cgroup: str) -> list[int]:
        """Processes in that cgroup or below, by our pids."""
        found: list[int] = []
        for place, _, _ in os.walk(self.cgroup(cgroup)):
            with contextlib.suppress(OSError):
                found += map(int, Path(place, "cgroup.procs").read_text().split())
        return found

    def may(self, capability: int) -> bool:
        """Its PID 1 has that capability, and what it starts may have it."""
        bounding = re.search(r"CapBnd:\s+(\w+)", Path(f"/proc/{self.init}/status").read_text())
        return bounding is not None and bool(int(bounding[1], 16) >> capability & 1)

    def kill(self, pid: int) -> None:
        """SIGKILL to a process inside, by the number that it has for us."""
        namespace = os.readlink(f"/proc/{pid}/ns/pid")
        assert namespace == os.readlink(f"/proc/{self.init}/ns/pid"), f"{pid} is not inside"
        os.kill(pid, signal.SIGKILL)

    def _command(self, *command: str, user: str | None = None) -> list[str]:
        """Command that runs it inside, as root or as that user with all of the user's groups."""
        enter = ["nsenter", "-t", str(self.init), "-m", "-p", "-C", "-u", "-i", "-n", "-r", "-w"]
        enter += ["setpriv", "--pdeathsig", "KILL"]
        if user is not None:
            enter += ["--reuid", user, "--regid", user, "--init-groups"]
        return [*enter, *command]

    def try_run(
        self, *command: str, user: str | None = None, seconds: float = COMMAND
    ) -> subprocess.CompletedProcess[str]:
        """Run it inside; whatever it ends with. Raises TimeoutExpired."""
        return subprocess.run(
            self._command(*command, user=user),
            env=PATH,
            cwd="/",
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=seconds,
        )

    def run(self, *command: str, user: str | None = None, seconds: float = COMMAND) -> str:
        """Output of a command. Raises Failed where it ends with another code than 0."""
        done = self.try_run(*command, user=user, seconds=seconds)
        if done.returncode != 0:
            raise Failed(f"{' '.join(command)}: {done.returncode}\n{done.stdout}{done.stderr}")
        return done.stdout

    def popen(self, *command: str) -> subprocess.Popen[bytes]:
        """A process inside that stays, with pipes to its standard input and output."""
        return subprocess.Popen(
            self._command(*command), env=PATH, cwd="/", stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )

    def until(self, what: Callable[[], T | None], seconds: float, message: str) -> T:
        """Wait until `what` returns a true value, at most `seconds`, and return it. Raises AssertionError."""
        deadline = time.monotonic() + seconds
        while not (found := what()):
            assert time.monotonic() < deadline, f"not within {seconds} s: {message}\n{self.diagnostics()}"
            time.sleep(0.05)  # asking costs as much as what is waited for
        return found

    def diagnostics(self) -> str:
        """The end of the journal, or of the console while there is none."""
        if self.init:
            with contextlib.suppress(subprocess.SubprocessError):
                return self.try_run("journalctl", "--no-pager", "-o", "short-monotonic", "-n", "60").stdout
        return (self.folder / "console").read_text()


def _remove(cgroup: Path) -> bool:
    """A cgroup with those below it; False where somebody is still in it."""
    with contextlib.suppress(FileNotFoundError):
        for place, _, _ in os.walk(cgroup, topdown=False):
            try:
                os.rmdir(place)
            except OSError:
                return False
    return True


def sweep(unified: Path) -> None:
    """Remove cgroups and folders of tests that were killed: who made them has gone, with all inside."""
    for left in (*unified.glob(f"{PREFIX}*"), *Path(tempfile.gettempdir()).glob(f"{PREFIX}*")):
        maker = left.name.removeprefix(PREFIX).partition("-")[0]
        if maker.isdigit() and not Path(f"/proc/{maker}").exists():
            if left.parent == unified:
                _remove(left)
            else:
                shutil.rmtree(left, ignore_errors=True)


def stop(process: subprocess.Popen[bytes], seconds: float = 5.0) -> None:
    """End a process of `Machine.popen`: by the end of its standard input, else by force."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.close()
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait(seconds)
    process.stdout.close()
