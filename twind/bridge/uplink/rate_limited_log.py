"""Log lines on stderr at a bounded rate, so that messages of a remote sender cannot fill the journal."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

AT_ONCE = 20  # lines
EACH = 1.0  # s from one to the next after that


@dataclass(slots=True)
class RateLimitedLog:
    """`write` gets a line; `now`: s. Lines without room are counted, and reported with the next one."""

    write: Callable[[str], None]
    now: Callable[[], float]
    _room: float = AT_ONCE
    _looked: float = float("-inf")
    _left_out: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __call__(self, line: str) -> None:
        """Log a line. From any thread."""
        with self._lock:
            now = self.now()
            self._room = min(AT_ONCE, self._room + (now - self._looked) / EACH)
            self._looked = now
            if self._room < 1.0:
                self._left_out += 1
                return
            self._room -= 1.0
            more = self._left_out
            self._left_out = 0
        self.write(f"{line} (and {more} lines before it, left out)" if more else line)
