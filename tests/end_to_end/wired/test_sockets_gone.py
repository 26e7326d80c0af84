"""A removed folder of sockets: the daemon notices, binds again or holds, and an e-stop still works.

Real processes, real pseudo-terminals. The log is kept out of the folder that is removed.
"""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import Daemon, Virtual, arm, go, patiently, robot, until
from twind.client import Client, NoDaemon, Refused
from twind.listening_sockets import listen

NOTICED = 1.0  # s within which a removed socket is noticed
COUNTS = 2  # what a joint may move where nothing may move
SIM = ("--mode", "sim")


@contextmanager
def serving(folder: Path, *options: str, **environment: str) -> Iterator[Daemon]:
    """A daemon whose sockets are in `folder/run`, its log outside."""
    running = Daemon(folder, *options, "--socket", str(folder / "run"), environment=environment)
    running.sockets = folder / "run"
    try:
        yield running
    finally:
        running.kill()


@contextmanager
def armed(**environment: str) -> Iterator[tuple[Daemon, Virtual, Client]]:
    """A virtual robot, armed, by a session that stays open."""
    with robot() as (virtual, folder):
        options = ["--mode", "live", "--calibration", str(virtual.calibration)]
        options += [part for bus, path in virtual.ports.items() for part in ("--port", f"{bus}={path}")]
        with serving(folder / "daemon", *options, **environment) as running:
            running.reach(state="connected")
            with running.client() as client:
                arm(client)
                yield running, virtual, client


@pytest.fixture(scope="module")
def simulations(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[], Daemon]]:
    """Return the simulated daemon that runs; start another where a test has ended it."""
    with contextlib.ExitStack() as stack:
        made = list[Daemon]()

        def current() -> Daemon:
            if not made or made[-1].process.poll() is not None:
                folder = tmp_path_factory.mktemp("sim")
                made.append(stack.enter_context(serving(folder, *SIM)))
            return made[-1]

        yield current


@pytest.fixture
def sim(simulations: Callable[[], Daemon]) -> Daemon:
    """A simulated daemon with both of its sockets and an empty log."""
    running = simulations()
    if running.sockets.is_file():
        running.sockets.unlink()
    running.reach(mode="sim", faults=[])
    os.truncate(running.log, 0)  # the daemon appends
    return running


def nod(seconds: float, to: float = 0.4) -> dict[str, object]:
    """A slow motion of the head, there and back."""
    points = [
        {"positions": [to], "time_from_start": seconds / 2},
        {"positions": [0.0], "time_from_start": seconds},
    ]
    return {"joint_names": ["head_pitch"], "points": points}


def begin(client: Client, trajectory: dict[str, object]) -> Iterator[dict[str, Any]]:
    """The reports of a motion that is accepted."""

    def submit() -> Iterator[dict[str, Any]]:
        client.call("AcquireLease")
        reports = client.stream("SubmitTrajectory", trajectory=trajectory)
        assert next(reports)["phase"] == "accepted"
        return reports

    return patiently(submit)


def lose(running: Daemon, *, for_good: bool) -> None:
    """Remove the folder of the sockets; `for_good`: a file takes its place, as the daemon cannot."""
    shutil.rmtree(running.sockets)
    if for_good:
        running.sockets.write_text("in the way")


def logged(running: Daemon, text: str, seconds: float = NOTICED) -> None:
    until(lambda: text in running.log.read_text(), seconds, lambda: f"{text!r}: {running.log.read_text()}")


def estop(running: Daemon, *words: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(running.sockets), "estop", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)


# ------------------------------------------------------------------------------- bound again


def test_a_removed_folder_is_back_within_a_second_the_motion_goes_on_and_an_estop_is_answered() -> None:
    with armed() as (running, virtual, client):
        reports = begin(client, nod(8.0))
        lose(running, for_good=False)
        lost = time.monotonic()
        until(lambda: (running.sockets / "control.sock").is_socket(), NOTICED, running.log.read_text)
        with running.client() as other:
            status = other.call("GetStatus")["status"]
        print(f"back after {time.monotonic() - lost:.2f} s")
        logged(running, "control.sock was removed or replaced; it is bound again")
        assert (status["armed"], status["motion"]) == (True, "active")
        assert next(reports)["phase"] == "running"
        modes = {path.name: path.stat().st_mode & 0o777 for path in running.sockets.iterdir()}
        assert modes == {"control.sock": 0o660, "observe.sock": 0o660}
        done = estop(running)
        assert (done.returncode, "e-stop (settle): state estop" in done.stdout) == (0, True), done.stderr
        until(lambda: not any(servo["torque"] for servo in virtual.servos()), 15.0, "torque off")


def test_a_removed_socket_is_bound_again_and_the_other_stays(sim: Daemon) -> None:
    observe = sim.sockets / "observe.sock"
    before = observe.stat().st_ino
    (sim.sockets / "control.sock").unlink()
    sim.reach(seconds=NOTICED, mode="sim")
    assert observe.stat().st_ino == before


def test_a_socket_that_was_bound_again_outlives_the_front(sim: Daemon) -> None:
    lose(sim, for_good=False)
    sim.reach(seconds=NOTICED, mode="sim")
    until(lambda: sim.log.read_text().count("bound again") == 2, NOTICED, "two reports")
    before = {path.name: path.stat().st_ino for path in sim.sockets.iterdir()}
    for _ in range(2):
        os.kill(sim.front(), signal.SIGKILL)
        sim.reach(seconds=10.0, mode="sim")
    assert {path.name: path.stat().st_ino for path in sim.sockets.iterdir()} == before
    assert sim.log.read_text().count("bound again") == 2


def test_a_front_that_dies_without_its_sockets_is_replaced_by_one_that_binds_them(sim: Daemon) -> None:
    os.kill(sim.front(), signal.SIGSTOP)
    lose(sim, for_good=False)
    os.kill(sim.front(), signal.SIGKILL)
    sim.reach(seconds=10.0, mode="sim")
    assert sim.process.poll() is None


# ------------------------------------------------------------------------------- not to be bound again


@contextmanager
def manager(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Address of a service manager, and the status lines that it has received; `drain` reads more."""
    path = str(folder / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(path)
        sock.setblocking(False)
        yield path, _Lines(sock)


class _Lines(list[str]):
    def __init__(self, sock: socket.socket) -> None:
        super().__init__()
        self._sock = sock

    def drain(self) -> "_Lines":
        with contextlib.suppress(BlockingIOError):
            while True:
                self.append(self._sock.recv(1 << 16).decode())
        return self


def test_a_daemon_that_cannot_bind_its_sockets_holds_refuses_reports_and_recovers(tmp_path: Path) -> None:
    with (
        manager(tmp_path) as (address, lines),
        armed(NOTIFY_SOCKET=address) as (running, virtual, client),
        running.client() as watcher,
    ):
        news = watcher.stream("Monitor", topics=["events"])
        reports = begin(client, nod(20.0))
        lose(running, for_good=True)
        lost = time.monotonic()
        *_, last = reports
        print(f"held after {time.monotonic() - lost:.2f} s")
        assert (last["phase"], [each["code"] for each in last["findings"]]) == ("aborted", ["SOCKETS_GONE"])
        assert time.monotonic() - lost < NOTICED
        found = next(each["event"] for each in news if each["event"]["code"] == "SOCKETS_GONE")
        assert found["level"] == "error" and "control.sock" in found["message"]
        logged(running, "error   SOCKETS_GONE: no client can connect")
        assert isinstance(lines, _Lines)
        until(lambda: any("SOCKETS_GONE" in line for line in lines.drain()), 2.0, "a status line")

        status = until(lambda: still(client), 3.0, "a hold")
        assert (status["state"], status["armed"]) == ("armed", True)
        assert "SOCKETS_GONE" in [fault["code"] for fault in status["faults"]]
        client.call("AcquireLease")
        with pytest.raises(Refused) as refusal:
            client.call("SubmitTrajectory", trajectory=nod(4.0))
        assert "SOCKETS_GONE" in [finding["code"] for finding in refusal.value.findings]

        rest = [servo["position"] for servo in virtual.servos()]
        running.sockets.unlink()
        running.reach(seconds=NOTICED, armed=True, motion="holding")
        logged(running, "clients can connect again")
        time.sleep(0.5)
        now = [servo["position"] for servo in virtual.servos()]
        assert max(abs(a - b) for a, b in zip(now, rest, strict=True)) <= COUNTS, "it moved by itself"
        assert go(client, nod(2.0, 0.1))["phase"] == "succeeded"
        assert running.end() == 0


def still(client: Client) -> dict[str, Any] | None:
    status: dict[str, Any] = client.call("GetStatus")["status"]
    return status if status["motion"] == "holding" else None


def test_a_socket_that_another_daemon_serves_at_the_path_is_never_taken_away(sim: Daemon) -> None:
    with sim.client() as session:
        session.call("GetStatus")
        os.kill(sim.front(), signal.SIGSTOP)
        shutil.rmtree(sim.sockets)
        with listen(sim.sockets, "control"):
            before = (sim.sockets / "control.sock").stat().st_ino
            os.kill(sim.front(), signal.SIGCONT)
            logged(sim, "another twind answers there")
            faults = session.call("GetStatus")["status"]["faults"]
            assert "SOCKETS_GONE" in [fault["code"] for fault in faults]
            assert (sim.sockets / "control.sock").stat().st_ino == before
        logged(sim, "clients can connect again")
    sim.reach(seconds=NOTICED, mode="sim")


HAND_OVER = """
import os, socket, sys
for place, path in enumerate(sys.argv[1:3]):
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(path)
    listener.listen()
    os.dup2(listener.fileno(), 10 + place)
for place in range(2):
    os.dup2(10 + place, 3 + place, inheritable=True)
os.environ |= {"LISTEN_FDS": "2", "LISTEN_PID": str(os.getpid()), "LISTEN_FDNAMES": "control:observe"}
os.execv(sys.executable, [sys.executable, "-m", "twind.cli", "--mode", "sim"])
"""


def test_a_socket_of_the_service_manager_is_not_bound_again_but_reported_with_what_brings_it_back(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    paths = [str(folder / f"{name}.sock") for name in ("control", "observe")]
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen([sys.executable, "-c", HAND_OVER, *paths], stderr=log)
    try:
        until(lambda: answered(folder), 30.0, "an answer")
        with Client(str(folder)) as session:
            assert session.call("GetStatus")["status"]["faults"] == []
            shutil.rmtree(folder)
            until(lambda: session.call("GetStatus")["status"]["faults"], NOTICED, "a fault")
            (fault,) = session.call("GetStatus")["status"]["faults"]
        assert fault["code"] == "SOCKETS_GONE"
        assert "`systemctl restart twind-control.socket" in fault["message"]
        assert not folder.exists()
        done = subprocess.run(
            [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(folder), "estop"], check=False
        )
        assert (done.returncode, process.wait(10)) == (0, 0)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait(10)


def answered(folder: Path) -> bool:
    with contextlib.suppress(NoDaemon), Client(str(folder), timeout=30.0) as client:
        return bool(client.call("GetStatus"))
    return False


# ------------------------------------------------------------------------------- twindctl estop


def test_estop_without_a_socket_lowers_this_robot_and_leaves_another_daemon_alone(sim: Daemon) -> None:
    with armed() as (running, virtual, client):
        begin(client, nod(20.0))
        lose(running, for_good=True)
        done = estop(running)
        assert done.returncode == 0, done.stderr
        assert (
            f"twind (pid {running.process.pid}) serves it: SIGTERM sent; it lowers the robot" in done.stdout
        )
        assert "twind has ended" in done.stdout
        assert running.process.wait(5.0) == 0
        assert not any(servo["torque"] for servo in virtual.servos())
        assert sim.status()["mode"] == "sim"


def test_status_of_a_daemon_without_sockets_names_it_and_the_estop_that_ends_it(sim: Daemon) -> None:
    lose(sim, for_good=True)
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(sim.sockets), "status"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20.0, check=False)
    assert done.returncode == 3
    assert f"twind (pid {sim.process.pid}) runs, but its sockets are gone" in done.stderr
    assert f"`twindctl --socket {sim.sockets} estop`, which lowers the robot" in done.stderr
    assert sim.process.poll() is None


def test_an_e_stop_without_a_daemon_fails_at_once(sim: Daemon, tmp_path: Path) -> None:
    begun = time.monotonic()
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(tmp_path / "none"), "estop"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20.0, check=False)
    assert (done.returncode, "there is no such socket" in done.stderr) == (3, True)
    assert time.monotonic() - begun < 2.0
    assert sim.status()["mode"] == "sim"


AS_ANOTHER = """
import argparse, os, sys
import twind.ctl.lost_socket_daemon
from twind.ctl import estop
from twind.command_line.verb import Rejected
os.setgroups([])
os.setgid(65534)
os.setuid(65534)
try:
    estop.ESTOP.run(argparse.Namespace(socket=sys.argv[1], remote=None, json=False, cut=False, reason=None))
except Rejected as error:
    print(error)
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_user_who_may_not_signal_the_daemon_gets_the_command_that_does(sim: Daemon) -> None:
    lose(sim, for_good=True)
    for folder in sim.sockets.parents:
        if folder == Path(tempfile.gettempdir()):
            break
        folder.chmod(0o755)  # of these tests: another user finds that there is no socket
    command = [sys.executable, "-c", AS_ANOTHER, str(sim.sockets)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20.0, check=False)
    assert f"run `sudo twindctl --socket {sim.sockets} estop`" in done.stdout, done.stderr
    assert "a twind of uid 0 serves it, which this user may not signal" in done.stdout
    assert sim.process.poll() is None


DECOY = """
import os, socket, subprocess, sys, time
listener = socket.socket(socket.AF_UNIX)
listener.bind(sys.argv[1])
listener.listen()
os.unlink(sys.argv[1])
named = {"child": os.getpid(), "stranger": 1, "none": None}[sys.argv[2]]
words = ["-m", "twind.front", *([] if named is None else ["--parent", str(named)])]
held = [] if sys.argv[2] == "child" else [listener.fileno()]
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)", *words], pass_fds=held)
print("ready", flush=True)
sys.stdin.read()
child.kill()
child.wait()
"""


@pytest.mark.parametrize("kind", ["stranger", "none", "child"])
def test_a_process_that_only_resembles_a_daemon_is_never_signalled(tmp_path: Path, kind: str) -> None:
    """The front of an orphan, one without a parent's number, one that does not hold the socket."""
    command = [sys.executable, "-c", DECOY, str(tmp_path / "control.sock"), kind]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as decoy:
        assert decoy.stdout is not None and decoy.stdout.readline() == "ready\n"
        words = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(tmp_path), "estop"]
        done = subprocess.run(words, capture_output=True, text=True, timeout=20.0, check=False)
        assert done.returncode == 3, done.stdout
        assert decoy.poll() is None


@pytest.mark.parametrize("words", [("--cut",), ("--cut", "--json")])
def test_an_impossible_cut_is_reported_and_the_daemon_ends(sim: Daemon, words: tuple[str, ...]) -> None:
    lose(sim, for_good=True)
    done = estop(sim, *words)
    assert (done.returncode, sim.process.wait(5.0)) == (0, 0)
    if "--json" in words:
        answer = json.loads(done.stdout)
        assert answer == {
            "signal": "SIGTERM",
            "pids": [sim.process.pid],
            "level": "settle",
            "ended": True,
        }
    else:
        assert "--cut needs the socket: the robot is lowered instead" in done.stdout
