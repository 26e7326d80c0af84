"""Search for a twind daemon whose sockets are gone, by the sockets that it has open, and its end by SIGTERM.

A bound socket keeps its path after its file is removed, so the kernel still names the server of a folder.
A process is signalled by a pidfd, which never means another process. Standard library only.
"""

import os
import select
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from twind.client.find_socket import directories

SOCKETS = ("control.sock", "observe.sock")
_FRONT = ["-m", "twind.front", "--parent"]  # words of a front's command line; the daemon's number follows
_LISTENS = 0x10000  # __SO_ACCEPTCON, in the flags of /proc/net/unix
PATIENCE = 2.0  # s that a daemon may be without a front: it starts one again


@dataclass(frozen=True, slots=True)
class LostSocketDaemon:
    """A daemon that listens in `folder`, though clients find no socket there."""

    folder: str
    uid: int
    pid: int = 0  # 0: this user may not see which process it is


def find(folders: Sequence[str], patience: float = PATIENCE) -> list[LostSocketDaemon]:
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


def described(serving: LostSocketDaemon) -> str:
    """The error for a client that finds no socket of a running daemon, with its remedy."""
    process = f"pid {serving.pid}" if serving.pid else f"uid {serving.uid}"
    remedy = (
        f"`twindctl --socket {os.path.abspath(serving.folder)} estop`, which lowers the robot and ends it"
    )
    return f"{serving.folder}: twind ({process}) runs, but its sockets are gone: try again, or {remedy}"


def terminate(serving: LostSocketDaemon) -> int:
    """Send SIGTERM; a pidfd of the daemon, the caller's to close.

    Raises PermissionError, and ProcessLookupError where it has ended or no longer serves that folder.
    An ended process has no files left to look at, and its user may not look at them: that is no permission.
    """
    if not serving.pid:
        raise PermissionError(f"the daemon of {serving.folder} is a process of uid {serving.uid}")
    pidfd = os.pidfd_open(serving.pid)
    try:
        if not _holds(serving.pid, _inodes(serving.pid, serving.folder)):
            raise ProcessLookupError(f"process {serving.pid} no longer listens in {serving.folder}")
        signal.pidfd_send_signal(pidfd, signal.SIGTERM)
    except OSError as error:
        if ended(pidfd, 0.0):
            raise ProcessLookupError(f"process {serving.pid} has ended") from error
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
                if words[at - len(_FRONT) : at + 1] == [*_FRONT, str(_parent(int(name)))]:
                    yield int(name)


def _served(front: int, folder: str) -> LostSocketDaemon | None:
    """The daemon of this front: its parent, of the same user, with the same socket that listens in `folder`.

    Any user can bind that path in a mount namespace of its own, and name any parent for its process.
    """
    with suppress(OSError, ValueError):
        inodes = _inodes(front, folder)
        if not inodes:
            return None
        daemon = _parent(front)
        uid = _user(front)
        if _user(daemon) != uid:
            return None
        try:
            if any(_holds(front, {inode}) and _holds(daemon, {inode}) for inode in inodes):
                return LostSocketDaemon(folder, uid, daemon)
        except PermissionError:
            return LostSocketDaemon(folder, uid)
    return None


def _inodes(pid: int, folder: str) -> set[str]:
    """Socket numbers that listen at a path of `folder`, in the network namespace of that process.

    A name with a line break makes lines of its own, which any user can do: a line that is none is left out.
    """
    wanted = os.path.realpath(folder)
    found = set()
    for line in _read(f"/proc/{pid}/net/unix").split("\n")[1:]:
        with suppress(ValueError):
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


def _user(pid: int) -> int:
    """Effective user id. The owner of /proc/PID is root for a process that may not be dumped."""
    return int(_read(f"/proc/{pid}/status").partition("\nUid:")[2].split()[1])


def _parent(pid: int) -> int:
    return int(_read(f"/proc/{pid}/stat").rpartition(")")[2].split()[1])


def _read(path: str) -> str:
    with open(path, encoding="utf-8", errors="surrogateescape") as file:
        return file.read()
