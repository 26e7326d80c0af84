"""Does a process grow? Memory and descriptors over time, with the beginning left out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

PAGE = os.sysconf("SC_PAGE_SIZE")
WARM = 0.25  # of the run: caches fill, tables are made
MOST_MEMORY = 3.0  # MB from the second quarter of a run to its last
MOST_FILES = 0  # descriptors, between the middles: a port that is away or a new front is no growth


def memory(pid: int | str = "self") -> float:
    """MB that are resident."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE / 1e6


def files(pid: int | str = "self") -> int:
    """Descriptors that are open."""
    return len(os.listdir(f"/proc/{pid}/fd"))


@dataclass
class Growth:
    """Samples of one process."""

    name: str
    time: list[float] = field(default_factory=list)  # s
    memory: list[float] = field(default_factory=list)  # MB
    files: list[int] = field(default_factory=list)

    def look(self, now: float, pid: int | str = "self") -> None:
        """One sample."""
        self.time.append(now)
        self.memory.append(memory(pid))
        self.files.append(files(pid))

    def _parts(self, values: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        kept = np.array(values[int(len(values) * WARM) :])
        third = max(1, len(kept) // 3)
        return kept[:third], kept[-third:]

    def figures(self) -> dict[str, float]:
        """MB and descriptors: at the beginning of what counts, at the end, and the slope a hour."""
        early, late = self._parts(self.memory)
        first, last = self._parts([float(each) for each in self.files])
        kept = int(len(self.time) * WARM)
        slope = 0.0
        if len(self.time) - kept > 5:
            slope = float(np.polyfit(self.time[kept:], self.memory[kept:], 1)[0]) * 3600.0
        return {
            "mb_early": round(float(np.median(early)), 2),
            "mb_late": round(float(np.median(late)), 2),
            "mb_per_hour": round(slope, 3),
            "files_early": float(np.median(first)),
            "files_late": float(np.median(last)),
        }

    def wrong(self) -> list[str]:
        """Quantities that grew; empty where there are too few samples."""
        if len(self.time) < 12:
            return []
        found = []
        it = self.figures()
        if it["mb_late"] - it["mb_early"] > MOST_MEMORY:
            found.append(f"{self.name}: memory grew from {it['mb_early']} to {it['mb_late']} MB")
        if it["files_late"] - it["files_early"] > MOST_FILES:
            found.append(f"{self.name}: descriptors grew from {it['files_early']} to {it['files_late']}")
        return found
