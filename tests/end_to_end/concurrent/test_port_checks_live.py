"""Real-time tests of doctor ports."""

import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.support.doctor_rig import found, look
from tests.support.port_checks_rig import codes


@pytest.fixture
def lone_pty() -> Iterator[str]:
    """The same with nobody at its end, not even us."""
    master, slave = os.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    yield path
    os.close(master)


HOLD = (
    "import os,sys,fcntl; fd=os.open(sys.argv[1],os.O_RDWR|os.O_NOCTTY); {}; "
    "print('has it',flush=True); sys.stdin.read()"
)


@pytest.mark.parametrize("lock", ["None", "fcntl.flock(fd, fcntl.LOCK_EX)"], ids=["open", "locked"])
def test_who_holds_a_port_is_named_with_its_pid(lone_pty: str, lock: str) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD.format(lock), lone_pty], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdout is not None and holder.stdin is not None
    holder.stdout.readline()
    try:
        (finding,) = found("--port", lone_pty, code="PORT_HELD")
        assert f"pid {holder.pid} " in finding.measured and "import os" in finding.measured
        assert finding.command == ""  # it may hold a robot up
        assert "kill" not in finding.advice
        assert f"`ps -fp {holder.pid}`" in finding.advice
    finally:
        holder.stdin.close()
        holder.wait(5)
        holder.stdout.close()
    assert codes(lone_pty, "PORT_HELD") == []


def test_a_port_that_somebody_holds_is_never_opened(lone_pty: str) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD.format("None"), lone_pty], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdout is not None and holder.stdin is not None
    holder.stdout.readline()
    try:
        outcome = look("--port", lone_pty, only=["LATENCY_FLOOR"])
        assert outcome.found == []
        assert any(f"held by pid {holder.pid}" in why for _, why in outcome.unseen), outcome.unseen
    finally:
        holder.stdin.close()
        holder.wait(5)
        holder.stdout.close()
