"""Recorder of a hand's path: states of `Monitor` become samples of the taught joints. Reads no clock."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twind.motion.hand_path import HandPath

# s without a reading of every joint. A shorter gap is bridged: at 10 rad/s², a quick hand, a curve over 0.1 s
# errs by 10 · 0.1² / 8 = 0.0125 rad. It is also the age from which the gate takes a joint for lost.
GAP = 0.1
LONGEST = 55.0  # s; the longest trajectory has 60, with the way to its start


class HandRecorder:
    """Samples from `__init__` on. `ended`: why no more are taken; "": it goes on.

    `cut_off`: it ended before it was asked to.
    """

    def __init__(self, joints: Sequence[str], period: float, seconds: float | None = None) -> None:
        """`period`: s between two readings of the daemon. `seconds`: to record; None: LONGEST."""
        self.joints = tuple(joints)
        self.ended = ""
        self.cut_off = False
        self.bridged = 0  # gaps between samples
        self._seconds = seconds
        self._period = period
        self._times: list[float] = []
        self._rows: list[list[float]] = []

    @property
    def seconds(self) -> float:
        """Time from the first sample to the last."""
        return self._times[-1] - self._times[0] if self._times else 0.0

    def path(self) -> HandPath | None:
        """The samples; None: there are fewer than two."""
        return HandPath(np.array(self._times), np.array(self._rows)) if len(self._times) > 1 else None

    def take(self, state: Mapping[str, Any]) -> None:
        """Take one message of topic `state`, unless the recording has ended."""
        if self.ended:
            return
        by_name = {row["name"]: row for row in state["joints"]}
        lost = [name for name in self.joints if name not in by_name]
        powered = [name for name in self.joints if name not in lost and by_name[name]["torque"]]
        if lost or state["mode"] == "sim":
            self.cut("the robot was changed" if lost else "the mode was changed to sim")
        elif powered:
            self.cut(f"torque came on: {', '.join(powered)}")
        else:
            self._take(float(state["time"]), [by_name[name] for name in self.joints])

    def cut(self, reason: str) -> None:
        """End the recording early; what was taken stays."""
        self.ended = self.ended or reason
        self.cut_off = True

    def _take(self, time: float, rows: Sequence[Mapping[str, Any]]) -> None:
        silent = [row["name"] for row in rows if not row["heard"] or row["position"] is None]
        if self._times and time - self._times[-1] > GAP:
            who = ", ".join(silent) or "the daemon"
            self.cut(f"no reading of {who} for {GAP:g} s")
        elif not silent and (not self._times or time > self._times[-1]):
            self._append(time, [float(row["position"]) for row in rows])

    def _append(self, time: float, row: list[float]) -> None:
        if (
            self._times and time - self._times[-1] > 2.5 * self._period
        ):  # a tick may be late, and the next early
            self.bridged += 1
        self._times.append(time)
        self._rows.append(row)
        if self._seconds is not None and self.seconds >= self._seconds:
            self.ended = f"after {self._seconds:g} s"
        elif self.seconds >= LONGEST:
            self.ended = f"{LONGEST:g} s are the longest that is recorded"
