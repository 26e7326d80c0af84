"""A file's bytes, from a file: a pipe, a device or a folder in its place is refused, and never waited for.

Pure standard library; knows no format.
"""

import os
import stat
from pathlib import Path

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class NotAFile(OSError):
    """What stands there is no file, or one that is too large; `strerror` says which."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(0, reason, str(path))


def read_plain(path: Path, most: int) -> bytes:
    """All of a file of at most `most` bytes. Raises NotAFile, OSError, ValueError (a path with a NUL)."""
    # Without O_NONBLOCK, opening a pipe waits for a writer. What was opened is looked at, not a name.
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        kind = stat.S_IFMT(os.fstat(fd).st_mode)
        if kind != stat.S_IFREG:
            raise NotAFile(path, f"is {_KINDS.get(kind, 'something else')}, not a file")
        with open(fd, "rb", closefd=False) as file:
            data = file.read(most + 1)
    finally:
        os.close(fd)
    if len(data) > most:
        raise NotAFile(path, f"larger than {_size(most)}: not a file of ours")
    return data


def _size(count: int) -> str:
    return f"{count >> 20} MiB" if count >= 1 << 20 else f"{count >> 10} KiB"
