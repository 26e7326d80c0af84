"""Progress of work of minutes: a plain line per step on standard error, for terminals, files and pipes.

Silent with --json. Standard library only.
"""

import argparse
import sys
import time
from collections.abc import Callable
from typing import Protocol, TextIO

from twind.command_line.progress import KNOWN_FROM, clock_text
from twind.command_line.verb import harmless


class StepReport(Protocol):
    """Function that is called at the begin of each step of a phase."""

    def __call__(self, text: str, share: float, seconds: float | None = None) -> None:
        """`share`: of the phase done before this step, 0..1; at 0 a phase begins.

        `seconds`: planned duration of the phase, if known.
        """


class PhaseLines:
    """`report = PhaseLines(options, "identify"); report("moves elbow (1 of 6)", 0.0, 180.0)`."""

    def __init__(
        self,
        options: argparse.Namespace,
        what: str,
        *,
        out: TextIO | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin each line with `what`."""
        self._what = what
        self._silent = bool(options.json)
        self._out = sys.stderr if out is None else out
        self._now = now
        self._begun = now()

    def __call__(self, text: str, share: float, seconds: float | None = None) -> None:
        """Print a line of a step, as `StepReport`, with the time that is left of its phase, if known."""
        now = self._now()
        if share <= 0.0:
            self._begun = now
        past = now - self._begun
        left = seconds * (1.0 - share) if seconds is not None else None
        if KNOWN_FROM <= share < 1.0:
            left = past / share - past
        if not self._silent:
            known = "" if left is None else f", about {clock_text(left)} left"
            print(harmless(f"{self._what}: {text}{known}"), file=self._out, flush=True)


def no_report(text: str, share: float, seconds: float | None = None) -> None:
    """Report nothing."""
