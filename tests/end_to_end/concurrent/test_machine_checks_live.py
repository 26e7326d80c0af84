"""Real-time tests of doctor machine."""

import os
import subprocess
from collections.abc import Iterator

import pytest

from tests.support.doctor_rig import found
from twind.loop.realtime import PRIORITY


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
