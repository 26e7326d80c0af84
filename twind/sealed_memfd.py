"""Sealed memfds (memfd_create(2)): bytes for another process that neither side can change."""

import fcntl
import os

SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE | fcntl.F_SEAL_SEAL


def seal(name: str, data: bytes) -> int:
    """Return a memfd with `data` that no process can change. The caller closes it."""
    fd = os.memfd_create(name, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        view = memoryview(data)
        while view:
            view = view[os.write(fd, view) :]
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, SEALS)
    except BaseException:
        os.close(fd)
        raise
    return fd


def sealed(fd: int) -> int:
    """Return `fd`, whose content no process can change. Raises ValueError and closes it if one can."""
    try:
        seals = fcntl.fcntl(fd, fcntl.F_GET_SEALS)
    except OSError:  # no memfd at all
        seals = 0
    if seals & SEALS != SEALS:
        os.close(fd)
        raise ValueError(f"memfd {fd} is not sealed: its contents could change after they were checked")
    return fd


def unseal(fd: int, most: int | None = None) -> bytes:
    """Return the content of a sealed `fd`, left open. Raises ValueError: changeable, or over `most` bytes."""
    if fcntl.fcntl(fd, fcntl.F_GET_SEALS) & SEALS != SEALS:
        raise ValueError(f"memfd {fd} is not sealed: its contents could change after they were checked")
    size = os.fstat(fd).st_size
    if most is not None and size > most:
        raise ValueError(f"memfd {fd} holds {size} bytes, at most {most} are taken")
    return os.pread(fd, size, 0)  # a mapping would cost the loop a page fault for each page
