"""A loop under SCHED_FIFO waits for bytes no longer than it asked, while nothing of lower priority runs."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from tests.support.serial_port_rig import Terminal
from twind_drivers.clock import MonotonicClock
from twind_drivers.ports.serial_port import SerialTransport

LOOP, DEVICE, BUSY = 40, 60, 10  # priorities
SECONDS = 6.0
REPLY = 400  # bytes
# Computes for 0.1 of each 0.25 s on the core of its number: the kernel's worker cannot run meanwhile.
COMPUTING = """
import os, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(sys.argv[2])))
while os.getppid() == int(sys.argv[3]):
    end = time.monotonic() + 0.1
    while time.monotonic() < end:
        pass
    time.sleep(0.15)
"""
ANSWERING = """
import os, sys, time
master, priority, reply = map(int, sys.argv[1:])
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
while True:
    os.read(master, 4096)
    for _ in range(4):
        time.sleep(0.0005)
        os.write(master, bytes(reply // 4))
"""


@contextmanager
def running(program: str, *arguments: int, passed: tuple[int, ...] = ()) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-c", program, *map(str, arguments)], pass_fds=passed)
    try:
        yield
    finally:
        process.kill()
        process.wait(10)


@pytest.fixture
def real_time() -> Iterator[None]:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(LOOP))
    except PermissionError:
        pytest.skip("this user may not use SCHED_FIFO")
    yield
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def test_a_wait_ends_in_time_while_the_worker_that_carries_the_bytes_cannot_run(real_time: None) -> None:
    """Without signals waits last some 0.1 s too long here."""
    terminal = Terminal()
    port = SerialTransport(terminal.path, 1_000_000, by_signal=True)
    clock = MonotonicClock()
    buffer = memoryview(bytearray(4096))
    longest = 0.0
    whole = 0
    with ExitStack() as stack:
        stack.enter_context(running(ANSWERING, terminal.master, DEVICE, REPLY, passed=(terminal.master,)))
        for core in os.sched_getaffinity(0):
            stack.enter_context(running(COMPUTING, core, BUSY, os.getpid()))
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            begun = time.monotonic()
            port.drain()
            port.write(b"request")
            deadline = time.monotonic() + 0.006
            got = 0
            while got < REPLY and time.monotonic() < deadline:
                if clock.wait([port], deadline):
                    got += port.read_into(buffer)
            longest = max(longest, time.monotonic() - begun)
            whole += got == REPLY
            time.sleep(max(0.0, begun + 0.01 - time.monotonic()))
    port.close()
    terminal.unplug()
    assert whole > 100, "nothing was measured"
    assert longest < 0.05
