"""The two listening sockets: the service manager's when it hands them over, else our own.

The mode is set by the umask before `bind`, never by chmod after it: between the two, anybody could connect.
"""

import contextlib
import grp
import os
import pwd
import socket
import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from twind.streams import tell

NAMES = ("control", "observe")
WRECK = "flight"  # FDNAME of what the loop stores: the flight recorder of a daemon that is gone
GROUPS = {"control": "twind-operator", "observe": "twind-observe"}
BACKLOG = 128  # connections that may wait to be taken: a crowd must not turn away who wants to stop
_FIRST = 3  # SD_LISTEN_FDS_START


class SocketError(Exception):
    """A control socket could not be made."""


@dataclass(frozen=True, slots=True)
class Handed:
    """What the service manager handed over, ours to close; the memfd by who takes it (`Wreck`)."""

    sockets: Mapping[str, socket.socket] = field(default_factory=dict)  # that it listens on, by name
    wreck: int | None = None  # memfd of a daemon before us

    def close(self) -> None:
        """Let go of the sockets."""
        for listener in self.sockets.values():
            listener.close()


def handed_over() -> Handed:
    """What the service manager hands over, by FileDescriptorName= or FDNAME=; clears LISTEN_*.

    A socket by another name is told, and left to the manager: we neither serve nor close it.
    """
    count, mine = os.environ.get("LISTEN_FDS", ""), os.environ.get("LISTEN_PID", "")
    names = os.environ.get("LISTEN_FDNAMES", "").split(":")
    for key in ("LISTEN_FDS", "LISTEN_PID", "LISTEN_FDNAMES"):
        os.environ.pop(key, None)
    if not count.isdigit() or mine != str(os.getpid()):
        return Handed()
    found, wreck = {}, None
    handed = range(_FIRST, _FIRST + int(count))
    for fd in handed:
        os.set_inheritable(fd, False)
    for fd, name in zip(handed, names, strict=False):
        if name in NAMES:
            found[name] = socket.socket(fileno=fd)
        elif name == WRECK:
            if wreck is not None:
                os.close(wreck)
            wreck = fd
        else:
            known = " or ".join(NAMES)
            said = f"a socket named {name!r} was handed over, and nobody serves it"
            tell(2, "warning", f"twind: {said}: FileDescriptorName= of its unit must be {known}")
    return Handed(found, wreck)


def listen(directory: Path, name: str) -> socket.socket:
    """Bind `directory/name.sock`, mode 0660, for its group where there is one and we may give it.

    Which it became says `group_of`. Raises SocketError naming who or what is in the way.
    """
    path = directory / f"{name}.sock"
    try:
        _make(directory)
        _check_folder(directory)
        _clear_stale(path)
        listener = _bind(path)
    except OSError as error:
        remedy = "choose another folder with --socket DIR"
        if isinstance(error, PermissionError) and not os.path.lexists(directory):
            remedy = f"`sudo install -d -o {_user()} {directory}` makes its folder, or {remedy}"
        raise SocketError(f"{path}: {error.strerror or error}; {remedy}") from None
    with contextlib.suppress(KeyError, PermissionError):
        os.chown(path, -1, grp.getgrnam(GROUPS[name]).gr_gid)
    return listener


def group_of(listener: socket.socket) -> str:
    """The group that may use this socket, by name; its number where it has none, "" where nobody can say."""
    try:
        gid = os.stat(listener.getsockname()).st_gid
    except (OSError, ValueError):  # bound to no path: abstract, or handed over and removed since
        return ""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _make(directory: Path) -> None:
    """A folder that the groups can enter, whatever our umask; one that is there stays as it is."""
    old = os.umask(0o022)
    try:
        directory.mkdir(mode=0o755, parents=True, exist_ok=True)
    finally:
        os.umask(old)


def _check_folder(directory: Path) -> None:
    """Refuse a folder in which somebody else could put a socket in the place of ours."""
    if directory.is_symlink():
        raise SocketError(f"{directory}: is a symbolic link; give the folder it points to with --socket DIR")
    found = directory.stat()
    _check_owner(directory, found)
    group = found.st_mode & stat.S_IWGRP and found.st_gid not in (0, os.getegid())
    if group or found.st_mode & stat.S_IWOTH:
        mode = f"{stat.S_IMODE(found.st_mode):04o}"
        remedy = "`chmod go-w` it or choose another folder with --socket DIR"
        raise SocketError(f"{directory}: others may write there (mode {mode}); {remedy}")


def _check_owner(path: Path, found: os.stat_result) -> None:
    if found.st_uid in (0, os.geteuid()):
        return
    owner = f"uid {found.st_uid}"
    with contextlib.suppress(KeyError):
        owner = f"{pwd.getpwuid(found.st_uid).pw_name} ({owner})"
    remedy = "run twind as that user, `chown` it, or choose another folder with --socket DIR"
    raise SocketError(f"{path}: belongs to {owner}, not to us (uid {os.geteuid()}) or root; {remedy}")


def _user() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def _bind(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    old = os.umask(0o117)
    try:
        listener.bind(str(path))
        listener.listen(BACKLOG)
    except OSError:
        listener.close()
        raise
    finally:
        os.umask(old)
    return listener


def _clear_stale(path: Path) -> None:
    """Remove a socket that nobody listens on; refuse anything else that is there."""
    if path.is_symlink() or (path.exists() and not path.is_socket()):
        raise SocketError(f"{path}: is not a socket; remove it or choose another folder with --socket DIR")
    if not path.exists():
        return
    _check_owner(path, path.lstat())
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)  # a daemon that hangs lets its queue fill, and is there nevertheless
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except BlockingIOError:
            pass
    raise SocketError(
        f"{path}: another twind answers there; stop it or choose another folder with --socket DIR"
    )
