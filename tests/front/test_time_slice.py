"""The front's time slice as the kernel reports it, in a process of its own."""

import json
import os
import platform
import subprocess
import sys
from typing import Any

import pytest

from twind.front.time_slice import SLICE

GET_ATTR = {"x86_64": 315, "aarch64": 275}
CODE = """
import ctypes, json, os, sys, threading
from twind.front import time_slice

os.sched_setscheduler(0, getattr(os, sys.argv[3]), os.sched_param(0))
os.nice(int(sys.argv[2]))

def read():
    found = time_slice.SchedAttr()
    ctypes.CDLL(None).syscall(int(sys.argv[1]), 0, ctypes.byref(found), ctypes.sizeof(found), 0)
    return found.policy, found.nice, found.runtime

before = read()
asked = time_slice.lengthen()
started = []
thread = threading.Thread(target=lambda: started.append(read()))
thread.start()
thread.join()
print(json.dumps([before, asked, read(), started[0]]))
"""


def lengthened(nice: int = 0, policy: str = "SCHED_OTHER") -> list[Any]:
    number = GET_ATTR.get(platform.machine())
    if number is None:
        pytest.skip(f"the number of sched_getattr on {platform.machine()} is not known here")
    command = [sys.executable, "-c", CODE, str(number), str(nice), policy]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=30)
    if "PermissionError" in ran.stderr:
        pytest.skip(f"the tests run under another policy and may not change to {policy}")
    assert ran.returncode == 0, ran.stderr
    found: list[Any] = json.loads(ran.stdout)
    return found


@pytest.mark.parametrize("nice", [0, 3])
def test_the_slice_is_longer_and_all_else_stays(nice: int) -> None:
    before, asked, after, thread = lengthened(nice)
    assert asked
    assert after[:2] == before[:2]
    assert after == thread
    if tuple(map(int, os.uname().release.split(".")[:2])) >= (6, 12):
        assert after[2] == SLICE > before[2]


def test_another_policy_is_left_as_it_is() -> None:
    before, asked, after, _ = lengthened(policy="SCHED_BATCH")
    assert not asked
    assert after == before
