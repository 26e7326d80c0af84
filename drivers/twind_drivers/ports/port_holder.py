"""Name of the process that has a port open, read from /proc as far as permissions allow. Linux only."""

import os
from collections.abc import Iterator
from itertools import chain
from pathlib import Path


def holder(path: str, *, search: bool = True) -> str:
    """Name the process that holds the device at `path`: "pid 4711 (twind --mode live)".

    `search`: also one without a flock, among all processes, which takes tens of milliseconds. Returns
    "another process (not visible to this user)" where /proc hides it.
    """
    for pid in chain(_lockers(path), _openers(path) if search else ()):
        return f"pid {pid} ({command(pid)})"
    return "another process (not visible to this user)" if search else f"another process (`fuser -v {path}`)"


def command(pid: int) -> str:
    """Return the command line of a process, at most 80 characters; its short name where that is hidden."""
    for file in ("cmdline", "comm"):
        try:
            text = (
                Path(f"/proc/{pid}/{file}").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
            )
        except OSError:
            continue
        if text:
            return text[:80]
    return "name hidden"


def _lockers(path: str) -> Iterator[int]:
    """Yield the pids that hold a flock on the device node.

    Format of /proc/locks: `1: FLOCK ADVISORY WRITE PID MAJOR:MINOR:INODE 0 EOF`.
    """
    try:
        node = os.stat(path)
        lines = Path("/proc/locks").read_text().splitlines()
    except OSError:
        return
    wanted = (os.major(node.st_dev), os.minor(node.st_dev), node.st_ino)
    for line in lines:
        words = line.split()
        if len(words) < 6 or words[1] != "FLOCK":
            continue
        major, minor, inode = words[5].split(":")
        if (int(major, 16), int(minor, 16), int(inode)) == wanted and int(words[4]) > 0:
            yield int(words[4])


def _openers(path: str) -> Iterator[int]:
    """Yield the pids, other than this process, with the device open, by /proc/PID/fd."""
    real = os.path.realpath(path)
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            links = [os.readlink(fd) for fd in (entry / "fd").iterdir()]
        except OSError:  # gone, or another user's
            continue
        if real in links:
            yield int(entry.name)
