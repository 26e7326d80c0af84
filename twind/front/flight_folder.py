"""Flight files in their folder: names, how many are kept, no two of one crash. Front process, in a thread.

Several daemons may share a folder: a name is taken by who makes its file first.
"""

import contextlib
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from twind.briefing import Briefing
from twind.flight import FlightError, Packed, about, save

KEPT, MOST = 20, 200 << 20  # files, and bytes of all: the newest stay
CRASH = "CRASH"  # the label of files of daemons that are gone
APART = 60.0  # s between two files of crashes of one robot: who crashes again and again leaves one a minute
LEFT = 3600.0  # s after which what a writer left unfinished is removed


def meta_of(
    briefing: Briefing, reason: str, label: str, mode: str | None = None, state: str | None = None
) -> dict[str, Any]:
    """The head of a file that is written now. `reason`: fault, inhibited, estop, dump, crash or failsafe."""
    return {
        "reason": reason,
        "code": label,
        "version": briefing.version,
        "robot": briefing.robot,
        "individual": briefing.parameters.get("individual"),
        "mode": mode,
        "state": state,
        "rate_hz": briefing.rate_hz,
        "buses": [bus["name"] for bus in briefing.description.get("buses", ())],  # as entries number them
        "wall_ns": time.time_ns(),  # when the two clocks were read
        "monotonic": time.monotonic(),
    }


def plain(briefing: Briefing) -> bytes:
    """A briefing for everybody: without the pickles, which only this daemon's own processes may open."""
    return msgspec.msgpack.encode(msgspec.structs.replace(briefing, binding=b"", described=b""))


@dataclass(frozen=True, slots=True)
class Folder:
    """`path` is made when the first file is written."""

    path: Path
    kept: int = KEPT
    most: int = MOST

    def write(self, label: str, meta: dict[str, Any], briefing: bytes, packed: Packed) -> Path | None:
        """A new file, `flight-20261122T161500Z-LABEL.flight` by `meta["wall_ns"]`; older ones make room.

        None: of a crash that is told already, or follows another too soon. Raises OSError.
        """
        self.path.mkdir(mode=0o750, parents=True, exist_ok=True)
        if label == CRASH and self._told(meta):
            return None
        path = self._reserve(label, meta["wall_ns"])
        try:
            save(path, meta, briefing, packed)
        except BaseException:
            with contextlib.suppress(OSError):
                path.unlink()
            raise
        self._make_room(path)
        return path

    def _reserve(self, label: str, wall_ns: int) -> Path:
        """A name that nobody else has, also at the same second."""
        stem = f"flight-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime(wall_ns // 1_000_000_000))}-{label}"
        for number in range(1, 1000):
            path = self.path / f"{stem}{f'-{number}' if number > 1 else ''}.flight"
            with contextlib.suppress(FileExistsError):
                os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o640))
                return path
        raise FileExistsError(f"{stem}.flight is there a thousand times")

    def _told(self, meta: dict[str, Any]) -> bool:
        """A crash of this robot was written down in the last minute."""
        now = meta["wall_ns"] / 1e9
        for path in self.path.glob(f"flight-*-{CRASH}*.flight"):
            with contextlib.suppress(OSError, FlightError):
                other = about(path) if abs(path.stat().st_mtime - now) < APART else {}
                if other and all(other.get(key) == meta[key] for key in ("reason", "robot", "individual")):
                    return True
        return False

    def _make_room(self, newest: Path) -> None:
        """Remove the oldest beyond what is kept, and what was begun and never finished.

        `newest` stays, whatever the clock says: of a machine that keeps no time it may be the oldest.
        """
        found = []
        for path in self.path.glob("flight-*.flight"):
            with contextlib.suppress(OSError):  # another daemon made room as well
                size, at = path.stat().st_size, path.stat().st_mtime_ns
                found.append((path == newest, at, path, size))
        bytes_kept = 0
        for place, (_, _, path, size) in enumerate(sorted(found, reverse=True)):
            bytes_kept += size
            if place >= self.kept or (place and bytes_kept > self.most):
                with contextlib.suppress(OSError):
                    path.unlink()
        for path in self.path.glob(".flight-*.tmp"):
            with contextlib.suppress(OSError):
                if abs(path.stat().st_mtime - time.time()) > LEFT:
                    path.unlink()
