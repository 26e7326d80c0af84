"""Display of a sweep: on a terminal one redrawn line per actuator; elsewhere only changes."""

import sys
from collections.abc import Sequence
from typing import TextIO

from twind_calibration.calibrating.sweep_tracker import SweepProgress, SweepStage

WIDTH = 24  # cells of a bar; the described range fills 20 of them
FULL = 20
PARTS = " ▏▎▍▌▋▊▉█"
MARK = {
    SweepStage.STILL: "",
    SweepStage.MOVING: "moving",
    SweepStage.DONE: "done",
    SweepStage.WRONG: "DOES NOT FIT",
}


def line(progress: SweepProgress, width: int) -> str:
    """Format one actuator: bar, travel beside the described range, the ends at which it has rested."""
    judged = progress.judged
    ends = "".join("●" if end else "○" for end in progress.ends)
    return (
        f"{progress.name:<{width}} {bar(judged.share)} {judged.radians:5.2f} of {progress.range:4.2f} rad "
        f"{100 * judged.share:4.0f} %  {ends}  {MARK[progress.stage]}"
    ).rstrip()


def bar(share: float) -> str:
    """Format a bar as long as the share of the described range, whose end is marked."""
    eighths = min(round(max(share, 0.0) * FULL * 8), WIDTH * 8)
    full, part = divmod(eighths, 8)
    cells = list(("█" * full + (PARTS[part] if part else "")).ljust(WIDTH))
    if cells[FULL] == " ":
        cells[FULL] = "▏"
    return "".join(cells)


class SweepDisplay:
    """Block of terminal lines that is redrawn in place. `live` False: nothing is drawn."""

    def __init__(self, out: TextIO | None = None, *, live: bool, rows: int = 24, columns: int = 80) -> None:
        self._out = out or sys.stdout
        self._live = live
        self._rows = rows
        self._columns = columns
        self._drawn: list[str] = []

    def draw(self, lines: Sequence[str]) -> None:
        """Replace the previous lines, as many as fit the terminal. Writes only changes."""
        if not self._live:
            return
        room = max(1, self._rows - 2)
        shown = [each[: self._columns - 1] for each in lines[:room]]
        if len(lines) > room:
            shown[-1] = f"... {len(lines) - room + 1} more: make the terminal taller"[: self._columns - 1]
        if shown == self._drawn:
            return
        same = len(shown) == len(self._drawn)
        known = self._drawn if same else [""] * len(shown)
        rows = ("\n" if now == then else f"\x1b[K{now}\n" for now, then in zip(shown, known, strict=True))
        self._out.write((f"\r\x1b[{len(shown)}A" if same and shown else self._back()) + "".join(rows))
        self._out.flush()
        self._drawn = shown

    def close(self) -> None:
        """Leave the drawn lines on the terminal: later output does not overwrite them."""
        self._drawn = []

    def print_line(self, text: str) -> None:
        """Print a permanent line above the redrawn lines, which are redrawn by the next `draw`."""
        self._out.write(f"{self._back()}{text}\n")
        self._out.flush()
        self._drawn = []

    def _back(self) -> str:
        up = f"\x1b[{len(self._drawn)}A" if self._drawn else ""
        return f"\r{up}\x1b[J" if self._live else ""
