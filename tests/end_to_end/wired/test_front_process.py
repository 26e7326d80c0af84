"""The front as a child: what it is started with, what it is kept away from, and how its end is noticed."""

import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import msgspec
import pytest

from tests.support import loop_stand_in as stand_in
from tests.support.processes import until
from twind import link, sealed_memfd
from twind.listening_sockets import Listener
from twind.loop.ipc import front_process
from twind.loop.ipc.former_flight_recorder import FormerFlightRecorder
from twind.loop.ipc.front_process import AGAIN, AGAIN_MOST, GRACE, HEARTBEAT, LATER, FrontProcess

SERVICE = {"NOTIFY_SOCKET": "@nobody", "LISTEN_FDS": "2", "LISTEN_PID": "1", "WATCHDOG_USEC": "1000"}


class World:
    """A front process and what it is handed: a briefing and two listening sockets."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        briefing = sealed_memfd.seal("briefing", msgspec.msgpack.encode(stand_in.briefing()))
        stack.callback(os.close, briefing)
        self.listeners = {}
        for name in ("control", "observe"):
            listener = stack.enter_context(socket.socket(socket.AF_UNIX))
            listener.bind(str(folder / name))
            listener.listen()
            self.listeners[name] = listener
        made = {name: Listener.of(bound, own=True) for name, bound in self.listeners.items()}
        self.front = FrontProcess(briefing, made)

    @property
    def pid(self) -> int:
        assert self.front.pid is not None
        return self.front.pid

    def has_heartbeat(self) -> bool:
        """Has it said anything yet?"""
        assert self.front.socket is not None
        with suppress(BlockingIOError):
            return isinstance(link.decode_command(self.front.socket.recv(link.DATAGRAM)), link.Heartbeat)
        return False

    def close(self) -> None:
        pid = self.front.pid
        self.front.end(0.0)
        if pid is not None:
            os.waitpid(pid, 0)


@contextmanager
def started(folder: Path) -> Iterator[World]:
    with ExitStack() as stack:
        world = World(folder, stack)
        world.front.start(100.0)
        try:
            yield world
        finally:
            world.close()


def descriptors(pid: int) -> dict[int, str]:
    found = {}
    for fd in os.listdir(f"/proc/{pid}/fd"):
        with suppress(FileNotFoundError):  # the one that lists
            found[int(fd)] = os.readlink(f"/proc/{pid}/fd/{fd}")
    return found


RIGHTS = """
import os, re, socket
from pathlib import Path
from twind import sealed_memfd
from twind.loop.ipc.front_process import FrontProcess
from twind.listening_sockets import Listener

def rights(pid):
    return re.search(r"CapEff:\\s*(\\w+)", Path(f"/proc/{pid}/status").read_text())[1]

with socket.socket(socket.AF_UNIX) as control, socket.socket(socket.AF_UNIX) as observe:
    listeners = {"control": Listener(control), "observe": Listener(observe)}
    front = FrontProcess(sealed_memfd.seal("briefing", b"none"), listeners)
    before = rights("self")
    front.start(0.0)
    # By that briefing it ends; what it was is told until it is buried. While it is executed it may have ours.
    os.waitid(os.P_PID, front.pid, os.WEXITED | os.WNOWAIT)
    print(before, rights("self"), rights(front.pid))
    front.finish()
"""


@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv")
def test_rights_that_the_service_manager_gave_the_loop_are_not_the_fronts() -> None:
    rights = "+net_admin,+dac_override"  # the second: the interpreter may stand in a folder of root's
    given = ["--ambient-caps", rights, "--inh-caps", rights, "--reuid", "65534", "--clear-groups"]
    command = ["setpriv", *given, sys.executable, "-c", RIGHTS]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20.0)
    if done.stderr.startswith("setpriv"):
        pytest.skip(done.stderr.strip())
    before, after, front = (int(each, 16) for each in done.stdout.split())
    assert before == after == 1 << 12 | 1 << 1  # CAP_NET_ADMIN, CAP_DAC_OVERRIDE
    assert front == 0


def test_a_front_is_started_apart_from_the_bus_the_terminal_and_the_service_manager(tmp_path: Path) -> None:
    with ExitStack() as stack, pytest.MonkeyPatch.context() as patch:
        for key, value in SERVICE.items():
            patch.setenv(key, value)
        inner, outer = os.openpty()  # a bus of ours
        for fd in (inner, outer):
            stack.callback(os.close, fd)
        with suppress(PermissionError):  # as the loop has it where it may
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        stack.callback(os.sched_setscheduler, 0, os.SCHED_OTHER, os.sched_param(0))
        world = stack.enter_context(started(tmp_path))
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        until(world.has_heartbeat, 20.0, "the front's first heartbeat")

        channel = world.front.socket
        assert channel is not None
        assert (
            channel.type == socket.SOCK_SEQPACKET
            and not channel.getblocking()
            and not channel.get_inheritable()
        )
        assert os.getsid(world.pid) == world.pid != os.getsid(0)
        assert os.getpgid(world.pid) == world.pid  # Ctrl-C of our terminal goes to our group alone
        assert os.sched_getscheduler(world.pid) == os.SCHED_OTHER
        environment = Path(f"/proc/{world.pid}/environ").read_bytes().decode().split("\0")
        assert not [one for one in environment if one.startswith(tuple(SERVICE))]
        assert "OPENBLAS_NUM_THREADS=1" in environment  # its second thread would compete with others
        assert f"PATH={os.environ['PATH']}" in environment

        theirs = descriptors(world.pid)
        ours = descriptors(os.getpid())
        sockets = [ours[listener.fileno()] for listener in world.listeners.values()]
        assert [theirs[5], theirs[6]] == sockets
        shared = {theirs[fd] for fd in (0, 1, 2)} | {"/dev/null", "anon_inode:[eventpoll]"}
        kept = {target for fd, target in ours.items() if not os.get_inheritable(fd)} - shared
        common = kept & set(theirs.values())
        assert common == set(sockets)
        assert os.ttyname(outer) in kept


def test_a_front_may_run_on_every_core_that_the_daemon_had_before_it_was_pinned(tmp_path: Path) -> None:
    cores = os.sched_getaffinity(0)
    with ExitStack() as stack:
        world = World(tmp_path, stack)
        stack.callback(os.sched_setaffinity, 0, cores)
        os.sched_setaffinity(0, {min(cores)})
        world.front.start(100.0)
        stack.callback(world.close)
        assert os.sched_getaffinity(world.pid) == cores
        assert os.sched_getaffinity(0) == {min(cores)}


def test_a_front_runs_nothing_of_the_folder_it_is_started_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("numpy", "msgspec", "twind"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('a module of the current folder ran')")
    monkeypatch.chdir(tmp_path)
    with started(tmp_path) as world:
        until(world.has_heartbeat, 20.0, "the front's first heartbeat")
        assert not world.front.reap()


class Paper(FrontProcess):
    """A front that costs no process: only the times of its lives count."""

    def _spawn(self, inner: socket.socket, outer: socket.socket) -> int:
        self.handed_wreck = self.wreck.fd is not None
        return os.posix_spawn("/bin/true", ["true"], {})

    def live(self, born: float, died: float) -> None:
        self.start(born)
        assert self.pid is not None
        os.waitpid(self.pid, 0)
        self.pid = None
        self.end(died)
        self.end(died)  # the loop may bury twice: one death, one step


def test_fronts_that_die_young_are_started_ever_later_until_one_lived() -> None:
    front = Paper(0, {})
    now = 100.0
    for pause in (AGAIN, 0.4, 0.8, 1.6, 3.2, AGAIN_MOST, AGAIN_MOST):
        front.live(now, now + GRACE * 0.99)
        now += GRACE * 0.99
        assert not front.due(now + pause * 0.99)
        now += pause + 1e-9
        assert front.due(now)
    front.live(now, now + GRACE)
    assert front.due(now + GRACE + AGAIN + 1e-9)
    front.live(200.0, 200.1)
    assert not front.due(200.1 + AGAIN * 1.99)
    assert front.due(200.1 + AGAIN * 2 + 1e-9)


def test_a_crash_recording_is_handed_to_at_most_two_front_processes() -> None:
    told = list[str]()
    wreck = FormerFlightRecorder(os.memfd_create("wreck"))
    wreck.then = lambda: told.append("done")
    front = Paper(0, {}, crash_recording=wreck)
    lives = []
    for number in range(4):
        front.live(100.0 * number, 100.0 * number + 1.0)
        lives.append((front.handed_wreck, len(told)))
    assert lives == [(True, 0), (True, 0), (False, 1), (False, 1)]


def test_a_socket_that_was_bound_again_is_given_to_the_next_front_and_the_old_one_is_closed(
    tmp_path: Path,
) -> None:
    with started(tmp_path) as world:
        old = world.listeners["control"]
        (tmp_path / "control").unlink()
        made = socket.socket(socket.AF_UNIX)
        made.bind(str(tmp_path / "control"))
        made.listen()
        world.front.rebound("control", Listener.of(made, own=True))
        assert old.fileno() == -1
        first = world.pid
        world.front.end(100.0)
        os.waitpid(first, 0)
        world.front.pid = None
        world.front.start(101.0)
        until(world.has_heartbeat, 20.0, "the second front's first heartbeat")
        assert descriptors(world.pid)[5] == descriptors(os.getpid())[made.fileno()]
        world.front.close()
        assert made.fileno() == -1


def test_a_front_ends_by_itself_when_the_loops_end_of_the_link_closes(tmp_path: Path) -> None:
    with started(tmp_path) as world:
        until(world.has_heartbeat, 20.0, "the front's first heartbeat")
        assert world.front.socket is not None
        os.kill(world.pid, signal.SIGINT)  # neither of these ends it
        os.kill(world.pid, signal.SIGTERM)
        until(world.has_heartbeat, 5.0, "another heartbeat")
        assert not world.front.reap()
        world.front.socket.close()
        world.front.socket = None
        until(world.front.reap, 10.0, "its end")
        assert world.front.pid is None


def test_a_killed_front_is_noticed_and_the_next_one_waits_a_moment(tmp_path: Path) -> None:
    with started(tmp_path) as world:
        first = world.pid
        assert not world.front.due(1e9)
        os.kill(first, signal.SIGKILL)
        until(world.front.reap, 10.0, "its end")
        assert not world.front.reap()  # told once
        assert world.front.fate == f"({first}) ended with signal 9"
        world.front.end(100.0)
        assert not world.front.due(100.0 + AGAIN * 0.99)
        assert world.front.due(100.0 + AGAIN)
        world.front.start(101.0)
        assert world.pid != first
        assert world.front.starts == 2
        until(world.has_heartbeat, 20.0, "the second front's first heartbeat")


def test_ending_a_front_kills_it_and_closes_the_link(tmp_path: Path) -> None:
    with started(tmp_path) as world:
        sock = world.front.socket
        pid = world.pid
        assert sock is not None
        world.front.end(200.0)
        world.front.end(200.0)  # twice is no harm
        assert sock.fileno() == -1
        assert world.front.socket is None
        until(world.front.reap, 10.0, "its end")
        assert not Path(f"/proc/{pid}").exists()
        assert not world.front.due(200.0 + AGAIN * 0.99)
        assert world.front.due(200.0 + AGAIN)


def test_a_front_that_is_finished_ends_by_itself_and_is_collected(tmp_path: Path) -> None:
    with started(tmp_path) as world:
        until(world.has_heartbeat, 20.0, "the front's first heartbeat")
        pid = world.pid
        world.front.finish()
        assert (world.front.pid, world.front.socket) == (None, None)
        assert not Path(f"/proc/{pid}").exists()
        world.front.finish()  # twice is no harm


def test_a_front_that_hangs_is_not_waited_for_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(front_process, "LAST_WORDS", 0.05)
    with started(tmp_path) as world:
        pid = world.pid
        os.kill(pid, signal.SIGSTOP)
        world.front.finish()
        assert not Path(f"/proc/{pid}").exists()


IDLE = """
import os, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from tests.end_to_end.wired.test_front_process import started
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
with started(Path(sys.argv[2])) as world:
    print(os.sched_getscheduler(world.pid) == os.SCHED_IDLE)
"""


def test_a_daemon_that_is_not_real_time_asks_for_no_scheduler_that_it_may_not_have(tmp_path: Path) -> None:
    """Leaving the idle class needs a right (RLIMIT_NICE): asked for, no front could ever be started."""
    command = [sys.executable, "-c", IDLE, str(Path(__file__).parents[3]), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "True\n", done.stderr


def test_a_front_that_cannot_be_started_leaves_nothing_behind(tmp_path: Path) -> None:
    with ExitStack() as stack:
        front = World(tmp_path, stack).front
        before = sorted(os.listdir("/proc/self/fd"))
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (66, hard))  # room for two of the four copies
        try:
            with pytest.raises(OSError):
                front.start(1.0)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert sorted(os.listdir("/proc/self/fd")) == before
        assert (front.pid, front.socket, front.starts) == (None, None, 0)
        front.postpone(1.0)
        assert not front.due(1.0 + LATER * 0.99)
        assert front.due(1.0 + LATER)


def test_a_front_has_time_to_start_and_then_must_show_life() -> None:
    front = Paper(0, {})
    assert front.due(0.0)
    assert not front.overdue(1e9), "there is none yet"
    front.start(100.0)
    assert front.pid is not None
    os.waitpid(front.pid, 0)
    assert not front.overdue(100.0 + GRACE)
    assert front.overdue(100.0 + GRACE + 0.001)
    front.alive(101.0)
    assert not front.overdue(101.0 + HEARTBEAT)
    assert front.overdue(101.0 + HEARTBEAT + 0.001)
    front.pid = None
    front.end(102.0)
