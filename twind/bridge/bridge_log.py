"""Log of a bridge, on standard error. Standard library, Python 3.10.

A thread writes it, so that a blocked reader of standard error delays no command. A flood of lines is cut.
"""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from twind.command_line.verb import harmless

ROOM = 50  # lines that wait; what comes then is counted
PACE = 0.1  # s from one line to the next
GRACE = 0.5  # s at the end for what waits


def print_line(text: str) -> None:
    """Print a text as one line on standard error."""
    with suppress(OSError):  # no reader is left: the bridge itself goes on
        print(f"twindctl: {harmless('; '.join(text.splitlines()))}", file=sys.stderr, flush=True)


class BridgeLog:
    """Log. A call may be made from any thread and returns at once."""

    def __init__(self, write: Callable[[str], None] = print_line) -> None:
        """Make the log; `write` writes a line."""
        self._write = write
        self._ended = threading.Event()
        self._lines: queue.Queue[str] = queue.Queue(ROOM)
        self._missed = 0
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)

    def __call__(self, line: str) -> None:
        """Log a line."""
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self._missed += 1

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Write until the end of the context, and then what waits, for `GRACE` s at most."""
        self._thread.start()
        try:
            yield
        finally:
            self._ended.set()
            self._thread.join(GRACE)

    def _run(self) -> None:
        while not (self._ended.is_set() and self._lines.empty()):
            try:
                self._write(self._lines.get(timeout=PACE))
            except queue.Empty:
                continue
            missed = self._missed
            self._missed = 0
            if missed:
                self._write(f"{missed} lines came too fast to be written here")
            self._ended.wait(PACE)
