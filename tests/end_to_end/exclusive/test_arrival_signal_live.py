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
SECONDS = 3.0
PERIOD = 0.005  # s
REPLY = 400  # bytes
# Computes for every second half of a second, all of them at once: the kernel's worker cannot run meanwhile.
COMPUTING = """
import os, sys, time
core, priority, parent = map(int, sys.argv[1:])
os.sched_setaffinity(0, {core})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
while os.getppid() == parent:
    time.sleep(1.0 - time.monotonic() % 1.0)
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        pass
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


def longest_cycle(*, by_signal: bool) -> float:
    """Longest cycle (s) of requests and replies; each waits for 4 ms at most."""
    terminal = Terminal()
    port = SerialTransport(terminal.path, 1_000_000, by_signal=by_signal)
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
            deadline = begun + 0.004
            got = 0
            while got < REPLY and time.monotonic() < deadline:
                if clock.wait([port], deadline):
                    got += port.read_into(buffer)
            longest = max(longest, time.monotonic() - begun)
            whole += got == REPLY
            time.sleep(max(0.0, begun + PERIOD - time.monotonic()))
    port.close()
    terminal.unplug()
    assert whole > 50, "nothing was measured"
    return longest


def test_a_wait_ends_in_time_while_the_worker_that_carries_the_bytes_cannot_run(real_time: None) -> None:
    usual = 0.0
    for _ in range(3):  # whether the worker has bytes to carry when the others begin to compute is chance
        usual = max(usual, longest_cycle(by_signal=False)) if usual < 0.2 else usual
    if usual < 0.2:
        pytest.skip(f"the worker was not delayed here: the longest cycle took {usual:.3f} s without signals")
    assert longest_cycle(by_signal=True) < 0.05
