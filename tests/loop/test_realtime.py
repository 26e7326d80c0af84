"""Realtime requests compared with what the kernel grants, seen from outside, in a process of its own."""

import json
import os
import subprocess
import sys
from functools import cache
from typing import Any

import pytest

from twind.loop.process.realtime import LIMIT, PRIORITY

CODE = """
import gc, json, os, resource, sys
from pathlib import Path
from twind.loop.process import realtime

rights, before, cpu = sys.argv[1:]
if rights == "none":
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
    if os.geteuid() == 0:
        os.setuid(65534)
if before:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(int(before)))
    except PermissionError:
        print(json.dumps(None))
        sys.exit()
got = realtime.enter(cpu=int(cpu) if cpu else None)

def churn():  # arrays that the allocator would map and give back each time
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(3):
        b"x" * (40 << 20)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

churn()
faults = churn()
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
child = os.fork()
if not child:
    os._exit(os.sched_getscheduler(0))
_, code = os.waitpid(child, 0)
print(json.dumps({
    "got": {what: each.text for what, each in got.items()},
    "denied": [what for what, each in got.items() if not each.granted],
    "fifo": os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO,
    "priority": os.sched_getparam(0).sched_priority,
    "locked": int(status["VmLck"].split()[0]),
    "collecting": gc.isenabled(),
    "frozen": gc.get_freeze_count(),
    "faults": faults,
    "cores": sorted(os.sched_getaffinity(0)),
    "child": os.waitstatus_to_exitcode(code),
}))
"""


@cache
def entered(rights: str = "ours", before: str = "", cpu: str = "") -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", CODE, rights, before, cpu], capture_output=True, text=True, timeout=30
    )
    assert done.returncode == 0, done.stderr
    told: dict[str, Any] | None = json.loads(done.stdout)
    if told is None:
        pytest.skip("FIFO is not allowed here")
    return told


def test_the_reported_realtime_state_equals_that_of_the_kernel() -> None:
    told = entered()
    got = told["got"]
    assert set(got) == {"scheduler", "memory", "timerslack", "heap", "blas", "gc", "cpu"}
    assert told["fifo"] == (got["scheduler"] == f"fifo {PRIORITY}") != got["scheduler"].startswith("no: ")
    assert told["priority"] == (PRIORITY if told["fifo"] else 0)
    assert (told["locked"] > 0) == (got["memory"] == "locked") != got["memory"].startswith("no: ")
    assert got["timerslack"] == "1 ns"
    assert got["blas"] == "1 thread"


def test_a_pinned_process_stays_on_its_core_and_an_unpinned_one_may_use_all() -> None:
    cores = sorted(os.sched_getaffinity(0))
    free = entered()
    pinned = entered(cpu=str(cores[-1]))
    assert (free["got"]["cpu"], free["cores"]) == ("any", cores)
    assert (pinned["got"]["cpu"], pinned["cores"]) == (f"pinned to {cores[-1]}", [cores[-1]])


def test_a_missing_core_is_reported_with_the_available_ones() -> None:
    told = entered(cpu="1023")
    assert told["got"]["cpu"].startswith("no: this process may run on 0")
    assert told["cores"] == sorted(os.sched_getaffinity(0))


def test_the_collector_is_off_and_what_is_there_is_frozen() -> None:
    told = entered()
    assert not told["collecting"]
    assert told["frozen"] > 1000
    assert told["got"]["gc"] == "frozen, off"


def test_memory_that_was_freed_is_not_faulted_in_again() -> None:
    told = entered("none")  # unlocked, where it costs most
    if told["got"]["heap"] == "kept":
        assert told["faults"] < 3 * 10  # 3 x 20 in the largest pages there are, else 3 x 10240
    else:
        assert told["got"]["heap"].startswith("no: ")


LEFT = """
import json, os
from pathlib import Path
from twind.loop.process import realtime

got = realtime.enter()
realtime.drop_realtime()
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
locked = int(status["VmLck"].split()[0])
print(json.dumps([got["scheduler"].text, got["memory"].text, policy == os.SCHED_OTHER, locked]))
"""


def test_work_after_the_loop_runs_without_realtime_priority_and_locked_memory() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LEFT], capture_output=True, text=True, timeout=30, check=True
    )
    scheduler, memory, ordinary, locked = json.loads(done.stdout)
    if (scheduler.startswith("no: "), memory) != (False, "locked"):
        pytest.skip(f"FIFO or locked memory is not allowed here: {scheduler}, {memory}")
    assert (ordinary, locked) == (True, 0)


def test_without_rights_the_loop_runs_and_reports_the_remedy() -> None:
    told = entered("none")
    assert not told["fifo"]
    assert told["locked"] == 0
    assert f"LimitRTPRIO={LIMIT}" in told["got"]["scheduler"]
    assert told["got"]["scheduler"].startswith("no: ")
    assert {"scheduler", "memory"} <= set(told["denied"])
    assert "LimitMEMLOCK=infinity" in told["got"]["memory"]
    assert told["got"]["memory"].startswith("no: ")
    assert not told["collecting"]


def test_a_child_of_the_loop_is_an_ordinary_process() -> None:
    assert entered()["child"] == 0  # SCHED_OTHER


def test_the_priority_that_the_unit_gave_stays() -> None:
    told = entered(before="7")
    assert told["got"]["scheduler"] == "fifo 7"
    assert told["priority"] == 7
