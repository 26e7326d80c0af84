"""The folder of recordings: names, and how much of a disk they may take."""

import contextlib
import fcntl
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

SHARE = 4  # of the budget one file may take a quarter: then the oldest goes, and not half of all
_OURS = re.compile(r"twind-[0-9]{8}T[0-9]{6}Z-[\w-]{1,60}(?<!-recovered)(\.[0-9]{1,4})?\.mcap")


@dataclass(frozen=True, slots=True)
class DiskQuota:
    """Limits of recordings on a disk, bytes and s."""

    keep: int  # all of them in this folder
    free: int  # what stays free of the disk
    file: int  # one file
    longest: float = 3600.0  # s, one file

    @property
    def largest(self) -> int:
        """Bytes at which the next file begins."""
        return max(1, min(self.file, self.keep // SHARE))


def fresh(folder: Path, time_ns: int, name: str) -> Path:
    """A path that nothing stands at: `twind-20261122T161500Z-h24.mcap`, in UTC."""
    when = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
    word = re.sub(r"[^\w-]+", "-", name).strip("-")[:59] or "robot"
    if f"-{word}".endswith("-recovered"):
        word += "_"  # that end is of the files of `twindctl recover`, which are never removed
    for more in range(1, 10_000):
        path = folder / f"twind-{when}-{word}{f'.{more}' if more > 1 else ''}.mcap"
        if not path.exists():
            return path
    raise FileExistsError(f"{folder}: no name is free for a recording of {when}")


def make_room(folder: Path, keep: int, spare: Path | None = None, newest: Sequence[Path] = ()) -> list[Path]:
    """Remove our oldest recordings until the rest takes at most `keep` bytes; return the removed ones.

    The oldest are those with the oldest last write: a name may be of a wrong clock. `newest`, in their order,
    go last, since the time of a file may be of that clock too.
    Files of others, a recording that is being written, and `spare` are never touched.
    """
    places = {path: place for place, path in enumerate(newest)}
    files = sorted((places.get(path, -1), time, path, size) for time, path, size in _ours(folder))
    total = sum(size for *_, size in files)
    removed = []
    for *_, path, size in files:
        if total <= keep:
            break
        if path != spare and _remove(path):
            removed.append(path)
            total -= size
    return removed


def free(folder: Path) -> int:
    """Bytes that this user may still write there. Raises OSError."""
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize


def _ours(folder: Path) -> Iterator[tuple[int, Path, int]]:
    """(time of the last write in ns, path, bytes on the disk)."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if _OURS.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                found = entry.stat(follow_symlinks=False)
                yield found.st_mtime_ns, Path(entry.path), found.st_size


def _remove(path: Path) -> bool:
    """False: another process writes it, or it cannot be removed."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        with contextlib.suppress(OSError):  # a file system without locks has no locked files
            if not _idle(fd):
                return False
        path.unlink()
    except OSError:
        return False
    finally:
        os.close(fd)
    return True


def _idle(fd: int) -> bool:
    """True if no process writes it. Raises OSError if the file system has no locks."""
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
