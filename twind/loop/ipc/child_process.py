"""Start of a child of the loop: by exec, never by fork, with normal scheduling and in its own session.

Ctrl-C reaches the loop only. A child gets no bus descriptor: all descriptors of the loop are close-on-exec.
"""

import contextlib
import ctypes
import fcntl
import os
import signal
import sys
from collections.abc import Sequence
from typing import Any

FIRST = 3  # descriptor number in the child of the first that is handed over; the others follow
ABOVE = 64  # descriptors of the child are copied to here first, out of the way of their places
# <linux/prctl.h>
_PR_CAP_AMBIENT = 47
_CLEAR_ALL = 4


def spawn(arguments: Sequence[str], handed: Sequence[int], cpus: set[int]) -> int:
    """Start this interpreter with `arguments` and the descriptors `handed`; return its process id.

    `cpus`: cores that it may run on. Raises OSError.
    """
    with contextlib.ExitStack() as copies:
        actions = []
        for place, fd in enumerate(handed, FIRST):
            # Up and out of the way: dup2 onto 3, 4 ... must not overwrite a source that is still to come.
            high = fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, ABOVE)
            copies.callback(os.close, high)
            actions.append((os.POSIX_SPAWN_DUP2, high, place))
        copies.callback(os.sched_setaffinity, 0, os.sched_getaffinity(0))
        os.sched_setaffinity(0, cpus)  # a child inherits the affinity of its parent
        _keep_rights()
        return os.posix_spawn(
            sys.executable,
            # -P: no module of the folder that the daemon happened to be started in
            [sys.executable, "-P", *arguments],
            child_environment(),
            file_actions=actions,
            setsid=True,
            setsigdef=[signal.SIGINT, signal.SIGTERM, signal.SIGHUP],
            **_ordinary(),
        )


def _keep_rights() -> None:
    """Clear ambient capabilities (AmbientCapabilities=), so that no child inherits them (capabilities(7)).

    A kernel without ambient capabilities gives none.
    """
    ctypes.CDLL(None).prctl(_PR_CAP_AMBIENT, _CLEAR_ALL, 0, 0, 0)


def _ordinary() -> dict[str, Any]:
    """Return normal scheduling for the child of a real-time process; any other policy is kept.

    Leaving the idle class needs a right that a user may not have.
    """
    real_time = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)
    return {"scheduler": (os.SCHED_OTHER, os.sched_param(0))} if real_time else {}


def child_environment() -> dict[str, str]:
    """Return the environment for a child: no second BLAS thread, no variables of the service manager.

    Only the main process uses those.
    """
    excluded = ("LISTEN_", "NOTIFY_SOCKET", "WATCHDOG_")
    kept = {key: value for key, value in os.environ.items() if not key.startswith(excluded)}
    return {"OPENBLAS_NUM_THREADS": "1", **kept}
