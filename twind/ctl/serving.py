"""The twind daemon whose sockets are gone: found by what it still listens on, and ended by SIGTERM.

A bound socket keeps its path after its file is removed, so the kernel still says who serves a folder.
A process is signalled by a pidfd, which never means another process. Standard library only.
"""

import os
import select
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from twind.client.places import directories

SOCKETS = ("control.sock", "observe.sock")
_FRONT = ["-m", "twind.front", "--parent"]  # words of a front's command line; the daemon's number follows
_LISTENS = 0x10000  # __SO_ACCEPTCON, in the flags of /proc/net/unix
PATIENCE = 2.0  # s that a daemon may be without a front: it starts one again


@dataclass(frozen=True, slots=True)
class Serving:
    """A daemon that listens in `folder`, though clients find no socket there."""

    folder: str
    uid: int
    pid: int = 0  # 0: this user may not see which process it is


def find(folders: Sequence[str], patience: float = PATIENCE) -> list[Serving]:
    """Daemons that listen in the first of `folders` that has any; none where none has one.

    Waits up to `patience` s where a process still listens, but has no front.
    """
    deadline = time.monotonic() + patience
    while True:
        for folder in folders:
            found = {serving for front in _fronts() if (serving := _served(front, folder)) is not None}
            if found:
                return sorted(found, key=lambda each: each.pid)
        listening = any(_inodes(os.getpid(), folder) for folder in folders)
        if not listening or time.monotonic() >= deadline:
            return []
        time.sleep(0.1)


def folders(place: str | None) -> Sequence[str]:
    """Folders whose sockets are tried, in order. `place`: the folder or socket of `--socket`."""
    if place is None:
        return directories()
    return [os.path.dirname(place) or "."] if place.endswith(".sock") else [place]


def described(serving: Serving) -> str:
    """The error for a client that finds no socket of a running daemon, with its remedy."""
    process = f"pid {serving.pid}" if serving.pid else f"uid {serving.uid}"
    remedy = (
        f"`twindctl --socket {os.path.abspath(serving.folder)} estop`, which lowers the robot and ends it"
    )
    return f"{serving.folder}: twind ({process}) runs, but its sockets are gone: try again, or {remedy}"


def terminate(serving: Serving) -> int:
    """Send SIGTERM; a pidfd of the daemon, the caller's to close.

    Raises PermissionError, and ProcessLookupError where it has ended or no longer serves that folder.
    """
    if not serving.pid:
        raise PermissionError(f"the daemon of {serving.folder} is a process of uid {serving.uid}")
    pidfd = os.pidfd_open(serving.pid)
    try:
        if not _holds(serving.pid, _inodes(serving.pid, serving.folder)):
            raise ProcessLookupError(f"process {serving.pid} no longer listens in {serving.folder}")
        signal.pidfd_send_signal(pidfd, signal.SIGTERM)
    except OSError:
        os.close(pidfd)
        raise
    return pidfd


def ended(pidfd: int, patience: float) -> bool:
    """The process has ended, within `patience` s. Closes the pidfd."""
    try:
        poll = select.poll()
        poll.register(pidfd, select.POLLIN)
        return bool(poll.poll(patience * 1e3))
    finally:
        os.close(pidfd)


def _fronts() -> Iterator[int]:
    """Fronts whose parent is still the daemon that started them: an orphan's parent is another program."""
    for name in os.listdir("/proc"):
        if name.isdecimal():
            with suppress(OSError):
                words = _read(f"/proc/{name}/cmdline").split("\0")
                if _FRONT[0] not in words:
                    continue
                at = words.index(_FRONT[0]) + len(_FRONT)
                if words[at - len(_FRONT) : at] == _FRONT and words[at] == str(_parent(int(name))):
                    yield int(name)


def _served(front: int, folder: str) -> Serving | None:
    """The daemon of this front, where both hold a socket that listens in `folder`."""
    with suppress(OSError, ValueError):
        inodes = _inodes(front, folder)
        if not inodes:
            return None
        uid = os.stat(f"/proc/{front}").st_uid
        try:
            daemon = _parent(front)
            if _holds(front, inodes) and _holds(daemon, inodes):
                return Serving(folder, uid, daemon)
        except PermissionError:
            return Serving(folder, uid)
    return None


def _inodes(pid: int, folder: str) -> set[str]:
    """Socket numbers that listen at a path of `folder`, in the network namespace of that process."""
    wanted = os.path.realpath(folder)
    found = set()
    for line in _read(f"/proc/{pid}/net/unix").splitlines()[1:]:
        _address, _count, _protocol, flags, _kind, _state, inode, *path = line.split(maxsplit=7)
        if path and int(flags, 16) & _LISTENS:
            directory, name = os.path.split(path[0])
            if name in SOCKETS and os.path.realpath(_absolute(pid, directory)) == wanted:
                found.add(inode)
    return found


def _absolute(pid: int, directory: str) -> str:
    """`directory`, of that process. One that this user may not see starts nowhere."""
    if os.path.isabs(directory):
        return directory
    try:
        return os.path.join(os.readlink(f"/proc/{pid}/cwd"), directory)
    except OSError:
        return "/nonexistent"


def _holds(pid: int, inodes: set[str]) -> bool:
    """The process has one of these sockets open. Raises PermissionError."""
    wanted = {f"socket:[{inode}]" for inode in inodes}
    for fd in os.listdir(f"/proc/{pid}/fd"):
        with suppress(FileNotFoundError):
            if os.readlink(f"/proc/{pid}/fd/{fd}") in wanted:
                return True
    return False


def _parent(pid: int) -> int:
    return int(_read(f"/proc/{pid}/stat").rpartition(")")[2].split()[1])


def _read(path: str) -> str:
    with open(path, encoding="utf-8", errors="surrogateescape") as file:
        return file.read()
