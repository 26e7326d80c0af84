"""Realtime requests compared with what the kernel grants, seen from outside, in a process of its own."""

import ctypes
import json
import os
import subprocess
import sys
from functools import cache
from typing import Any

import pytest

from twind.loop.process import realtime
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

def faulted(work):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    work()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

kept = realtime.touch_reserve()
in_reserve = [faulted(lambda: b"x" * (1 << 20)) if got["heap"].granted else 0]
in_reserve += [faulted(lambda: [bytes(400) for _ in range(2048)]) for _ in range(5)]  # 1 MB

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
    "in_reserve": in_reserve,
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


def test_memory_that_ticks_ask_for_is_there_before_the_first() -> None:
    assert max(entered("none")["in_reserve"]) < 10  # of 256 pages each


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


RESIDENT = """
import json, mmap, sys
from pathlib import Path
from twind.loop.process import realtime

def resident(what, key="Rss"):
    found = here = 0
    for line in Path("/proc/self/smaps").read_text().splitlines():
        first = line.split()[0]
        here = what in line if "-" in first else here
        found += int(line.split()[1]) if here and first == key + ":" else 0
    return found

def all_resident():
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(status["VmRSS"].split()[0])

got = realtime.enter()
before = all_resident()
space = mmap.mmap(-1, 64 << 20, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
grown = all_resident() - before
space[0] = 1
text = "_multiarray_umath"
print(json.dumps([got["memory"].text, grown, resident(text) / resident(text, "Size"),
    resident("openblas") / resident("openblas", "Size"), resident("[heap]", "Locked") / resident("[heap]")]))
"""


def test_locked_memory_holds_what_a_tick_may_touch_and_no_unused_work_space() -> None:
    done = subprocess.run(
        [sys.executable, "-c", RESIDENT], capture_output=True, text=True, timeout=30, check=True
    )
    memory, grown, text, blas, heap = json.loads(done.stdout)
    if memory != "locked":
        pytest.skip(f"locked memory is not allowed here: {memory}")
    assert grown < 1024  # KiB of 64 MiB that were mapped
    assert text == 1.0
    assert blas < 0.5  # a library of 23 MB, of which a tick uses some products
    assert heap == 1.0


MAPS = """\
5581-5582 r-xp 00000000 fe:00 100 /usr/bin/python3
7f00-7f10 r--p 00001000 fe:00 101 /usr/lib/libscipy_openblas64_-32a4.so
7f10-7f20 r-xp 00001000 fe:00 102 /usr/lib/a folder/_structs.so
7f20-7f30 ---p 00001000 fe:00 102 /usr/lib/a folder/_structs.so
7f30-7f40 rw-s 00000000 00:01 103 /memfd:flight (deleted)
7f40-7f50 r-xp 00000000 fe:00 104 /usr/lib/libcrypto.so.3
7f50-7f60 rw-p 00000000 00:00 0 [heap]
7f60-7f70 rw-p 00000000 00:00 0
7f70-7f80 r-xp 00000000 fe:00 105 /usr/lib/libcryptography.so
"""


def test_files_are_brought_in_whole_except_what_the_start_alone_uses() -> None:
    assert list(realtime.mapped_files(MAPS)) == [
        (0x5581, 0x1),
        (0x7F10, 0x10),
        (0x7F30, 0x10),
        (0x7F70, 0x10),
    ]


def test_a_kernel_without_lock_on_fault_locks_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    class Kernel:
        def mlockall(self, flags: int) -> int:
            asked.append(flags)
            return -1 if flags & 4 else 0

    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: Kernel())
    assert realtime.lock_memory() == realtime.Granted("locked")
    assert asked == [7, 3]


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
