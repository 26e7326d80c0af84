"""Folder of flight files: their names and number, one per crash. Front process, in a thread.

Several daemons may share a folder. A file is written under a temporary name and renamed when it is whole: a
process killed meanwhile leaves no file that counts.
"""

import contextlib
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from twind.briefing import Briefing
from twind.exceptions import InvalidInput
from twind.flight import PackedFlight, about, draft, settle

# files, and bytes of all: the newest stay
KEPT = 20
MOST = 200 << 20
CRASH = "CRASH"  # the label of files of daemons that are gone
FAILSAFE = "FAILSAFE"  # and of those that lowered a robot
APART = 60.0  # s between two files of crashes of one robot: without it a crash loop would fill the folder
LEFT = 60.0  # s after which what a writer left unfinished is removed: it takes some 2 s


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
    """Return a briefing without the pickles, which only this daemon's own processes may open."""
    return msgspec.msgpack.encode(msgspec.structs.replace(briefing, binding=b"", described=b""))


@dataclass(frozen=True, slots=True)
class FlightFolder:
    """Folder of flight files. `path` is made when the first file is written."""

    path: Path
    kept: int = KEPT
    most: int = MOST

    def write(self, label: str, meta: dict[str, Any], briefing: bytes, packed: PackedFlight) -> Path | None:
        """Write `flight-20261122T161500Z-LABEL.flight`, named by `meta["wall_ns"]`; older files make room.

        Returns None for a crash that is already recorded, or follows another too soon. Raises OSError.
        """
        self.path.mkdir(mode=0o750, parents=True, exist_ok=True)
        if meta["reason"] == "crash" and self._is_crash_reported(meta):
            return None
        self._make_room()  # before it too: of a full disk it may be what was left here that fills it
        at = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(meta["wall_ns"] // 1_000_000_000))
        stem = f"flight-{at}-{label}"
        beside = self.path / f".{stem}-{os.getpid()}.tmp"
        draft(beside, meta, briefing, packed)
        try:
            path = self._publish(beside, stem)
        finally:
            with contextlib.suppress(OSError):
                beside.unlink()
        self._make_room(path)
        return path

    def _publish(self, beside: Path, stem: str) -> Path:
        """Rename to a name that no other file has, also at the same second."""
        for number in range(1, 1000):
            path = self.path / f"{stem}{f'-{number}' if number > 1 else ''}.flight"
            with contextlib.suppress(FileExistsError):
                os.link(beside, path)
                settle(self.path)
                return path
        raise FileExistsError(f"{stem}.flight is there a thousand times")

    def _is_crash_reported(self, meta: dict[str, Any]) -> bool:
        """A crash of this robot was written down in the last minute."""
        now = meta["wall_ns"] / 1e9
        for path in self.path.glob(f"flight-*-{CRASH}*.flight"):
            with contextlib.suppress(OSError, InvalidInput):
                other = about(path) if abs(path.stat().st_mtime - now) < APART else {}
                if other and all(other.get(key) == meta[key] for key in ("reason", "robot", "individual")):
                    return True
        return False

    def _make_room(self, newest: Path | None = None) -> None:
        """Remove the oldest files beyond the limit, and unfinished ones.

        `newest` stays, whatever the clock shows: on a machine without a clock battery it may appear oldest.
        """
        found = []
        for path in self.path.glob("flight-*.flight"):
            with contextlib.suppress(OSError):  # another daemon made room as well
                size = path.stat().st_size
                at = path.stat().st_mtime_ns
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
