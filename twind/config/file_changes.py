"""Fingerprints of the files that describe the robot, to detect changes and to keep their texts."""

import hashlib
import os
import stat
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

LARGEST = 4 << 20  # bytes: no file of ours is that long


def fingerprint(path: Path) -> str:
    """sha256 of a regular file, in hex; empty where it cannot be read. Waits for no pipe and no device."""
    data = _contents(path)
    return "" if data is None else _hash(data)


def _contents(path: Path) -> bytes | None:
    """None where it cannot be read, is no regular file, or is too long."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        if not stat.S_ISREG(os.fstat(fd).st_mode):
            return None
        with os.fdopen(os.dup(fd), "rb") as file:
            data = file.read(LARGEST + 1)
        return None if len(data) > LARGEST else data
    except OSError:
        return None
    finally:
        os.close(fd)


def fingerprints(paths: Iterable[Path]) -> dict[str, str]:
    """Absolute path -> what it holds now."""
    return {str(path.absolute()): fingerprint(path) for path in paths}


def edited(files: Mapping[str, str]) -> list[str]:
    """Paths that hold something else by now, or cannot be read; one that never could be counts too."""
    return [path for path, before in files.items() if not before or fingerprint(Path(path)) != before]


def texts(files: Mapping[str, str], known: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the texts of the files with these fingerprints, by path: as `known`, or as still on the disk.

    A file with other contents now, or without UTF-8, is left out.
    """
    found = {}
    for path, before in files.items():
        kept = (known or {}).get(path, "").encode()
        data = kept if _hash(kept) == before else _contents(Path(path))
        if data is not None and _hash(data) == before:
            with suppress(UnicodeDecodeError):
                found[path] = data.decode()
    return found


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
