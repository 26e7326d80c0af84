"""Real-time set-up of the loop's process: requests and results. The daemon runs without any of it."""

import ctypes
import gc
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

PRIORITY = 40  # SCHED_FIFO: above the usual desktop services, below the kernel's own interrupt threads
RESERVE = 2 << 20  # bytes of heap, and of small objects, that are in memory before the first tick
LIMIT = 60  # LimitRTPRIO= of the units, and the value that messages name to users
# <sys/mman.h>
_MCL_CURRENT = 1
_MCL_FUTURE = 2
_MCL_ONFAULT = 4  # Linux 4.4
# <malloc.h>
_M_TRIM_THRESHOLD = -1
_M_MMAP_MAX = -4
_PR_SET_TIMERSLACK = 29  # <sys/prctl.h>
# Libraries that only the start uses, or of which a tick uses a small part: `one_thread` touches that of BLAS.
START_ONLY = re.compile(r"/(lib)?(\w*openblas\w*|gfortran|quadmath|crypto|ssl|_enums|_specs|_render)\b[^/]*$")
_MAPPING = re.compile(r"([0-9a-f]+)-([0-9a-f]+) r\S+ \S+ \S+ [1-9]\d* +(/.*)")  # readable, of a file


@dataclass(frozen=True, slots=True)
class Granted:
    """Result of one request to the system. `text` is for people."""

    text: str  # "fifo 40"; of a denied request "no: <reason>"
    granted: bool = True


def denied(reason: str) -> Granted:
    """Return the result of a request that the system did not grant."""
    return Granted(f"no: {reason}", granted=False)


def enter(priority: int = PRIORITY, cpu: int | None = None) -> dict[str, Granted]:
    """Request FIFO scheduling, locked memory and fine timers; freeze the garbage collector.

    `cpu`: the core to stay on; None: any. Returns the results by request, for `GetStatus`.
    """
    got = {"blas": one_thread(), "heap": _heap(), "memory": lock_memory(), "timerslack": _slack()}
    got["cpu"] = Granted("any") if cpu is None else pin(cpu)
    gc.collect()
    gc.freeze()
    gc.disable()
    got["gc"] = Granted("frozen, off")
    got["scheduler"] = fifo(priority)  # last: the steps before take long, and would hold up other processes
    return got


def touch_reserve() -> list[bytes]:
    """Bring memory in that ticks will ask for: after `enter`, which keeps it, and before the first tick.

    Keep the result: Python returns an arena of 1 MB when it is empty, and maps and faults it in anew.
    """
    np.ones(RESERVE // 8)
    small = [bytes(400) for _ in range(RESERVE // 448)]  # Python's own allocator: up to 512 bytes
    return small[::256]


def drop_realtime() -> None:
    """Return to normal scheduling and pageable memory, for work that takes time and memory."""
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    if policy in (os.SCHED_FIFO, os.SCHED_RR):  # the flag stays: to clear it takes a right of its own
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))
    ctypes.CDLL(None).munlockall()


def one_thread() -> Granted:
    """Keep matrix products in the calling thread, and allocate their work space before the first tick.

    OpenBLAS maps some 30 MB at its first product. In a process with locked memory that is faulted in at once:
    86 ms of a tick (measured 2026-11). A second thread of normal priority would starve behind a FIFO thread.
    """
    threadpool_limits(limits=1)
    square = np.ones((64, 64))
    return Granted("1 thread") if (square @ square @ square[0]).all() else denied("wrong products")


def fifo(priority: int) -> Granted:
    """Set SCHED_FIFO for this process, not for its children; return the result."""
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    if policy == os.SCHED_FIFO:  # the unit's CPUSchedulingPolicy= came first
        return Granted(f"fifo {os.sched_getparam(0).sched_priority}")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as error:
        remedy = f"LimitRTPRIO={LIMIT} or CPUSchedulingPolicy=fifo in the unit, or CAP_SYS_NICE"
        return denied(f"{error.strerror} ({remedy})")
    return Granted(f"fifo {priority}")


def pin(cpu: int) -> Granted:
    """Keep the calling thread on one core; return the result."""
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, OverflowError, ValueError):
        there = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
        return denied(f"this process may run on {there}, not on {cpu} (cpu: in the settings)")
    return Granted(f"pinned to {cpu}")


def _heap() -> Granted:
    """Keep freed memory in the process.

    Else every array of 100 kB is mapped, faulted in and returned anew.
    """
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallopt"):  # not glibc
        return denied("this C library has no mallopt")
    kept = libc.mallopt(_M_TRIM_THRESHOLD, -1) and libc.mallopt(_M_MMAP_MAX, 0)
    return Granted("kept") if kept else denied("mallopt refused")


def lock_memory() -> Granted:
    """Lock every page once it is in memory, and bring in what a tick may touch that is not.

    That is the text of libraries and the flight recorder. Pages of Python objects are there since they were
    written. Work space that is mapped and never used costs nothing: 170 MB less (measured 2026-11).
    """
    libc = ctypes.CDLL(None, use_errno=True)
    everything = _MCL_CURRENT | _MCL_FUTURE
    if libc.mlockall(everything | _MCL_ONFAULT) == 0:
        for start, length in mapped_files(Path("/proc/self/maps").read_text()):
            libc.mlock(ctypes.c_void_p(start), ctypes.c_size_t(length))  # faults in the whole range
        return Granted("locked")
    if libc.mlockall(everything) == 0:  # a kernel without MCL_ONFAULT
        return Granted("locked")
    return denied(f"{os.strerror(ctypes.get_errno())} (LimitMEMLOCK=infinity in the unit)")


def mapped_files(maps: str) -> Iterator[tuple[int, int]]:
    """Yield address and length of each readable mapping of a file, except of `START_ONLY`."""
    for line in maps.splitlines():
        found = _MAPPING.match(line)
        if found and not START_ONLY.search(found[3]):
            start = int(found[1], 16)
            yield start, int(found[2], 16) - start


def _slack() -> Granted:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0) == 0:
        return Granted("1 ns")
    return denied(os.strerror(ctypes.get_errno()))
