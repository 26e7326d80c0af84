"""Becomes another program, of a priority that it cannot raise: `python -m … PRIORITY PROGRAM ARGUMENTS`.

A daemon takes the priority of a robot's where it may. That of a replay is none, and one may run beside it.
"""

import ctypes
import os
import resource
import sys
from contextlib import suppress

# SCHED_FIFO where it is asked for: below a robot's loop, which has 40
DAEMON = 30
PORTS = 31
# <sys/prctl.h>
_PR_CAPBSET_DROP = 24
_PR_CAP_AMBIENT = 47
_CLEAR_ALL = 4
_CAP_SYS_NICE = 23  # <linux/capability.h>


def first(priority: int) -> None:
    """This thread before the ordinary programs of this machine, where that is allowed."""
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def main() -> None:
    """Priority 0: as any other program. Raises OSError: no such program."""
    priority = int(sys.argv[1])
    if priority:
        first(priority)
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    libc = ctypes.CDLL(None)
    libc.prctl(_PR_CAP_AMBIENT, _CLEAR_ALL, 0, 0, 0)
    libc.prctl(_PR_CAPBSET_DROP, _CAP_SYS_NICE, 0, 0, 0)  # refused to who has not the right either
    os.execv(sys.argv[2], sys.argv[2:])


if __name__ == "__main__":
    main()
