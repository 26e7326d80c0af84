"""New files in folders where others may write: a link or file in the way is removed, never written to.

Standard library only.
"""

import errno
import os
from pathlib import Path
from types import MappingProxyType

# errors that nothing but a write meets, with their remedies; rights can be missing for a read too
UNWRITABLE = MappingProxyType(
    {
        errno.ENOSPC: "free space on that disk",
        errno.EDQUOT: "free space, or raise the quota of this user",
        errno.EROFS: "mount that file system writable",
    }
)
TRIES = 100  # a file that comes back each time is placed by another program
_FLAGS = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


def open_new(path: Path | str, mode: int, folder: int | None = None) -> int:
    """Return the descriptor of a new empty file, open for reading and writing. The caller closes it.

    `mode`: less what the umask takes. `folder`: descriptor that a relative `path` starts from. What is at
    `path` loses that name: no link is followed, and no other user holds the file open. Raises OSError.
    """
    for _ in range(TRIES):
        try:
            return os.open(path, _FLAGS, mode, dir_fd=folder)
        except FileExistsError:
            try:
                os.unlink(path, dir_fd=folder)
            except FileNotFoundError:
                continue
    why = "another program makes this file again and again; use a folder where only you may write"
    raise FileExistsError(errno.EEXIST, why, str(path))


def unwritten(error: OSError) -> str:
    """Return why something was not written, with the remedy where it is known."""
    why = error.strerror or str(error)
    remedy = "try with sudo" if isinstance(error, PermissionError) else UNWRITABLE.get(error.errno or 0)
    return f"{why}; {remedy}" if remedy else why


def write_new(path: Path, data: bytes, mode: int = 0o666) -> None:
    """Write `data` to a new file at `path`, as `open_new`. Raises OSError."""
    with open(open_new(path, mode), "wb") as file:
        file.write(data)
