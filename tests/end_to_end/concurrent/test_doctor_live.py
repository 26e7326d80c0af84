"""Findings of the doctor about other real programs and a full disk."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.doctor_rig import codes, copy_h24, found, look, needs_root, run_with_own_mounts, settings
from twind.loop.process.realtime import PRIORITY

LEGS = ("--robot", "h24-mixed", "--port", "l_leg=can:socketcan:can0")
HOLD = (
    "import os,sys,fcntl; fd=os.open(sys.argv[1],os.O_RDWR|os.O_NOCTTY); {}; "
    "print('has it',flush=True); sys.stdin.read()"
)
FULL = """
mount -t tmpfs -o size=3m none "$1/state" || exit 77
head -c 4m /dev/zero > "$1/state/recording" 2> /dev/null
"$2" -m twind.ctl.ctl_main --socket "$1" --json doctor --config "$1/twind.yaml" --only DISK_FULL
"""


def test_owner_of_a_can_interface_is_named() -> None:
    name = f"doct{os.getpid()}"
    program = (
        "from twind_drivers.ports.can_interface_lock import CanInterfaceLock; sign = "
        f"CanInterfaceLock({name!r}); print(flush=True); input()"
    )
    words = (*LEGS[:2], "--port", f"l_leg=can:socketcan:{name}")
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "\n"
        (finding,) = found(*words, code="PORT_HELD")
        assert (finding.thing, finding.command) == (name, "")
        assert f"`ps -fp {other.pid}`" in finding.advice
        assert f"pid {other.pid} (" in finding.measured
        other.communicate("\n")
    assert found(*words, code="PORT_HELD") == []


@pytest.fixture
def lone_pty() -> Iterator[str]:
    """The same with nobody at its end, not even us."""
    master, slave = os.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    yield path
    os.close(master)


@contextmanager
def holder(port: str, lock: str = "None") -> Iterator[int]:
    """A process that has the port open; its id."""
    command = [sys.executable, "-c", HOLD.format(lock), port]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process.pid
        process.communicate(timeout=5.0)


@pytest.mark.parametrize("lock", ["None", "fcntl.flock(fd, fcntl.LOCK_EX)"], ids=["open", "locked"])
def test_holder_of_a_port_is_named_with_its_pid(lone_pty: str, lock: str) -> None:
    with holder(lone_pty, lock) as pid:
        (finding,) = found("--port", lone_pty, code="PORT_HELD")
        assert f"pid {pid} " in finding.measured and "import os" in finding.measured
        assert finding.command == ""  # it may hold a robot up
        assert "kill" not in finding.advice
        assert f"`ps -fp {pid}`" in finding.advice
    assert codes(lone_pty, "PORT_HELD") == []


def test_held_port_is_not_opened(lone_pty: str) -> None:
    with holder(lone_pty) as pid:
        outcome = look("--port", lone_pty, only=["LATENCY_FLOOR"])
        assert outcome.found == []
        assert any(f"held by pid {pid}" in why for _, why in outcome.unseen), outcome.unseen


@needs_root
def test_a_full_disk_is_found(tmp_path: Path) -> None:
    """On a disk of memory that only these processes see."""
    (tmp_path / "state").mkdir()
    settings(tmp_path, copy_h24(tmp_path))
    assert f'"thing": "{tmp_path / "state"}", "measured": "0 MiB free of 3"' in run_with_own_mounts(
        FULL, tmp_path
    )
    assert str(tmp_path) not in str(found("--config", str(tmp_path / "twind.yaml"), code="DISK_FULL"))


@pytest.fixture
def rival() -> Iterator[subprocess.Popen[bytes]]:
    """A program that waits at a priority above the loop's."""
    running = subprocess.Popen(["sleep", "60"])
    try:
        os.sched_setscheduler(running.pid, os.SCHED_RR, os.sched_param(PRIORITY + 10))
        yield running
    except PermissionError:
        pytest.skip("nobody may have real time here")
    finally:
        running.kill()
        running.wait(5)


def test_a_program_of_higher_priority_is_found_with_its_pid(rival: subprocess.Popen[bytes]) -> None:
    mine = [each for each in found(code="RT_RIVAL") if f"pid {rival.pid} " in each.thing]
    (finding,) = mine
    assert finding.thing == f"pid {rival.pid} (sleep 60)"
    assert finding.measured == f"RR priority {PRIORITY + 10}"
    assert finding.command == ""  # it may drive motors of its own
    assert finding.advice.index("other cores") < finding.advice.index(f"sudo chrt -f -p 10 {rival.pid}")
    os.sched_setscheduler(rival.pid, os.SCHED_FIFO, os.sched_param(10))
    assert not [each for each in found(code="RT_RIVAL") if f"pid {rival.pid} " in each.thing]
