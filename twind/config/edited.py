"""Were the files that describe the robot written anew since they were read? Asked before arming."""

import hashlib
import os
import stat
from collections.abc import Iterable, Mapping
from pathlib import Path

LARGEST = 4 << 20  # bytes: no file of ours is that long


def fingerprint(path: Path) -> str:
    """sha256 of a regular file, in hex; empty where it cannot be read. Waits for no pipe and no device."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return ""
    try:
        if not stat.S_ISREG(os.fstat(fd).st_mode):
            return ""
        with os.fdopen(os.dup(fd), "rb") as file:
            data = file.read(LARGEST + 1)
        return "" if len(data) > LARGEST else hashlib.sha256(data).hexdigest()
    except OSError:
        return ""
    finally:
        os.close(fd)


def fingerprints(paths: Iterable[Path]) -> dict[str, str]:
    """Absolute path -> what it holds now."""
    return {str(path.absolute()): fingerprint(path) for path in paths}


def edited(files: Mapping[str, str]) -> list[str]:
    """Paths that hold something else by now, or cannot be read; one that never could be counts too."""
    return [path for path, before in files.items() if not before or fingerprint(Path(path)) != before]
