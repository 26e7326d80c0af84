"""The rows in real time that are done to processes: signals, sockets, files, descriptors."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from tests.proof.faults.real_clients import client_dies, never_reads, no_descriptors, second_daemon
from tests.support.processes import Daemon
from twind.client import CallError, Client, ClientError

if TYPE_CHECKING:
    from tests.proof.faults.ground import Ground

COUNTS = 2.0


def _pause(ground: Ground, seconds: float) -> None:
    """The daemon is stopped and goes on."""
    if ground.relay is not None:
        ground.relay.tell(told="stopped")
    pid = ground.running.process.pid
    ground.begun = time.monotonic()
    os.kill(pid, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(pid, signal.SIGCONT)
    ground.begun = time.monotonic()


def paused(least: float, most: float) -> Callable[[Ground], None]:
    """Rows 21, 22, 25."""

    def run(ground: Ground) -> None:
        ground.moving(watched=True)
        seconds = float(np.exp(ground.random.uniform(np.log(least), np.log(most))))
        _pause(ground, seconds)
        if seconds >= 0.15:
            ground.detected(0.2, codes=("WATCHDOG_TRIPPED", "TIME_GAP"))
            time.sleep(0.6)
            ground.stands()
        else:
            ground.detected(0.1, codes=("LOOP_LATE", "WATCHDOG_TRIPPED", "TIME_GAP", "BUS_ERRORS"))
        ground.torque(True)
        ground.recover()

    return run


def killed(ground: Ground) -> None:
    """Row 24: servos stop by themselves; the next daemon moves nothing."""
    ground.moving()
    ground.keeper.end()
    os.kill(ground.running.process.pid, signal.SIGKILL)
    ground.running.process.wait(5)
    tripped = ground.until(lambda: all(servo["tripped"] for servo in ground.servos()), 5.0)
    ground.claim(tripped, "not every watchdog tripped")
    delays = [servo["trip_delay"] or 9.0 for servo in ground.servos()]
    ground.outcome.delay = max(delays)
    ground.outcome.bound = 0.12
    ground.claim(max(delays) <= 0.12, f"a watchdog tripped after {max(delays):.3f} s")
    ground.torque(True)
    time.sleep(0.5)
    rest = ground.places()
    ground.daemon()
    status = ground.running.status()
    ground.claim(status["inherited"] and not status["armed"], "what was found on is not inherited")
    time.sleep(0.5)
    moved = float(np.abs(ground.places() - rest).max())
    ground.claim(moved <= COUNTS, f"a restart moved a joint {moved:.1f} ticks")
    ground.recover()


def terminated(ground: Ground) -> None:
    """Row 26: twice; lowered, off, ended with 0."""
    ground.moving(watched=True)
    ground.keeper.end()
    rest = ground.places()
    ground.begun = time.monotonic()
    ground.running.process.send_signal(signal.SIGTERM)
    time.sleep(float(ground.random.uniform(0.01, 2.0)))
    with suppress(ProcessLookupError):
        ground.running.process.send_signal(signal.SIGTERM)
    code = ground.running.process.wait(20)
    ground.claim(code == 0, f"ended with {code}")
    ground.torque(False)
    ground.claim(len(rest) == len(ground.places()), "servos are gone")


def front_hangs(ground: Ground) -> None:
    """Row 27: the front is stopped: killed by the loop, started anew; the motion holds."""
    ground.moving(watched=True)
    ground.keeper.end()
    front = ground.running.front()
    ground.begun = time.monotonic()
    os.kill(front, signal.SIGSTOP)
    time.sleep(0.8)
    ground.torque(True)
    ground.claim(
        not any(servo["tripped"] for servo in ground.servos()), "a watchdog tripped: the tick waited"
    )
    again = ground.until(lambda: _front(ground) not in (None, front), 8.0)
    ground.outcome.delay = time.monotonic() - ground.begun
    ground.outcome.bound = 8.0
    ground.claim(again, "no new front within 8 s")
    time.sleep(1.0)
    ground.stands()
    ground.torque(True)
    ground.recover()


def _front(ground: Ground) -> int | None:
    with suppress(AssertionError, OSError):
        return ground.running.front()
    return None


HANG = "import signal, time\nsignal.signal(signal.SIGUSR1, lambda *given: time.sleep(3600.0))\n"
WALL = """
import signal, time
real, real_ns, off = time.time, time.time_ns, [0.0]
time.time = lambda: real() + off[0]
time.time_ns = lambda: real_ns() + int(off[0] * 1e9)
def step(*given):
    off[0] += 1e8
signal.signal(signal.SIGUSR1, step)
"""


def _with(ground: Ground, code: str) -> Client:
    """A daemon that runs this code at its start, armed and moving."""
    (ground.folder / "site").mkdir()
    (ground.folder / "site" / "sitecustomize.py").write_text(code)
    ground.robot()
    path = os.pathsep.join([str(ground.folder / "site"), os.environ.get("PYTHONPATH", "")])
    ground.daemon(environment={"PYTHONPATH": path.rstrip(os.pathsep)})
    client = ground.client()
    ground.arm(client)
    ground.move(client)
    time.sleep(float(ground.random.uniform(0.2, 0.8)))
    return client


def hangs(ground: Ground) -> None:
    """Row 28: a tick does not end. Servos stop by themselves; the service manager hears nothing."""
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    address = str(ground.folder / "notify")
    manager.bind(address)
    manager.setblocking(False)
    ground.stack.callback(manager.close)
    os.environ["NOTIFY_SOCKET"] = address
    os.environ["WATCHDOG_USEC"] = "2000000"
    try:
        _with(ground, HANG)
    finally:
        del os.environ["NOTIFY_SOCKET"], os.environ["WATCHDOG_USEC"]
    ground.claim("WATCHDOG=1" in _received(manager), "the service manager is not told that the loop lives")
    ground.begun = time.monotonic()
    os.kill(ground.running.process.pid, signal.SIGUSR1)
    ground.claim(
        ground.until(lambda: all(servo["tripped"] for servo in ground.servos()), 3.0), "no watchdog tripped"
    )
    delays = [servo["trip_delay"] or 9.0 for servo in ground.servos()]
    ground.outcome.delay = max(delays)
    ground.outcome.bound = 0.12
    ground.claim(max(delays) <= 0.12, f"a watchdog tripped after {max(delays):.3f} s")
    _received(manager)
    time.sleep(2.2)
    ground.claim("WATCHDOG=1" not in _received(manager), "the service manager is told that a hung loop lives")
    ground.torque(True)


def _received(manager: socket.socket) -> str:
    said = ""
    while True:
        try:
            said += manager.recv(4096).decode() + "\n"
        except BlockingIOError:
            return said


def wall_clock(ground: Ground) -> None:
    """Row 29: the clock of the processes steps by three years."""
    _with(ground, WALL)
    for pid in (ground.running.process.pid, ground.running.front()):
        os.kill(pid, signal.SIGUSR1)
    ground.goes_on(2.0)
    ground.claim(not ground.running.status()["faults"], "a fault is latched")


def _unread(ground: Ground) -> None:
    """A daemon whose log cannot be read, armed and moving."""
    ground.robot()
    ground.running = Daemon(
        ground.folder / "run",
        *("--mode", "live", "--robot", "h24", "--calibration", str(ground.virtual.calibration)),
        *("--port", f"main={ground.folder / 'ports' / 'main'}"),
    )
    ground.stack.callback(ground.end_daemon, ground.running)

    def there() -> bool:
        with suppress(ClientError):
            return bool(ground.running.status()["state"] == "connected")
        return False

    assert ground.until(there, 30.0), "never connected"
    ground.watch()
    client = ground.client()
    ground.arm(client)
    ground.move(client)


def log_full(ground: Ground) -> None:
    """Row 31: the log goes to a full disk."""
    (ground.folder / "run").mkdir()
    (ground.folder / "run" / "log").symlink_to("/dev/full")
    _unread(ground)
    ground.obey({"fault": "corrupt", "count": 20})
    ground.goes_on(2.0)
    ground.claim(ground.running.process.poll() is None, "the daemon ended")


def killed_saving(ground: Ground) -> None:
    """Row 32: killed while it saves, again and again: old or new."""
    code = (
        "import sys\nfrom pathlib import Path\nfrom twind.config.atomic_save import save_text\n"
        "for n in range(10**9): save_text(Path(sys.argv[1]), 'h24', f'{n}\\n' * 4000, 5)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(ground.folder)])
    saved = ground.folder / "h24.yaml"
    ground.until(saved.exists, 5.0)
    time.sleep(float(ground.random.uniform(0.01, 0.5)))
    process.kill()
    process.wait(5)
    lines = saved.read_text().splitlines()
    ground.claim(len(lines) == 4000 and len(set(lines)) == 1, f"{len(lines)} lines, {len(set(lines))} kinds")


def file_edited(ground: Ground) -> None:
    """Row 37: the calibration is another one than the daemon has read: not armed with it."""
    ground.robot()
    ground.daemon()
    client = ground.client()
    kept = ground.virtual.calibration.read_text()
    ground.virtual.calibration.write_text(kept + "\n# edited\n")
    time.sleep(0.6)
    try:
        client.call("AcquireLease")
        client.call("Arm")
        ground.claim(False, "armed though its calibration was edited")
    except CallError as error:
        ground.outcome.delay = 0.0
        print(f"    refused: {error}"[:200])
    ground.torque(False)
    ground.virtual.calibration.write_text(kept)
    time.sleep(0.6)
    ground.arm(client)


def blocked_log(ground: Ground) -> None:
    """Row 40: nobody reads the pipe that the log goes to, which is full before the first line.

    Noise enough for a warning, below the 5 % of a second's exchanges at which BUS_ERRORS holds the motion.
    """
    (ground.folder / "run").mkdir()
    fifo = ground.folder / "run" / "log"
    os.mkfifo(fifo)
    reading = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    ground.stack.callback(os.close, reading)
    filling = os.open(fifo, os.O_WRONLY | os.O_NONBLOCK)
    with suppress(BlockingIOError):
        while True:
            os.write(filling, b"\n" * 4096)
    os.close(filling)
    _unread(ground)
    for _ in range(20):
        with suppress(ClientError), ground.running.client() as other:
            other.call("GetStatus")
        ground.obey({"fault": "corrupt", "count": 2})
        time.sleep(0.35)
    ground.goes_on(2.0)
    ground.claim(ground.running.status()["armed"], "not armed any more")


PROCESSES: dict[int, Callable[[Ground], None]] = {
    21: paused(0.16, 0.25),
    22: paused(0.03, 0.06),
    24: killed,
    25: paused(0.2, 5.0),
    26: terminated,
    27: front_hangs,
    28: hangs,
    29: wall_clock,
    31: log_full,
    32: killed_saving,
    33: never_reads,
    34: client_dies,
    35: second_daemon,
    36: no_descriptors,
    37: file_edited,
    40: blocked_log,
}
