"""A process that sends a byte through a pseudo-terminal of its own, again and again, and prints what is late.

The kernel carries bytes of a pseudo-terminal by a worker that waits for a core as others do; no process that
it keeps waiting is to blame, and none of their accounts shows it.
"""

import os
import pty
import select
import sys
import time
import tty
from contextlib import suppress

EVERY = 0.005  # s
MOST = 0.001  # s
PRIORITY = 35  # SCHED_FIFO: between the servos and the daemon

if __name__ == "__main__":
    with suppress(OSError):  # else it waits as everybody does, and tells that too
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    while not select.select([sys.stdin], [], [], EVERY)[0]:  # ended by the end of its input
        sent = time.monotonic()
        os.write(theirs, b"x")
        select.select([ours], [], [])
        late = time.monotonic() - sent
        os.read(ours, 1)
        if late > MOST:
            print(f"a byte took {late * 1e3:.1f} ms through a pseudo-terminal", flush=True)
