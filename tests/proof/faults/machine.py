"""Time for which the machine kept runnable processes waiting, from the kernel's account.

A process that waits for a core cannot answer in time. This is not what it says of itself, and nothing that is
done to it on purpose (a signal, a fault) counts: a stopped process wants nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from threading import Thread

LOOK = 0.02  # s between two looks
MOST = 0.001  # s within a look that a process may wait for a core: answers may take 2 ms, past all of them
ABOVE = 30  # SCHED_FIFO, below the daemon's own 40


class Machine(Thread):
    """Watches processes from `watch` on; `waits` is what was too long, in words."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self._waited: dict[int, float] = {}  # process id -> s until the last look
        self._names: dict[int, str] = {}
        self._over = False
        self.waits: list[str] = []
        command = [sys.executable, "-S", "-E", str(Path(__file__).with_name("probe.py"))]
        self._probe = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._listening = Thread(target=self._listen, daemon=True)
        self._listening.start()
        self.start()

    def watch(self, name: str, pid: int, *, first: bool = False) -> None:
        """From now on; `first`: it goes before the machine's other work, where that is allowed."""
        if first:
            with suppress(OSError):
                os.sched_setscheduler(pid, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(ABOVE))
        self._names[pid] = name
        self._waited.pop(pid, None)

    def forget(self) -> None:
        """Whatever was so far was before anything counted."""
        self.waits.clear()

    def note(self, what: str) -> None:
        """A disturbance that is seen elsewhere."""
        self.waits.append(what)

    def run(self) -> None:
        while not self._over:
            for pid, name in list(self._names.items()):
                waited = _waited(pid)
                if waited is None:
                    self._names.pop(pid, None)
                    continue
                more = waited - self._waited.get(pid, waited)
                self._waited[pid] = waited
                if more > MOST:
                    self.waits.append(f"{name} waited {more * 1e3:.0f} ms for a core")
            time.sleep(LOOK)

    def _listen(self) -> None:
        assert self._probe.stdout is not None
        for line in self._probe.stdout:
            self.waits.append(line.strip())

    def end(self) -> None:
        self._over = True
        assert self._probe.stdin is not None and self._probe.stdout is not None
        self._probe.stdin.close()
        self._probe.wait(5.0)
        self._listening.join(1.0)
        self._probe.stdout.close()
        self.join(1.0)


def _waited(pid: int) -> float | None:
    """s that its first thread was ready and had no core (proc(5), schedstat); None: it is gone."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) * 1e-9
    except (OSError, IndexError, ValueError):
        return None
