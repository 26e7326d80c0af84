"""Journal of commands and their results, on standard error. Standard library, Python 3.10.

A separate thread writes it: a blocked reader of standard error delays no stop.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping
from typing import Any

ROOM = 50  # lines that wait; what comes then is counted
PACE = 0.1  # s from one line to the next
GRACE = 0.5  # s at the end for what waits


class CommandJournal:
    """Journal of commands. `note` may be called from any thread and returns at once."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        """Start the journal; `tell` writes a line."""
        self._tell = tell
        self._ended = threading.Event()
        self._lines: queue.Queue[str] = queue.Queue(ROOM)
        self._missed = 0
        self._thread = threading.Thread(target=self._run, name="journal", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def note(self, result: Mapping[str, Any]) -> None:
        """A message of /bridge/results, or what a service answered."""
        try:
            self._lines.put_nowait(line(result))
        except queue.Full:
            self._missed += 1

    def close(self) -> None:
        """Write what waits, and end."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(GRACE)

    def _run(self) -> None:
        while not (self._ended.is_set() and self._lines.empty()):
            try:
                self._tell(self._lines.get(timeout=PACE))
            except queue.Empty:
                continue
            missed = self._missed
            self._missed = 0
            if missed:
                self._tell(f"{missed} outcomes of commands came too fast to be written here")
            self._ended.wait(PACE)


def line(result: Mapping[str, Any]) -> str:
    """Format `/cmd/joint_trajectory from 'mine': refused: POS_LIMIT: ...`."""
    who = f" from {result['frame_id']!r}" if result.get("frame_id") else ""
    request = f" {result['asked']}" if result.get("asked") else ""
    name = f" {result['id']}" if result.get("id") else ""
    why = f": {str(result['message'])[:500]}" if result.get("message") else ""
    return f"{result['topic']}{request}{who}: {result['phase']}{name}{why}"
