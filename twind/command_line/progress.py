"""Progress of long work: one line on standard error that is drawn over. Standard library only.

Silent where standard error is no terminal, and with --json. The cursor is never hidden, so whatever ends the
process leaves a clean terminal. Call `clear` before other output; the next `update` draws again.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import TextIO, TypeVar

from twind.command_line.verb import harmless

PERIOD = 0.1  # s, shortest time between two drawings of the same step
BAR = 24  # characters
# elapsed time (s) and share from which the remaining time is estimated
KNOWN_AFTER = 2.0
KNOWN_FROM = 0.02
_Thing = TypeVar("_Thing")


class ProgressLine:
    """`with ProgressLine(options, "export") as progress: progress.update("joints", 0.4)`."""

    def __init__(
        self,
        options: argparse.Namespace,
        what: str,
        *,
        seconds: float | None = None,
        out: TextIO | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin the line with `what`. `seconds`: expected duration, for steps without a share."""
        self._out = sys.stderr if out is None else out
        self.live = not options.json and self._out.isatty() and os.environ.get("TERM") != "dumb"
        self._what = what
        self._seconds = seconds
        self._now = now
        self._begun = now()
        self._drawn = -PERIOD
        self._shown = ""

    def __enter__(self) -> "ProgressLine":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.clear()

    def update(self, text: str, share: float | None = None) -> None:
        """Draw the current step `text`.

        `share` is the completed fraction of the whole, 0..1 (None: unknown).
        """
        now = self._now()
        if not self.live or (text == self._shown and now - self._drawn < PERIOD):
            return
        self._drawn = now
        self._shown = text
        past = now - self._begun
        if share is None and self._seconds:
            share = past / self._seconds
        line = harmless("  ".join([self._what, *_share(share, past), text]))
        self._write(f"\r{line[: self._columns() - 1]}\x1b[K")

    def clear(self) -> None:
        """Erase the line to make room for a result or a question."""
        if self._drawn >= 0.0:
            self._drawn = -PERIOD
            self._write("\r\x1b[K")

    def each(self, things: Sequence[_Thing], say: Callable[[_Thing], str]) -> Iterator[_Thing]:
        """Yield the items one after the other, and show each as it is taken."""
        for place, thing in enumerate(things):
            self.update(say(thing), place / len(things))
            yield thing

    def _columns(self) -> int:
        try:
            return os.get_terminal_size(self._out.fileno()).columns or 80
        except (OSError, ValueError):
            return 80

    def _write(self, text: str) -> None:
        self._out.write(text)
        self._out.flush()


def _share(share: float | None, past: float) -> list[str]:
    """Parts of the line: the bar and the times, as far as they are known."""
    if share is None:
        return [clock_text(past)]
    share = max(0.0, min(1.0, share))
    done = int(share * BAR)
    parts = [f"{'━' * done}{'─' * (BAR - done)} {share:4.0%}", clock_text(past)]
    if past >= KNOWN_AFTER and KNOWN_FROM <= share < 1.0:
        parts[-1] += f", about {clock_text(past / share - past)} left"
    return parts


def clock_text(seconds: float) -> str:
    """Format a time, s, as `7:05`."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
