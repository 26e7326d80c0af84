"""Time slice of the front process, so that the kernel's short work does not wait for it. Front process.

The bytes of every serial port and pseudo-terminal reach the loop by a kernel thread of normal priority
(`flush_to_ldisc`). A busy front process held it up for as long as its own slice lasts, which cost the bus
exchanges. Since Linux 6.12 a thread that wakes up interrupts one that has asked for a longer slice.
"""

import ctypes
import os
import platform

# ns; the usual slice is 1.4 to 3 ms. 5 ms changed little, as work that wakes up late in a slice still waits.
# 20 ms delayed no reply of the front beside two busy programs (measured 2026-11).
SLICE = 20_000_000
_SET_ATTR = {"x86_64": 314, "aarch64": 274, "riscv64": 274, "armv7l": 380}  # sched_setattr(2), by machine


class SchedAttr(ctypes.Structure):
    """`struct sched_attr` of <linux/sched/types.h>."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        ("runtime", ctypes.c_uint64),  # of normal scheduling: the slice, ns
        ("deadline", ctypes.c_uint64),
        ("period", ctypes.c_uint64),
    )


def lengthen() -> bool:
    """Ask for a slice of `SLICE`, for this thread and those that it starts; False: not possible.

    An older kernel accepts and ignores it. The share of the processor stays the same.
    """
    number = _SET_ATTR.get(platform.machine())
    if number is None or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return False
    wanted = SchedAttr(size=ctypes.sizeof(SchedAttr), nice=os.getpriority(os.PRIO_PROCESS, 0), runtime=SLICE)
    return bool(ctypes.CDLL(None).syscall(number, 0, ctypes.byref(wanted), 0) == 0)
