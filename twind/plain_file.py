"""Reading of plain files: a pipe, a device or a folder in place of a file is refused, without waiting.

Standard library only; independent of file formats.
"""

import os
import stat
from io import BufferedReader
from pathlib import Path

from twind.exceptions import InvalidInput

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def open_plain(path: Path | str) -> BufferedReader:
    """Open a regular file for reading. Raises InvalidInput (no file), OSError, ValueError (NUL in a path)."""
    # Without O_NONBLOCK, opening a pipe waits for a writer. The type of the open file is checked,
    # since another file may take the name meanwhile.
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        kind = stat.S_IFMT(os.fstat(fd).st_mode)
        if kind != stat.S_IFREG:
            raise InvalidInput(f"is {_KINDS.get(kind, 'something else')}, not a file", where=str(path))
        return open(fd, "rb")
    except BaseException:
        os.close(fd)
        raise


def read_plain(path: Path, most: int) -> bytes:
    """All of a file of at most `most` bytes.

    Raises InvalidInput (no file, or a larger one), OSError, ValueError (a path with a NUL).
    """
    with open_plain(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise InvalidInput(f"larger than {_size(most)}: not a file of ours", where=str(path))
    return data


def _size(count: int) -> str:
    return f"{count >> 20} MiB" if count >= 1 << 20 else f"{count >> 10} KiB"
